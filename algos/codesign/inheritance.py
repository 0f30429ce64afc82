"""Weight inheritance between different bodies: inputs and outputs are matched by grid position."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from rsl_rl.models import MLPModel
from torch import nn

from warpvox.envs.vec_env import VoxelVecEnv
from warpvox.envs.worlds import ROBOT
from warpvox.errors import RunError
from warpvox.types import Cell


@dataclass(frozen=True)
class BodyLayout:
    """Names of all observations and actions of a design, by grid position.

    ``columns`` name an axis and a corner of the body's grid, or an entry of a term that is not about points;
    ``actuators`` give the row, column and type of a cell. Equal names mean the same thing in different bodies.
    """

    columns: tuple[tuple, ...]
    actuators: tuple[tuple, ...]

    @staticmethod
    def of(env: VoxelVecEnv, design: int) -> BodyLayout:
        """Return the layout of design number ``design`` in ``env``."""
        body = env.designs[design]
        first_env = design * env.num_envs // env.num_designs
        mesh = env.sim.designs[int(env.sim.design_index[first_env])].body(ROBOT)
        assert mesh is not None  # every world of a task has its robot

        # The mesh is placed in the world's grid: shift its cells to the body's own grid.
        row_shift = int(np.flatnonzero(np.any(body != Cell.EMPTY, 1))[0]) - min(row for row, _ in mesh.cells)
        column_shift = int(np.flatnonzero(np.any(body != Cell.EMPTY, 0))[0]) - min(column for _, column in mesh.cells)

        # Row and column of the corner that each point lies at
        corners = {}
        for (row, column), points in mesh.corners.items():
            around = ((row, column), (row, column + 1), (row + 1, column + 1), (row + 1, column))
            for point, (y, x) in zip(points, around, strict=True):
                corners[point] = (y + row_shift, x + column_shift)
        places = [corners[point] for point in range(len(mesh.points))]

        # Observations
        columns: list[tuple] = []
        for term in env.spec.observations:
            part = env.obs_columns[design][term.name]
            width = part.stop - part.start
            if dict(term.params).get("name") == ROBOT and width == 2 * len(places):
                columns += [(term.name, axis, *place) for axis in "xy" for place in places]
            else:
                columns += [(term.name, width, k) for k in range(width)]

        # Actions
        actuators = []
        for row, column in mesh.cells:
            kind = mesh.kind((row, column))
            if kind in (Cell.H_ACT, Cell.V_ACT):
                actuators.append((row + row_shift, column + column_shift, kind))
        return BodyLayout(tuple(columns), tuple(actuators))


def copy_weights(
    actor: MLPModel, critic: MLPModel, child: BodyLayout, parent: BodyLayout, policy: dict[str, torch.Tensor]
) -> None:
    """Initialise a child's networks from its parent's policy.

    Weights of shared inputs and outputs, hidden layers and running moments come from the parent. New inputs of the
    child have weights of 0; new outputs keep their initial weights and deviation. The value function keeps its initial
    weights, for a policy's state holds none, and takes the moments.

    Args:
        actor, critic: of the child; changed in place.
    """
    # Layers
    state = actor.state_dict()
    inputs = _matches(child.columns, parent.columns)
    outputs = _matches(child.actuators, parent.actuators)
    layers = [k for k, layer in enumerate(actor.mlp) if isinstance(layer, nn.Linear)]
    for k in layers:
        for name in (f"mlp.{k}.weight", f"mlp.{k}.bias"):
            own = state[name]
            old = policy.get(name)
            rows = outputs if k == layers[-1] else None
            columns = inputs if k == layers[0] and own.ndim == 2 else None
            if columns is not None:
                own.zero_()
            _copy(own, old, rows, columns, name)
    _copy(state["distribution.log_std_param"], policy["distribution.log_std_param"], outputs, None, "log_std")

    # Moments of the observations
    for name in ("_mean", "_var", "_std"):
        key = f"obs_normalizer.{name}"
        if key in state:
            _copy(state[key].T, policy[key].T, inputs, None, key)
    if "obs_normalizer.count" in state:
        # Limit the count, so that the child's normaliser still adapts to its own observations.
        state["obs_normalizer.count"].copy_(policy["obs_normalizer.count"].clamp(max=4096))

    actor.load_state_dict(state)
    moments = {name: value for name, value in state.items() if name.startswith("obs_normalizer.")}
    critic.load_state_dict(critic.state_dict() | moments)


def _matches(child: tuple[tuple, ...], parent: tuple[tuple, ...]) -> tuple[list[int], list[int]]:
    """Find names that both lists contain; return their indices in the child's list and in the parent's."""
    where = {name: k for k, name in enumerate(parent)}
    mine = [k for k, name in enumerate(child) if name in where]
    theirs = [where[child[k]] for k in mine]
    return mine, theirs


def _copy(own: torch.Tensor, old: torch.Tensor | None, rows: tuple | None, columns: tuple | None, name: str) -> None:
    """Copy the matched rows and columns of ``old`` into ``own``; None: copy all, with equal sizes."""
    free = [axis for axis, pairs in enumerate((rows, columns)) if pairs is None and axis < own.ndim]
    if old is None or old.ndim != own.ndim or any(old.shape[axis] != own.shape[axis] for axis in free):
        found = "nothing" if old is None else list(old.shape)
        raise RunError(f"A parent's policy has another architecture: {name} is {found}, expected {list(own.shape)}.")

    mine = []
    theirs = []
    for pair, size in zip((rows, columns), own.shape, strict=False):
        every = range(size)
        mine.append(every if pair is None else pair[0])
        theirs.append(every if pair is None else pair[1])
    own[np.ix_(*mine)] = old[np.ix_(*theirs)].to(own)
