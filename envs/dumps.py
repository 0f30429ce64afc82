"""Recording of diverged environments: a rollout file with the last states of each."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.nn.functional import pad

from warpvox.errors import RolloutError
from warpvox.types import ACTION_HIGH, ACTION_LOW
from warpvox.view.rollout import Rollout, facts_of, scenes_of

STEPS = 64
"""Maximum number of control steps in a file."""


class DivergenceDump:
    """Ring buffer of the last control steps; writes a rollout file for each environment that diverges.

    ``env.dump = DivergenceDump(env, "dumps")`` switches it on.

    A file is a :class:`warpvox.view.rollout.Rollout` of one environment: positions before each of its last steps, at
    most :data:`STEPS` and of the same episode, the actions taken and the rewards. The last step is the one that
    diverged; it was undone, so that the last two entries of the positions are equal. The metadata say which environment
    it was and in which step of its episode.

    On the CPU it is written in the step of the divergence. On CUDA, where reading flags waits for the device, files are
    written every :data:`STEPS` steps, for the first divergence of an environment since the last time.

    Args:
        env: the :class:`warpvox.envs.vec_env.VoxelVecEnv`, which calls this object in its steps and resets.
        folder: made when there is a file; may be changed later.
    """

    def __init__(self, env: Any, folder: str | os.PathLike[str]) -> None:
        self.env = env
        self.folder = Path(folder)
        self.pause = 1 if torch.device(env.sim.device).type == "cpu" else STEPS
        self._scenes, self._points = scenes_of(env.sim)
        self._room = STEPS + self.pause
        self._open = True
        self._count = 0
        self._rings: dict[str, torch.Tensor] = {}
        self._at = torch.full((env.num_envs,), -1, dtype=torch.long, device=env.device)
        self._length = torch.zeros_like(self._at)
        self._begun = torch.zeros_like(self._at)

    def refresh(self) -> None:
        """Update the bodies after some were exchanged; call :meth:`clear` for these environments next."""
        self._scenes, self._points = scenes_of(self.env.sim)

    def clear(self, mask: torch.Tensor | None = None) -> None:
        """Discard the recorded steps of environments (bool ``[num_envs]``; None: all) at their reset."""
        mask = torch.ones_like(self._at, dtype=torch.bool) if mask is None else mask
        self._at = self._at.masked_fill(mask, -1)
        self._begun = self._begun.masked_fill(mask, self._count)

    def before(self, actions: torch.Tensor) -> None:
        """Record the state before a step and the actions ``[num_envs, num_actions]``."""
        self._write_to_buffer("positions", self._points())
        self._write_to_buffer("actions", actions)

    def _write_to_buffer(self, name: str, values: torch.Tensor) -> None:
        """Write ``values`` into a ring buffer at the present step."""
        if name not in self._rings:
            self._rings[name] = values.new_zeros((self._room, *values.shape))
        ring = self._rings[name]
        if name == "positions" and (more := values.shape[1] - ring.shape[2]):  # widest body has come or gone
            ring = self._rings[name] = pad(ring, (0, 0, 0, more)) if more > 0 else ring
            values = pad(values, (0, 0, 0, max(-more, 0)))
        ring[self._count % self._room] = values

    def after(self, reward: torch.Tensor, info: dict[str, Any]) -> list[Path]:
        """Record the result of a step, and write files of diverged environments from time to time; return paths."""
        self._write_to_buffer("rewards", reward)
        new = info["diverged"] & (self._at < 0)
        self._at = torch.where(new, self._count, self._at)
        self._length = torch.where(new, info["episode"]["length"].long(), self._length)
        self._count += 1
        if self._count % self.pause or not bool((self._at >= 0).any()):
            return []
        found = np.flatnonzero(self._at.cpu() >= 0).tolist()
        written = [path for env in found if (path := self._write(env)) is not None]
        self._at = torch.full_like(self._at, -1)
        return written

    def _write(self, env: int) -> Path | None:
        """Write the file of one environment and return the path; None after 10 files or a failed write.

        A failure warns, and no more files are written.
        """
        taken = [int(number) for p in self.folder.glob("diverged_*.npz") if (number := p.stem.split("_")[1]).isdigit()]
        if not self._open or len(taken) >= 10:
            return None
        path = self.folder / f"diverged_{max(taken, default=0) + 1:03}_env{env}.npz"
        try:
            return self.rollout(env).save(path)
        except (OSError, RolloutError) as error:
            self._open = False
            warnings.warn(f"No more divergences are written: {path} failed: {error}", RuntimeWarning, stacklevel=2)
            return None

    def rollout(self, env: int) -> Rollout:
        """Return the last steps of an environment before its divergence as a rollout."""
        # What was recorded, in the order of the steps
        end = int(self._at[env]) + 1
        steps = min(int(self._length[env]), STEPS, end - int(self._begun[env]))
        places = [step % self._room for step in range(end - steps, end)]
        positions = self._rings["positions"][places, env].double().cpu().numpy()
        actions = self._rings["actions"][places, env].double().cpu().numpy()
        rewards = self._rings["rewards"][places, env].double().cpu().numpy()

        # As a rollout: numbers that are finite, and an end in the last step
        scene = self._scenes[int(self.env.sim.design_index[env])]
        with np.errstate(over="ignore", invalid="ignore"):
            shown = positions[:, : scene.num_points].astype(np.float32)  # [steps, points, 2]
        # A frame that float32 cannot hold is replaced by the one before.
        good = np.isfinite(shown).all((1, 2))
        last = np.maximum.accumulate(np.where(good, np.arange(steps), good.argmax()))
        shown = shown[last] if good.any() else np.zeros_like(shown)
        over = np.zeros((steps, 1), bool)
        over[-1] = True
        return Rollout(
            positions=np.concatenate([shown, shown[-1:]])[:, None],
            design_index=np.zeros(1, np.int32),
            scenes=(scene,),
            actions=np.where(np.isfinite(actions), actions, 1.0).clip(ACTION_LOW, ACTION_HIGH)[:, None],
            rewards=rewards[:, None],
            terminated=over,
            truncated=np.zeros_like(over),
            metadata=facts_of(self.env)
            | {
                "agent": "policy",
                "diverged": True,
                "environment": env,
                "episode_step": int(self._length[env]),
                "actions_not_finite": int((~np.isfinite(actions)).sum()),
                "states_not_finite": int((~np.isfinite(positions)).any((1, 2)).sum()),
            },
        )
