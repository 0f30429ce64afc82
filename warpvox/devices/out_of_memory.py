"""Error messages for running out of memory, on a GPU or in the machine."""

import re
from collections.abc import Iterator
from contextlib import contextmanager

from warpvox.errors import DeviceError
from warpvox.system import available_memory


def shortage(error: BaseException) -> str | None:
    """Describe the failed allocation behind an error as part of a sentence; None if memory was not the cause."""
    if not isinstance(error, (MemoryError, RuntimeError)):
        return None
    text = " ".join(str(error).split())

    # Libraries have no common class for it.
    signs = (
        r"out of memory"  # torch and CUDA
        r"|failed to allocate"  # Warp
        r"|can't allocate memory|not enough memory"  # torch on the CPU
        r"|unable to allocate"  # numpy
        r"|cuda_error_out_of_memory|cublas_status_alloc_failed"
    )
    if not isinstance(error, MemoryError) and not re.search(signs, text, re.IGNORECASE):
        return None

    # What was asked for, or the first two sentences
    asked = re.search(r"(?:allocate|allocate:|tried to allocate)\D{0,40}?(\d+)\s+bytes", text, re.IGNORECASE)
    if asked:
        where = re.search(r"'((?:cuda|cpu)[:\d]*)'", text)
        size = int(asked[1]) / 2**30
        return f"{size:.3g} GiB more could not be had{f' on {where[1]}' if where else ''}"
    sentences = re.split(r"(?<=[.!])\s+(?=[A-Z])", text)
    return ". ".join(part.rstrip(".") for part in sentences[:2])[:200] or "memory is used up"


def free_memory(device: str) -> int | None:
    """Return the free memory of a device (``cpu``, ``cuda:<index>``) in bytes; None if unknown."""
    if device == "cpu":
        return available_memory()
    import torch

    # what torch has cached and does not use counts as taken by the device, but can be used again
    cached = torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
    return int(torch.cuda.mem_get_info(device)[0]) + cached


def fewer(num_envs: int) -> str:
    """Return the advice to halve ``num_envs``, as a sentence for :func:`enough_memory`."""
    half = f"num_envs={num_envs // 2} instead of {num_envs}" if num_envs > 1 else "a smaller body"
    return f"Take {half}, or free memory that other programs or tensors hold on the device."


@contextmanager
def enough_memory(advice: str) -> Iterator[None]:
    """Convert out-of-memory errors within the block to a DeviceError that ends with ``advice``, a sentence."""
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        reason = None if isinstance(error, DeviceError) else shortage(error)
        if reason is None:
            raise
        raise DeviceError(f"Memory has run out ({reason}). {advice}") from error
