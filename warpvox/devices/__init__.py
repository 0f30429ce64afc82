"""Devices: their names, free memory, the start of Warp and its kernel cache."""
