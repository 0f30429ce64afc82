"""Training by gradients through the physics: ``method=gradients``, of a policy that moves by body and time alone."""

from __future__ import annotations

from typing import Any

import torch
from torch import nn

from warpvox.algos.policies.cpg import CpgNetwork
from warpvox.algos.policies.layout import clock
from warpvox.algos.training.ppo import PPO
from warpvox.algos.training.runner import Runner
from warpvox.envs.rsl_rl import ACTION_CENTER
from warpvox.envs.snapshot import Snapshot
from warpvox.envs.vec_env import VoxelVecEnv
from warpvox.errors import ConfigError, SimulationError
from warpvox.gradients import Gradients

__all__ = ["Ascent", "AscentRunner"]

DERIVED = ("com", "velocity")
"""What of a state is differentiated: quantities that rewards may be made of."""
PROBE = 40
"""Control steps in which some reward must have a derivative."""
TINY = 1e-12


class Ascent(PPO):
    """Ascent along given derivatives of returns by the weights of a :class:`CpgNetwork`, in the place of PPO's update.

    ``learning_rate``, ``schedule`` and ``max_grad_norm`` are those of PPO; critic and deviations do not learn.
    """

    def weights(self, obs: Any) -> torch.Tensor:
        """``[num_envs, actions, 1 + clock]``: those of the network for each action, 0 where a body has none."""
        cells, _, actions = self.actor.unpack(self.actor.get_latent(obs))
        by_cell = self.actor.network.weights(cells)
        place = actions.long()[..., None].expand(-1, -1, by_cell.shape[2])
        count = self.actor.layout.actions
        return by_cell.new_zeros(len(by_cell), count + 1, by_cell.shape[2]).scatter(1, place, by_cell)[:, :count]

    def ascend(self, weights: torch.Tensor, slope: torch.Tensor) -> None:
        """A step of Adam: ``weights`` as :meth:`weights` gave them, ``slope`` the derivatives of returns by them."""
        self._decay()
        parameters = [*self.actor.parameters(), *self.critic.parameters()]
        gradients = torch.autograd.grad(weights, parameters, -slope / len(slope), allow_unused=True)
        found = [p.new_zeros(p.shape) if g is None else g for g, p in zip(gradients, parameters, strict=True)]
        self.optimizer.steps += 1
        self.optimizer.descend(self.optimizer.flat(found), self.max_grad_norm, self.rates, self.optimizer.steps)
        for group in self.optimizer.param_groups:
            group["lr"] = self.learning_rate
        self.updates += 1


class AscentRunner(Runner):
    """Trains one policy by the derivatives of what it gets in the first control steps of episodes.

    Each iteration begins new episodes, ``ppo.steps`` control steps of which are differentiated: rewards of the task by
    the weights of the policy. Bonuses at ends of episodes do not count. Each body's derivative is scaled to the median
    norm at most, and those of episodes that were stopped are left out.

    Raises:
        ConfigError: another policy than cpg, several processes, an environment that :class:`Gradients` refuses, or
            rewards without derivatives.
    """

    algorithm = Ascent
    alg: Ascent

    def __init__(self, *args: Any, **settings: Any) -> None:
        super().__init__(*args, **settings)
        _check_gradients(self.env.env, self.alg.actor.network, self.group.size)
        self._gradients = Gradients(self.env.env.sim)
        _, slope, _, stopped = self._roll_out(min(PROBE, self.ppo.steps))
        self.env.reset()
        if not bool(slope.any()) and not bool(stopped.any()):
            raise ConfigError(
                f"method=gradients: the rewards of {self.env.env.spec.id} have no derivative by the actions. What a"
                " robot pushes or carries has none, nor have contacts of voxels with each other."
            )
        self._found: dict[str, float] = {}

    def _roll_out(self, steps: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """New episodes, so many control steps of them.

        Returns:
            The weights that the policy has for the bodies, the derivatives of returns by them, the returns, and bool
            ``[num_envs]``: where an episode was stopped or derivatives are not finite. These derivatives are 0.
        """
        env, layout = self.env.env, self.alg.actor.layout
        weights = self.alg.weights(self.env.reset())
        leaf = weights.detach().requires_grad_()
        state, total = self._gradients.state(), 0.0
        stopped = torch.zeros(self.env.num_envs, dtype=torch.bool, device=self.device)
        before = Snapshot(_Differentiated(self._gradients, state))
        for step in range(steps):
            outputs = CpgNetwork.motion(leaf, clock(leaf.new_tensor([[step]]), layout.periods))
            state = self._gradients.step(state, ACTION_CENTER + self.ppo.action_scale * outputs)
            stopped |= env.sim.unstable
            after = Snapshot(_Differentiated(self._gradients, state))
            total = total + sum(term(before, after) * term.weight for term in env.spec.rewards)
            before = after
        (slope,) = torch.autograd.grad(total.sum(), leaf)
        stopped |= ~slope.isfinite().flatten(1).all(1)
        returns = total.detach().masked_fill(stopped, 0.0)
        return weights, slope.masked_fill(stopped[:, None, None], 0.0), returns, stopped

    def _collect(self) -> tuple[list[dict[str, torch.Tensor]], torch.Tensor]:
        """Roll out and take a step of ascent; returns logs, and that all episodes have ended."""
        weights, slope, returns, stopped = self._roll_out(self.ppo.steps)
        norm = slope.flatten(1).norm(dim=1)
        going = norm[~stopped]
        middle = going.median() if len(going) else norm.new_zeros(())
        scale = 1 / torch.maximum(norm, middle).clamp(min=TINY)
        self.alg.ascend(weights, slope * scale[:, None, None])
        self._found = {"return": float(returns.mean()), "unstable": int(stopped.sum())}
        logs = {"Gradient/norm": middle, "Episode/unstable": stopped.float().mean()}
        return [logs], torch.ones_like(stopped)

    def _update(self) -> dict[str, float]:
        return {"value": 0.0, "surrogate": -self._found["return"], "entropy": 0.0}

    def _action_std(self) -> float:
        return 0.0

    def _episodes(self) -> dict[str, float]:
        """Of the rollout: the beginnings of episodes."""
        count = self.env.num_envs
        return {"episodes": count, "length": self.ppo.steps, "diverged": 0} | self._found


class _Differentiated:
    """What rewards may ask of a state, differentiable; a simulation for :class:`Snapshot`."""

    def __init__(self, gradients: Gradients, state: torch.Tensor) -> None:
        self._gradients, self._state = gradients, state

    def com(self, name: str) -> torch.Tensor:
        return self._gradients.com(self._state, name)

    def velocity(self, name: str) -> torch.Tensor:
        return self._gradients.velocity(self._state, name)


def _check_gradients(env: VoxelVecEnv, network: nn.Module, processes: int) -> None:
    """Raise ConfigError where a training by gradients is not possible."""
    if not isinstance(network, CpgNetwork):
        raise ConfigError("method=gradients trains policy=cpg: what other policies observe is not differentiated.")
    asked = {quantity[0] for quantity in env.episodes.before} | ({"memory"} if env.spec.memory else set())
    if not asked <= set(DERIVED):
        other = ", ".join(sorted(asked - set(DERIVED)))
        raise ConfigError(
            f"method=gradients differentiates rewards made of centres of mass and velocities; those of {env.spec.id}"
            f" are made of {other}, too."
        )
    if processes > 1:
        raise ConfigError(f"method=gradients learns in one process, not in {processes}.")
    try:
        Gradients.check(env.sim)
    except SimulationError as error:
        raise ConfigError(f"method=gradients: {error}") from None
