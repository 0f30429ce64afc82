"""Devices: their names, their memory, the start of Warp and its cache of kernels."""
