"""The time as an observation: ``make_vec(..., obs="timed")`` or ``"timed_voxel"``."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from warpvox.envs.about import About

if TYPE_CHECKING:
    from warpvox.envs.episodes import Episodes
    from warpvox.envs.snapshot import Snapshot
    from warpvox.envs.vec_env import VoxelVecEnv

NAME = "elapsed_steps"


class ElapsedSteps:
    """The observation term ``[num_envs, 1]`` with the control steps since an episode began, as its time limit counts.

    With it the end of an episode by the time limit can be foreseen (Pardo et al. 2018, "Time Limits in Reinforcement
    Learning", section 3).
    """

    __name__ = NAME
    about = About("control steps since the episode began", low=0.0)

    def __init__(self, episodes: Episodes) -> None:
        self._length = episodes.length  # one tensor for good, which a captured step may read

    def __call__(self, state: Snapshot) -> torch.Tensor:
        return self._length[:, None]


def is_timed(env: VoxelVecEnv) -> bool:
    """Whether observations end with the time."""
    return NAME in env.obs_columns[0]
