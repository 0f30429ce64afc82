"""rsl-rl's PPO with a linear schedule, Adam's epsilon and time limits bootstrapped where they struck."""

from __future__ import annotations

import contextlib
import io
from typing import Any

import torch
from rsl_rl.algorithms import PPO as RslRlPPO
from tensordict import TensorDict

from warpvox.configs.schema import PpoConfig
from warpvox.envs.rsl_rl import OBS_GROUP

__all__ = ["PPO", "rsl_rl_config"]


class PPO(RslRlPPO):
    """rsl-rl's PPO with what the paper's settings need (section D.3) and a better guess beyond a time limit.

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
        self.decays = schedule == "linear"
        self.initial_learning_rate = self.learning_rate
        self.total_iterations = total_iterations
        self.updates = 0
        for group in self.optimizer.param_groups:
            group["eps"] = adam_eps

    @staticmethod
    def construct_algorithm(obs: TensorDict, env: Any, cfg: dict, device: str) -> RslRlPPO:
        """As rsl-rl does, without its printing both networks."""
        with contextlib.redirect_stdout(io.StringIO()):
            return RslRlPPO.construct_algorithm(obs, env, cfg, device)

    def process_env_step(
        self, obs: TensorDict, rewards: torch.Tensor, dones: torch.Tensor, extras: dict[str, Any]
    ) -> None:
        """Record a step; where only the time limit has ended an episode, add the value of its final state.

        rsl-rl would add the value of the state before the step, because it is not told the final one.
        """
        if "time_outs" in extras and "final_obs" in extras:
            rewards = self._beyond_the_limit(rewards, extras["time_outs"], extras["final_obs"])
            extras = {name: value for name, value in extras.items() if name != "time_outs"}
        super().process_env_step(obs, rewards, dones, extras)

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
        losses = super().update()
        self.updates += 1
        return losses

    def save(self) -> dict[str, Any]:
        """Networks, optimiser and schedule."""
        return super().save() | {"updates": self.updates}

    def load(self, loaded_dict: dict[str, Any], load_cfg: dict | None, strict: bool) -> bool:
        """Restore what :meth:`save` gave. Adam's epsilon and the schedule's length stay as configured."""
        eps = [group["eps"] for group in self.optimizer.param_groups]
        result = super().load(loaded_dict, load_cfg, strict)
        for group, value in zip(self.optimizer.param_groups, eps, strict=True):
            group["eps"] = value
        self.updates = loaded_dict.get("updates", 0)
        return result


def rsl_rl_config(ppo: PpoConfig, total_iterations: int) -> dict[str, Any]:
    """The dictionary that rsl-rl's runner wants."""
    network = {
        "class_name": "MLPModel",
        "hidden_dims": list(ppo.hidden),
        "activation": ppo.activation,
        "obs_normalization": ppo.normalize_obs,
    }
    noise = {"class_name": "GaussianDistribution", "init_std": ppo.init_std, "std_type": "log"}
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
