"""rsl-rl's PPO with a linear schedule, Adam's epsilon and time limits bootstrapped where they struck."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping
from types import EllipsisType
from typing import Any, NamedTuple

import torch
from rsl_rl.algorithms import PPO as RslRlPPO
from tensordict import TensorDict

from warpvox.algos.policies.model import VoxelModel
from warpvox.algos.settings import Ppo
from warpvox.algos.training.adam import VectorAdam
from warpvox.algos.training.networks import Gaussian, Network, observations
from warpvox.envs.adapters.rsl_rl import OBS_GROUP
from warpvox.errors import ConfigError

__all__ = ["PPO", "rsl_rl_config"]

LOSSES = ("value", "surrogate", "entropy")
SLOWEST, FASTEST = 1e-5, 1e-2
"""Bounds of the learning rate in rsl-rl's adaptive schedule."""


class Samples(NamedTuple):
    """A rollout, or a part of it: inputs, actions and their mean ``[samples, ...]``, the rest ``[samples]``."""

    inputs: torch.Tensor
    actions: torch.Tensor
    mean: torch.Tensor
    log_prob: torch.Tensor
    values: torch.Tensor
    returns: torch.Tensor
    advantages: torch.Tensor


class PPO(RslRlPPO):
    """rsl-rl's PPO with the paper's settings (section D.3) and exact bootstrapping at time limits.

    From the same random numbers it learns the same as rsl-rl's, up to rounding, in fewer operations: values and
    log-probabilities are computed for the whole rollout at once, samples are put in order once for all epochs, and no
    actions are drawn while learning. tests/algos/training/test_stock_ppo.py compares both.

    Methods that work on :class:`Samples` also take a first axis for designs
    (:class:`warpvox.algos.population.ppo.PopulationPPO`).

    Args:
        total_iterations: iterations in all, the end of the linear schedule.
        adam_eps: Adam's epsilon.
        schedule: ``fixed``, ``adaptive`` (rsl-rl's) or ``linear``: the learning rate of update k of n is
            ``learning_rate * (1 - k / n)`` with k = 0, 1, ..., n - 1.

    Attributes:
        rates: learning rate, a float64 scalar.
    """

    rates: torch.Tensor

    def __init__(
        self,
        *args: Any,
        total_iterations: int,
        adam_eps: float = 1e-8,
        schedule: str = "fixed",
        learning_rate: float = 1e-3,
        **kwargs: Any,
    ) -> None:
        options = {"schedule": "adaptive" if schedule == "adaptive" else "fixed"}
        super().__init__(*args, learning_rate=learning_rate, **options, **kwargs)
        if self.rnd or self.symmetry or not all(hasattr(model, "run") for model in (self.actor, self.critic)):
            raise ConfigError(
                "This PPO trains the networks of rsl_rl_config(), without extensions; for others use rsl-rl's own"
                " (docs/policies.md)."
            )
        self.decays = schedule == "linear"
        self.initial_learning_rate, self.total_iterations, self.updates = learning_rate, total_iterations, 0
        self.adam_eps, self._inputs = adam_eps, None
        self.optimizer = self._optimizer()
        # both networks have the same observations: one normaliser for both
        self.critic.obs_normalizer = self.actor.obs_normalizer

    def _optimizer(self) -> VectorAdam:
        return VectorAdam([self.actor, self.critic], self.initial_learning_rate, self.adam_eps)

    @property
    def learning_rate(self) -> float:
        """Of the next step; the mean over the designs of a population."""
        return self.rates.mean().item()

    @learning_rate.setter
    def learning_rate(self, value: float) -> None:
        self.rates = torch.full(self._rate_shape(), value, dtype=torch.float64, device=self.device)

    def _rate_shape(self) -> tuple[int, ...]:
        return ()

    @staticmethod
    def construct_algorithm(obs: TensorDict, env: Any, cfg: dict, device: str) -> RslRlPPO:
        """As rsl-rl does, without its printing both networks."""
        with contextlib.redirect_stdout(io.StringIO()):
            return RslRlPPO.construct_algorithm(obs, env, cfg, device)

    # ------------------------------------------------------------- collection

    @torch.no_grad()
    def act(self, obs: TensorDict) -> torch.Tensor:
        """Draw actions. What else learning needs to know of them is computed for the whole rollout at once."""
        storage, step = self.storage, self.storage.step
        if step >= storage.num_transitions_per_env:
            raise OverflowError(f"The storage is full: {step} steps, and no update since.")
        inputs = self.actor.scaled(observations(self.actor, obs))
        rows = inputs.reshape(-1, inputs.shape[-1])
        if storage.distribution_params is None:
            storage.distribution_params = (torch.zeros_like(storage.actions),)
            self._inputs = rows.new_empty(storage.num_transitions_per_env, *rows.shape)
        actions = self.actor.sample(inputs)
        # The normaliser learns after the update only: scaled once, the inputs serve all epochs.
        self._inputs[step] = rows
        for name, values in obs.items():
            storage.observations[name][step] = values
        storage.actions[step] = actions
        storage.distribution_params[0][step] = self.actor.output_mean
        return actions

    @torch.no_grad()
    def process_env_step(
        self, obs: TensorDict, rewards: torch.Tensor, dones: torch.Tensor, extras: dict[str, Any]
    ) -> None:
        """Record a step; where only the time limit has ended an episode, add the value of its final state.

        rsl-rl would add the value of the state before the step, because it does not get the final one.
        """
        storage = self.storage
        if "time_outs" in extras:
            rewards = self._bootstrap_time_limit(rewards, extras["time_outs"], extras["final_obs"])
        storage.rewards[storage.step, :, 0] = rewards
        storage.dones[storage.step, :, 0] = dones
        storage.step += 1

    def _bootstrap_time_limit(
        self, rewards: torch.Tensor, time_outs: torch.Tensor, final_obs: TensorDict
    ) -> torch.Tensor:
        # Looking first saves the forward pass of nearly all steps; on CUDA looking would wait for the device.
        on_cpu = time_outs.device.type == "cpu"
        if on_cpu and not bool(time_outs.any()):
            return rewards
        if on_cpu and isinstance(self.critic, VoxelModel):  # it costs more than to pick rows; a population needs all
            rows = time_outs.nonzero()[:, 0]
            return rewards.index_add(0, rows, self.critic(final_obs[rows])[:, 0], alpha=self.gamma)
        values = self.critic(final_obs.to(self.device)).detach().squeeze(-1)
        return rewards + self.gamma * values * time_outs.to(self.device)

    @torch.no_grad()
    def compute_returns(self, obs: TensorDict) -> None:
        """Values and log-probabilities of the rollout, then returns and advantages; ``obs`` are those after it."""
        st, policy = self.storage, self.actor.distribution
        rows = [self._samples(values) for values in (self._inputs, st.distribution_params[0], st.actions)]
        axis = rows[0].ndim - 2
        size = -(-rows[0].shape[axis] // self.num_mini_batches)  # no more memory than learning takes
        parts: list[tuple[torch.Tensor, ...]] = []
        for inputs, mean, actions in zip(*(values.split(size, dim=axis) for values in rows), strict=True):
            values = self.critic.run(self.actor.unpack(inputs))
            policy.update(mean)
            parts.append((values, policy.log_prob(actions)[..., None]))
        values, log_prob = (torch.cat(part, dim=axis) for part in zip(*parts, strict=True))
        self._store(st.values, values)
        self._store(st.actions_log_prob, log_prob)
        super().compute_returns(obs)

    def _samples(self, values: torch.Tensor) -> torch.Tensor:
        """``[steps, envs, ...]`` of the storage as ``[samples, ...]``."""
        return values.flatten(0, 1)

    def _store(self, target: torch.Tensor, values: torch.Tensor) -> None:
        """Write ``[samples, ...]`` to ``[steps, envs, ...]`` of the storage."""
        target.copy_(values.view_as(target))

    # ---------------------------------------------------------------- learning

    def update(self) -> dict[str, float]:
        """One iteration's optimisation; returns the mean losses."""
        self._decay()
        losses = self._optimise(self._shuffled())
        self.optimizer.steps += self.num_learning_epochs * self.num_mini_batches
        for group in self.optimizer.param_groups:
            group["lr"] = self.learning_rate
        if hasattr(self.actor.obs_normalizer, "update"):
            self.actor.obs_normalizer.update(self._samples(observations(self.actor, self.storage.observations)))
        self.storage.clear()
        self.updates += 1
        return losses

    def _decay(self) -> None:
        """The linear schedule."""
        if self.decays:
            self.rates.fill_(self.initial_learning_rate * max(0.0, 1.0 - self.updates / self.total_iterations))

    def _optimise(self, data: Samples) -> dict[str, float]:
        losses = self._epochs(data, self.actor, self.critic)
        return dict(zip(LOSSES, losses.tolist(), strict=True))

    @torch.no_grad()
    def _shuffled(self) -> Samples:
        """The rollout in the order in which all epochs take it."""
        st = self.storage
        rows = Samples(
            self._samples(self._inputs),
            self._samples(st.actions),
            self._samples(st.distribution_params[0]),
            *(self._samples(values)[..., 0] for values in (st.actions_log_prob, st.values, st.returns, st.advantages)),
        )
        return self._in_random_order(rows, self._minibatch(rows) * self.num_mini_batches)

    def _in_random_order(self, rows: Samples, count: int) -> Samples:
        order = torch.randperm(count, device=self.device)
        return Samples(*(values[order] for values in rows))

    def _minibatch(self, data: Samples) -> int:
        return data.returns.shape[-1] // self.num_mini_batches

    def _epochs(self, data: Samples, actor: Any, critic: Any, rows: slice | EllipsisType = ...) -> torch.Tensor:
        """All epochs of some designs; returns the mean value loss, surrogate loss and entropy ``[3]``."""
        size, times = self._minibatch(data), self.num_learning_epochs * self.num_mini_batches
        policy, rate = actor.distribution, self.rates[rows]
        parameters = [*actor.parameters(), *critic.parameters()]
        layers = [parameter for parameter in parameters if parameter is not policy.log_std_param]
        old_std, sums = policy.kept_std.clone()[rows], 0
        for k in range(times):
            first = k % self.num_mini_batches * size
            part = Samples(*(values.narrow(data.returns.ndim - 1, first, size) for values in data))
            inputs = actor.unpack(part.inputs)
            mean, values = actor.run(inputs), critic.run(inputs)[..., 0]
            with torch.no_grad():
                policy.update(mean)
                if self.schedule == "adaptive":
                    self._adapt(rate, policy.mean_divergence(part.mean, old_std))
                surrogate, of_mean, of_log_std = self._surrogate(policy, part)
                value, of_values = self._value_loss(values, part)
            gradients = iter(torch.autograd.grad([mean, values], layers, [of_mean, of_values]))
            gradients = [of_log_std if p is policy.log_std_param else next(gradients) for p in parameters]
            gradient = self.optimizer.flat(gradients)
            if self.is_multi_gpu:
                torch.distributed.all_reduce(gradient)
                gradient /= self.gpu_world_size
            self.optimizer.descend(gradient, self.max_grad_norm, rate, self.optimizer.steps + k + 1, rows)
            sums += torch.stack([value, surrogate, policy.entropy.mean(-1).detach()])
        return sums / times

    def _surrogate(self, policy: Gaussian, part: Samples) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """PPO's clipped loss, and the gradients of it and of the entropy's part by mean and logarithmic deviation.

        Derived by hand: autograd would spend most of its time on the overhead of small operations.
        """
        noise = (part.actions - policy.mean).div_(policy.row_std)
        squares = noise.square()
        ratio = policy.log_prob_of(squares).sub_(part.log_prob).exp_()
        free = -part.advantages * ratio
        bounded = -part.advantages * ratio.clamp(1 - self.clip_param, 1 + self.clip_param)
        # of the larger of the two losses; where they are equal, within the bounds, both have the same gradient
        of_log_prob = free.mul(free >= bounded).div_(free.shape[-1])
        of_mean = noise.mul_(of_log_prob[..., None]).div_(policy.row_std)
        of_log_std = policy.gradient(squares.sub_(1).mul_(of_log_prob[..., None]), self.entropy_coef)
        return torch.max(free, bounded).mean(-1), of_mean, of_log_std

    def _value_loss(self, values: torch.Tensor, part: Samples) -> tuple[torch.Tensor, torch.Tensor]:
        """The mean squared error of the values ``[samples]``, and the gradient of its part of the loss by them."""
        error = values - part.returns
        squares, slope = error.square(), error * (2 * self.value_loss_coef / error.shape[-1])
        if self.use_clipped_value_loss:
            moved = values - part.values
            clipped = (part.values + moved.clamp(-self.clip_param, self.clip_param) - part.returns).square()
            # beyond the bounds the clipped error does not depend on the value; within them both errors are the same
            slope *= (squares >= clipped) | (moved.abs() <= self.clip_param)
            squares = torch.max(squares, clipped)
        return squares.mean(-1), slope

    def _adapt(self, rate: torch.Tensor, kl: torch.Tensor) -> None:
        """rsl-rl's adaptive schedule; changes ``rate``."""
        if self.is_multi_gpu:  # all processes get the same mean, and come to the same rate
            torch.distributed.all_reduce(kl)
            kl /= self.gpu_world_size
        lower, higher = (rate / 1.5).clamp_(min=SLOWEST), (rate * 1.5).clamp_(max=FASTEST)
        far, near = kl > 2 * self.desired_kl, (kl < self.desired_kl / 2) & (kl > 0)
        rate.copy_(torch.where(far, lower, torch.where(near, higher, rate)))

    # ------------------------------------------------------------------- state

    def save(self) -> dict[str, Any]:
        """Networks, optimiser and schedule."""
        return super().save() | {"updates": self.updates}

    def load(self, loaded_dict: dict[str, Any], load_cfg: dict | None = None, strict: bool = True) -> bool:
        """Restore what :meth:`save` gave. Adam's epsilon and the schedule's length stay as configured."""
        result = super().load(loaded_dict, load_cfg, strict)
        for group in self.optimizer.param_groups:
            group["eps"] = self.adam_eps
        self.updates = loaded_dict.get("updates", 0)
        return result


def rsl_rl_config(
    ppo: Ppo, total_iterations: int, voxels: Mapping[str, Any] | None = None, algorithm: type[PPO] = PPO
) -> dict[str, Any]:
    """The dictionary that rsl-rl's runner wants.

    Args:
        ppo: settings of the method.
        total_iterations: the end of a linear schedule.
        voxels: ``network``, ``settings`` and ``layout`` of :class:`~warpvox.algos.policies.model.VoxelModel`; None:
            fully connected layers.
        algorithm: the class that learns.
    """
    network = {"class_name": Network, "hidden_dims": list(ppo.hidden), "activation": ppo.activation}
    if voxels is not None:
        network = {"class_name": VoxelModel, **voxels}
    network["obs_normalization"] = ppo.normalize_obs
    noise = {"class_name": Gaussian, "init_std": ppo.init_std, "std_type": "log"}
    return {
        "num_steps_per_env": ppo.steps,
        "check_for_nan": False,
        "logger": "tensorboard",
        "obs_groups": {"actor": [OBS_GROUP], "critic": [OBS_GROUP]},
        "actor": network | {"distribution_cfg": noise},
        "critic": dict(network),
        "algorithm": {
            "class_name": algorithm,
            "total_iterations": total_iterations,
            "adam_eps": ppo.adam_eps,
            "schedule": ppo.schedule,
            "num_learning_epochs": ppo.epochs,
            "num_mini_batches": ppo.minibatches,
            "gamma": ppo.gamma,
            "lam": ppo.lam,
            "clip_param": ppo.clip,
            "use_clipped_value_loss": ppo.clip_values,
            "value_loss_coef": ppo.value_coef,
            "entropy_coef": ppo.entropy_coef,
            "max_grad_norm": ppo.max_grad_norm,
            "learning_rate": ppo.learning_rate,
            "desired_kl": ppo.desired_kl,
        },
    }
