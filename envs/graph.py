"""The control step of environments as one CUDA graph: physics, sensing, observations, rewards, ends and resets.

A graph repeats launches on fixed addresses. So what an environment carries from step to step is copied into tensors of
the graph's own before a replay and left there after it, and what a step returns is cloned: results stay fresh.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import torch
import warp as wp

if TYPE_CHECKING:
    from warpvox.envs.vec_env import VoxelVecEnv

__all__ = ["StepGraph", "capture_on_cuda"]

Capture = Callable[[Callable[[], None]], Callable[[], None]]
"""Records what a function launches, without doing it; returns what does it, again and again."""
EAGER_STEPS = 2
"""Steps before the capture: they load the kernels and make the buffers, which a capture must not."""


def capture_on_cuda(device: str) -> Capture:
    """A :data:`Capture` of torch operations and Warp launches on one CUDA device."""

    def capture(body: Callable[[], None]) -> Callable[[], None]:
        stream = torch.cuda.Stream(device)
        ours = wp.stream_from_torch(stream)
        graph = torch.cuda.CUDAGraph()
        # Within, torch's current stream is this one, and kernels are launched on it (warpvox.kernels.device).
        # thread_local: what other threads do meanwhile (data loaders, loggers) cannot spoil the capture.
        with torch.cuda.graph(graph, stream=stream, capture_error_mode="thread_local"):
            wp.capture_begin(stream=ours, external=True)
            try:
                body()
            finally:
                kept = wp.capture_end(stream=ours)  # keeps the kernels' modules loaded

        def replay() -> None:
            graph.replay()

        replay.keeps = (graph, kept, stream)  # type: ignore[attr-defined]
        return replay

    return capture


class StepGraph:
    """Stands in for the part of ``VoxelVecEnv.step`` that runs on the device.

    The first steps run as they are; the next is captured, and from then on replayed. Between steps the environment may
    be reset or given another state: whatever it then carries is copied into the graph's tensors.

    Args:
        env: must keep its number of environments; has ``_whole_step``, ``_carried`` and ``_carry``.
        capture: how launches are recorded.
    """

    def __init__(self, env: VoxelVecEnv, capture: Capture) -> None:
        self._env, self._capture = env, capture
        self._steps = 0
        self._replay: Callable[[], None] | None = None
        self._fixed: dict[Any, torch.Tensor] = {}
        self._results: Any = None

    def __call__(self) -> Any:
        """One control step from the actions that the simulation has taken; returns what ``_whole_step`` returns."""
        self._steps += 1
        if self._steps <= EAGER_STEPS:
            return self._env._whole_step()
        if self._replay is None:
            self._fixed = {name: tensor.clone() for name, tensor in self._env._carried().items()}
            self._env._carry(self._fixed)
            self._replay = self._capture(self._body)
        else:
            for name, tensor in self._env._carried().items():
                if tensor is not self._fixed[name]:
                    self._fixed[name].copy_(tensor)
        self._env._carry(self._fixed)
        self._replay()
        self._env._carry(self._fixed)
        return _cloned(self._results)

    def _body(self) -> None:
        """What is recorded: a step, and what it leaves for the next."""
        self._results = self._env._whole_step()
        own = set(map(id, self._fixed.values()))
        # Of a fixed tensor that is left as another one's next value a copy is made first: copying goes one by one.
        left = {name: t.clone() if id(t) in own else t for name, t in self._env._carried().items()}
        for name, tensor in left.items():
            self._fixed[name].copy_(tensor)


def _cloned(value: Any) -> Any:
    """A copy with fresh tensors of what a step returns: tuples and dictionaries of tensors."""
    if isinstance(value, torch.Tensor):
        return value.clone()
    if isinstance(value, dict):
        return {name: _cloned(item) for name, item in value.items()}
    return tuple(_cloned(item) for item in value)
