"""Compilation, launching and array allocation for all kernels, on the CPU and on CUDA.

On CUDA a launch goes to torch's current stream of the device, so that it is in order with torch's operations whichever
stream they are on, and can be part of a graph that torch captures. Memory is torch's, which does not reuse it while
work on that stream is pending. Warp's own streams, allocator and copies are not used.
"""

import functools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
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
    """Return a decorator like :data:`kernel` for CUDA blocks of ``block`` threads with at most ``registers`` each.

    Such a kernel has no loop over the grid.
    """
    options = {"fuse_fp": False, "block_dim": block}
    return wp.kernel(
        enable_backward=False, module="unique", module_options=options, grid_stride=False, cuda_max_registers=registers
    )


BLOCK = 64
"""Threads of a CUDA block. With one thread an environment the step takes 240 registers a thread: one block of Warp's
256 fits into a multiprocessor, and a batch of 4,096 environments would keep 16 multiprocessors busy."""

SMALL = 1 << 16
"""Maximum size in bytes of an array that shares a block of memory with others."""
ALIGNMENT = 64
"""Alignment of arrays in bytes: a cache line."""

_streams: dict[tuple[str, int], wp.Stream] = {}


def on_cuda(device: str) -> bool:
    """Return whether ``device`` (``cpu``, ``cuda:<index>``) is a GPU."""
    return device != "cpu"


def shared_memory(device: str) -> int:
    """Return the shared memory in bytes available to a block of a CUDA device (227 KiB on an H200); 0 on the CPU."""
    return wp.get_device(device).max_shared_memory_per_block


def current_stream(device: str) -> wp.Stream:
    """Return torch's current CUDA stream as a Warp stream; cached."""
    import torch

    stream = torch.cuda.current_stream(device)
    key = device, stream.cuda_stream
    if key not in _streams:
        _streams[key] = wp.stream_from_torch(stream)
    return _streams[key]


class Command:
    """A recorded CUDA kernel launch that runs on torch's current stream."""

    def __init__(self, command: wp.Launch, device: str) -> None:
        self._command = command
        self._device = device

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
    """Record a kernel launch: each ``launch()`` runs the kernel on the same arrays, faster than a new launch.

    The arrays must stay at their addresses.

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
    """Allocate an array ``shape`` of zeros of a scalar or vector type."""
    if not on_cuda(device):
        return wp.zeros(shape, dtype=dtype, device=device)
    import torch

    dtype = {int: wp.int32, float: wp.float32}.get(dtype, dtype)
    scalar = getattr(dtype, "_wp_scalar_type_", dtype)
    inner = getattr(dtype, "_shape_", ())
    return wp.from_torch(torch.zeros((*shape, *inner), dtype=wp.dtype_to_torch(scalar), device=device), dtype=dtype)


class HostArrays(Mapping[str, wp.array]):
    """Zero-initialised arrays on the CPU by name; small ones share a block of memory.

    A simulation of one environment has a hundred arrays of some hundred bytes. To allocate them one by one, and to make
    all of them known to Warp, takes longer than a control step: Warp's array is made when it is asked for by name.

    Args:
        kinds: shapes and types by name.
    """

    def __init__(self, kinds: Mapping[str, tuple[tuple[int, ...], Any]]) -> None:
        self._kinds = kinds
        self._arrays: dict[str, wp.array] = {}
        self._memory: dict[str, tuple[np.ndarray, int, int]] = {}  # a block, where an array begins in it, its address

        shared: dict[str, int] = {}
        end = 0
        for name, (shape, dtype) in kinds.items():
            size = math.prod(shape) * _layout(dtype)[2]
            if size <= SMALL:
                shared[name] = end
                end += -(-size // ALIGNMENT) * ALIGNMENT
            else:
                block = _aligned(size)
                self._memory[name] = block, 0, block.ctypes.data
        block = _aligned(end)
        address = block.ctypes.data
        for name, begin in shared.items():
            self._memory[name] = block, begin, address + begin

    def __iter__(self) -> Iterator[str]:
        return iter(self._kinds)

    def __len__(self) -> int:
        return len(self._kinds)

    def __getitem__(self, name: str) -> wp.array:
        """Return the Warp array of a name, created on first access."""
        if name not in self._arrays:
            shape, dtype = self._kinds[name]
            block, _, address = self._memory[name]
            keep = functools.partial(_keep, block)
            self._arrays[name] = wp.array(ptr=address, shape=shape, dtype=dtype, device="cpu", deleter=keep)
        return self._arrays[name]

    def numpy(self, name: str) -> np.ndarray:
        """Return a numpy view of an array, without copying; vectors become the last axis."""
        shape, dtype = self._kinds[name]
        block, begin, _ = self._memory[name]
        scalar, inner, _ = _layout(dtype)
        return np.ndarray((*shape, *inner), scalar, block, begin)

    def set_fields(self, struct: Any, names: Iterable[str]) -> None:
        """Point fields ``names`` of a Warp struct to these arrays; keep this object alive as long as the struct."""
        fields = struct.__ctype__()
        for name in names:
            shape, dtype = self._kinds[name]
            field = getattr(fields, name)
            field.data = self._memory[name][2]
            field.ndim = len(shape)
            stride = _layout(dtype)[2]
            for axis in range(len(shape) - 1, -1, -1):
                field.shape[axis] = shape[axis]
                field.strides[axis] = stride
                stride *= shape[axis]


def _aligned(size: int) -> np.ndarray:
    """Allocate ``size`` zero bytes aligned to a cache line."""
    block = np.zeros(size + ALIGNMENT, np.uint8)
    begin = -block.ctypes.data % ALIGNMENT
    return block[begin : begin + size]


@functools.cache
def _layout(dtype: Any) -> tuple[np.dtype, tuple[int, ...], int]:
    """Return a Warp type's numpy scalar type, vector shape, and size of an entry in bytes."""
    scalar = getattr(dtype, "_wp_scalar_type_", dtype)
    scalar = np.dtype(wp.dtype_to_numpy({int: wp.int32, float: wp.float32}.get(scalar, scalar)))
    inner = tuple(getattr(dtype, "_shape_", ()))
    return scalar, inner, scalar.itemsize * math.prod(inner)


def _keep(block: np.ndarray, pointer: int, size: int) -> None:
    """Ignore Warp's request to free an array in a shared ``block``; Python frees the block."""


def allocate(kinds: Mapping[str, tuple[tuple[int, ...], Any]], device: str) -> Mapping[str, wp.array]:
    """Allocate arrays of zeros by name, from their shapes and types."""
    if on_cuda(device):
        return {name: zeros(shape, dtype, device) for name, (shape, dtype) in kinds.items()}
    return HostArrays(kinds)


def put(arrays: Mapping[str, wp.array], name: str, place: Any, values: Any) -> None:
    """Write numpy values, or one number, into part of an array: ``arrays[name][place]``."""
    if isinstance(arrays, HostArrays):
        arrays.numpy(name)[place] = values
    else:
        import torch

        view = wp.to_torch(arrays[name])
        view[place] = torch.as_tensor(np.ascontiguousarray(values), dtype=view.dtype, device=view.device)


def set_fields(struct: Any, arrays: Mapping[str, wp.array], names: Iterable[str]) -> None:
    """Point the fields ``names`` of a Warp struct to the arrays of these names."""
    if isinstance(arrays, HostArrays):
        arrays.set_fields(struct, names)
    else:
        for name in names:
            setattr(struct, name, arrays[name])


def from_numpy(values: Any, dtype: Any, device: str) -> wp.array:
    """Copy values to a new array on the device; for a vector ``dtype`` the last axis holds the components."""
    values = np.ascontiguousarray(values)
    inner = len(getattr(dtype, "_shape_", ()))
    array = zeros(values.shape[: values.ndim - inner], dtype, device)
    if math.prod(values.shape):
        import torch

        view = wp.to_torch(array)
        view.copy_(torch.from_numpy(values).to(view.dtype))
    return array
