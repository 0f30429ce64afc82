"""Devices by name."""

import re

import torch
import warp as wp

from warpvox.devices.startup import start_warp
from warpvox.errors import DeviceError

ENOUGH = 256
"""Environments from which "auto" takes a GPU. Beside 16 cores an H200 steps 64 environments faster; in a training the
host launches for 0.1 s an iteration, however many environments there are (docs/performance.md)."""
DRIVER = "NVIDIA driver 580 or newer"
"""For Warp's own packages, which are built for CUDA 13."""


def missing_cuda() -> str | None:
    """Which of torch and Warp has no CUDA device, and why; None: both have one."""
    start_warp()
    found = torch.cuda.is_available(), wp.is_cuda_available()
    if all(found):
        return None
    toolkit, driver = wp.get_cuda_toolkit_version(), wp.get_cuda_driver_version()
    of_torch, of_warp = f"finds no device (it is built for CUDA {torch.version.cuda})", "finds no device"
    if torch.version.cuda is None:
        of_torch = f"{torch.__version__} is built without CUDA"
    if toolkit is None:
        of_warp = "is built without CUDA"
    elif driver is None:
        of_warp = f"finds no driver ({DRIVER} is needed)"
    elif driver < (toolkit[0], 0):
        of_warp = f"refuses the driver, which is of CUDA {driver[0]}.{driver[1]}: {toolkit[0]}.0 is needed ({DRIVER})"
    return ", ".join(
        f"{name} {'has a device' if has else why}"
        for name, has, why in zip(("torch", "Warp"), found, (of_torch, of_warp), strict=True)
    )


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
