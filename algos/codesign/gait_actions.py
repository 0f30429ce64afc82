"""Simulation of many open-loop gaits of several designs at once."""

import itertools
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import torch

from warpvox.algos.checkpoints.files import actions_of
from warpvox.algos.codesign.gaits import Gait
from warpvox.algos.disturbance import Draws, with_noise
from warpvox.algos.policies.gait import gait_outputs
from warpvox.algos.protocols import DISTURBANCES
from warpvox.envs.episodes import state_rows
from warpvox.envs.vec_env import VoxelVecEnv
from warpvox.types import ACTION_SCALE, Cell


def continued(state: Any, sources: torch.Tensor, episodes: int) -> Any:
    """Rearrange ``state`` so that gait ``k`` of design ``d`` continues from the episodes of gait ``sources[d, k]``."""
    device = sources.device
    gaits = sources + sources.shape[1] * torch.arange(len(sources), device=device)[:, None]
    rows = gaits[:, :, None] * episodes + torch.arange(episodes, device=device)
    return state_rows(state, rows.flatten())


def play(
    env: VoxelVecEnv,
    bodies: Sequence[np.ndarray],
    gaits: Sequence[Sequence[Gait]],
    episodes: int,
    first: int = 0,
    last: int | None = None,
    noise: Draws | None = None,
) -> torch.Tensor:
    """Step the environments through control steps ``first`` to ``last`` of ``gaits``; return the mean returns.

    Args:
        noise: random numbers of noise on the actions, for ``episodes`` copies, equal for all gaits; None: no noise.

    Returns:
        The mean return of each gait so far, float64 ``[designs, gaits]`` on the CPU.
    """
    with torch.no_grad():
        for step, actions in enumerate(actions_of_gaits(env, bodies, gaits, episodes, first, last)):
            if noise is not None:
                deviation = float(np.float32(DISTURBANCES["noise"].noise))  # rounded as in episodes of other policies
                actions = with_noise(actions, noise, first + step, deviation)
            _, _, terminated, truncated, _ = env.step(actions)
            if step % 25 == 0 and bool((terminated | truncated).all()):
                break
    returns = env.state()["return"].to(env.dtype).double()
    return returns.view(len(bodies), -1, episodes).mean(2).cpu()


def actions_of_gaits(
    env: VoxelVecEnv,
    bodies: Sequence[np.ndarray],
    gaits: Sequence[Sequence[Gait]],
    episodes: int,
    first: int = 0,
    last: int | None = None,
) -> Iterator[torch.Tensor]:
    """Yield the actions ``[num_envs, num_actions]`` of gaits at each control step.

    Environments are those of a design, gait by gait, one after another.

    Args:
        gaits: as many for each design; they may have different numbers of stages.
        episodes: environments of each gait.
        first, last: control steps of the episode; ``last`` is not among them, None: the episode's last one is.
    """
    last = env.max_episode_steps if last is None else last
    count = len(gaits[0])
    stages = max(len(gait.begin) for tried in gaits for gait in tried)
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
    parts = [torch.as_tensor(one.reshape(stages, env.num_envs, -1), device=env.device) for one in (*timing, *values)]
    # With few environments, compute the actions of many control steps at once.
    together = max(1, 2**20 // (env.num_envs * env.num_actions))
    for begin in itertools.count(first, together):
        end = min(begin + together, last)
        if begin >= end:
            return
        times = torch.arange(begin, end, dtype=torch.float64, device=env.device)[:, None, None]
        yield from actions_of(gait_outputs(times, *parts).float(), ACTION_SCALE)
