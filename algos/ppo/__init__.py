"""PPO: that of rsl-rl, and one for many policies side by side, whose iterations CUDA graphs repeat."""
