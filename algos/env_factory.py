"""Factory of the environments of a design search, from a task and simulation options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from warpvox.algos.protocols import NOMINAL, episodes_of
from warpvox.batch.options import SimOptions, lanes_for, most_lanes, resolve_arithmetic
from warpvox.design import Design
from warpvox.devices.names import resolve_device
from warpvox.envs.spec import TaskSpec
from warpvox.envs.vec_env import VoxelVecEnv, make_vec

CPU = SimOptions(device="cpu")


@dataclass(frozen=True)
class EnvFactory:
    """Factory of environments for one task; fields as in :func:`warpvox.envs.vec_env.make_vec`.

    ``device="auto"`` is a GPU where there is one: all environments of a training are on one device, however many.
    ``protocol``: of the episodes that designs are judged by, see :mod:`warpvox.algos.protocols`.
    """

    task: str | TaskSpec
    rules: str = "evogym"
    obs: str = "task"
    sim: SimOptions = CPU
    protocol: str = NOMINAL

    def __post_init__(self) -> None:
        """Resolve the device ``auto``: a GPU if there is one, else the CPU."""
        if self.sim.device == "auto":
            object.__setattr__(self, "sim", replace(self.sim, device=resolve_device(self.sim.device)))

    def computed(self, **changes: Any) -> EnvFactory:
        """Copy the factory with some simulation options changed."""
        return replace(self, sim=replace(self.sim, **changes))

    def episodes(self, given: int | None) -> int:
        """Return the number of evaluation episodes per design: ``given``, or the default of ``protocol``."""
        return episodes_of(given, self.protocol)

    def make(
        self, bodies: Sequence[Design], envs: int, seeds: Sequence[int], auto_reset: bool, shared: bool = False
    ) -> VoxelVecEnv:
        """Create ``envs`` environments of each body; random tasks draw as if each body were alone with its seed.

        With ``shared`` different bodies share packs, which few environments of one body would not fill.
        """
        # Lanes follow from `envs` alone, however often a body occurs, so that all batches run the same kernels.
        chosen = self.shared_lanes(envs) if shared else lanes_for(envs)
        return make_vec(
            self.task,
            list(bodies),
            envs * len(bodies),
            rules=self.rules,
            obs=self.obs,
            seed=list(seeds),
            auto_reset=auto_reset,
            sim=self.sim,
            lanes=(self.sim.lanes or chosen) if self.sim.device == "cpu" else None,
            memory_check=False,  # the command has checked the whole; here the batch before may still hold memory
        )

    def shared_lanes(self, envs: int) -> int:
        """Return the lane width for ``envs`` environments per design, independent of the designs.

        In fast arithmetic different bodies share packs, in exact arithmetic they do not.
        """
        fast = resolve_arithmetic(self.sim.arithmetic, self.sim.dtype) == "fast"
        return most_lanes() if fast else lanes_for(envs)
