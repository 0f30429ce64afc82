"""One environment as gymnasium has them: ``gymnasium.make("warpvox/Walker-v0", body=...)``."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.spec import TaskSpec
from warpvox.errors import ActionError, ConfigError, listing
from warpvox.types import ACTION_HIGH, ACTION_LOW, Physics

__all__ = ["VoxelEnv", "register"]

NAMESPACE = "warpvox"
OBSERVATION_BOUND = 100.0  # as released: nominal, observations are not clipped
_NO_LIMIT = 2**62  # gymnasium's TimeLimit counts the steps


def register() -> None:
    """Make all tasks known to gymnasium as ``warpvox/<id>``. Harmless to repeat."""
    for task in task_ids():
        name = f"{NAMESPACE}/{task}"
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point="warpvox.envs.gym:VoxelEnv",
                max_episode_steps=get_task(task).max_episode_steps,
                kwargs={"task": task},
            )


class VoxelEnv(gymnasium.Env):
    """One robot in one task: numpy in and out, float64, EvoGym's spaces.

    Observations are float64 ``[num_obs]`` (``Box(-100, 100)``), actions ``[num_actions]``
    (``Box(0.6, 1.6)``): goal lengths of the actuators, row by row from the top of the body, in units of their
    rest length. The time limit is gymnasium's. An environment that has terminated stays as it is until it is
    reset.

    Args:
        task: id or specification.
        body: cells ``[rows, columns]`` or anything :func:`warpvox.load_design` reads. Default: ``walker``.
        connections: EvoGym's ``[2, k]`` pairs of flat cell indices; None connects all neighbours.
        render_mode: None or one of ``metadata["render_modes"]``.
        rules, physics, dtype, device: as in :func:`warpvox.make_vec`.

    Raises:
        TaskError, DesignError, WorldError, DeviceError: as :func:`warpvox.make_vec`. ConfigError: unknown
            rules or render mode.
    """

    metadata: dict[str, Any] = {"render_modes": [], "render_fps": 50}  # noqa: RUF012

    def __init__(
        self,
        task: str | TaskSpec,
        body: object = None,
        connections: object = None,
        render_mode: str | None = None,
        rules: str = "evogym",
        physics: str | Physics | None = None,
        dtype: str = "float64",
        device: str = "cpu",
    ) -> None:
        from warpvox.envs.vec_env import make_vec  # brings torch, which registering must not

        modes = self.metadata["render_modes"]
        if render_mode is not None and render_mode not in modes:
            raise ConfigError(f"render_mode must be None or one of {listing(modes)}, got {render_mode!r}.")
        self._vec = make_vec(
            task,
            designs=None if body is None else [body],
            connections=[connections],
            device=device,
            rules=rules,
            physics=physics,
            dtype=dtype,
            auto_reset=False,
            threads=1,
            max_episode_steps=_NO_LIMIT,
        )
        self.render_mode = render_mode
        shape = (self._vec.num_obs,)
        self.observation_space = gymnasium.spaces.Box(-OBSERVATION_BOUND, OBSERVATION_BOUND, shape, np.float64)
        shape = (self._vec.num_actions,)
        self.action_space = gymnasium.spaces.Box(ACTION_LOW, ACTION_HIGH, shape, np.float64)

    @property
    def sim(self) -> Any:
        """The :class:`warpvox.Simulation`, with one environment."""
        return self._vec.sim

    @property
    def body(self) -> np.ndarray:
        """int8 ``[rows, columns]``: the robot."""
        return self._vec.designs[0].copy()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; ``options`` are not used."""
        super().reset(seed=seed)
        obs, _ = self._vec.reset(seed)
        return self._numpy(obs), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """One control step.

        Returns:
            Observation, reward, terminated, truncated (always False here), and a dictionary with ``unstable``
            and ``reward_terms``, what each term has added to the reward.

        Raises:
            ActionError: wrong shape, or entries that are not finite.
        """
        action = np.asarray(action, dtype=np.float64)
        if action.shape != self.action_space.shape:
            expected = list(self.action_space.shape)
            raise ActionError(f"An action must have the shape {expected}, got {list(action.shape)}.")
        obs, reward, terminated, _, info = self._vec.step(action[None])
        details = {
            "unstable": bool(info["unstable"][0]),
            "reward_terms": {name: float(value[0]) for name, value in info["reward_terms"].items()},
        }
        return self._numpy(obs), float(reward[0]), bool(terminated[0]), False, details

    @staticmethod
    def _numpy(obs: Any) -> np.ndarray:
        return obs[0].cpu().numpy().astype(np.float64)
