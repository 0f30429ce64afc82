"""Makes the environments of a design search: a task and how it is simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from warpvox.batch.options import MAX_WIDTH, lanes_for, resolve_arithmetic
from warpvox.design import Design
from warpvox.devices.names import resolve_device
from warpvox.envs.spec import TaskSpec
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.types import Physics

__all__ = ["EnvFactory"]


@dataclass(frozen=True)
class EnvFactory:
    """A task and how it is simulated; the arguments are those of :func:`warpvox.envs.vec_env.make_vec`.

    ``device="auto"`` is a GPU where there is one: all environments of a training are on one device, however many.
    """

    task: str | TaskSpec
    rules: str = "evogym"
    physics: str | Physics | None = None
    device: str = "cpu"
    dtype: str = "float32"
    threads: int | None = None
    max_episode_steps: int | None = None
    arithmetic: str | None = None
    obs: str = "task"
    grid: tuple[int, int] | None = None
    lanes: int | None = None
    layout: str | None = None

    def __post_init__(self) -> None:
        if self.device == "auto":
            object.__setattr__(self, "device", resolve_device(self.device))

    def make(
        self, bodies: Sequence[Design], envs: int, seeds: Sequence[int], auto_reset: bool, shared: bool = False
    ) -> VoxelVecEnv:
        """``envs`` environments of each body; random tasks draw as if each body were alone with its seed.

        With ``shared`` different bodies share packs, which few environments of one body would not fill.
        """
        # Lanes follow from `envs` alone, however often a body occurs, so that all batches run the same kernels.
        chosen = self.shared_lanes(envs) if shared else lanes_for(envs)
        lanes = (self.lanes or chosen) if self.device == "cpu" else None
        return make_vec(
            self.task,
            list(bodies),
            envs * len(bodies),
            device=self.device,
            rules=self.rules,
            dtype=self.dtype,
            arithmetic=self.arithmetic,
            seed=list(seeds),
            auto_reset=auto_reset,
            physics=self.physics,
            lanes=lanes,
            layout=self.layout,
            threads=self.threads,
            max_episode_steps=self.max_episode_steps,
            obs=self.obs,
            grid=self.grid,
            memory_check=False,  # the command has checked the whole; here the batch before may still hold memory
        )

    def shared_lanes(self, envs: int) -> int:
        """Lanes of a pack with ``envs`` environments of a design, whatever designs are simulated with it.

        In fast arithmetic different bodies share packs, in exact arithmetic they do not.
        """
        fast = resolve_arithmetic(self.arithmetic, self.dtype) == "fast"
        return MAX_WIDTH if fast else lanes_for(envs)
