"""Policies that control bodies of any shape voxel by voxel, as models for rsl-rl's PPO."""
