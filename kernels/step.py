"""The control step: all stages of 30 sub-steps in one kernel, so that a pack's data stays in the cache.

The stage functions are those of the other files; this file is their order. A stage is a Warp function
``(model, data, mesh, pack, lane, unit, dt)`` that serves the ``width`` environments at ``lane`` of a pack. A *unit* is
the thread that does so.
"""

import functools

import warp as wp

from warpvox.kernels.broadphase import boxes, collect
from warpvox.kernels.contact import contacts
from warpvox.kernels.device import Command, kernel, record
from warpvox.kernels.exact import order, springs as exact_springs
from warpvox.kernels.folding import check
from warpvox.kernels.group import record_group
from warpvox.kernels.kit import Kit, builder, kit_of
from warpvox.kernels.reset import save, settle
from warpvox.kernels.springs import goals, limit, runge_kutta

STAGES = {
    "fast": (boxes, collect, contacts, runge_kutta, limit, check),
    "exact": (boxes, collect, order.contacts, *exact_springs.STAGES, check),
}
"""Stages of a sub-step in order, for each arithmetic."""


@functools.cache
def step_kernel(arithmetic: str, precision: str, width: int) -> wp.Kernel:
    """Build the kernel of whole control steps; launch it over (packs, units of a pack).

    ``first_pack`` is the first pack of a launch.
    """
    kit = kit_of(precision, width)
    begin = save(kit)
    set_goals = goals(kit)
    end = settle(kit)
    stages = (build(kit) for build in STAGES[arithmetic])
    bounds, candidates, contact, motion, strain, folds = stages

    @kit.func
    def idle(data, pack, lane):
        """Clear the status of the unit's lanes; return 1 if all lanes are frozen, else 0."""
        all_frozen = int(1)
        for k in range(lane, lane + int(width)):
            if data.frozen[pack, k] == 0:
                all_frozen = 0
            data.status[pack, k] = 0
        return all_frozen

    @kernel
    def control_step(model: kit.Model, data: kit.Data, first_pack: int, units: int, substeps: int, dt: wp.float64):
        """Do one control step of one unit of a pack."""
        row, part = wp.tid()
        pack = first_pack + row
        lane = part * width
        unit = pack * units + part
        if idle(data, pack, lane) == 1:
            return
        mesh = model.pack_mesh[pack]
        begin(model, data, mesh, pack, lane, unit, dt)
        set_goals(model, data, mesh, pack, lane, unit, dt)
        for _ in range(substeps):
            bounds(model, data, mesh, pack, lane, unit, dt)
            candidates(model, data, mesh, pack, lane, unit, dt)
            contact(model, data, mesh, pack, lane, unit, dt)
            motion(model, data, mesh, pack, lane, unit, dt)
            strain(model, data, mesh, pack, lane, unit, dt)
            folds(model, data, mesh, pack, lane, unit, dt)
        end(model, data, mesh, pack, lane, unit, dt)

    return control_step


@functools.cache
def stage_kernel(build, precision: str, width: int) -> wp.Kernel:
    """Build a kernel that runs one stage alone; launch it over (packs, units of a pack)."""
    kit = kit_of(precision, width)
    stage = build(kit)

    @kernel
    def run_stage(model: kit.Model, data: kit.Data, units: int, dt: wp.float64):
        pack, part = wp.tid()
        stage(model, data, model.pack_mesh[pack], pack, part * width, pack * units + part, dt)

    return run_stage


@builder
def action_kernel(kit: Kit) -> wp.Kernel:
    """Build the kernel that clips actions and copies them into packs and lanes, over (environments, actions)."""

    @kernel
    def place_actions(
        data: kit.Data, env_pack: wp.array(dtype=int), env_lane: wp.array(dtype=int),
        actions: wp.array2d(dtype=kit.real), low: wp.float64, high: wp.float64,
    ):  # fmt: skip
        env, a = wp.tid()
        goal = wp.float64(actions[env, a])
        if wp.isfinite(goal):  # clamping would make a goal of NaN; as it is, it stops the environment
            goal = wp.clamp(goal, low, high)
        data.action[env_pack[env], a, env_lane[env]] = goal

    return place_actions


def record_actions(state, actions, low: float, high: float) -> wp.Launch | Command:
    """Record the kernel that copies ``actions``, a Warp array [environment, action], to the packs."""
    inputs = [state.data, state.env_pack, state.env_lane, actions, low, high]
    return record(action_kernel(state.precision), actions.shape, inputs, state.device)


def record_step(state, substeps: int, first: int, packs: int) -> wp.Launch | Command:
    """Record one control step of the packs ``first`` to ``first + packs``.

    The step reads the actions that are in the buffers when the command is launched.
    """
    if state.group is not None:
        return record_group(state, substeps, first, packs)
    fused = step_kernel(state.arithmetic, state.precision, state.width)
    inputs = [state.model, state.data, first, state.units, substeps, state.dt]
    return record(fused, (packs, state.units), inputs, state.device)
