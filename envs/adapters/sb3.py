"""Environments for Stable-Baselines3: ``PPO("MlpPolicy", VoxelSB3VecEnv("Walker-v0", 64))``."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box

from warpvox.checks import check_choice
from warpvox.envs.adapters.base import BatchAdapter, SubEnv, spaces_of
from warpvox.envs.spec import TaskSpec
from warpvox.errors import ConfigError
from warpvox.keys import in_words
from warpvox.types import ACTION_CENTER, ACTION_HIGH, ACTION_LOW, ACTION_SCALE

try:
    from stable_baselines3.common.vec_env import VecEnv
    from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices
except ImportError as error:
    raise ConfigError("This needs the package stable-baselines3: pip install 'warpvox[sb3]'") from error


class VoxelSB3VecEnv(BatchAdapter, VecEnv):
    """Environments behind Stable-Baselines3's ``VecEnv``, simulated in one batch and one process.

    Observations ``[num_envs, num_obs]`` and rewards ``[num_envs]`` are float32. Environments that end are reset in the
    same step; their ``infos`` then hold ``terminal_observation``, ``TimeLimit.truncated`` (ended by the time limit
    alone) and ``episode`` (``r``: return, ``l``: length), so that no ``VecMonitor`` is needed. ``infos`` of all others
    are empty.

    Args:
        task, num_envs, body, designs, options: as in :func:`warpvox.make_vec`; ``device="cpu"`` without ``sim``.
        normalize_actions: actions are -1 to 1, as Stable-Baselines3 advises, and stand for 0.6 to 1.6; False: they are
            target lengths themselves.
        render_mode: None or ``rgb_array``: :meth:`get_images` gives pictures of all environments.
        render_size: width and height of a picture in pixels.

    Raises: what :func:`warpvox.make_vec` raises; ConfigError: an unknown render mode.
    """

    @in_words
    def __init__(
        self,
        task: str | TaskSpec,
        num_envs: int = 1,
        body: object = None,
        designs: Sequence[object] | None = None,
        *,
        normalize_actions: bool = True,
        render_mode: str | None = None,
        render_size: tuple[int, int] = (640, 360),
        **options: Any,
    ) -> None:
        check_choice("render_mode", render_mode, [None, "rgb_array"])
        self._make(task, designs, num_envs, options, {"device": "cpu"}, body=body, auto_reset=True)
        self.normalize_actions = normalize_actions
        self.render_size = render_size
        self.render_mode = render_mode
        self._actions: Any = None
        observations, actions = spaces_of(self.vec)
        observations = Box(observations.low, observations.high, dtype=np.float32)
        low, high = (-1.0, 1.0) if normalize_actions else (ACTION_LOW, ACTION_HIGH)
        actions = Box(low, high, actions.shape, np.float32)
        self.single_spaces = observations, actions
        super().__init__(self.vec.num_envs, observations, actions)  # pyright: ignore[reportUnknownMemberType] # bare Space

    def reset(self) -> np.ndarray:
        """Begin an episode in all environments, with the seeds set by :meth:`seed`; return the observations."""
        seeds = None if None in self._seeds else [int(seed) for seed in self._seeds if seed is not None]
        self._reset_seeds()
        self._reset_options()
        return self._numbers(self._reset(seeds))

    def restart(self, mask: np.ndarray, seeds: Sequence[int] | None) -> np.ndarray:
        """Begin an episode where ``mask``, bool ``[num_envs]``, is True; return all observations."""
        return self._numbers(self._reset(seeds, mask))

    def step_async(self, actions: np.ndarray) -> None:
        """Store ``actions`` ``[num_envs, num_actions]`` for :meth:`step_wait`."""
        self._actions = np.asarray(actions)

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Do one control step in all environments; return observations, rewards, dones and infos.

        Raises:
            ActionError: wrong shape, or entries that are not finite.
        """
        actions = ACTION_CENTER + ACTION_SCALE * self._actions if self.normalize_actions else self._actions
        obs, reward, terminated, truncated, info = self.vec.step(actions)
        done = (terminated | truncated).cpu().numpy()
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if done.any():
            final = self._numbers(info["final_obs"])
            late = (truncated & ~terminated).cpu().numpy()
            returns = info["episode"]["return"].cpu().tolist()
            lengths = info["episode"]["length"].cpu().tolist()
            for env in np.flatnonzero(done):
                infos[env] = {
                    "terminal_observation": final[env],
                    "TimeLimit.truncated": bool(late[env]),
                    "episode": {"r": returns[env], "l": int(lengths[env])},
                }
        return self._numbers(obs), self._numbers(reward), done, infos

    @staticmethod
    def _numbers(values: torch.Tensor) -> np.ndarray:
        return values.to(torch.float32).cpu().numpy()

    def get_images(self) -> list[np.ndarray | None]:
        """Render all environments, uint8 ``[height, width, 3]`` each."""
        if self.render_mode is None:
            return [None] * self.num_envs
        return list(self.pictures())

    def close(self) -> None:
        """Do nothing, as no resources are held."""

    # ------------------------------------------------------- what Stable-Baselines3 asks of each environment

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Read an attribute of each environment."""
        return [env.get_wrapper_attr(attr_name) for env in self._chosen(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of each environment."""
        for env in self._chosen(indices):
            setattr(env, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **options: Any) -> list[Any]:
        """Call a method of each environment; return the results."""
        return [env.get_wrapper_attr(method_name)(*args, **options) for env in self._chosen(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: VecEnvIndices = None) -> list[bool]:
        """Return False for each environment, as none has a wrapper."""
        return [False for _ in self._chosen(indices)]

    def _chosen(self, indices: VecEnvIndices) -> list[SubEnv]:
        return [self.envs[number] for number in self._get_indices(indices)]
