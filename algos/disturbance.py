"""Disturbed episodes: noise on actions and observations, repeated actions, random starts."""

import math
from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np
import torch

from warpvox.algos.protocols import DISTURBANCES, NOMINAL
from warpvox.envs.random_stream import RandomStream
from warpvox.envs.vec_env import VoxelVecEnv
from warpvox.envs.voxels import FEATURES
from warpvox.simulation import checked_actions
from warpvox.types import ACTION_HIGH, ACTION_LOW

JUDGED, SEARCHED = 0xFA1F, 0x5EED
"""Random streams of final evaluations and of searches, so that both draw different disturbances."""
NOISE, STICKY, START, SENSORS, LENGTH = range(5)
"""Kinds of disturbance, each with random numbers of its own."""


class Draws:
    """Random numbers of disturbed episodes, reproducible from seed, stream, copy, control step and kind.

    Args:
        seed: of the numbers.
        stream: :data:`JUDGED` or :data:`SEARCHED`, which have different numbers for the same seed.
        copies: number of episodes with different numbers; all policies that are compared get the same numbers.
        device: of the numbers.
    """

    def __init__(self, seed: int, stream: int, copies: int, device: Any = "cpu") -> None:
        self.stream = RandomStream(cast(Any, [(stream, seed)]), copies, device)

    def uniform(self, purpose: int, step: int, count: int) -> torch.Tensor:
        """Draw uniform numbers in [0, 1), float64 ``[copies, count]``."""
        # An episode has fewer than 2**20 control steps.
        self.stream.episode.fill_(purpose * 2**20 + step)
        return self.stream.rewind().integers(0, 2**53, count).double() / 2**53

    def normal(self, purpose: int, step: int, count: int) -> torch.Tensor:
        """Draw standard normal numbers, float64 ``[copies, count]`` (Box and Muller)."""
        first, second = self.uniform(purpose, step, 2 * count).unflatten(1, (count, 2)).unbind(2)
        values = torch.sqrt(-2.0 * torch.log(1.0 - first)) * torch.cos(2.0 * math.pi * second)
        # Multiples of 2**-20: machines whose logarithms differ in the last bit agree.
        return torch.round(values * 2.0**20) / 2.0**20


def with_noise(actions: torch.Tensor, draws: Draws, step: int, deviation: Any) -> torch.Tensor:
    """Add noise to ``actions`` ``[n * copies, num_actions]``; row r gets the noise of copy ``r % copies``.

    ``deviation``: a number or ``[n * copies, 1]``.
    """
    noise = draws.normal(NOISE, step, actions.shape[1])
    noise = noise.repeat(len(actions) // len(noise), 1)
    return (actions + (deviation * noise).to(actions.dtype)).clamp(ACTION_LOW, ACTION_HIGH)


class Disturbed:
    """Wrapper that disturbs a policy's actions and observations; each design has equal blocks of disturbances.

    Args:
        policy: observations to actions, as :func:`warpvox.algos.evaluate.evaluate` takes it.
        env: its environments, a multiple of designs times disturbances.
        parts: names of the disturbances of the blocks.
        seed, stream: see :class:`Draws`.

    Attributes:
        names: of each environment's disturbance.
    """

    def __init__(
        self, policy: Callable[[Any], Any], env: VoxelVecEnv, parts: Sequence[str], seed: int, stream: int = JUDGED
    ) -> None:
        copies = env.num_envs // (env.num_designs * len(parts))
        self.policy = policy
        self.draws = Draws(seed, stream, copies, env.device)
        self.shape = (env.num_envs, env.num_actions)
        self.parts = tuple(parts)
        self.names = [name for name in parts for _ in range(copies)] * env.num_designs
        self.kinds = [DISTURBANCES[name] for name in self.names]

        # How strong each disturbance is in each environment, [num_envs, 1]
        def strength(name: str) -> torch.Tensor:
            return torch.tensor([[getattr(kind, name)] for kind in self.kinds], device=env.device)

        self.noise = strength("noise").double()
        self.sticky = strength("sticky").double()

        # Noise on observations, except padding and the types and neighbours of cells
        sensed = env.obs_mask[env.design_index].double()
        for grid in env.voxels.values():
            grid.cells(sensed)[..., FEATURES["type"].start :] = 0.0
        self.sensors = strength("sensors").double() * sensed

        # Control steps with random actions at the beginning
        most = strength("start")
        lengths = self._repeat_copies(self.draws.uniform(LENGTH, 0, 1))
        self.random_steps = torch.where(most > 0, 1 + (lengths * most).long(), 0)

        # Upper limit 1.6 in float32, which lies above 1.6: the highest actions of policies are not clamped.
        self.highest = float(np.float32(ACTION_HIGH))
        # Computed once, so that a step does not wait for the device
        self.most = {}
        for name in vars(self.kinds[0]):
            self.most[name] = max(getattr(kind, name) for kind in self.kinds)
        self.reset()

    def reset(self) -> None:
        self.step = 0
        self.before = None
        if hasattr(self.policy, "reset"):
            self.policy.reset()

    def _repeat_copies(self, numbers: torch.Tensor) -> torch.Tensor:
        """Repeat ``numbers``, one row for each disturbed copy, to one row for each environment."""
        return numbers.repeat(len(self.kinds) // len(numbers), 1)

    def __call__(self, obs: torch.Tensor) -> torch.Tensor:
        """Compute disturbed actions ``[num_envs, num_actions]`` from observations ``[num_envs, num_obs]``."""
        draws = self.draws
        step = self.step

        # Observations
        if self.most["sensors"]:
            noise = self._repeat_copies(draws.normal(SENSORS, step, obs.shape[1]))
            obs = obs + (self.sensors * noise).to(obs.dtype)

        # The policy's actions
        actions = checked_actions(self.policy(obs), self.shape, str(obs.device))
        actions = actions.clamp(ACTION_LOW, self.highest)  # outside the range noise would be cut off

        # Random actions, those of the step before, and noise
        if step < self.most["start"]:
            uniform = self._repeat_copies(draws.uniform(START, step, actions.shape[1]))
            uniform = (ACTION_LOW + (ACTION_HIGH - ACTION_LOW) * uniform).to(actions.dtype)
            actions = torch.where(self.random_steps > step, uniform, actions)
        if self.before is not None and self.most["sticky"]:
            repeats = self._repeat_copies(draws.uniform(STICKY, step, 1)) < self.sticky
            actions = torch.where(repeats, self.before, actions)
        if self.most["noise"]:
            actions = torch.where(self.noise > 0, with_noise(actions, draws, step, self.noise), actions)
        self.step = step + 1
        self.before = actions
        return actions


def as_judged(policy: Any, env: VoxelVecEnv, seed: int | Sequence[int] | None, protocol: str) -> Any:
    """Wrap ``policy`` for the protocol ``protocol``: unchanged, or with action noise drawn from ``seed``."""
    if protocol == NOMINAL:
        return policy
    first = seed[0] if isinstance(seed, Sequence) else seed
    return Disturbed(policy, env, ["noise"], first or 0, SEARCHED)
