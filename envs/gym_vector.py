"""Many environments as gymnasium has them: ``gymnasium.make_vec("warpvox/Walker-v0", num_envs=8, body=...)``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from warpvox.envs.gym import FPS, NAMESPACE, spaces_of
from warpvox.envs.spec import TaskSpec
from warpvox.errors import ConfigError, listing
from warpvox.types import Physics

__all__ = ["VoxelGymVectorEnv"]


class VoxelGymVectorEnv(VectorEnv):
    """A :class:`warpvox.envs.vec_env.VoxelVecEnv` behind gymnasium's vector interface: one batch, no processes.

    Observations ``[num_envs, num_obs]``, rewards float64 and flags ``[num_envs]`` are numpy arrays. An environment
    that ends is reset in the same step (``AutoresetMode.SAME_STEP``): ``infos["final_obs"]`` and
    ``infos["final_info"]`` hold what ended, where ``infos["_final_obs"]`` is True. Where an environment goes on,
    ``unstable``, ``diverged`` and ``reward_terms`` are in ``infos`` itself, as they are for a single environment.

    Args:
        task: id, ``module:NAME`` or specification.
        num_envs: environments; a multiple of the number of ``designs``.
        body: one body for all; or
        designs: several bodies, in equal blocks; smaller ones are padded on the right, see ``vec.obs_mask`` and
            ``vec.action_mask``.
        connections: of ``body``, or one entry for each of ``designs``.
        max_episode_steps: time limit; None: the task's.
        render_mode: None or ``rgb_array``: :meth:`render` gives a picture of every environment.
        render_size: width and height of a picture in pixels.
        seed: of the first episodes, until :meth:`reset` gets another.
        rules, physics, dtype, device, threads, obs: as in :func:`warpvox.make_vec`.

    Attributes:
        vec: the environments themselves, with torch tensors.

    Raises:
        TaskError, DesignError, WorldError, DeviceError, ConfigError: as :func:`warpvox.make_vec`; both ``body`` and
            ``designs``; an unknown render mode.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["rgb_array"],
        "render_fps": FPS,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        task: str | TaskSpec,
        num_envs: int = 1,
        body: object = None,
        designs: Sequence[object] | None = None,
        connections: object = None,
        max_episode_steps: int | None = None,
        render_mode: str | None = None,
        rules: str = "evogym",
        physics: str | Physics | None = None,
        dtype: str = "float64",
        device: str = "cpu",
        threads: int | None = None,
        obs: str = "task",
        seed: int = 0,
        render_size: tuple[int, int] = (640, 360),
    ) -> None:
        from warpvox.envs.vec_env import make_vec  # brings torch

        modes = self.metadata["render_modes"]
        if render_mode is not None and render_mode not in modes:
            raise ConfigError(f"render_mode must be None or one of {listing(modes)}, got {render_mode!r}.")
        if body is not None and designs is not None:
            raise ConfigError("Give a body for all environments or a list of designs, not both.")
        self.vec = make_vec(
            task,
            designs=[body] if body is not None else designs,
            num_envs=num_envs,
            connections=connections if designs is not None else [connections],
            max_episode_steps=max_episode_steps,
            rules=rules,
            physics=physics,
            dtype=dtype,
            device=device,
            threads=threads,
            obs=obs,
            seed=seed,
        )
        self.num_envs, self.render_mode, self.render_size = self.vec.num_envs, render_mode, render_size
        self.single_observation_space, self.single_action_space = spaces_of(self.vec)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._view: Any = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode everywhere; ``options`` are not used.

        Args:
            seed: governs all environments; each draws numbers of its own from it.
        """
        super().reset(seed=seed)
        return self.vec.reset(seed)[0].cpu().numpy(), {}

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """One control step everywhere; ``actions`` ``[num_envs, num_actions]``.

        Raises:
            ActionError: wrong shape, or entries that are not finite.
        """
        obs, reward, terminated, truncated, info = self.vec.step(np.asarray(actions))
        terms = {name: value.cpu().numpy() for name, value in info["reward_terms"].items()}
        details = {name: info[name].cpu().numpy() for name in ("unstable", "diverged")} | {"reward_terms": terms}
        done = info["episode"]["done"].cpu().numpy()
        infos = {} if done.all() else _masked(details, ~done)
        if done.any():
            final = np.full(self.num_envs, None, dtype=object)
            last = info["final_obs"].cpu().numpy()
            for env in np.flatnonzero(done):
                final[env] = last[env]
            infos |= {"final_obs": final, "_final_obs": done, "_final_info": done.copy()}
            infos["final_info"] = _masked(details, done)
        flags = (terminated.cpu().numpy(), truncated.cpu().numpy())
        return obs.cpu().numpy(), reward.double().cpu().numpy(), *flags, infos

    def render(self) -> tuple[np.ndarray, ...] | None:
        """A picture of every environment as it is now, uint8 ``[height, width, 3]`` each."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() does nothing without render_mode='rgb_array'.")
            return None
        if self._view is None:
            from warpvox.live import LiveView

            self._view = LiveView(self.vec.sim, self.render_size)
        return tuple(self._view.pictures())

    def __repr__(self) -> str:
        return f"{type(self).__name__}({NAMESPACE} {self.vec.spec.id}, num_envs={self.num_envs})"


def _masked(values: dict[str, Any], mask: np.ndarray) -> dict[str, Any]:
    """Values of all environments as gymnasium has them: 0 where the mask, which stands beside them, is False."""
    out: dict[str, Any] = {}
    for name, value in values.items():
        here = _masked(value, mask) if isinstance(value, dict) else np.where(mask, value, np.zeros_like(value))
        out |= {name: here, f"_{name}": mask.copy()}
    return out
