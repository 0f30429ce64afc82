"""Policies that control bodies of any shape, voxel by voxel, as models that rsl-rl's PPO trains."""
