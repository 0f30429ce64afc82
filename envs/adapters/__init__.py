"""Environments behind the interfaces of other libraries: gymnasium, rsl-rl, Stable-Baselines3."""
