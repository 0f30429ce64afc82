"""Devices by name."""

from __future__ import annotations

import re

import torch
import warp as wp

from warpvox.devices.startup import start_warp
from warpvox.errors import DeviceError

__all__ = ["ENOUGH", "resolve_device"]

ENOUGH = 1000
"""Environments from which "auto" takes a GPU. With one thread an environment, in exact arithmetic or in worlds too
large for a group, fewer are stepped faster by a core of the CPU; a group of threads should need fewer. Both are
predictions, see docs/performance.md."""


def resolve_device(device: str, num_envs: int | None = None) -> str:
    """The torch name of a device: 'auto', 'cpu', 'cuda', 'cuda:<index>'.

    Args:
        device: 'auto': CUDA where there is one, if there are environments enough for it (:data:`ENOUGH`).
        num_envs: how many; None: enough.

    Raises:
        DeviceError: no such device here.
    """
    start_warp()
    name = str(device)[:80]
    if name == "auto":
        if num_envs is not None and num_envs < ENOUGH:
            return "cpu"
        return "cuda:0" if torch.cuda.is_available() and wp.is_cuda_available() else "cpu"
    if name == "cpu":
        return name
    kind, _, number = name.partition(":")
    if kind != "cuda" or not re.fullmatch("[0-9]{0,4}", number):
        raise DeviceError(f"Unknown device {name!r}; valid are 'auto', 'cpu', 'cuda' and 'cuda:<index>'.")
    found = torch.cuda.device_count() if torch.cuda.is_available() and wp.is_cuda_available() else 0
    if int(number or 0) >= found:
        have = f"this machine has {found} CUDA device(s)" if found else "no CUDA device was found"
        raise DeviceError(f"Device {device!r} is not available: {have}. Use device=cpu or device=auto.")
    return f"cuda:{int(number or 0)}"
