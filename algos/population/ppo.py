"""PPO for many designs at once: separate trainings that share their matrix products."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import torch
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict

from warpvox.algos.population.adam import PopulationAdam, clip_gradients
from warpvox.algos.population.model import PopulationModel
from warpvox.algos.population.streams import Streams
from warpvox.algos.training.ppo import PPO

__all__ = ["PopulationPPO"]

SLOWEST, FASTEST = 1e-5, 1e-2
"""Between these rsl-rl's adaptive schedule keeps a learning rate."""


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
        # Advantages are normalised for each design in `update`; rsl-rl would do it over all rows.
        super().__init__(actor, critic, storage, normalize_advantage_per_mini_batch=True, **settings)
        self.streams, self.threads = streams, threads
        # torch's own number of threads is a setting of every thread
        self._pool = ThreadPoolExecutor(
            max(1, threads - 1), initializer=torch.set_num_threads, initargs=(torch.get_num_threads(),)
        )
        actor.sampler = lambda rows: streams.normal(rows, actor.outputs, actor.width)
        self.rates = torch.full((actor.num_designs,), self.learning_rate, dtype=torch.float64, device=self.device)
        self.losses: dict[str, torch.Tensor] = {}

    @property
    def num_designs(self) -> int:
        """Number of designs."""
        return self.actor.num_designs

    def _optimizer(self) -> PopulationAdam:
        return PopulationAdam([*self.actor.parameters(), *self.critic.parameters()], self.adam_eps)

    # ------------------------------------------------------------------ update

    def update(self) -> dict[str, float]:
        """One iteration's optimisation of all designs; returns the mean losses."""
        if self.decays:
            self.rates.fill_(self.initial_learning_rate * max(0.0, 1.0 - self.updates / self.total_iterations))
        data, times = self._shuffled(), self.num_learning_epochs * self.num_mini_batches
        losses = torch.cat(self._share_out(lambda share: self._learn(share, data)), dim=1) / times
        self.optimizer.steps += times
        obs = self._by_design(self._observations())
        rows = obs.shape[1]
        mean = _total(obs) / rows
        var = _total((obs - mean).square_()) / rows
        for model in (self.actor, self.critic):
            model.update_normalization(mean, var, rows)
        self.storage.clear()
        self.updates += 1
        self.losses = dict(zip(("value", "surrogate", "entropy"), losses, strict=True))
        self.learning_rate = float(self.rates.mean())
        return {name: float(values.mean()) for name, values in self.losses.items()}

    def _share_out(self, learn: Callable[[slice], torch.Tensor]) -> list[torch.Tensor]:
        """Results of ``learn`` for equal shares of the designs, a thread for each; designs do not mind how."""
        count = min(self.threads, self.num_designs)
        cuts = [self.num_designs * k // count for k in range(count + 1)]
        shares = [slice(begin, end) for begin, end in itertools.pairwise(cuts)]
        jobs = [self._pool.submit(learn, share) for share in shares[1:]]
        return [learn(shares[0]), *(job.result() for job in jobs)]

    def _learn(self, share: slice, data: dict[str, torch.Tensor]) -> torch.Tensor:
        """All epochs of some designs; returns sums of value loss, surrogate loss and entropy ``[3, designs]``."""
        data, size = {name: values[share] for name, values in data.items()}, self._minibatch()
        actor, critic = self.actor.part(share), self.critic.part(share)
        optimizer = self.optimizer.part(share, [*actor.parameters(), *critic.parameters()])
        actor.set_mean(torch.zeros_like(data["mean"][:, :1]))
        old_std, rates = actor.output_std.detach().clone(), self.rates[share]
        sums = torch.zeros((3, actor.num_designs), device=self.device)
        for _ in range(self.num_learning_epochs):
            for k in range(self.num_mini_batches):
                part = {name: values[:, k * size : (k + 1) * size] for name, values in data.items()}
                actor.set_mean(actor.run(part["obs"]))
                if self.schedule == "adaptive":
                    self._adapt(rates, actor, part["mean"], old_std)
                losses = self._losses(part, actor, critic)
                optimizer.zero_grad()
                weights = (self.value_loss_coef, 1.0, -self.entropy_coef)
                # the sum, not the mean, over designs: each has the gradient that it would have alone
                sum(weight * loss for weight, loss in zip(weights, losses, strict=True)).sum().backward()
                for model in (actor, critic):
                    clip_gradients(model.parameters(), self.max_grad_norm)
                optimizer.step(rates)
                sums += torch.stack(losses).detach()
        return sums

    def _losses(
        self, part: dict[str, torch.Tensor], actor: PopulationModel, critic: PopulationModel
    ) -> list[torch.Tensor]:
        """Value loss, surrogate loss and entropy of a minibatch, ``[designs]`` each; the actor's mean is set."""
        ratio = torch.exp(actor.log_prob(part["actions"]) - part["log_prob"])
        bounded = ratio.clamp(1 - self.clip_param, 1 + self.clip_param)
        surrogate = torch.max(-part["advantages"] * ratio, -part["advantages"] * bounded).mean(1)
        values = critic.run(part["obs"])[..., 0]
        error = (values - part["returns"]).square()
        if self.use_clipped_value_loss:
            near = part["values"] + (values - part["values"]).clamp(-self.clip_param, self.clip_param)
            error = torch.max(error, (near - part["returns"]).square())
        return [error.mean(1), surrogate, actor.output_entropy]

    @torch.no_grad()
    def _adapt(self, rates: torch.Tensor, actor: PopulationModel, mean: torch.Tensor, std: torch.Tensor) -> None:
        """rsl-rl's adaptive schedule, for each design; changes ``rates``."""
        kl = actor.mean_divergence(mean, std)
        lower, higher = (rates / 1.5).clamp(min=SLOWEST), (rates * 1.5).clamp(max=FASTEST)
        far, near = kl > 2 * self.desired_kl, (kl < self.desired_kl / 2) & (kl > 0)
        rates.copy_(torch.where(far, lower, torch.where(near, higher, rates)))

    def _look_back(self) -> None:
        st, actor = self.storage, self.actor
        self._inputs = actor.latent(self._by_design(self._observations()))
        values = [self.critic.run(part)[..., :1] for part in self._inputs.split(self._minibatch(), dim=1)]
        st.values.copy_(self._by_row(torch.cat(values, dim=1)))
        actor.set_mean(self._by_design(st.distribution_params[0]))
        st.actions_log_prob.copy_(self._by_row(actor.log_prob(self._by_design(st.actions))[..., None]))

    def _minibatch(self) -> int:
        """Samples of a design in a minibatch."""
        samples = self.storage.num_transitions_per_env * self.storage.num_envs // self.num_designs
        return samples // self.num_mini_batches

    def _observations(self) -> torch.Tensor:
        return self.actor._observations(self.storage.observations)

    def _by_design(self, values: torch.Tensor) -> torch.Tensor:
        """``[steps, rows, ...]`` of the storage as ``[designs, steps * envs, ...]``."""
        steps, rows = values.shape[:2]
        split = values.view(steps, self.num_designs, rows // self.num_designs, *values.shape[2:])
        return split.transpose(0, 1).flatten(1, 2)

    def _by_row(self, values: torch.Tensor) -> torch.Tensor:
        """The inverse of :meth:`_by_design`."""
        designs, samples, *rest = values.shape
        steps = self.storage.num_transitions_per_env
        return values.view(designs, steps, samples // steps, *rest).transpose(0, 1).flatten(1, 2)

    @torch.no_grad()
    def _shuffled(self) -> dict[str, torch.Tensor]:
        """The rollout ``[designs, samples, ...]``, each design's in an order of its own, the same in all epochs."""
        st = self.storage
        advantages = self._by_design(st.advantages)[..., 0]
        spread = advantages.std(1, keepdim=True) + 1e-8
        data = {
            "obs": self._inputs,
            "actions": self._by_design(st.actions),
            "mean": self._by_design(st.distribution_params[0]),
            "log_prob": self._by_design(st.actions_log_prob)[..., 0],
            "values": self._by_design(st.values)[..., 0],
            "returns": self._by_design(st.returns)[..., 0],
            "advantages": (advantages - advantages.mean(1, keepdim=True)) / spread,
        }
        order = self.streams.permutations(self._minibatch() * self.num_mini_batches)
        rows = torch.arange(self.num_designs, device=self.device)[:, None]
        data = {name: values[rows, order] for name, values in data.items()}
        self._inputs = None
        return data

    # ------------------------------------------------------------ state, parts

    def healthy(self) -> torch.Tensor:
        """bool ``[designs]``: whose networks are made of finite numbers."""
        sums = [parameter.detach().sum((1, 2)) for parameter in self.optimizer.parameters]
        return torch.isfinite(torch.stack(sums)).all(0)

    def keep(self, index: Sequence[int], obs: TensorDict) -> None:
        """Only these designs go on, in this order, with observations like ``obs``; between updates only."""
        envs = self.storage.num_envs // self.num_designs
        for part in (self.actor, self.critic, self.optimizer, self.streams):
            part.keep(index)
        self.rates = self.rates[list(index)]
        steps, rows = self.storage.num_transitions_per_env, envs * len(index)
        self.storage = RolloutStorage("rl", rows, steps, obs, [self.actor.width], self.device)

    def save(self) -> dict[str, Any]:
        """Networks, optimiser, learning rates and random streams: what :meth:`load` takes back."""
        own = {"rates": self.rates, "streams": self.streams.state()}
        return super().save() | own

    def load(self, loaded_dict: dict[str, Any], load_cfg: dict | None = None, strict: bool = True) -> bool:
        """Go on from :meth:`save` of the same designs and settings."""
        self.actor.load_state_dict(loaded_dict["actor_state_dict"], strict=strict)
        self.critic.load_state_dict(loaded_dict["critic_state_dict"], strict=strict)
        self.optimizer.load_state_dict(loaded_dict["optimizer_state_dict"])
        self.rates = loaded_dict["rates"].to(self.device)
        self.streams.set_state(loaded_dict["streams"])
        self.updates = loaded_dict["updates"]
        return True


def _total(values: torch.Tensor) -> torch.Tensor:
    """Sum over the second axis, kept as an axis of 1, by adding halves.

    torch's own sums add in an order that depends on the number of columns, which other designs have a say in.
    """
    while (rows := values.shape[1]) > 1:
        half, rest = rows // 2, values[:, rows - rows % 2 :]
        values = values[:, :half] + values[:, half : 2 * half]
        values = torch.cat([values, rest], dim=1) if rows % 2 else values
    return values
