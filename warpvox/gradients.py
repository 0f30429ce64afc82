"""Gradients through the physics: control steps that torch differentiates with respect to actions and state."""

from functools import partial
from typing import Any

import torch
import warp as wp

from warpvox.checks import is_number
from warpvox.errors import SimulationError
from warpvox.kernels.reverse import record_reverse
from warpvox.kernels.state import TAPE, allocate, structs
from warpvox.simulation import Simulation
from warpvox.types import AXES

PARTS = ("pos", "vel", "true_vel")
"""Fields of a differentiable state, in order."""


class Gradients:
    """Differentiable control steps: functions from a state and actions to the next state.

    The states are those of the simulation, bit for bit. The reverse pass computes the control step once more, so that
    of each step only its first state is kept. In the air derivatives are those of the physics; contact with terrain is
    smoothed (see :mod:`warpvox.kernels.reverse`), and contacts between voxels have derivative 0.

    A state is a float64 tensor ``[num_envs, 3, columns]``: positions, velocities and true velocities (the displacement
    of the last sub-step / dt), in simulator units, x and y of the points in turn as in :meth:`Simulation.state`,
    padded with 0.

    Args:
        sim: in fast arithmetic, in the layout ``lanes``.
        smoothing: of contacts with terrain, in simulator units; by default 0.8 % of a voxel (docs/gradients.md compares
            others).

    Attributes:
        tape: the arrays of :data:`warpvox.kernels.state.TAPE`, of the control step that was differentiated last.

    Raises:
        SimulationError: another arithmetic or layout, or a smoothing that is no number from 1e-9 to 1e9.
    """

    def __init__(self, sim: Simulation, smoothing: float = 8e-4) -> None:
        self.check(sim)
        if not is_number(smoothing) or not 1e-9 <= smoothing <= 1e9:  # its cube must be a number, too
            raise SimulationError(f"smoothing must be from 1e-9 to 1e9 simulator units, got {smoothing!r:.80}.")
        self.sim = sim
        self.smoothing = float(smoothing)
        buffers = sim.buffers
        sizes = buffers.sizes | {"trail": (sim.physics.substeps + 1) * buffers.sizes["point"]}
        precision = sim.options.dtype
        self.tape = allocate(TAPE, sizes, precision, sim.device)
        tape = structs(precision).Tape()
        for name, array in self.tape.items():
            setattr(tape, name, array)
        tape.smoothing = self.smoothing
        self._by = [wp.to_torch(self.tape[f"by_{name}"]) for name in PARTS]
        self._by_action = wp.to_torch(self.tape["by_action"])
        self._env = tuple(wp.to_torch(array).long() for array in (buffers.env_pack, buffers.env_lane))
        self._launches = sim.record_shares(partial(record_reverse, buffers, tape, sim.physics.substeps))

    def __repr__(self) -> str:
        return f"Gradients({self.sim!r}, smoothing={self.smoothing:g})"

    @staticmethod
    def check(sim: Simulation) -> None:
        """Raise SimulationError if the control steps of a simulation cannot be differentiated."""
        if (got := getattr(sim, "arithmetic", sim)) != "fast":
            raise SimulationError(f"Gradients need a simulation (env.sim) with arithmetic='fast', got {got!r:.80}.")
        if sim.layout != "lanes":
            raise SimulationError(f"Gradients need a simulation with layout='lanes', got {sim.layout!r}.")

    def state(self) -> torch.Tensor:
        """Return the present state of the simulation."""
        state = self.sim.state()
        return torch.stack([state[name] for name in PARTS], dim=1)

    def step(self, state: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        """Do one differentiable control step from ``state``, and return the next state.

        An environment that is frozen or whose step is undone (:attr:`Simulation.unstable`) keeps its state, and so
        does its derivative. Actions are clipped to the simulation's range; beyond it their derivative is 0.

        Args:
            state: as :meth:`state` and this method give it, of the same worlds.
            actions: ``[num_envs, num_actions]``, as :meth:`Simulation.step` takes them.

        Raises:
            SimulationError: a state of another shape or type. ActionError: see :meth:`Simulation.step`.
        """
        rows = self.sim.rows[0]
        expected = torch.float64, (len(rows), len(PARTS), rows.shape[1])
        got = (state.dtype, tuple(state.shape)) if isinstance(state, torch.Tensor) else None
        if got != expected:
            said, given = (
                f"{kind} {list(shape)}".removeprefix("torch.") for kind, shape in (expected, got or expected)
            )
            raise SimulationError(f"A state must be a tensor {said}, got {given if got else f'{state!r:.60}'}.")
        self.sim.take(actions)
        return _Step.apply(self, state, torch.as_tensor(actions).to(self.sim.device))

    def com(self, state: torch.Tensor, name: str) -> torch.Tensor:
        """Return an object's centre of mass in a state, ``[num_envs, 2]``; SimulationError: the object is fixed."""
        return self._mean(state, name, 0)

    def velocity(self, state: torch.Tensor, name: str) -> torch.Tensor:
        """Return the velocity of an object's centre of mass in a state, ``[num_envs, 2]``."""
        return self._mean(state, name, 1)

    def _mean(self, state: torch.Tensor, name: str, part: int) -> torch.Tensor:
        """Average the positions (``part`` 0) or velocities (1) of an object's points, ``[num_envs, 2]``."""
        mask = self.sim.rows_of(name)
        if not mask.any():
            raise SimulationError(f"The object {name!r} is made of fixed cells only: it never moves.")
        values = (state[:, part] * mask).unflatten(1, (-1, len(AXES)))
        return values.sum(1) / mask.sum(1, keepdim=True) * len(AXES)

    # What autograd calls.

    def _forward(self, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Do one step from ``state`` with the stored actions; return the new state and a mask of moved environments."""
        still = self.sim.frozen
        self.sim.set_state(self.sim.state() | _parts(state))
        self.sim.advance()
        return self.state(), ~(still | self.sim.unstable)

    def _backward(
        self, state: torch.Tensor, actions: torch.Tensor, by_end: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return gradients with respect to state and actions from the gradient with respect to the next state."""
        sim = self.sim
        before = sim.state()
        taken = sim.actions

        # Where the entries of a state lie in the arrays, and the derivatives by the end
        pack, lane = self._env
        rows, is_real = sim.rows
        padding = ~is_real
        place = pack[:, None], rows, lane[:, None]
        for part, values in zip(self._by, by_end.unbind(1), strict=True):
            part.zero_()
            part.index_put_(place, values.masked_fill(padding, 0.0).to(part.dtype), accumulate=True)

        # The step again, then back; environments that have been frozen since were not yet
        sim.set_state(before | _parts(state) | {"frozen": torch.zeros_like(before["frozen"])})
        sim.take(actions)
        sim.place_actions()
        sim.run(self._launches)

        # The derivatives by the start; the simulation is then where it was
        by_start = torch.stack([part[place].masked_fill(padding, 0.0) for part in self._by], dim=1)
        low, high = sim.action_range
        by_actions = self._by_action[pack, :, lane] * ((actions >= low) & (actions <= high))
        sim.set_state(before)
        sim.take(taken)
        return by_start.to(by_end.dtype), by_actions.to(actions.dtype)


def _parts(state: torch.Tensor) -> dict[str, torch.Tensor]:
    return dict(zip(PARTS, state.unbind(1), strict=True))


class _Step(torch.autograd.Function):
    """One control step as a function of torch's autograd."""

    @staticmethod
    def forward(ctx: Any, gradients: Gradients, state: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        after, moved = gradients._forward(state)
        ctx.gradients = gradients
        ctx.save_for_backward(state, actions, moved, gradients.sim.world_numbers)
        return after

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, by_end: torch.Tensor) -> tuple[None, torch.Tensor, torch.Tensor]:
        """Return gradients of state and actions; gradients of environments that did not move pass through."""
        state, actions, moved, worlds = ctx.saved_tensors
        if not torch.equal(worlds, ctx.gradients.sim.world_numbers):
            raise SimulationError(
                "The bodies have been exchanged since the step: it cannot be differentiated any more."
            )
        by_start, by_actions = ctx.gradients._backward(state, actions, by_end)
        return None, by_start.where(moved[:, None, None], by_end), by_actions.where(moved[:, None], 0.0)
