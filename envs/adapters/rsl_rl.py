"""Adapter of a :class:`VoxelVecEnv` to rsl-rl's environment interface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import nan
from typing import Any

import torch
from rsl_rl.env import VecEnv  # pyright: ignore[reportMissingTypeStubs] # not marked as typed
from tensordict import TensorDict

from warpvox.envs.checks import check_fields
from warpvox.envs.episodes import state_rows
from warpvox.envs.vec_env import VoxelVecEnv
from warpvox.errors import ConfigError
from warpvox.types import ACTION_CENTER, ACTION_SCALE

STOP_CAUSES = ("unstable", "diverged")
"""Logged reasons for stopping an episode: an undone step, and divergence in particular."""
EPISODE_SUMS = ("sum_episodes", "sum_return", "sum_length", *(f"sum_{name}" for name in STOP_CAUSES))
"""Names of the sums over finished episodes."""
OBS_GROUP = "policy"
"""Name of the observation group in rsl-rl."""


class RslRlVecEnv(VecEnv):
    """Environments behind rsl-rl's interface: scales policy outputs and rewards, and reports time limits.

    ``extras`` of a step hold ``log`` (means of this step for TensorBoard), ``returns`` (of the episodes so far,
    ``[num_envs]``), ``whole`` (bool ``[num_envs]``: episodes that have ended and had no random start) and, if time
    limits are to be bootstrapped, ``time_outs`` (bool ``[num_envs]``: ended by the time limit alone) with ``final_obs``
    (TensorDict: the last observations of what ended). Episodes that the task stopped, self-folding and divergence
    included, have been reset by the environment. All tensors are fresh.
    The adapter's own stay where they are: a CUDA graph finds them again.

    Args:
        env: made with ``auto_reset=True``.
        action_scale: an action is ``1.1 + action_scale * a``, clipped to [0.6, 1.6] by the environment.
        reward_scale: factor of the rewards (those in ``log`` and :meth:`pop_episodes` stay as they are).
        reward_gamma: if given, rewards are divided by the running standard deviation of the return discounted
            with it, and clipped to +-10.
        apart: each design has a standard deviation of its own.
        bootstrap_time_limit: report ``time_outs``. Without, a time limit counts as an end like any other.

    Raises:
        ConfigError: ``env`` does not reset by itself.
    """

    def __init__(
        self,
        env: VoxelVecEnv,
        *,
        action_scale: float = ACTION_SCALE,
        reward_scale: float = 1.0,
        reward_gamma: float | None = None,
        bootstrap_time_limit: bool = True,
        apart: bool = False,
    ) -> None:
        if not env.auto_reset:
            raise ConfigError("Training needs environments that reset themselves: make_vec(auto_reset=True).")
        self.env = env
        self.network_dtype = torch.get_default_dtype()  # that of the networks which are made now
        self.num_envs = env.num_envs
        self.num_actions = env.num_actions
        self.max_episode_length = env.max_episode_steps
        self.device = env.device
        self.cfg = {"task": env.spec.id, "rules": env.rules}
        self.action_scale = action_scale
        self.reward_scale = reward_scale
        self.bootstrap_time_limit = bootstrap_time_limit
        self.apart = apart
        self.reward_norm = None
        if reward_gamma is not None:
            self.reward_norm = _ReturnScale(env.num_envs, reward_gamma, env.device, env.num_designs if apart else 1)
        # The length that random starts pretend is none that the policy has lived through.
        self._shortened = torch.zeros(env.num_envs, dtype=torch.bool, device=env.device)
        self._sums = torch.zeros(len(EPISODE_SUMS), dtype=torch.float64, device=env.device)
        self._obs = env.reset()[0]

    @property
    def unwrapped(self) -> RslRlVecEnv:
        """This adapter, because rsl-rl reads :attr:`step_dt` from here."""
        return self

    @property
    def step_dt(self) -> float:
        """Duration of a control step, which rsl-rl multiplies with the weight of intrinsic rewards."""
        return self.env.sim.physics.substeps * self.env.sim.physics.dt

    @property
    def episode_length_buf(self) -> torch.Tensor:
        """Control steps of the present episodes, long ``[num_envs]``; rsl-rl sets it for random starts."""
        return self.env.episode_length

    @episode_length_buf.setter  # a variable in rsl-rl
    def episode_length_buf(self, lengths: torch.Tensor) -> None:  # pyright: ignore[reportIncompatibleVariableOverride]
        self.env.episode_length = lengths.to(self.env.episode_length)
        self._obs.copy_(self.env.retimed(self._obs))
        self._shortened.fill_(True)

    def get_observations(self) -> TensorDict:
        """Return the present observations, group ``policy``, ``[num_envs, num_obs]``."""
        return self._group(self._obs.clone())

    def set_designs(self, designs: Sequence[object], mask: torch.Tensor) -> None:
        """Replace the bodies of environments (:meth:`VoxelVecEnv.set_designs`), which begin new episodes."""
        self._begin(self.env.set_designs(designs, mask), mask)

    def reset(self) -> TensorDict:
        """Begin new episodes in all environments; return the observations."""
        self._begin(self.env.reset()[0], torch.ones_like(self._shortened))
        return self.get_observations()

    def _begin(self, obs: torch.Tensor, mask: torch.Tensor) -> None:
        """Store ``obs`` as the present observations, and reset returns where ``mask`` is True."""
        self._obs.copy_(obs)
        self._shortened.logical_and_(~mask)
        if self.reward_norm is not None:
            self.reward_norm.forget(mask)

    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """Do one control step with policy outputs ``actions`` ``[num_envs, num_actions]``."""
        obs, reward, terminated, truncated, info = self.env.step(self.goals(actions))
        self._obs.copy_(obs)
        episode = info["episode"]
        done = episode["done"]
        whole = done.masked_fill(self._shortened, False)
        self._shortened.masked_fill_(done, False)

        # Sums over the episodes that have ended
        flags = torch.stack([whole, *(info[name] for name in STOP_CAUSES)])
        counts = flags.sum(1, dtype=torch.float64)
        amounts = torch.stack([episode["return"], episode["length"]]) * whole
        totals = amounts.sum(1, dtype=torch.float64)
        self._sums.add_(torch.cat([counts[:1], totals, counts[1:]]))

        # Means over the environments
        terms = info["reward_terms"]
        names = [f"Reward/{name}" for name in terms]
        names += [f"Episode/{name}" for name in STOP_CAUSES]
        rewards = torch.stack(list(terms.values())).mean(1)
        stopped = (counts[1:] / self.num_envs).float()
        log = dict(zip(names, (*rewards, *stopped), strict=True))

        extras: dict[str, Any] = {"log": log, "returns": episode["return"], "whole": whole}
        if self.bootstrap_time_limit:
            extras["time_outs"] = truncated.masked_fill(terminated, False)
            extras["final_obs"] = self._group(info["final_obs"])
        reward = reward.to(self.network_dtype)
        if self.reward_norm is not None:
            reward = self.reward_norm(reward, done)
        return self._group(obs), reward * self.reward_scale, done, extras

    def goals(self, outputs: torch.Tensor) -> torch.Tensor:
        """Convert policy outputs to actions of the environments, both ``[num_envs, num_actions]``."""
        return ACTION_CENTER + self.action_scale * outputs

    def _group(self, obs: torch.Tensor) -> TensorDict:
        return TensorDict({OBS_GROUP: obs.to(self.network_dtype)}, batch_size=[self.num_envs], device=self.device)

    def pop_episodes(self) -> dict[str, float]:
        """Return number, mean return and mean length of the episodes ended since the last call (NaN: none).

        Returns are the task's own, not scaled. Episodes that were shortened for a random start do not count, except
        in ``unstable`` and ``diverged``: how many ended by a step that was stopped, and by divergence among them.
        """
        self.env.not_finite()  # warns of non-finite terms; the device is read below anyway
        return self.episodes_of(dict(zip(EPISODE_SUMS, map(float, self.take_sums().cpu()), strict=True)))

    def take_sums(self) -> torch.Tensor:
        """Return the sums :data:`EPISODE_SUMS` over episodes ended since the last call, and reset them.

        They are float64, on the device.
        """
        sums = self._sums.clone()
        self._sums.zero_()
        return sums

    @staticmethod
    def episodes_of(sums: Mapping[str, float]) -> dict[str, float]:
        """Compute the result of :meth:`pop_episodes` from sums by name."""
        count, total, length, *ends = (sums[name] for name in EPISODE_SUMS)
        means = (total / count, length / count) if count else (nan, nan)
        names = ("episodes", "return", "length", *STOP_CAUSES)
        return dict(zip(names, (int(count), *means, *map(int, ends)), strict=True))

    def state(self) -> dict[str, Any]:
        """Return the complete state as tensors, for :meth:`set_state`."""
        return {
            "env": self.env.state(),
            "obs": self._obs.clone(),
            "shortened": self._shortened.clone(),
            "sums": self._sums.clone(),
            "reward_norm": None if self.reward_norm is None else self.reward_norm.state(),
        }

    def pick(self, designs: Sequence[int]) -> dict[str, Any]:
        """Return the :meth:`state` that these designs alone would have, in this order.

        Raises:
            ConfigError: the designs do not scale their rewards apart.
        """
        if self.reward_norm is not None and not self.apart:
            raise ConfigError("Designs that share one scale of rewards cannot be separated.")
        mask = self.env.design_index[:, None] == torch.as_tensor(list(designs), device=self.device)
        rows = mask.T.nonzero()[:, 1]
        state = state_rows(self.state() | {"sums": None, "reward_norm": None}, rows)
        if self.env.sim.grid is None:  # without columns that only wider designs have
            state["obs"] = state["obs"][:, : int(self.env.obs_mask[list(designs)].sum(1).max())]
        norm = None if self.reward_norm is None else self.reward_norm.pick(rows, list(designs))
        return state | {"sums": torch.zeros_like(self._sums), "reward_norm": norm}

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore a :meth:`state` of an adapter with the same task, designs and settings.

        Raises:
            SimulationError: the state is that of other worlds or another number of environments, or lacks something.
        """
        norm = self.reward_norm
        own = {"obs": self._obs, "shortened": self._shortened, "sums": self._sums}
        check_fields(state, own | {"env": {}, "reward_norm": None if norm is None else norm.state()})
        self.env.set_state(state["env"])
        for name, tensor in own.items():
            tensor.copy_(state[name])
        if norm is not None:
            norm.set_state(state["reward_norm"])


class _ReturnScale:
    """Divides rewards by the running standard deviation of the discounted return.

    Environments come in ``groups`` of equal size, each with a deviation of its own.
    """

    def __init__(self, num_envs: int, gamma: float, device: str, groups: int = 1) -> None:
        self.gamma = gamma
        self._return = torch.zeros(num_envs, dtype=torch.float64, device=device)
        # count, mean and sum of squared deviations; the count starts small so that early rewards stay tame
        start = torch.tensor([1e-4, 0.0, 1e-4], dtype=torch.float64, device=device)
        self._moments = start[:, None].repeat(1, groups)

    def __call__(self, reward: torch.Tensor, done: torch.Tensor) -> torch.Tensor:
        """Update the running deviation, and divide rewards by it; the result is clipped to +-10."""
        self._return.mul_(self.gamma).add_(reward)
        count, mean, squares = self._moments
        grouped = self._return.view(len(count), -1)
        new = grouped.shape[1]
        gap = grouped.mean(1) - mean
        total = count + new
        spread = grouped.var(1, unbiased=False) * new + gap.square() * count * new / total
        self._moments.copy_(torch.stack([total, mean + gap * new / total, squares + spread]))
        self._return.masked_fill_(done, 0.0)
        scale = torch.sqrt(self._moments[2] / self._moments[0] + 1e-8).repeat_interleave(new)
        return (reward / scale).clamp(-10.0, 10.0).to(reward.dtype)

    def forget(self, mask: torch.Tensor) -> None:
        """Reset the discounted returns where ``mask`` is True, at the start of episodes."""
        self._return.masked_fill_(mask, 0.0)

    def state(self) -> dict[str, torch.Tensor]:
        return {"return": self._return.clone(), "moments": self._moments.clone()}

    def pick(self, rows: torch.Tensor, groups: list[int]) -> dict[str, torch.Tensor]:
        """Return the :meth:`state` of these environments and groups only."""
        return {"return": self._return[rows], "moments": self._moments[:, groups]}

    def set_state(self, state: dict[str, torch.Tensor]) -> None:
        self._return.copy_(state["return"])
        self._moments.copy_(state["moments"])
