"""Voxel networks as rsl-rl models: inputs, scaling, order of actions, action distribution."""

from collections.abc import Mapping
from typing import Any

import torch
from tensordict import TensorDict
from torch import nn

from warpvox.algos.policies.layout import FEATURES, MOVING, VoxelInputs, VoxelLayout
from warpvox.algos.policies.network import Network, VoxelGaussian
from warpvox.algos.policies.registry import make_network

FARTHEST = 8.0
"""Clipping limit of scaled inputs, in standard deviations."""
BLOCK = 1024
"""Rows per block when updating the moments; a block fits into a CPU's cache."""


class VoxelNormalizer(nn.Module):
    """Converts observations to inputs, scaled by running moments over the voxels of all bodies.

    A feature of all voxels is scaled alike, wherever in the grid it lies, so that a voxel looks the same in all bodies.
    What moves is scaled; place, type, neighbours and the clock stay as they are.
    """

    mean: torch.Tensor
    var: torch.Tensor
    count: torch.Tensor

    def __init__(self, layout: VoxelLayout) -> None:
        super().__init__()
        self.layout = layout
        self.inputs = VoxelInputs(layout)
        self.register_buffer("mean", torch.zeros(MOVING + layout.scaled))
        self.register_buffer("var", torch.ones(MOVING + layout.scaled))
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))

    def forward(self, obs: torch.Tensor) -> torch.Tensor:
        """Compute a network's inputs from observations ``[rows, num_obs]``, then actuator order and kinds."""
        features, present, actions, kinds = self.inputs(obs)
        deviation = self.var.sqrt() + 1e-4  # 1/1000 of a voxel's side, for velocities per second
        moving = features[..., :MOVING].sub_(self.mean[:MOVING]).div_(deviation[:MOVING])
        moving.clamp_(-FARTHEST, FARTHEST).mul_(present)
        rest = (self._between_grid_and_time(obs) - self.mean[MOVING:]) / deviation[MOVING:]
        rest = [rest.clamp_(-FARTHEST, FARTHEST), *([self.inputs.clock(obs[:, -1:])] if self.layout.timed else [])]
        return torch.cat([features.flatten(1), *rest, actions.to(obs.dtype), kinds], dim=1)

    def _between_grid_and_time(self, obs: torch.Tensor) -> torch.Tensor:
        """Return the observations between the grid and the time."""
        last = obs.shape[1] - int(self.layout.timed)
        return obs[:, last - self.layout.scaled : last]

    @torch.no_grad()
    def update(self, obs: torch.Tensor) -> None:
        """Update the moments from observations ``[rows, num_obs]`` of all processes."""
        sums = sum((self._sums(rows) for rows in obs.split(BLOCK)), torch.zeros(()))
        if torch.distributed.is_initialized():
            torch.distributed.all_reduce(sums)
        first, second, (voxels, rows) = *sums[:-2].chunk(2), sums[-2:]
        number = torch.cat([voxels.expand(MOVING), rows.expand(self.layout.scaled)])
        mean = first / number
        var = (second / number - mean.square()).clamp(min=0)
        self.count += rows
        rate = rows / self.count
        moved = mean - self.mean
        self.mean += rate * moved
        self.var += rate * (var - self.var + moved * (mean - self.mean))

    def _sums(self, obs: torch.Tensor) -> torch.Tensor:
        """Return sums and sums of squares of scaled entries, number of voxels and number of rows, float64."""
        features, present, _, _ = self.inputs(obs)
        moving = features[..., :MOVING]
        rest = self._between_grid_and_time(obs)
        sums = torch.cat([moving.sum((0, 1)), rest.sum(0), moving.square().sum((0, 1)), rest.square().sum(0)])
        return torch.cat([sums.double(), present.sum().double()[None], sums.new_full((1,), len(obs)).double()])


class VoxelModel(Network):
    """Actor or critic for ``obs="voxel"``, as a model for rsl-rl's PPO.

    Args:
        obs, obs_groups, obs_set, output_dim, obs_normalization, distribution_cfg: as of rsl-rl's models; a model with a
            distribution gives a mean for every action, one without a value.
        layout: of observations and actions, see :func:`warpvox.algos.policies.layout.layout_of`.
        network: name of the network (:mod:`warpvox.algos.policies.registry`).
    """

    def __init__(
        self,
        obs: TensorDict,
        obs_groups: dict[str, list[str]],
        obs_set: str,
        output_dim: int,
        layout: Mapping[str, Any],
        network: str,
        settings: Mapping[str, Any] | None = None,
        obs_normalization: bool = True,
        distribution_cfg: Mapping[str, Any] | None = None,
    ) -> None:
        nn.Module.__init__(self)
        self.obs_groups, self.obs_dim = self._get_obs_dim(obs, obs_groups, obs_set)
        self.layout = VoxelLayout(**layout)
        self.obs_normalization = obs_normalization
        self.distribution: VoxelGaussian | None = None
        if distribution_cfg is not None:
            given = {name: value for name, value in distribution_cfg.items() if name != "class_name"}
            self.distribution = VoxelGaussian(output_dim, **given)
        self.obs_normalizer = VoxelNormalizer(self.layout)  # without `obs_normalization` it only clips
        self.network = make_network(network, self.layout, self.distribution is None, settings)
        cells = self.layout.cells
        count = self.layout.cells * FEATURES
        self._parts = [count, self.layout.rest, cells, self.layout.actions]

    def unpack(self, latent: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Split inputs ``[rows, inputs]`` into voxels ``[rows, cells, 26]``, the rest and the order of actions.

        Tells the distribution which actions the bodies have.
        """
        features, rest, actions, kinds = latent.split(self._parts, dim=1)
        if self.distribution is not None:
            self.distribution.look(kinds)
        return features.contiguous().view(-1, self.layout.cells, FEATURES), rest, actions

    def run(self, latent: torch.Tensor) -> torch.Tensor:
        """Compute action means ``[rows, actions]``, or values ``[rows, 1]``, from inputs."""
        cells, rest, actions = self.unpack(latent)
        values = self.network(cells, rest)
        if self.distribution is None:
            return values[:, None]
        # cells without an actuator share the last column, which is dropped
        means = values.new_zeros(values.shape[0], self.layout.actions + 1).scatter(1, actions.long(), values)
        return means[:, : self.layout.actions]
