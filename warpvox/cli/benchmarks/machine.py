"""The machine that figures belong to."""

from __future__ import annotations

import os
import platform
from typing import Any

import torch
import warp as wp

from warpvox import __version__
from warpvox.cli.info import cpu_name

__all__ = ["available_memory", "core_count", "machine", "machine_line"]


def core_count() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def machine(device: str) -> dict[str, Any]:
    """Processor, device and versions."""
    facts: dict[str, Any] = {
        "cpu": cpu_name(),
        "cores": core_count(),
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
    """Bytes that can still be had on the device; infinite where the system does not tell."""
    if device != "cpu":
        return float(torch.cuda.mem_get_info(device)[0])
    try:
        return float(os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError, OSError):
        return float("inf")
