"""Mapping from observations with ``obs="voxel"`` to the inputs of voxel policies, and to actions."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import nn
from torch.nn import functional

from warpvox.algos.policies.gait import phase_at
from warpvox.envs.terms.observations import is_timed
from warpvox.envs.vec_env import VoxelVecEnv
from warpvox.envs.voxels import FEATURES as OBSERVED, NUM_FEATURES
from warpvox.errors import ConfigError
from warpvox.types import VOXEL

INPUTS = {
    "shift": slice(0, 2),
    "shape": slice(2, 8),
    "velocity": slice(8, 10),
    "shape_velocity": slice(10, 16),
    "place": slice(16, 18),
    "type": slice(18, 22),
    "neighbours": slice(22, 26),
}
"""Indices of voxel features in a policy's input; all features are 0 for a cell without a voxel.

``shift``: x and y of the voxel's centre less those at rest, the mean over the body's voxels taken off; ``shape``: for x
and for y how far the corners are spread horizontally, vertically and crosswise; ``velocity``, ``shape_velocity``: of
centre and shape; ``place``: x and y of the centre at rest, in voxels, about the mean over the body's voxels; ``type``:
one of (rigid, soft, horizontal actuator, vertical actuator) is 1; ``neighbours``: 1 where the voxel is connected
(above, right, below, left).
"""
MOVING = 16
"""Number of a voxel's inputs that change during an episode; these come first."""
FEATURES = 26
"""Number of inputs per voxel."""
CLOCK = (7.0, 14.0, 28.0)
"""Default periods of the time inputs (sines and cosines), in control steps."""
_SPREADS = ((1, 1, 1, 1), (-1, 1, 1, -1), (1, 1, -1, -1), (1, -1, 1, -1))
"""Signs of the corners (top left, top right, bottom right, bottom left) in a voxel's centre and shape."""


@dataclass(frozen=True)
class VoxelLayout:
    """Sizes of bodies, observations and actions for a voxel policy.

    Attributes:
        rest: number of inputs besides those of voxels: entries of an observation after the grid, with the sines and
            cosines of the clock in place of the time.
        actions: entries of an action, the most actuators that a body may have.
        timed: True if an observation ends with the time (``obs="timed_voxel"``).
        periods: of the clock's sines and cosines, in control steps.
    """

    rows: int
    columns: int
    rest: int
    actions: int
    timed: bool = False
    periods: tuple[float, ...] = CLOCK

    def __post_init__(self) -> None:
        """Convert ``periods`` to a tuple of floats."""
        object.__setattr__(self, "periods", tuple(map(float, self.periods)))

    @property
    def scaled(self) -> int:
        """Number of normalised entries of an observation behind the grid, without the time."""
        return self.rest - 2 * len(self.periods) * self.timed

    @property
    def cells(self) -> int:
        return self.rows * self.columns

    @property
    def num_obs(self) -> int:
        return self.cells * NUM_FEATURES + self.scaled + self.timed

    def random_obs(self, rows: int, generator: torch.Generator) -> torch.Tensor:
        """Draw observations ``[rows, num_obs]`` of random bodies with random motions."""
        # features of the voxels, with flags of 0 or 1 as in an environment
        cells = 0.1 * torch.randn((rows, self.cells, NUM_FEATURES), generator=generator)
        kinds = torch.randint(0, 5, (rows, self.cells), generator=generator)
        cells[..., OBSERVED["type"]] = functional.one_hot(kinds, 5).to(cells.dtype)
        cells[..., OBSERVED["neighbours"]] = (cells[..., OBSERVED["neighbours"]] > 0).to(cells.dtype)

        # what follows the grid
        rest = torch.randn((rows, self.scaled), generator=generator)
        time = torch.randint(0, 1000, (rows, int(self.timed)), generator=generator)
        return torch.cat([cells.flatten(1), rest, time.float()], dim=1)

    def dict(self) -> dict[str, Any]:
        """Convert the layout to a dictionary for a checkpoint, without default ``periods``."""
        own = asdict(self) | {"periods": list(self.periods)}
        if self.periods == CLOCK:
            del own["periods"]
        return own


def layout_of(env: VoxelVecEnv, periods: tuple[float, ...] = CLOCK) -> VoxelLayout:
    """Return the layout of environments with ``obs="voxel"`` or ``"timed_voxel"``; ``periods``: of the clock."""
    if len(env.voxels) != 1:
        what = "several robots" if env.voxels else 'not obs="voxel"'
        raise ConfigError(f"A policy for voxels needs environments of one robot with obs=voxel; these have {what}.")
    grid = next(iter(env.voxels.values()))
    cells = grid.rows * grid.columns
    if grid.place != slice(0, cells * NUM_FEATURES):
        raise ConfigError("A policy for voxels needs the grid at the beginning of an observation.")
    rest = env.num_obs - cells * NUM_FEATURES
    timed = is_timed(env.obs_columns[0])
    rest += (2 * len(periods) - 1) * timed
    return VoxelLayout(grid.rows, grid.columns, rest, env.num_actions, timed, periods)


class VoxelInputs(nn.Module):
    """Converts observations to a policy's inputs; inputs of a cell without a voxel are 0.

    Its tables are buffers, so that they lie where the policy is: a step brings nothing to the device.
    """

    transform: torch.Tensor
    places: torch.Tensor
    periods: torch.Tensor

    def __init__(self, layout: VoxelLayout) -> None:
        super().__init__()
        self.layout = layout
        self.register_buffer("transform", input_transform(), persistent=False)
        self.register_buffer("places", rest_places(layout), persistent=False)
        self.register_buffer("periods", torch.tensor(layout.periods, dtype=torch.float64), persistent=False)

    def clock(self, time: torch.Tensor) -> torch.Tensor:
        """Compute sines, then cosines ``[rows, 2 * len(periods)]`` of the time ``[rows, 1]`` in control steps."""
        phase = phase_at(time, self.periods.to(time.dtype))
        return torch.cat([phase.sin(), phase.cos()], dim=1)

    def forward(self, obs: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """Split observations ``[rows, num_obs]`` into features, voxel mask and actions.

        Returns:
            Features of the voxels ``[rows, cells, 26]`` (:data:`INPUTS`, not scaled yet), 1 where there is a voxel
            ``[rows, cells, 1]``, the actions of the cells ``[rows, cells]`` (``layout.actions`` where there is no
            actuator) and the kinds of the actions ``[rows, actions]`` (0: the body has no such action, 1: horizontal,
            2: vertical).
        """
        layout = self.layout
        cells = obs[:, : layout.cells * NUM_FEATURES].reshape(-1, layout.cells, NUM_FEATURES)
        types = cells[..., OBSERVED["type"]]
        present = 1 - types[..., :1]
        features = cells @ self.transform.to(obs.dtype)
        # masked, not multiplied: values that are not finite in an absent cell must become 0, too
        features = features.masked_fill_(present == 0, 0.0)
        count = present.sum(1, keepdim=True).clamp(min=1)
        place = self.places.to(obs.dtype) * present
        place = (place - place.sum(1, keepdim=True) / count) * present
        shift = features[..., INPUTS["shift"]] - VOXEL * place
        features[..., INPUTS["shift"]] = (shift - shift.sum(1, keepdim=True) / count) * present
        features[..., INPUTS["place"]] = place
        kind = types[..., 3] + 2 * types[..., 4]
        driving = kind > 0
        actions = torch.where(driving, driving.long().cumsum(-1) - 1, layout.actions)
        kinds = torch.zeros(obs.shape[0], layout.actions + 1, dtype=obs.dtype, device=obs.device)
        kinds = kinds.scatter(1, actions, kind)[:, : layout.actions]
        return features, present, actions, kinds


def input_transform() -> torch.Tensor:
    """Return the matrix ``[25, 26]`` from an observed cell's features to inputs, with zero columns for ``place``."""
    axes = [(0, 0), (1, 0), *((axis, spread) for axis in (0, 1) for spread in (1, 2, 3))]
    columns = [[_SPREADS[spread][k // 2] / 4 * (k % 2 == axis) for k in range(8)] for axis, spread in axes]
    corners = torch.tensor(columns).T
    transform = torch.zeros(NUM_FEATURES, FEATURES)
    transform[OBSERVED["positions"], :8] = corners
    transform[OBSERVED["velocities"], 8:MOVING] = corners
    fixed = slice(OBSERVED["type"].start + 1, OBSERVED["neighbours"].stop)
    transform[fixed, INPUTS["type"].start :] = torch.eye(fixed.stop - fixed.start)
    return transform


def rest_places(layout: VoxelLayout) -> torch.Tensor:
    """Return the x (right) and y (up) of the cells' centres ``[cells, 2]``, in voxels."""
    y, x = torch.meshgrid(-torch.arange(layout.rows), torch.arange(layout.columns), indexing="ij")
    return torch.stack([x.flatten(), y.flatten()], dim=1).float()
