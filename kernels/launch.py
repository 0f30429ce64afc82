"""Launches of stages: alone, a kernel each (tests, per-stage times), or fused into a control step (``step.py``).

A stage is a Warp function ``(model, data, mesh, pack, lane, unit, dt)`` that serves the ``width`` environments
at ``lane`` of a pack. A *unit* is the thread that does so.
"""

import functools

import warp as wp

from warpvox.kernels.device import kernel, launch
from warpvox.kernels.kit import kit_of


@functools.cache
def stage_kernel(build, precision: str, width: int) -> wp.Kernel:
    """The kernel that runs one stage; launch over (units of a pack, packs)."""
    kit = kit_of(precision, width)
    stage = build(kit)

    @kernel
    def run_stage(model: kit.Model, data: kit.Data, units: int, dt: wp.float64):
        pack, part = wp.tid()
        stage(model, data, model.pack_mesh[pack], pack, part * width, pack * units + part, dt)

    return run_stage


def launch_stage(build, state) -> None:
    """Run one stage for every environment of a :class:`warpvox.batch.arrays.Buffers`."""
    alone = stage_kernel(build, state.precision, state.width)
    launch(alone, (state.packs, state.units), [state.model, state.data, state.units, state.dt], state.device)
