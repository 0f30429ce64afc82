"""The actions of many gaits at once, of several designs."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
import torch

from warpvox.algos.checkpoints.files import actions_of
from warpvox.algos.codesign.gaits import Gait
from warpvox.algos.policies.gait import AMPLITUDE, gait_outputs
from warpvox.envs.vec_env import VoxelVecEnv
from warpvox.types import Cell

__all__ = ["actions_of_gaits"]

AT_ONCE = 1 << 20
"""Actions that are computed at once, about: those of many control steps, if environments are few."""


def actions_of_gaits(
    env: VoxelVecEnv,
    bodies: Sequence[np.ndarray],
    gaits: Sequence[Sequence[Gait]],
    episodes: int,
    first: int = 0,
    last: int | None = None,
) -> Iterator[torch.Tensor]:
    """Actions ``[num_envs, num_actions]`` of one control step after the other, as the stored policies have them.

    Environments are those of a design, gait by gait, one after another.

    Args:
        env: where they act.
        bodies: the designs.
        gaits: as many for each design; they may have different numbers of stages.
        episodes: environments of each gait.
        first, last: control steps of the episode; ``last`` is not among them, None: the episode's last one is.
    """
    last = env.max_episode_steps if last is None else last
    count, stages = len(gaits[0]), max(len(gait.begin) for tried in gaits for gait in tried)
    values = np.zeros((3, stages, len(bodies), count, episodes, env.num_actions))
    timing = np.ones((2, stages, len(bodies), count, episodes, 1))
    timing[0] = np.inf  # stages that a gait does not have never begin
    for place, body in enumerate(bodies):
        driven = body >= Cell.H_ACT  # row by row, the order of actions
        for k, gait in enumerate(gaits[place]):
            own = len(gait.begin)
            timing[:, :own, place, k] = np.stack([gait.begin, gait.period])[:, :, None, None]
            cells = np.stack([gait.amplitude, gait.phase, gait.rest])[:, :, driven]
            values[:, :own, place, k, :, : cells.shape[-1]] = cells[:, :, None]
    parts = [
        torch.as_tensor(array.reshape(stages, env.num_envs, -1), device=env.device) for array in (*timing, *values)
    ]
    together = max(1, AT_ONCE // (env.num_envs * env.num_actions))
    for begin in itertools.count(first, together):
        end = min(begin + together, last)
        if begin >= end:
            return
        times = torch.arange(begin, end, dtype=torch.float64, device=env.device)[:, None, None]
        yield from actions_of(gait_outputs(times, *parts).float(), AMPLITUDE)
