"""Single environment for gymnasium: ``gymnasium.make("warpvox/Walker-v0", body=...)``."""

import time
from math import isfinite
from typing import Any

import gymnasium
import numpy as np

from warpvox.checks import check_choice
from warpvox.envs.adapters.base import FPS, Adapter, OneEnv, flat, metadata_here, spaces_of
from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.spec import TaskSpec
from warpvox.errors import ActionError, ConfigError, DisplayError
from warpvox.keys import in_words
from warpvox.types import FRAME_SECONDS
from warpvox.view import window

NAMESPACE = "warpvox"


def register() -> None:
    """Register all tasks with gymnasium as ``warpvox/<id>``; safe to repeat."""
    for task in task_ids():
        if f"{NAMESPACE}/{task}" not in gymnasium.registry:
            _register(NAMESPACE, task, task)


def register_task(task: str | TaskSpec, namespace: str) -> str:
    """Register the user's own task with gymnasium; return its id ``<namespace>/<task id>``.

    Args:
        task: a specification, or ``module:NAME``, which other processes (``vectorization_mode="async"``) can import.
        namespace: anything but ``warpvox``.

    Raises:
        ConfigError: a namespace that is not free. TaskError: no such task.
    """
    if namespace == NAMESPACE or not namespace.isidentifier():
        raise ConfigError(f"A namespace of your own is a word other than {NAMESPACE!r}, got {namespace!r}.")
    return _register(namespace, get_task(task).id, task)


def _register(namespace: str, name: str, task: str | TaskSpec) -> str:
    """Register a task with gymnasium; return its gymnasium id."""
    gymnasium.register(  # pyright: ignore[reportUnknownMemberType] # its types leave arguments open
        f"{namespace}/{name}",
        entry_point="warpvox.envs.adapters.gym:VoxelEnv",
        vector_entry_point="warpvox.envs.adapters.gym_vector:VoxelGymVectorEnv",
        max_episode_steps=get_task(task).max_episode_steps,
        kwargs={"task": task},
    )
    return f"{namespace}/{name}"


class VoxelEnv(Adapter, OneEnv, gymnasium.Env):
    """One robot in one task as a gymnasium environment: numpy in and out, float64.

    Observations are ``[num_obs]`` (for their bounds see :func:`warpvox.envs.adapters.base.spaces_of`), actions
    ``[num_actions]`` (``Box(0.6, 1.6)``): target lengths of the actuators, row by row from the top of the body, in
    units of their rest length. One that has terminated stays so until its reset. The time limit is gymnasium's, that of
    the released rules: by the paper's, Traverser-v0 needs ``max_episode_steps=1000``.

    ``metadata`` of the class names all render modes, that of an instance those which work on this machine: ``human``
    needs a display.

    Args:
        task: id, ``module:NAME`` or specification.
        body: cells ``[rows, columns]`` or anything :func:`warpvox.load_design` reads; for a task with several robots
            ``{name: body}``. Default: ``walker``.
        connections: EvoGym's ``[2, k]`` pairs of flat cell indices; None connects all neighbours.
        render_mode: None, ``rgb_array`` (:meth:`render` gives a picture) or ``human`` (a window shows every step).
        render_size: width and height of pictures in pixels.
        options: ``seed`` (of the first episodes, until :meth:`reset` gets another; 0, also in copies), ``rules``,
            ``obs``, ``sim`` and its fields as in :func:`warpvox.make_vec`; here ``device="cpu"``, ``dtype="float64"``
            and ``threads=1`` unless ``sim`` is given.

    Raises: what :func:`warpvox.make_vec` raises; ConfigError: an unknown render mode; DisplayError: ``human`` without a
    display.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": FPS}  # noqa: RUF012

    @in_words
    def __init__(
        self,
        task: str | TaskSpec,
        body: object = None,
        connections: object = None,
        render_mode: str | None = None,
        render_size: tuple[int, int] = (640, 360),
        **options: Any,
    ) -> None:
        from warpvox.envs.adapters.single import fast_stepper

        check_choice("render_mode", render_mode, [None, *VoxelEnv.metadata["render_modes"]])
        if render_mode == "human" and (reason := window.why_no_window()) is not None:
            raise DisplayError(f"render_mode='human' shows a window, but {reason}; render_mode='rgb_array' needs none.")
        self.metadata = metadata_here(VoxelEnv.metadata)
        bodies = None if body is None else [body]
        links = [connections]
        defaults = {"device": "cpu", "dtype": "float64", "threads": 1}
        limit = {"auto_reset": False, "max_episode_steps": 2**62}  # gymnasium's TimeLimit counts the steps
        self._make(task, bodies, 1, options, defaults, connections=links, body=None, **limit)
        self.render_mode = render_mode
        self.render_size = render_size
        self.observation_space, self.action_space = spaces_of(self.vec)
        self._window: window.Window | None = None
        self._next_frame = 0.0
        # The observation and the reward terms, as 0, with which the episode has ended.
        self._ended: tuple[np.ndarray, dict[str, float]] | None = None
        self._fast = fast_stepper(self.vec)
        self._zeros = np.zeros(self.action_space.shape)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; ``options`` are not used."""
        super().reset(seed=seed)
        obs, _ = self.vec.reset(seed)
        self._ended = None
        self._show()
        return obs[0].cpu().numpy(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Do one control step.

        Returns:
            Observation, reward, terminated, truncated (always False here), and a dictionary with ``unstable``
            (the step was stopped), ``diverged`` (it diverged, not by self-folding) and ``reward_terms/NAME`` for
            each term, what it has added to the reward.

        Raises:
            ActionError: wrong shape, or entries that are not finite.
        """
        try:
            action = np.asarray(action, dtype=np.float64)
        except Exception as error:  # conversion of an arbitrary object may raise anything
            raise ActionError(f"An action must be an array of numbers: {str(error)[:200]}.") from None
        if action.shape != self.action_space.shape:
            expected = self.action_space.shape
            raise ActionError(f"An action must have the shape {list(expected or ())}, got {list(action.shape)}.")
        if self._ended is not None and self.vec.episodes.terminated.item():  # it may have been set to an earlier state
            obs, terms = self._ended
            return obs.copy(), 0.0, True, False, {"unstable": False, "diverged": False, **flat(terms)}
        if self._fast is not None:
            if not isfinite(action.dot(self._zeros)):
                self.sim.take(action[None])  # names an entry that is not finite
            obs, terms, terminated, unstable, diverged = self._fast.step(action)
        else:
            row, _, done, _, info = self.vec.step(action[None])
            obs = row[0].cpu().numpy()
            terms = {name: value.item() for name, value in info["reward_terms"].items()}
            terminated = bool(done)
            unstable = bool(info["unstable"])
            diverged = bool(info["diverged"])
        if terminated:
            self._ended = obs.copy(), dict.fromkeys(terms, 0.0)
        self._show()
        info = {"unstable": unstable, "diverged": diverged, **flat(terms)}
        return obs, sum(terms.values()), terminated, False, info

    def render(self) -> np.ndarray | None:
        """Render the present state as uint8 ``[height, width, 3]``, in the mode ``rgb_array``.

        In the mode ``human`` it is shown, as after every step, and None returned. Without a mode gymnasium's
        convention is a warning and None.
        """
        if self.render_mode is None:
            gymnasium.logger.warn("render() does nothing without a render_mode: gymnasium.make(..., render_mode=...).")
            return None
        self._show()
        return self.pictures()[0] if self.render_mode == "rgb_array" else None

    def _show(self) -> None:
        """Show the present state in a window, in the mode ``human``; do nothing once the user closed the window."""
        if self.render_mode != "human" or (self._window is not None and self._window.closed):
            return
        picture = self.pictures()[0]  # refuses a size before there is a window of it
        if self._window is None:
            self._window = window.Window(self.render_size, f"{NAMESPACE} {self.vec.spec.id}")
        time.sleep(max(0.0, self._next_frame - time.perf_counter()))  # in real time
        self._window.show(picture)
        self._next_frame = time.perf_counter() + FRAME_SECONDS

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()
