"""The control step of environments as one CUDA graph: physics, sensing, observations, rewards, terminations, resets.

A graph repeats launches on fixed addresses. Episode state lives in tensors that are
written to in place (:mod:`warpvox.envs.episodes`), so the step is captured as it stands; what it returns is cloned.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Hashable
from typing import Any

import torch
import warp as wp

from warpvox.kernels.device import current_stream

Capture = Callable[[Callable[[], Any]], tuple[Callable[[], None], Any]]
"""Records what a function launches, without doing it; returns what does it, again and again, and what it returned."""


def capture_on_cuda(device: str, step: Callable[[], Any]) -> tuple[Callable[[], None], Any]:
    """A :data:`Capture`, once it has its device: of torch operations and Warp launches, on a stream of its own."""
    stream = torch.cuda.Stream(device)
    graph = torch.cuda.CUDAGraph()
    # Within, torch's current stream is this one, and kernels are launched on it (warpvox.kernels.device).
    # thread_local: what other threads do meanwhile (data loaders, loggers) cannot spoil the capture.
    capturing = torch.cuda.graph(graph, stream=stream, capture_error_mode="thread_local")
    # the outer context brings the stream back; that of torch leaves it current when a capture fails
    with torch.cuda.stream(torch.cuda.current_stream(device)), capturing:
        ours = current_stream(device)
        wp.capture_begin(stream=ours, external=True)
        try:
            results = step()
        finally:
            kept = wp.capture_end(stream=ours)  # keeps the kernels' modules loaded

    def replay(keeps: tuple[Any, ...] = (graph, kept, stream)) -> None:
        graph.replay()

    return replay, results


class StepGraph:
    """Stands in for a function that steps environments on the device.

    Under settings that it meets for the first time some steps run as they are; the next is captured, and from then on
    replayed. Each settings have a recording of their own, so that a change of them is never missed and costs nothing
    when they come back. Where a capture fails, a warning says so once, and all steps run as they are.

    Args:
        capture: how launches are recorded.
    """

    def __init__(self, capture: Capture) -> None:
        self._capture = capture
        self._eager: dict[Hashable, int] = {}
        self._recorded: dict[Hashable, tuple[Callable[[], None], Any]] = {}
        self._failed = False

    def __call__(self, step: Callable[[], Any], settings: Hashable) -> Any:
        """One step; returns fresh tensors.

        Args:
            step: takes no arguments, reads and writes tensors that stay where they are. Not kept: the environments that
                it belongs to would live until Python looks for cycles, with their memory on the device.
            settings: all that the step depends on besides tensors.
        """
        if settings not in self._recorded:
            # Two steps before the capture load the kernels and make the buffers, which a capture must not.
            done = self._eager[settings] = self._eager.get(settings, 0) + 1
            if done <= 2 or self._failed or not self._record(step, settings):
                return step()
        replay, results = self._recorded[settings]
        replay()
        return _cloned(results)

    def _record(self, step: Callable[[], Any], settings: Hashable) -> bool:
        """Capture a step, without doing it; False if that fails."""
        try:
            self._recorded[settings] = self._capture(step)
        except RuntimeError as error:  # of torch and of Warp
            self._failed = True
            reason = " ".join(str(error).split())[:200]
            text = f"Control steps cannot be captured as a CUDA graph and are launched one by one: {reason}"
            warnings.warn(text, RuntimeWarning, stacklevel=2)
        return not self._failed


def _cloned(value: Any) -> Any:
    """A copy with fresh tensors of what a step returns: tuples and dictionaries of tensors."""
    fresh: dict[torch.dtype, tuple[list[torch.Tensor], list[torch.Tensor]]] = {}

    def made(value: torch.Tensor | dict[str, Any] | tuple[Any, ...]) -> Any:
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
