"""Runs recordings of the reference through our environments and says how far apart the two are.

A recording file holds several runs of one task, as ``record.py`` beside this file writes them.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from warpvox.envs.vec_env import VoxelVecEnv, make_vec

RECORDINGS = Path(__file__).with_name("recordings")


@dataclass(frozen=True)
class Run:
    """One recorded episode: ``info`` is its entry in the file's list, ``arrays`` what was recorded."""

    task: str
    index: int
    info: dict[str, Any]
    arrays: dict[str, np.ndarray]

    def __str__(self) -> str:
        return f"{self.task}/r{self.index}"

    @property
    def actions(self) -> np.ndarray:
        """float64 ``[steps, actuators]``, not clipped."""
        return self.arrays["actions"] / 1024.0

    @property
    def frames(self) -> np.ndarray:
        """int ``[rows]``: the rows of a replay that positions and observations are recorded of."""
        rows = np.arange(len(self.arrays["pos"]))
        return self.arrays.get("frames", rows).astype(int)

    @property
    def memory(self) -> dict[str, list[list[int]]]:
        """What was random in the run, in the form in which an environment of ours remembers it."""
        return {name: [self.info[name]] for name in ("goals", "offset") if self.info.get(name) is not None}

    @property
    def unstable_at(self) -> int:
        """The step that self-folding has stopped, or -1."""
        return int(self.info["unstable_at"])


@dataclass
class Replay:
    """Our side of a run. Row 0 is after the reset, row t + 1 after step t.

    ``positions`` ``[steps + 1, 2, points that can move]``, ``obs`` ``[steps + 1, num_obs]``; ``reward``,
    ``terminated``, ``truncated`` ``[steps]``; ``angles``: columns of ``obs`` that hold an orientation.
    """

    positions: np.ndarray
    obs: np.ndarray
    reward: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    angles: list[int]


def load_runs(folder: Path = RECORDINGS) -> list[Run]:
    """All runs of the recordings in a folder."""
    runs = []
    for path in sorted(folder.glob("*.npz")):
        with np.load(path) as archive:
            meta = json.loads(str(archive["meta"]))
            arrays = {key: archive[key] for key in archive.files if key != "meta"}
        for index, info in enumerate(meta["runs"]):
            prefix = f"r{index}_"
            own = {key[len(prefix) :]: value for key, value in arrays.items() if key.startswith(prefix)}
            runs.append(Run(meta["task"], index, info, own))
    return runs


def make_env(run: Run, **options: Any) -> VoxelVecEnv:
    """One environment with the body of a run, in float64 under the released rules unless told otherwise."""
    defaults = {"device": "cpu", "dtype": "float64", "rules": "evogym", "auto_reset": False}
    return make_vec(run.task, designs=[run.arrays["body"]], num_envs=1, **(defaults | options))


def replay(run: Run, steps: int | None = None, **options: Any) -> Replay:
    """Repeat the first ``steps`` (default: all) actions of a run in :func:`make_env`'s environment."""
    env = make_env(run, **options)
    actions = torch.as_tensor(run.actions[:steps]).to(env.dtype)
    observations = [env.reset(memory=run.memory)[0][0]]
    positions = [moving_positions(env, run)]
    outcomes = []
    for action in actions:
        obs, reward, terminated, truncated, _ = env.step(action[None])
        observations.append(obs[0])
        positions.append(moving_positions(env, run))
        outcomes.append((float(reward[0]), bool(terminated[0]), bool(truncated[0])))
    reward, terminated, truncated = (np.array(column) for column in zip(*outcomes, strict=True))
    columns = env.obs_columns[0].items()
    angles = [span.start for name, span in columns if name.startswith("orientation")]
    observed = torch.stack(observations).double().cpu().numpy()
    return Replay(np.stack(positions), observed, reward, terminated, truncated, angles)


def moving_positions(env: VoxelVecEnv, run: Run) -> np.ndarray:
    """float64 ``[2, k]``: the points that can move, in the order of the recording."""
    whole = [env.sim.object_positions(entry["name"])[0].double() for entry in run.info["objects"]]
    return torch.cat(whole).T.cpu().numpy()[:, run.arrays["dyn"]]


def position_error(run: Run, ours: Replay) -> np.ndarray:
    """float64 ``[frames]``: largest difference of any coordinate, over the frames that both sides have."""
    rows = run.frames[run.frames < len(ours.positions)]
    return np.abs(run.arrays["pos"][: len(rows)] - ours.positions[rows]).max(axis=(1, 2))


def obs_error(run: Run, ours: Replay) -> tuple[np.ndarray, np.ndarray]:
    """float64 ``[frames]`` twice: largest difference of entries but angles, and of angles modulo 2 pi."""
    rows = run.frames[run.frames < len(ours.obs)]
    gap = np.abs(run.arrays["obs"][: len(rows)] - ours.obs[rows])
    turned = gap[:, ours.angles]
    turned = np.minimum(turned, np.abs(2 * np.pi - turned))
    return np.delete(gap, ours.angles, axis=1).max(axis=1), turned.max(axis=1, initial=0.0)


def reward_error(run: Run, ours: Replay) -> np.ndarray:
    """float64 ``[steps]``: difference of the rewards."""
    return np.abs(run.arrays["reward"][: len(ours.reward)] - ours.reward)
