"""PPO for many designs at once: separate trainings that share their matrix products."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import torch
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict
from torch import nn

from warpvox.algos.population.model import PopulationModel
from warpvox.algos.population.streams import Streams
from warpvox.algos.training.adam import VectorAdam
from warpvox.algos.training.ppo import LOSSES, PPO, Samples

__all__ = ["PopulationPPO"]

BLOCK = 16
"""Most designs that learn in one go; fewer cost more overhead, more leave threads without work."""


class PopulationPPO(PPO):
    """Our PPO with an axis for designs: losses, gradients' norms, learning rates and random numbers are per design.

    Rows of the storage are sorted by design. Each design learns what :class:`warpvox.algos.training.ppo.PPO` would
    teach it alone, up to rounding. The same batch gives the same bits.

    Args:
        actor, critic: stacked networks.
        storage: for ``designs * envs`` environments; actions as wide as the actor's outputs.
        streams: each design's random numbers.
        threads: that share the designs while learning.
        settings: further arguments of :class:`warpvox.algos.training.ppo.PPO`.

    Attributes:
        rates: float64 ``[designs]``, learning rates.
        losses: ``{name: [designs]}`` of the last update.
    """

    def __init__(
        self,
        actor: PopulationModel,
        critic: PopulationModel,
        storage: RolloutStorage,
        streams: Streams,
        threads: int = 1,
        **settings: Any,
    ) -> None:
        # rsl-rl would normalise advantages over all rows: `_in_random_order` does it for each design
        super().__init__(actor, critic, storage, normalize_advantage_per_mini_batch=True, **settings)
        self.streams, self._pool = streams, None
        if threads > 1:  # torch's own number of threads is a setting of every thread
            own = {"initializer": torch.set_num_threads, "initargs": (torch.get_num_threads(),)}
            self._pool = ThreadPoolExecutor(threads, **own)
        self.losses: dict[str, torch.Tensor] = {}

    @property
    def num_designs(self) -> int:
        """Number of designs."""
        return self.actor.num_designs

    def _optimizer(self) -> VectorAdam:
        return VectorAdam([self.actor, self.critic], self.initial_learning_rate, self.adam_eps, stacked=True)

    def _rate_shape(self) -> tuple[int, ...]:
        return (self.num_designs,)

    def _optimise(self, data: Samples) -> dict[str, float]:
        """Threads share the work block by block, so that their number changes no result."""
        count = -(-self.num_designs // BLOCK)
        ends = [self.num_designs * k // count for k in range(count + 1)]
        blocks = [slice(*pair) for pair in itertools.pairwise(ends)]
        run = self._pool.map if self._pool else map
        losses = torch.cat(list(run(lambda block: self._learn(block, data), blocks)), dim=1)
        self.losses = dict(zip(LOSSES, losses, strict=True))
        return {name: values.mean().item() for name, values in self.losses.items()}

    def _learn(self, block: slice, data: Samples) -> torch.Tensor:
        part = Samples(*(values[block] for values in data))
        return self._epochs(part, self.actor.part(block), self.critic.part(block), block)

    def _samples(self, values: torch.Tensor) -> torch.Tensor:
        """``[steps, rows, ...]`` of the storage as ``[designs, steps * envs, ...]``."""
        steps, rows = values.shape[:2]
        split = values.view(steps, self.num_designs, rows // self.num_designs, *values.shape[2:])
        return split.transpose(0, 1).flatten(1, 2)

    def _store(self, target: torch.Tensor, values: torch.Tensor) -> None:
        steps = self.storage.num_transitions_per_env
        by_step = values.unflatten(1, (steps, -1)).transpose(0, 1)
        target.copy_(by_step.flatten(1, 2))

    def _in_random_order(self, rows: Samples, count: int) -> Samples:
        """Each design's samples in an order of its own; its advantages get a mean of 0 and a deviation of 1."""
        centred = rows.advantages - rows.advantages.mean(1, keepdim=True)
        rows = rows._replace(advantages=centred / (rows.advantages.std(1, keepdim=True) + 1e-8))
        order, designs = self.streams.permutations(count), torch.arange(self.num_designs, device=self.device)
        return Samples(*(values[designs[:, None], order] for values in rows))

    # ------------------------------------------------------------ state, parts

    def healthy(self) -> torch.Tensor:
        """bool ``[designs]``: whose networks consist of finite numbers."""
        sums = [parameter.detach().sum((1, 2)) for parameter in self.optimizer.parameters]
        return torch.isfinite(torch.stack(sums)).all(0)

    def keep(self, index: Sequence[int], obs: TensorDict) -> None:
        """Keep these designs, in this order, with observations like ``obs``; between updates only."""
        envs, steps = self.storage.num_envs // self.num_designs, self.storage.num_transitions_per_env
        shapes = [parameter.shape for parameter in self.optimizer.parameters]
        self.critic.obs_normalizer = nn.Identity()  # it is the actor's
        for part in (self.actor, self.critic, self.streams):
            part.keep(index)
        self.critic.obs_normalizer = self.actor.obs_normalizer
        self.optimizer.keep(index, shapes)
        self.rates = self.rates[list(index)]
        self.storage = RolloutStorage("rl", envs * len(index), steps, obs, [max(self.actor.outputs)], self.device)

    def save(self) -> dict[str, Any]:
        """Networks, optimiser, learning rates and random streams, for :meth:`load`."""
        return super().save() | {"rates": self.rates, "streams": self.streams.state()}

    def load(self, loaded_dict: dict[str, Any], load_cfg: dict | None = None, strict: bool = True) -> bool:
        """Restore :meth:`save` of the same designs and settings."""
        result = super().load(loaded_dict, load_cfg, strict)
        self.rates = loaded_dict["rates"].to(self.device)
        self.streams.set_state(loaded_dict["streams"])
        return result
