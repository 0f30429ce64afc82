"""rsl-rl's PPO with a linear schedule, Adam's epsilon and time limits bootstrapped where they struck."""

from __future__ import annotations

import contextlib
import io
from typing import Any, NamedTuple

import torch
from rsl_rl.algorithms import PPO as RslRlPPO
from tensordict import TensorDict

from warpvox.algos.settings import PpoConfig
from warpvox.algos.training.adam import VectorAdam
from warpvox.algos.training.networks import Gaussian, Network
from warpvox.envs.rsl_rl import OBS_GROUP
from warpvox.errors import ConfigError

__all__ = ["PPO", "rsl_rl_config"]

SLOWEST, FASTEST = 1e-5, 1e-2
"""Between these rsl-rl's adaptive schedule keeps a learning rate."""


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
    """rsl-rl's PPO with what the paper's settings need (section D.3) and a better guess beyond a time limit.

    From the same random numbers it learns the same as rsl-rl's, up to rounding, in fewer operations: values and
    log-probabilities are computed for the whole rollout at once, samples are put in order once for all epochs, and no
    actions are drawn while learning. tests/algos/test_stock_ppo.py compares both.

    Args:
        total_iterations: iterations in all, the end of the linear schedule.
        adam_eps: Adam's epsilon.
        schedule: ``fixed``, ``adaptive`` (rsl-rl's) or ``linear``: the learning rate of update k of n is
            ``learning_rate * (1 - k / n)`` with k = 0, 1, ..., n - 1.
    """

    def __init__(
        self,
        *args: Any,
        total_iterations: int,
        adam_eps: float = 1e-8,
        schedule: str = "fixed",
        **kwargs: Any,
    ) -> None:
        super().__init__(*args, schedule="adaptive" if schedule == "adaptive" else "fixed", **kwargs)
        if self.rnd or self.symmetry or not all(hasattr(model, "run") for model in (self.actor, self.critic)):
            raise ConfigError(
                "This PPO trains the networks of rsl_rl_config(), without extensions; for others use rsl-rl's own"
                " (docs/policies.md)."
            )
        self.decays = schedule == "linear"
        self.initial_learning_rate = self.learning_rate
        self.total_iterations = total_iterations
        self.updates = 0
        self.adam_eps, self._inputs = adam_eps, None
        self.optimizer = self._optimizer()
        self._layers = [value for value in self.optimizer.parameters if value is not self.actor.log_std]
        # Both networks see the same observations: one normaliser learns for both.
        if isinstance(self.actor, Network):
            self.critic.obs_normalizer = self.actor.obs_normalizer

    def _optimizer(self) -> VectorAdam:
        return VectorAdam([self.actor, self.critic], self.learning_rate, self.adam_eps)

    @staticmethod
    def construct_algorithm(obs: TensorDict, env: Any, cfg: dict, device: str) -> RslRlPPO:
        """As rsl-rl does, without its printing both networks."""
        with contextlib.redirect_stdout(io.StringIO()):
            return RslRlPPO.construct_algorithm(obs, env, cfg, device)

    @torch.no_grad()
    def act(self, obs: TensorDict) -> torch.Tensor:
        """Draw actions. What else learning needs to know of them is computed for the whole rollout at once."""
        storage, step = self.storage, self.storage.step
        if step >= storage.num_transitions_per_env:
            raise OverflowError(f"The storage is full: {step} steps, and no update since.")
        if storage.distribution_params is None:
            storage.distribution_params = (torch.zeros_like(storage.actions),)
        actions = self.actor(obs, stochastic_output=True)
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

        rsl-rl would add the value of the state before the step, because it is not told the final one.
        """
        storage = self.storage
        if "time_outs" in extras:
            rewards = self._beyond_the_limit(rewards, extras["time_outs"], extras["final_obs"])
        storage.rewards[storage.step, :, 0] = rewards
        storage.dones[storage.step, :, 0] = dones
        storage.step += 1

    @torch.no_grad()
    def compute_returns(self, obs: TensorDict) -> None:
        """Values and log-probabilities of the rollout, then returns and advantages; ``obs`` are those after it."""
        self._look_back()
        super().compute_returns(obs)

    def _look_back(self) -> None:
        """Fill in what :meth:`act` has left out: values and log-probabilities."""
        st, policy = self.storage, self.actor.distribution
        # The normaliser learns after the update only: scaled once, the inputs serve all epochs.
        self._inputs = self.actor.get_latent(st.observations.flatten(0, 1))
        size = -(-len(self._inputs) // self.num_mini_batches)  # no more memory than learning takes
        values = [self.critic.run(part) for part in self._inputs.split(size)]
        st.values.copy_(torch.cat(values).view_as(st.values))
        policy.update(st.distribution_params[0])
        st.actions_log_prob.copy_(policy.log_prob(st.actions).view_as(st.actions_log_prob))

    def _beyond_the_limit(self, rewards: torch.Tensor, time_outs: torch.Tensor, final_obs: TensorDict) -> torch.Tensor:
        # Looking first saves the forward pass of nearly all steps; on CUDA looking would wait for the device.
        if time_outs.device.type == "cpu" and not bool(time_outs.any()):
            return rewards
        values = self.critic(final_obs.to(self.device)).detach().squeeze(-1)
        return rewards + self.gamma * values * time_outs.to(self.device)

    def update(self) -> dict[str, float]:
        """One iteration's optimisation; returns the mean losses."""
        if self.decays:
            left = max(0.0, 1.0 - self.updates / self.total_iterations)
            self.learning_rate = self.initial_learning_rate * left
            for group in self.optimizer.param_groups:
                group["lr"] = self.learning_rate
        losses = self._optimise()
        self.updates += 1
        return losses

    def _optimise(self) -> dict[str, float]:
        """What rsl-rl's update does, up to rounding, without drawing actions that nobody takes."""
        data, old_std = self._shuffled()
        size, times = len(data[0]) // self.num_mini_batches, self.num_learning_epochs * self.num_mini_batches
        sums = torch.zeros(3, device=self.device)
        for _ in range(self.num_learning_epochs):
            for k in range(self.num_mini_batches):
                part = Samples(*(values[k * size : (k + 1) * size] for values in data))
                sums += self._learn(part, old_std)
        self.actor.update_normalization(self.storage.observations.flatten(0, 1))
        self.storage.clear()
        return dict(zip(("value", "surrogate", "entropy"), (sums / times).tolist(), strict=True))

    @torch.no_grad()
    def _shuffled(self) -> tuple[Samples, torch.Tensor]:
        """The rollout in the order in which all epochs take it, and the deviation with which actions were drawn."""
        st = self.storage
        count = st.num_envs * st.num_transitions_per_env // self.num_mini_batches * self.num_mini_batches
        order = torch.randperm(count, device=self.device)
        rows = Samples(
            self._inputs,
            st.actions.flatten(0, 1),
            st.distribution_params[0].flatten(0, 1),
            st.actions_log_prob.flatten(),
            st.values.flatten(),
            st.returns.flatten(),
            st.advantages.flatten(),
        )
        self._inputs = None
        return Samples(*(values[order] for values in rows)), self.actor.distribution.row_std.clone()

    def _learn(self, part: Samples, old_std: torch.Tensor) -> torch.Tensor:
        """Learn from a minibatch; returns value loss, surrogate loss and entropy ``[3]``."""
        mean, values = self.actor.run(part.inputs), self.critic.run(part.inputs)
        with torch.no_grad():
            policy = self.actor.distribution
            policy.update(mean)
            if self.schedule == "adaptive":
                self._adapt(policy, part.mean, old_std)
            surrogate, of_mean, of_log_std = self._surrogate(policy, part)
            value, of_values = self._value_loss(values[:, 0], part)
        networks = torch.autograd.grad([mean, values], self._layers, [of_mean, of_values[:, None]])
        gradient = torch.cat([of_log_std, *(part.flatten() for part in networks)])
        if self.is_multi_gpu:
            torch.distributed.all_reduce(gradient)
            gradient /= self.gpu_world_size
        self.optimizer.descend(gradient, self.max_grad_norm)
        return torch.stack([value, surrogate, policy.entropy[0]])

    def _surrogate(self, policy: Gaussian, part: Samples) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """PPO's clipped loss, and the gradients of it and of the entropy's part by mean and logarithmic deviation.

        By hand: of what autograd would do, most is the overhead of small operations.
        """
        noise = (part.actions - policy.mean).div_(policy.row_std)
        squares = noise.square()
        ratio = policy.log_prob_of(squares).sub_(part.log_prob).exp_()
        free = -part.advantages * ratio
        bounded = -part.advantages * ratio.clamp(1 - self.clip_param, 1 + self.clip_param)
        # of the larger of the two losses; where they are equal, within the bounds, both have the same gradient
        of_log_prob = free.mul(free >= bounded).div_(len(free))
        of_mean = noise.mul_(of_log_prob[:, None]).div_(policy.row_std)
        of_log_std = of_log_prob @ squares - of_log_prob.sum() - self.entropy_coef
        return torch.max(free, bounded).mean(), of_mean, of_log_std * policy.std_is_free

    def _value_loss(self, values: torch.Tensor, part: Samples) -> tuple[torch.Tensor, torch.Tensor]:
        """The mean squared error of the values ``[samples]``, and the gradient of its part of the loss by them."""
        error = values - part.returns
        squares, slope = error.square(), error * (2 * self.value_loss_coef / len(error))
        if self.use_clipped_value_loss:
            moved = values - part.values
            clipped = (part.values + moved.clamp(-self.clip_param, self.clip_param) - part.returns).square()
            # beyond the bounds the clipped error does not depend on the value; within them both errors are the same
            slope *= (squares >= clipped) | (moved.abs() <= self.clip_param)
            squares = torch.max(squares, clipped)
        return squares.mean(), slope

    @torch.no_grad()
    def _adapt(self, policy: Gaussian, old_mean: torch.Tensor, old_std: torch.Tensor) -> None:
        """rsl-rl's adaptive schedule."""
        kl = policy.mean_divergence(old_mean, old_std)
        if self.is_multi_gpu:  # all processes get the same mean, and come to the same rate
            torch.distributed.all_reduce(kl)
            kl /= self.gpu_world_size
        kl = kl.item()
        if kl > 2 * self.desired_kl:
            self.learning_rate = max(SLOWEST, self.learning_rate / 1.5)
        elif 0 < kl < self.desired_kl / 2:
            self.learning_rate = min(FASTEST, self.learning_rate * 1.5)
        for group in self.optimizer.param_groups:
            group["lr"] = self.learning_rate

    def save(self) -> dict[str, Any]:
        """Networks, optimiser and schedule."""
        return super().save() | {"updates": self.updates}

    def load(self, loaded_dict: dict[str, Any], load_cfg: dict | None, strict: bool) -> bool:
        """Restore what :meth:`save` gave. Adam's epsilon and the schedule's length stay as configured."""
        result = super().load(loaded_dict, load_cfg, strict)
        for group in self.optimizer.param_groups:
            group["eps"] = self.adam_eps
        self.updates = loaded_dict.get("updates", 0)
        return result


def rsl_rl_config(ppo: PpoConfig, total_iterations: int) -> dict[str, Any]:
    """The dictionary that rsl-rl's runner wants."""
    network = {
        "class_name": Network,
        "hidden_dims": list(ppo.hidden),
        "activation": ppo.activation,
        "obs_normalization": ppo.normalize_obs,
    }
    noise = {"class_name": Gaussian, "init_std": ppo.init_std, "std_type": "log"}
    return {
        "num_steps_per_env": ppo.steps,
        "check_for_nan": False,
        "logger": "tensorboard",
        "obs_groups": {"actor": [OBS_GROUP], "critic": [OBS_GROUP]},
        "actor": network | {"distribution_cfg": noise},
        "critic": dict(network),
        "algorithm": {
            "class_name": PPO,
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
