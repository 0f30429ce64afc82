"""CUDA graphs: a control step, or a whole iteration of PPO, replayed as one launch.

A graph repeats launches on fixed addresses. What lives on from one repetition to the next is in tensors that are
written to in place, as episode state is (:mod:`warpvox.envs.episodes`); what is returned is cloned.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Hashable, Sequence
from typing import Any

import torch
import warp as wp

from warpvox.kernels.device import current_stream

Capture = Callable[[Callable[[], Any], Sequence[torch.Generator]], tuple[Callable[[], None], Any]]
"""Function that records a call's kernel launches; returns a function that replays them, and the call's result.

It takes the generators that the function draws from as well: each repetition draws further numbers.
"""


def capture_on_cuda(
    device: str, work: Callable[[], Any], generators: Sequence[torch.Generator] = ()
) -> tuple[Callable[[], None], Any]:
    """Run ``work`` once on a separate stream, and record its launches as a CUDA graph without computing.

    Returns a function that replays the graph, and the results of ``work``, whose tensors a replay fills. With its
    device given this is a :data:`Capture`.
    """
    stream = torch.cuda.Stream(device)
    graph = torch.cuda.CUDAGraph()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # newer versions of torch find the generators, and say so
        for generator in generators:
            graph.register_generator_state(generator)  # pyright: ignore[reportUnknownMemberType] # of torch's stubs
    # Within, torch's current stream is this one, and kernels are launched on it (warpvox.kernels.device).
    # thread_local: what other threads do meanwhile (data loaders, loggers) cannot spoil the capture.
    capturing = torch.cuda.graph(graph, stream=stream, capture_error_mode="thread_local")
    # the outer context brings the stream back; that of torch leaves it current when a capture fails
    with torch.cuda.stream(torch.cuda.current_stream(device)), capturing:
        ours = current_stream(device)
        wp.capture_begin(stream=ours, external=True)
        try:
            results = work()
        finally:
            kept = wp.capture_end(stream=ours)  # keeps the kernels' modules loaded

    def replay(keeps: tuple[Any, ...] = (graph, kept, stream)) -> None:
        graph.replay()

    return replay, results


class Graph:
    """Replays a function's kernel launches, such as a control step, as a CUDA graph; else calls the function.

    Under settings that it meets for the first time some calls are made as they are; the next is captured, and from then
    on replayed. Each settings have a recording of their own, so that a change of them is never missed and costs nothing
    when they come back. Where a capture fails, a warning says so once, and all calls are made as they are.

    Args:
        capture: how launches are recorded.
        name: of what is done, in the warning.
        generators: that the function draws random numbers from.
    """

    def __init__(self, capture: Capture, name: str, generators: Sequence[torch.Generator] = ()) -> None:
        self._capture = capture
        self._name = name
        self._generators = generators
        self._eager: dict[Hashable, int] = {}
        self._recorded: dict[Hashable, tuple[Callable[[], None], Any]] = {}
        self._failed = False

    def __call__(self, work: Callable[[], Any], settings: Hashable = None) -> Any:
        """Run ``work`` or replay its CUDA graph; return the results as new tensors.

        Args:
            work: takes no arguments, reads and writes tensors that stay where they are. Not kept: the environments that
                it belongs to would live until Python looks for cycles, with their memory on the device.
            settings: all that it depends on besides tensors.
        """
        if settings not in self._recorded:
            # Two calls before the capture load the kernels and make the buffers, which a capture must not.
            done = self._eager[settings] = self._eager.get(settings, 0) + 1
            if done <= 2 or self._failed or not self._record(work, settings):
                return work()
        replay, results = self._recorded[settings]
        replay()
        return _cloned(results)

    @property
    def is_recorded(self) -> bool:
        """True if a CUDA graph has been recorded."""
        return bool(self._recorded)

    def _record(self, work: Callable[[], Any], settings: Hashable) -> bool:
        """Record ``work`` as a CUDA graph; return False, with a warning, if the capture fails."""
        try:
            self._recorded[settings] = self._capture(work, self._generators)
        except RuntimeError as error:  # of torch and of Warp
            self._failed = True
            for generator in self._generators:  # torch leaves them as if the capture went on
                generator.graphsafe_set_state(generator.clone_state())
            reason = " ".join(str(error).split())[:200]
            text = f"{self._name} cannot be captured as a CUDA graph and are launched one by one: {reason}"
            warnings.warn(text, RuntimeWarning, stacklevel=2)
        return not self._failed


def _cloned(value: Any) -> Any:
    """Clone all tensors in ``value``, a nest of tuples and dictionaries."""
    fresh: dict[torch.dtype, tuple[list[torch.Tensor], list[torch.Tensor]]] = {}

    def made(value: torch.Tensor | dict[str, Any] | tuple[Any, ...]) -> Any:
        """Return ``value`` with new, empty tensors, and list both in ``fresh`` for copying."""
        if isinstance(value, torch.Tensor):
            new, old = fresh.setdefault(value.dtype, ([], []))
            new.append(torch.empty_like(value))
            old.append(value)
            return new[-1]
        if isinstance(value, dict):
            return {name: made(item) for name, item in value.items()}
        return tuple(map(made, value))

    copies = made(value)
    for new, old in fresh.values():
        # one launch for all of a type; public functions of torch copy tensor by tensor
        torch._foreach_copy_(new, old)  # pyright: ignore[reportPrivateUsage, reportPrivateImportUsage]
    return copies
