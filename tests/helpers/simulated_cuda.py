"""Simulated CUDA device without a GPU: CPU tensors that claim to lie on ``cuda:0``, for testing host code.

Which tensors lie on the device is a matter of their storage, so that views, parameters and gradients need no care.
Operations that mix devices raise as torch does; where the host would wait for the device is noted; every Warp kernel
must be launched on torch's current stream. A graph that is captured repeats operations and launches on the same
addresses. Not simulated: the order of streams, memory, the lanes layout (its CUDA branch is not compiled for the CPU),
and, unless ``own_capacities``, the sizes and approximations of CUDA's group kernel: tests have compiled another.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from types import SimpleNamespace
from typing import Any
from unittest import mock

import torch
import warp as wp
from torch.multiprocessing.reductions import StorageWeakRef
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from warpvox.batch import arrays
from warpvox.kernels import device as kernel_device
from warpvox.kernels.group import choose

__all__ = ["SimulatedCuda", "Tape"]

CUDA, CPU = torch.device("cuda", 0), torch.device("cpu")
PLAIN = set(
    (
        "size dim stride numel __len__ element_size is_floating_point data_ptr is_contiguous "
        "_has_compatible_shallow_copy_type"
    ).split()
)  # functions that are about no values
NO_NODES = {"empty", "empty_like", "new_empty", "_unsafe_view"}
"""Operations that launch nothing."""
WAITING = {
    *("item", "tolist", "__bool__", "__int__", "__float__", "__index__", "__format__", "__repr__", "equal", "allclose"),
    *("nonzero", "argwhere", "masked_select", "unique", "unique_consecutive", "bincount", "histc", "is_nonzero"),
}  # functions that read values on the host, or whose result has a size that depends on values
FROM_HOST = {"tensor", "as_tensor", "asarray", "new_tensor", "from_numpy"}
INDEXING = {"__getitem__", "__setitem__", "index_put_", "index_put"}
PROPERTIES = {"device": (CUDA, CPU), "is_cuda": (True, False), "is_cpu": (False, True)}
SHARED_MEMORY = 227 * 1024
"""Shared memory available to a block in bytes, as on an H200."""
TOGETHER, LANES = "group_step", "control_step"
"""Names of the kernel whose threads wait for each other, and of the control step in the lanes layout."""


class Tape(TorchDispatchMode):
    """Recording of a CUDA graph: operations and launches in order, on fixed addresses.

    Played, it does them again on the tensors of the recording; what Python computed, looked at or chose is as it was.
    Only tensors that are written to in place tell it about the present.
    """

    def __init__(self) -> None:
        super().__init__()
        self.done: list[Callable[[], Any]] = []

    def __torch_dispatch__(self, func: Any, types: Any, args: tuple = (), kwargs: dict | None = None) -> Any:
        kwargs = kwargs or {}
        result = func(*args, **kwargs)
        is_view = any(value.alias_info is not None for value in func._schema.returns)  # it follows what it shows
        if func._schema.is_mutable:
            self.done.append(lambda: func(*args, **kwargs))
        elif not is_view and func.__name__.split(".")[0] not in NO_NODES:
            assert isinstance(result, torch.Tensor), func
            self.done.append(lambda: result.copy_(func(*args, **kwargs)))
        return result

    def play(self) -> None:
        for do in self.done:
            do()


class Stream:
    """Replacement of torch's CUDA stream."""

    def __init__(self, device: Any = None, number: int = 99) -> None:
        self.cuda_stream = number


class _Generator(torch.Generator):
    """Random generator of the simulated device."""

    def __new__(cls, device: Any = "cpu") -> _Generator:
        made = super().__new__(cls)
        made.kind = torch.device(device)
        return made

    def __init__(self, device: Any = "cpu") -> None:
        self.is_stuck = False  # in a capture that has failed

    def clone_state(self) -> _Generator:
        return self

    def graphsafe_set_state(self, state: _Generator) -> None:
        self.is_stuck = False

    @property
    def device(self) -> torch.device:
        return self.kind


class _Graph:
    """Replacement of torch's CUDA graph; a capture also runs, in place of the first replay."""

    def __init__(self) -> None:
        self.tape, self.replays = Tape(), 0
        self.generators: list[torch.Generator] = []

    def register_generator_state(self, generator: torch.Generator) -> None:
        """Make each replay draw new numbers from a generator."""
        self.generators.append(generator)

    def replay(self) -> None:
        self.replays += 1
        if self.replays > 1:
            with torch._C.DisableTorchFunction(), torch.no_grad():  # a graph knows nothing of gradients
                self.tape.play()


class _Event:
    """Replacement of torch's CUDA event; launches finish at once."""

    def __init__(self, enable_timing: bool = False, external: bool = False) -> None:
        self._seconds = 0.0

    def record(self) -> None:
        self._seconds = time.perf_counter()

    def elapsed_time(self, later: _Event) -> float:
        return 1000 * (later._seconds - self._seconds)


class _Command:
    def __init__(self, owner: SimulatedCuda, name: str, command: wp.Launch) -> None:
        self._owner, self._name, self._command = owner, name, command

    def launch(self, stream: Any = None) -> None:
        self._owner.launched(self._name, stream, self._command.launch)


class SimulatedCuda(TorchFunctionMode):
    """Context in which the machine has one CUDA device.

    Args:
        own_capacities: compile the group kernel as for CUDA, with capacities of the worlds and approximate; takes long.

    Attributes:
        waits: how often the host waited for the device, by what it did and the innermost function of warpvox or rsl-rl.
        launches: launches of Warp kernels by name.
        operations: calls of torch on the device, by name.
        captured: the graphs.
    """

    def __init__(self, own_capacities: bool = False) -> None:
        super().__init__()
        self.waits: Counter[tuple[str, str, str]] = Counter()
        self.launches: Counter[str] = Counter()
        self.operations: Counter[str] = Counter()
        self.captured: list[_Graph] = []
        self.stream, self._capturing = Stream(number=0), None
        self._memory: dict[int, StorageWeakRef] = {}
        self._own_capacities = own_capacities
        self._real = SimpleNamespace(launch=wp.launch, from_torch=wp.from_torch, to_torch=wp.to_torch)

    def __enter__(self) -> SimulatedCuda:
        with ExitStack() as stack:
            for owner, name, value in self._patches():
                stack.enter_context(mock.patch.object(owner, name, value))
            super().__enter__()
            self._patched = stack.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        super().__exit__(*error)
        self._patched.close()

    def _patches(self) -> Iterator[tuple[Any, str, Any]]:
        properties = SimpleNamespace(name="simulated", total_memory=80 << 30, major=9, minor=0)
        of_torch = {
            "is_available": lambda: True,
            "device_count": lambda: 1,
            "current_stream": lambda device=None: self.stream,
            "Stream": Stream,
            "Event": _Event,
            "stream": self._on_stream,
            "synchronize": lambda device=None: self.wait("synchronize"),
            "mem_get_info": lambda device=None: (70 << 30, 80 << 30),
            "memory_reserved": lambda device=None: 0,
            "memory_allocated": lambda device=None: 0,
            "get_device_properties": lambda device=None: properties,
            "get_rng_state": lambda device=None: torch.get_rng_state(),
            "set_rng_state": lambda state, device=None: None,
            "is_current_stream_capturing": lambda: self._capturing is not None,
            "CUDAGraph": _Graph,
            "graph": self._graph,
        }
        of_warp = {
            "is_cuda_available": lambda: True,
            "stream_from_torch": lambda stream: ("warp", stream.cuda_stream),
            "from_torch": self._from_torch,
            "to_torch": self._to_torch,
            "launch": self._launch,
            "capture_begin": lambda stream, external: self._check_stream(stream),
            "capture_end": self._check_stream,
        }
        yield from ((torch.cuda, *item) for item in of_torch.items())
        yield from ((wp, *item) for item in of_warp.items())
        yield torch, "Generator", _Generator
        # builds with CUDA, but no driver, would ask it
        yield torch.accelerator, "current_accelerator", lambda check_available=False: None
        yield kernel_device, "_streams", {}
        yield arrays, "on_cuda", lambda name: False  # what a block shares on CUDA is memory of its own on the CPU
        yield arrays, "shared_memory", lambda name: SHARED_MEMORY
        if not self._own_capacities:
            yield arrays, "choose", lambda sizes, precision, *more: choose(sizes, precision, "cpu")

    # ------------------------------------------------------------------------------------------------ memory

    def holds(self, tensor: torch.Tensor) -> bool:
        with torch._C.DisableTorchFunction():
            return tensor.untyped_storage()._cdata in self._memory

    def _take(self, found: Any) -> Any:
        for tensor in tree_leaves(found):
            if isinstance(tensor, torch.Tensor):
                with torch._C.DisableTorchFunction():
                    place = StorageWeakRef(tensor.untyped_storage())  # while it lives no other has this address
                self._memory.setdefault(place.cdata, place)
        if len(self._memory) > 20_000:
            self._memory = {key: place for key, place in self._memory.items() if not place.expired()}
        return found

    def wait(self, what: str) -> None:
        """Count a wait of the host for the device; RuntimeError during the capture of a graph."""
        if self._capturing is not None:
            raise RuntimeError(f"operation not permitted when stream is capturing: {what}")
        self.waits[(what, *_caller())] += 1

    @contextmanager
    def watched(self) -> Iterator[Counter[tuple[str, str, str]]]:
        """Record waits within the block only."""
        before, self.waits = self.waits, Counter()
        try:
            yield self.waits
        finally:
            self.waits = before + self.waits

    # -------------------------------------------------------------------------------------------- operations

    def __torch_function__(self, func: Any, types: Any, args: tuple = (), kwargs: dict | None = None) -> Any:
        kwargs, name = dict(kwargs or {}), func.__name__
        if name in PLAIN or name == "__set__":
            return self._do(func, args, kwargs)
        if name == "__get__":
            return self._property(func, args)
        if name in ("to", "cpu", "cuda") and isinstance(args[0], torch.Tensor):
            return self._move(args[0], *({"to": (), "cpu": (CPU,), "cuda": (CUDA,)}[name]), *args[1:], **kwargs)
        if name in ("as_tensor", "asarray") and isinstance(args[0], torch.Tensor):
            return self._move(*args, **kwargs)
        asked = kwargs.get("device")
        given = [value for value in tree_leaves((args, kwargs)) if isinstance(value, torch.Tensor)]
        held = [value for value in given if self.holds(value)]
        on_cuda = torch.device(asked).type == "cuda" if asked is not None else bool(held)
        if asked is not None and on_cuda:
            kwargs["device"] = CPU
        if held:
            self._look(name, args, kwargs, held, [value for value in given if not self.holds(value)])
        if name in FROM_HOST and on_cuda:
            self.wait(f"{name} from the host")
        generator = kwargs.get("generator")
        if generator is not None and (generator.device.type == "cuda") != on_cuda:
            raise RuntimeError(f"{name}: the generator is on {generator.device}, not where the numbers shall be")
        if isinstance(generator, _Generator) and generator.is_stuck:
            raise RuntimeError("Offset increment outside graph capture encountered unexpectedly.")
        if generator is not None and self._capturing is not None and generator not in self.captured[-1].generators:
            raise RuntimeError(f"{name}: the generator is not registered with the graph")
        self.operations[name] += on_cuda
        own = all(issubclass(kind, torch.Tensor) for kind in types)
        found = self._do(func, args, kwargs, own)
        if not on_cuda or found is None or (args and found is args[0]):
            return found
        if name in FROM_HOST:
            found = self._do(torch.Tensor.clone, (found,), {})  # it may have shared the host's memory
        return self._take(found)

    @staticmethod
    def _do(func: Any, args: tuple, kwargs: dict, own: bool = True) -> Any:
        with torch._C.DisableTorchFunction() if own else nullcontext():
            return func(*args, **kwargs)

    def _property(self, func: Any, args: tuple) -> Any:
        name, found = func.__self__.__name__, self._do(func, args, {})
        if name in PROPERTIES and self.holds(args[0]):
            return PROPERTIES[name][0]
        if name == "grad" and found is not None and self.holds(args[0]):
            self._take(found)
        return found

    def _move(self, tensor: torch.Tensor, *words: Any, **named: Any) -> torch.Tensor:
        wanted, kind = named.get("device"), named.get("dtype")
        for word in words:
            if isinstance(word, torch.Tensor):
                wanted, kind = CUDA if self.holds(word) else CPU, self._do(torch.Tensor.dtype.__get__, (word,), {})
            elif isinstance(word, torch.dtype):
                kind = word
            elif isinstance(word, str | torch.device):
                wanted = word
        wanted, held = None if wanted is None else torch.device(wanted), self.holds(tensor)
        with torch._C.DisableTorchFunction():
            if wanted is not None and wanted.type == "meta":
                return tensor.to(wanted, kind)
            goal = held if wanted is None else wanted.type == "cuda"
            found = tensor.to(kind or tensor.dtype, copy=named.get("copy", False) or goal != held)
        if goal != held:
            self.wait("copy to the device" if goal else "copy to the host")
        return self._take(found) if goal else found

    def _look(self, name: str, args: tuple, kwargs: dict, held: list, others: list) -> None:
        """Record operations that wait for the device, and refuse mixed devices."""
        others = [value for value in others if self._do(torch.Tensor.dim, (value,), {})]
        if name in ("numpy", "__array__"):
            raise TypeError("can't convert cuda:0 device type tensor to numpy. Use Tensor.cpu() to copy the tensor.")
        if others and name not in ("copy_", *INDEXING):
            raise RuntimeError(f"Expected all tensors to be on the same device, in {name}")
        by_size = name == "where" and len(args) + len(kwargs) == 1
        by_size |= name == "repeat_interleave" and len(args) > 1 and isinstance(args[1], torch.Tensor)
        if others or name in WAITING or by_size or (name in INDEXING and self._reads(args[1])):
            self.wait(name)

    def _reads(self, index: Any) -> bool:
        """Return whether an index is a mask, a list, or a number on the device."""
        with torch._C.DisableTorchFunction():
            for part in index if isinstance(index, tuple) else (index,):
                if isinstance(part, torch.Tensor):
                    if part.dtype == torch.bool or part.dim() == 0:
                        return True
                elif not (part is None or part is Ellipsis or isinstance(part, int | slice)):
                    return True
        return False

    # ------------------------------------------------------------------------------------- streams and Warp

    @contextmanager
    def _on_stream(self, stream: Stream) -> Iterator[None]:
        before, self.stream = self.stream, stream
        try:
            yield
        finally:
            self.stream = before

    @contextmanager
    def _graph(self, graph: _Graph, stream: Stream, capture_error_mode: str) -> Iterator[None]:
        self.captured.append(graph)
        with self._on_stream(stream), graph.tape:
            self._capturing = graph.tape
            try:
                yield
            finally:
                self._capturing = None

    def _check_stream(self, stream: Any) -> None:
        if stream != ("warp", self.stream.cuda_stream):
            raise AssertionError(f"not on torch's current stream {self.stream.cuda_stream}: {stream}")

    def _from_torch(self, tensor: torch.Tensor, *words: Any, **named: Any) -> wp.array:
        held = self.holds(tensor)
        with torch._C.DisableTorchFunction():
            array = self._real.from_torch(tensor, *words, **named)
        array.on_cuda = held
        return array

    def _to_torch(self, array: wp.array, **named: Any) -> torch.Tensor:
        with torch._C.DisableTorchFunction():
            tensor = self._real.to_torch(array, **named)
        return self._take(tensor) if getattr(array, "on_cuda", False) else tensor

    def _launch(self, kernel: wp.Kernel, dim: Any, inputs: Any, device: Any = None, **options: Any) -> Any:
        name, recorded = kernel.func.__name__, options.get("record_cmd", False)
        if str(device) == "cpu":
            return self._real.launch(kernel, dim, inputs, device=device, **options)
        if name == LANES:
            raise NotImplementedError("the lanes layout is not simulated")
        stream = options.pop("stream", None)
        options |= {"block_dim": dim[1] if name == TOGETHER else 1}

        def launch() -> Any:
            with mock.patch.object(wp.config, "enable_cpu_blocks", name == TOGETHER):
                return self._real.launch(kernel, dim, inputs, device="cpu", **options)

        return _Command(self, name, launch()) if recorded else self.launched(name, stream, launch)

    def launched(self, name: str, stream: Any, launch: Callable[[], Any]) -> None:
        """Launch a kernel on a stream, and count it."""
        self._check_stream(stream)
        self.launches[name] += 1
        with torch._C.DisableTorchFunction():
            launch()
        if self._capturing is not None:
            self._capturing.done.append(launch)


def _caller() -> tuple[str, str]:
    """Return module and name of the innermost calling function of warpvox or rsl-rl."""
    frame = sys._getframe(2)
    while frame is not None:
        module = str(frame.f_globals.get("__name__", ""))
        if module.split(".")[0] in ("warpvox", "rsl_rl") and module != __name__:
            return module, frame.f_code.co_name
        frame = frame.f_back
    return "", ""
