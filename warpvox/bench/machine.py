"""The machine that figures belong to."""

from __future__ import annotations

import platform
from typing import Any

import torch
import warp as wp

from warpvox import __version__
from warpvox.devices.out_of_memory import free_memory
from warpvox.system import processor_name, usable_cores

__all__ = ["available_memory", "machine", "machine_line"]


def machine(device: str) -> dict[str, Any]:
    """Processor, device and versions."""
    facts: dict[str, Any] = {
        "cpu": processor_name(),
        "cores": usable_cores(),
        "system": platform.platform(),
        "python": platform.python_version(),
        "torch": torch.__version__,
        "warp": wp.__version__,
        "warpvox": __version__,
    }
    if device != "cpu":
        properties = torch.cuda.get_device_properties(device)
        facts |= {"gpu": properties.name, "gpu_gib": round(properties.total_memory / 2**30, 1)}
    return facts


def machine_line(facts: dict[str, Any]) -> str:
    """The same as a sentence."""
    gpu = f"{facts['gpu']}, " if "gpu" in facts else ""
    return (
        f"{gpu}{facts['cores']} usable cores of {facts['cpu']}; Python {facts['python']}, torch {facts['torch']},"
        f" warp {facts['warp']}, warpvox {facts['warpvox']}"
    )


def available_memory(device: str) -> float:
    """Bytes that can still be allocated on the device; infinite where the system does not report it."""
    free = free_memory(device)
    return float("inf") if free is None else float(free)
