"""Policy for design inside the episode: a cellular automaton designs the body, a voxel network controls it.

Both are one model of rsl-rl's kind, which stock PPO trains on :class:`lab.design_in_episode.episodes.RslRlDesignEnv`.
"""

from collections.abc import Mapping
from typing import Any

import torch
from rsl_rl.models import MLPModel
from rsl_rl.modules.distribution import Distribution
from tensordict import TensorDict
from torch import nn

from lab.design_in_episode.episodes import NUM_TYPES, DesignLayout, RslRlDesignEnv
from warpvox.algos.policies.layout import layout_of
from warpvox.algos.policies.model import VoxelModel
from warpvox.errors import ConfigError

GROUP = "policy"
"""Name of the observation group."""


def joined(model: MLPModel, obs: TensorDict) -> torch.Tensor:
    """Concatenate a model's observations, ``[rows, num_obs]``."""
    return torch.cat([obs[name] for name in model.obs_groups], dim=-1)


def design_models(
    env: RslRlDesignEnv,
    network: str = "grid",
    settings: Mapping[str, Any] | None = None,
    channels: int = 32,
    init_std: float = 0.5,
) -> dict[str, Any]:
    """Build the entries ``obs_groups``, ``actor`` and ``critic`` of rsl-rl's configuration.

    Args:
        env: made with ``obs="voxel"`` and ``actions="types"``.
        network, settings: of the control stage, as for ``policy=`` and ``network=`` of ``warpvox train``.
        init_std: deviation of the control stage's exploration at the start.
    """
    plain = env.env.env
    if not plain.voxels or env.env.layout.actions != "types":
        raise ConfigError('These models need design_episodes(..., obs="voxel", actions="types").')
    control = {"network": network, "settings": dict(settings or {}), "voxels": layout_of(plain).dict()}
    model = {"class_name": DesignModel, "layout": env.env.layout.dict(), "channels": channels, **control}
    noise = {"class_name": "GaussianDistribution", "init_std": init_std, "std_type": "log"}
    return {
        "obs_groups": {"actor": [GROUP], "critic": [GROUP]},
        "actor": model | {"distribution_cfg": noise},
        "critic": dict(model),
    }


class Automaton(nn.Module):
    """Cellular automaton: computes features of a partial body from each cell's neighbourhood with shared weights.

    Two convolutions of 3x3 cells with tanh. Inputs of a cell: its type, one-hot; 1, which tells the rim of the grid
    from what lies beyond; its place in the grid, -1 to 1 in both directions; the share of the design steps that are
    done; and whether it is the one to be set.
    """

    places: torch.Tensor

    def __init__(self, layout: DesignLayout, outputs: int, channels: int) -> None:
        super().__init__()
        self.layout = layout
        first = nn.Conv2d(NUM_TYPES + 5, channels, 3, padding=1)
        second = nn.Conv2d(channels, channels, 3, padding=1)
        last = nn.Conv2d(channels, outputs, 1)
        weight, bias = last.parameters()
        nn.init.orthogonal_(weight, 0.1)
        nn.init.zeros_(bias)
        self.layers = nn.Sequential(first, nn.Tanh(), second, nn.Tanh(), last)
        lines = [2 * (torch.arange(count) + 0.5) / count - 1 for count in (layout.rows, layout.columns)]
        places = torch.stack([torch.ones(layout.rows, layout.columns), *torch.meshgrid(*lines, indexing="ij")])
        self.register_buffer("places", places, persistent=False)

    def forward(self, obs: torch.Tensor) -> torch.Tensor:
        """Compute features ``[rows, cells, outputs]`` from observations ``[rows, num_obs]``."""
        layout, count = self.layout, len(obs)
        grid = (layout.rows, layout.columns)
        types = layout.types(obs).transpose(1, 2).unflatten(2, grid)
        progress = layout.progress(obs)[:, None, None, None].expand(count, 1, *grid)
        cursor = layout.cursor(obs) if layout.revise == "one" else obs.new_zeros(count, layout.cells)
        inputs = [types, self.places.expand(count, -1, -1, -1), progress, cursor.reshape(count, 1, *grid)]
        return self.layers(torch.cat(inputs, dim=1)).flatten(2).transpose(1, 2)


class DesignDistribution(Distribution):
    """Action distribution: categorical cell types in the design stage, Gaussian actions in the control stage.

    What belongs to the other stage, and actions that a body has not, are 0 and take no part: they add nothing to
    likelihood, entropy, divergence or gradients. :meth:`look` says, before :meth:`update`, which rows are which.

    Args:
        gaussian: the distribution of the control stage (``VoxelModel.distribution``).
    """

    def __init__(self, layout: DesignLayout, gaussian: Distribution) -> None:
        super().__init__(layout.num_actions)
        self.layout, self.gaussian = layout, gaussian

    def look(self, designing: torch.Tensor) -> None:
        """Set the mask of rows in the design stage, bool ``[rows]``."""
        self._designing = designing

    def update(self, mlp_output: torch.Tensor) -> None:
        """Set action means and type logits, ``[rows, control + revised * 5]``."""
        self.gaussian.update(mlp_output[:, : self.layout.control])
        logits = mlp_output[:, self.layout.control :].unflatten(1, (-1, NUM_TYPES))
        # 0 where nothing is designed: such rows add 0 to all sums
        self._log_p = torch.where(self._designing[:, None, None], logits.log_softmax(-1), 0.0)

    def sample(self) -> torch.Tensor:
        """Sample actions ``[rows, actions]`` without gradient; types are numbers 0 to 4."""
        noise = torch.empty_like(self._log_p).exponential_().log()  # the largest of log p - log(noise) is drawn with p
        types = (self._log_p.detach() - noise).argmax(-1)
        return torch.cat([self.gaussian.sample(), self._of_design(types)], dim=1)

    def _of_design(self, types: torch.Tensor) -> torch.Tensor:
        return (types * self._designing[:, None]).to(self._log_p.dtype)

    @property
    def mean(self) -> torch.Tensor:
        """Mean actions and most likely types, ``[rows, actions]``."""
        return torch.cat([self.gaussian.mean, self._of_design(self._log_p.argmax(-1))], dim=1)

    @property
    def std(self) -> torch.Tensor:
        """Standard deviations of the control actions, ``[rows, control]``."""
        return self.gaussian.std

    @property
    def entropy(self) -> torch.Tensor:
        """Entropy of each row's distribution, ``[rows]``."""
        design = -(self._log_p.exp() * self._log_p).sum((1, 2))
        return self.gaussian.entropy + design

    @property
    def params(self) -> tuple[torch.Tensor, ...]:
        """Means and deviations ``[rows, control]``, and log-probabilities of types ``[rows, revised, 5]``."""
        return (*self.gaussian.params, self._log_p)

    def log_prob(self, outputs: torch.Tensor) -> torch.Tensor:
        """Compute log-probabilities ``[rows]`` of actions ``[rows, actions]``."""
        control = self.layout.control
        # entries that do not count may hold anything, also values that are no type
        types = torch.where(self._designing[:, None], outputs[:, control:], 0.0).long()
        design = self._log_p.gather(2, types[..., None])[..., 0].sum(1)
        return self.gaussian.log_prob(outputs[:, :control]) + design

    def kl_divergence(self, old_params: tuple[torch.Tensor, ...], new_params: tuple[torch.Tensor, ...]) -> torch.Tensor:
        """Compute KL(old || new), ``[rows]``; masked entries are equal in both."""
        (old_mean, old_std, old), (mean, std, new) = old_params, new_params
        gaussian = (std / old_std).log() + (old_std.square() + (old_mean - mean).square()) / (2 * std.square()) - 0.5
        return gaussian.sum(1) + (old.exp() * (old - new)).sum((1, 2))


class DesignModel(MLPModel):
    """Actor or critic for both stages.

    Args:
        layout: of observations and actions (:class:`DesignLayout`).
        voxels: layout of the control stage's observations (:func:`warpvox.algos.policies.layout.layout_of`).
        network, settings, channels: see :func:`design_models`.
    """

    def __init__(
        self,
        obs: TensorDict,
        obs_groups: dict[str, list[str]],
        obs_set: str,
        output_dim: int,
        layout: Mapping[str, Any],
        voxels: Mapping[str, Any],
        network: str = "grid",
        settings: Mapping[str, Any] | None = None,
        channels: int = 32,
        obs_normalization: bool = True,
        distribution_cfg: Mapping[str, Any] | None = None,
    ) -> None:
        nn.Module.__init__(self)
        self.obs_groups, self.obs_dim = self._get_obs_dim(obs, obs_groups, obs_set)
        self.layout, self.obs_normalization = DesignLayout(**layout), obs_normalization
        plan = self.layout
        actor = distribution_cfg is not None
        self.control = VoxelModel(
            self._task(joined(self, obs)),
            {obs_set: [GROUP]},
            obs_set,
            plan.control if actor else 1,
            voxels,
            network,
            settings,
            obs_normalization,
            distribution_cfg,
        )
        self.automaton = Automaton(plan, NUM_TYPES if actor else channels, channels)
        self.value = None if actor else nn.Linear(channels, 1)
        gaussian = self.control.distribution
        self.distribution: DesignDistribution | None = None if gaussian is None else DesignDistribution(plan, gaussian)

    def _task(self, obs: torch.Tensor) -> TensorDict:
        """Extract the control stage's observations for its model."""
        return TensorDict({GROUP: obs[:, : self.layout.task]}, batch_size=[len(obs)])

    def forward(
        self, obs: TensorDict, masks: object = None, hidden_state: object = None, stochastic_output: bool = False
    ) -> torch.Tensor:
        flat = joined(self, obs)
        out = self._outputs(flat)
        if self.distribution is None:
            return out
        self.distribution.look(self.layout.designing(flat))
        self.distribution.update(out)
        return self.distribution.sample() if stochastic_output else self.distribution.mean

    def _outputs(self, obs: torch.Tensor) -> torch.Tensor:
        """Compute an actor's means and logits ``[rows, control + revised * 5]``, or a critic's values ``[rows, 1]``."""
        layout, designing = self.layout, self.layout.designing(obs)
        control = self.control.run(self.control.obs_normalizer(obs[:, : layout.task]))
        rows = designing.nonzero()[:, 0]
        design = self.automaton(obs[rows])
        if self.value is not None:
            return control.index_put((rows,), self.value(torch.tanh(design.mean(1))))
        if layout.revise == "one":
            design = design[torch.arange(len(rows), device=obs.device), layout.cursor(obs[rows]).argmax(1)]
        logits = control.new_zeros(len(obs), layout.revised * NUM_TYPES)
        return torch.cat([control, logits.index_put((rows,), design.flatten(1))], dim=1)

    def update_normalization(self, obs: TensorDict) -> None:
        flat = joined(self, obs)
        moving = flat[~self.layout.designing(flat)]
        if len(moving):
            self.control.update_normalization(self._task(moving))
