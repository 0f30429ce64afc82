"""Stages of a sub-step, launched separately."""

from warpvox.kernels.device import launch
from warpvox.kernels.step import STAGES, stage_kernel


def launch_stage(build, state) -> None:
    """Run one stage for every environment of a :class:`warpvox.batch.arrays.Buffers`."""
    alone = stage_kernel(build, state.precision, state.width)
    launch(alone, (state.packs, state.units), [state.model, state.data, state.units, state.dt], state.device)


def launch_stages(state, *names: str) -> None:
    """Run stages by name in the given order; without names, all of a sub-step."""
    stages = {build.__name__: build for build in STAGES[state.arithmetic]}
    for name in names or stages:
        launch_stage(stages[name], state)
