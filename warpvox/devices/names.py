"""Device names: ``auto``, ``cpu``, ``cuda:<index>``."""

import re

import torch
import warp as wp

from warpvox.devices.startup import start_warp
from warpvox.errors import DeviceError

ENOUGH = 256
"""Environments from which "auto" takes a GPU. Beside 16 cores an H200 steps 64 environments faster; in a training the
host launches for 0.1 s an iteration, however many environments there are (docs/performance.md)."""


def missing_cuda() -> str | None:
    """Return why torch or Warp cannot use a CUDA device; None if both can."""
    start_warp()
    torch_has = torch.cuda.is_available()
    warp_has = wp.is_cuda_available()
    if torch_has and warp_has:
        return None

    # torch
    of_torch = "has a device"
    if not torch_has and torch.version.cuda is None:
        of_torch = f"{torch.__version__} is built without CUDA"
    elif not torch_has:
        of_torch = f"finds no device (it is built for CUDA {torch.version.cuda})"

    # Warp's own packages are built for CUDA 13.
    needed = "NVIDIA driver 580 or newer"
    toolkit = wp.get_cuda_toolkit_version()
    driver = wp.get_cuda_driver_version()
    if warp_has:
        of_warp = "has a device"
    elif toolkit is None:
        of_warp = "is built without CUDA"
    elif driver is None:
        of_warp = f"finds no driver ({needed} is needed)"
    elif driver < (toolkit[0], 0):
        of_warp = f"refuses the driver, which is of CUDA {driver[0]}.{driver[1]}: {toolkit[0]}.0 is needed ({needed})"
    else:
        of_warp = "finds no device"
    return f"torch {of_torch}, Warp {of_warp}"


def resolve_device(device: str, num_envs: int | None = None) -> str:
    """Return torch's name of a device given as 'auto', 'cpu', 'cuda' or 'cuda:<index>'.

    Args:
        device: 'auto': CUDA where there is one, if there are environments enough for it (:data:`ENOUGH`).
        num_envs: how many; None: enough.

    Raises:
        DeviceError: no such device here.
    """
    start_warp()
    name = str(device)[:80]
    has_cuda = torch.cuda.is_available() and wp.is_cuda_available()
    if name == "auto":
        return "cuda:0" if has_cuda and (num_envs is None or num_envs >= ENOUGH) else "cpu"
    if name == "cpu":
        return name
    kind, _, number = name.partition(":")
    if kind != "cuda" or not re.fullmatch("[0-9]{0,4}", number):
        raise DeviceError(f"Unknown device {name!r}; valid are 'auto', 'cpu', 'cuda' and 'cuda:<index>'.")
    found = torch.cuda.device_count() if has_cuda else 0
    if int(number or 0) >= found:
        have = f"this machine has {found} CUDA device(s)" if found else f"no CUDA device was found: {missing_cuda()}"
        raise DeviceError(f"Device {device!r} is not available: {have}. Use device=cpu or device=auto.")
    return f"cuda:{int(number or 0)}"
