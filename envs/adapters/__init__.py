"""Adapters to the environment interfaces of gymnasium, rsl-rl and Stable-Baselines3."""
