"""Gradients of control steps: a loss on where bodies go, differentiated by what their actuators did."""

from __future__ import annotations

import itertools
from typing import Any

import torch
import warp as wp

from warpvox.errors import SimulationError
from warpvox.kernels.reverse import record_reverse
from warpvox.kernels.state import TAPE, allocate, structs
from warpvox.simulation import Simulation
from warpvox.types import AXES

__all__ = ["SMOOTHING", "Gradients"]

SMOOTHING = 4e-4
"""Of contacts with terrain, in simulator units: 0.4 % of a voxel."""
PARTS = ("pos", "vel", "true_vel")
"""What changes in a control step, in the order of a state."""


class Gradients:
    """Control steps as functions that torch differentiates: a state and actions in, a state out.

    Forward they are those of the simulation, bit for bit. Backward takes about twice as long and computes the control step once
    more, so that a step keeps its first state only. Its derivatives are exact to a few percent, with two exceptions: contact with
    terrain is smoothed (:mod:`warpvox.kernels.reverse` says why), and contacts of voxels with each other have none.

    Args:
        sim: in fast arithmetic; its state is where :meth:`state` begins.
        smoothing: of contacts with terrain, in simulator units.

    Raises:
        SimulationError: a simulation in exact arithmetic or in the layout ``group``, or a smoothing that is no positive number.

    A state is a tensor ``[num_envs, 3, rows]``: positions, velocities and true velocities (the displacement of the last sub-step /
    dt), in simulator units, with x and y of the points alternately as in :meth:`Simulation.state`, padded with 0.
    """

    def __init__(self, sim: Simulation, smoothing: float = SMOOTHING) -> None:
        if sim.arithmetic != "fast":
            raise SimulationError(f"Gradients need arithmetic='fast', got a simulation in {sim.arithmetic!r} arithmetic.")
        if sim.layout != "lanes":
            raise SimulationError(f"Gradients need layout='lanes', got a simulation in the layout {sim.layout!r}.")
        if not isinstance(smoothing, (int, float)) or not 0 < smoothing < float("inf"):
            raise SimulationError(f"smoothing must be a positive number of simulator units, got {smoothing!r:.80}.")
        self.sim, self.smoothing = sim, float(smoothing)
        buffers = sim.buffers
        substeps = sim.physics.substeps
        sizes = buffers.sizes | {"trail": (substeps + 1) * buffers.sizes["point"]}
        precision = str(sim.dtype).removeprefix("torch.")
        arrays = allocate(TAPE, sizes, precision, sim.device)
        tape = structs(precision).Tape()
        for name, array in arrays.items():
            setattr(tape, name, array)
        tape.smoothing = self.smoothing
        self._by = [wp.to_torch(arrays[f"by_{name}"]) for name in PARTS]
        self._by_action = wp.to_torch(arrays["by_action"])
        self._env = tuple(wp.to_torch(array).long() for array in (buffers.env_pack, buffers.env_lane))
        self._tape = arrays, tape  # the launches do not keep the arrays alive
        count = min(sim.threads, buffers.packs) if sim.device == "cpu" else 1
        cuts = [buffers.packs * k // count for k in range(count + 1)]
        self._shares = [
            record_reverse(buffers, tape, substeps, begin, end - begin) for begin, end in itertools.pairwise(cuts)
        ]

    def state(self) -> torch.Tensor:
        """The present state of the simulation."""
        state = self.sim.state()
        return torch.stack([state[name] for name in PARTS], dim=1)

    def step(self, state: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        """The state after one control step from ``state``, in which the simulation is then.

        An environment that is frozen or whose step is undone (:attr:`Simulation.unstable`) keeps its state, with the derivative of
        something that does not move. Actions are clipped to the simulation's range; beyond it their derivative is that at the bound.

        Args:
            state: as :meth:`state` and this method give it, of the same worlds.
            actions: ``[num_envs, num_actions]``, as :meth:`Simulation.step` takes them.

        Raises:
            SimulationError: a state of another shape. ActionError: see :meth:`Simulation.step`.
        """
        expected = (self.sim.num_envs, len(PARTS), self.sim.rows[0].shape[1])
        if not isinstance(state, torch.Tensor) or tuple(state.shape) != expected:
            got = list(state.shape) if isinstance(state, torch.Tensor) else f"{state!r:.60}"
            raise SimulationError(f"A state must be a tensor {list(expected)}, got {got}.")
        return _Step.apply(self, state, actions)

    def com(self, state: torch.Tensor, name: str) -> torch.Tensor:
        """``[num_envs, 2]``: the centre of mass of an object in a state."""
        return self._mean(state, name, 0)

    def velocity(self, state: torch.Tensor, name: str) -> torch.Tensor:
        """``[num_envs, 2]``: the velocity of its centre of mass."""
        return self._mean(state, name, 1)

    def _mean(self, state: torch.Tensor, name: str, part: int) -> torch.Tensor:
        mask = self.sim.rows_of(name)
        values = (state[:, part] * mask).unflatten(1, (-1, len(AXES)))
        return values.sum(1) / mask.sum(1, keepdim=True) * len(AXES)

    # What autograd calls.

    def _forward(self, state: torch.Tensor, actions: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """The next state, and bool ``[num_envs]``: which environments have moved."""
        still = self.sim.frozen
        self._put(state)
        self.sim.step(actions)
        return self.state(), ~(still | self.sim.unstable)

    def _put(self, state: torch.Tensor) -> None:
        self.sim.set_state(self.sim.state() | dict(zip(PARTS, state.unbind(1), strict=True)))

    def _backward(
        self, state: torch.Tensor, actions: torch.Tensor, by_end: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Derivatives by a state and by actions from those by the state after the step."""
        sim, before, taken = self.sim, self.sim.state(), self.sim.actions
        pack, lane = self._env
        rows, real = sim.rows
        place = pack[:, None], rows, lane[:, None]
        for part, values in zip(self._by, by_end.unbind(1), strict=True):
            part.zero_()
            part.index_put_(place, (values * real).to(part.dtype), accumulate=True)
        self._put(state)
        sim.take(actions)
        sim.place_actions()
        sim.run(self._shares)
        by_start = torch.stack([part[place] * real for part in self._by], dim=1)
        by_actions = self._by_action[pack, :, lane]
        sim.set_state(before)
        sim.take(taken)
        return by_start.to(by_end.dtype), by_actions


class _Step(torch.autograd.Function):
    """One control step."""

    @staticmethod
    def forward(ctx: Any, gradients: Gradients, state: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        after, moved = gradients._forward(state, actions)
        ctx.gradients = gradients
        ctx.save_for_backward(state, torch.as_tensor(actions), moved)
        return after

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, by_end: torch.Tensor) -> tuple[None, torch.Tensor, torch.Tensor]:
        state, actions, moved = ctx.saved_tensors
        by_start, by_actions = ctx.gradients._backward(state, actions, by_end)
        by_start = by_start.where(moved[:, None, None], by_end)
        return None, by_start, by_actions.where(moved[:, None], torch.zeros_like(by_actions)).to(actions.dtype)
