"""The one way to a device: what every kernel is compiled with, and where it is launched and arrays are allocated.

On CUDA a launch goes to torch's current stream of the device, so that it is in order with torch's operations whichever
stream they are on, and can be part of a graph that torch captures. Memory is torch's, which does not reuse it while
work on that stream is pending. Warp's own streams, allocator and copies are not used.
"""

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

import numpy as np
import warp as wp

kernel: Callable[[Callable[..., None]], wp.Kernel] = wp.kernel(
    enable_backward=False, module="unique", module_options={"fuse_fp": False}
)
"""Decorator: a kernel in a module of its own. Contacts at time 0 and thresholds of tasks hang on the last bit of a
double: round as the formulas are written, with fused multiply-add where they say so alone (`fused`), because the places
that a compiler chooses differ between devices."""


def register_limited(registers: int, block: int) -> Any:
    """Decorator: such a kernel for blocks of so many threads with at most so many registers each on CUDA, and no loop
    over the grid."""
    options = {"fuse_fp": False, "block_dim": block}
    return wp.kernel(
        enable_backward=False, module="unique", module_options=options, grid_stride=False, cuda_max_registers=registers
    )


BLOCK = 64
"""Threads of a CUDA block. With one thread an environment the step takes 240 registers a thread: one block of Warp's
256 fits into a multiprocessor, and a batch of 4,096 environments would keep 16 multiprocessors busy."""

SMALL = 1 << 16
"""Bytes of the largest array that shares a block of memory with others."""
ALIGNMENT = 64
"""Bytes of a cache line, at which arrays begin."""

_streams: dict[tuple[str, int], wp.Stream] = {}


def on_cuda(device: str) -> bool:
    """Whether a device (``cpu``, ``cuda:<index>``) has streams."""
    return device != "cpu"


def current_stream(device: str) -> wp.Stream:
    """Torch's current stream of a CUDA device, as Warp's; made once for each stream."""
    import torch

    stream = torch.cuda.current_stream(device)
    key = device, stream.cuda_stream
    if key not in _streams:
        _streams[key] = wp.stream_from_torch(stream)
    return _streams[key]


class Command:
    """A recorded launch for CUDA: goes to the stream that is torch's current one when it is launched."""

    def __init__(self, command: wp.Launch, device: str) -> None:
        self._command, self._device = command, device

    def launch(self) -> None:
        """Launch the kernel."""
        self._command.launch(stream=current_stream(self._device))


def launch(kernel: wp.Kernel, dim: Any, inputs: Sequence[Any], device: str) -> None:
    """Launch a kernel over ``dim`` threads."""
    if on_cuda(device):
        wp.launch(kernel, dim, inputs, device=device, stream=current_stream(device), block_dim=BLOCK)
    else:
        wp.launch(kernel, dim, inputs, device=device)


def record(
    kernel: wp.Kernel, dim: Any, inputs: Sequence[Any], device: str, block: int = BLOCK, together: bool = False
) -> wp.Launch | Command:
    """A launch that can be repeated by ``launch()`` for a fraction of its cost; arrays must stay where they are.

    Args:
        block: threads of a block, on CUDA.
        together: the threads of a block wait for each other; on the CPU they run in turns from barrier to barrier.
    """
    if on_cuda(device):
        command = wp.launch(kernel, dim, inputs, device=device, record_cmd=True, block_dim=block)
        return Command(cast("wp.Launch", command), device)
    before = wp.config.enable_cpu_blocks
    wp.config.enable_cpu_blocks = together
    try:
        command = wp.launch(kernel, dim, inputs, device=device, record_cmd=True, block_dim=block if together else 1)
        return cast("wp.Launch", command)
    finally:
        wp.config.enable_cpu_blocks = before


def zeros(shape: tuple[int, ...], dtype: Any, device: str) -> wp.array:
    """A zeroed array ``shape`` of a scalar or vector type."""
    if not on_cuda(device):
        return wp.zeros(shape, dtype=dtype, device=device)
    import torch

    dtype = {int: wp.int32, float: wp.float32}.get(dtype, dtype)
    scalar, inner = getattr(dtype, "_wp_scalar_type_", dtype), getattr(dtype, "_shape_", ())
    return wp.from_torch(torch.zeros((*shape, *inner), dtype=wp.dtype_to_torch(scalar), device=device), dtype=dtype)


def zeros_together(kinds: Mapping[str, tuple[tuple[int, ...], Any]], device: str) -> dict[str, wp.array]:
    """Zeroed arrays by name, from their shapes and types. On the CPU the small ones share one block of memory.

    A simulation of one environment has a hundred arrays of some hundred bytes, and every allocation takes 15 us.
    """
    if on_cuda(device):
        return {name: zeros(shape, dtype, device) for name, (shape, dtype) in kinds.items()}

    # Places in the block
    place = {}
    end = 0
    for name, (shape, dtype) in kinds.items():
        size = math.prod(shape) * wp.types.type_size_in_bytes(dtype)
        if size <= SMALL:
            place[name] = end
            end += -(-size // ALIGNMENT) * ALIGNMENT
    block = np.zeros(end + ALIGNMENT, np.uint8)
    begin = -(-block.ctypes.data // ALIGNMENT) * ALIGNMENT

    # Arrays. Each of those in the block keeps it alive.
    cpu = wp.get_device("cpu")
    arrays = {}
    for name, (shape, dtype) in kinds.items():
        if name in place:
            keep = functools.partial(_keep, block)
            arrays[name] = wp.array(ptr=begin + place[name], shape=shape, dtype=dtype, device=cpu, deleter=keep)
        else:
            arrays[name] = zeros(shape, dtype, device)
    return arrays


def _keep(block: np.ndarray, pointer: int, size: int) -> None:
    """What Warp calls to free an array whose memory is part of ``block``, which goes with the last of its arrays."""


def from_numpy(values: Any, dtype: Any, device: str) -> wp.array:
    """An array on the device with these values, whose last axis is a vector's if ``dtype`` is one."""
    values = np.ascontiguousarray(values)
    inner = len(getattr(dtype, "_shape_", ()))
    array = zeros(values.shape[: values.ndim - inner], dtype, device)
    if math.prod(values.shape):
        put(array, values, slice(None))
    return array


def put(array: wp.array, values: np.ndarray, place: Any) -> None:
    """Write values into ``array[place]``, an index as numpy has them."""
    if array.device.is_cpu:  # small arrays are written faster by numpy
        array.numpy()[place] = values
    else:
        import torch

        view = wp.to_torch(array)
        view[place] = torch.from_numpy(np.ascontiguousarray(values)).to(view.device, view.dtype)
