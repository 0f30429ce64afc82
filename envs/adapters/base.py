"""Common code of the adapters: construction, spaces, rendering."""

import copy
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, TypeVar

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.spaces import Box

from warpvox.checks import check_integer
from warpvox.errors import SimulationError
from warpvox.keys import check_known
from warpvox.types import ACTION_HIGH, ACTION_LOW, FRAME_SECONDS
from warpvox.view import window

Values = TypeVar("Values")

WINDOWED = ("human", "screen")
"""Render modes that open a window."""
FPS = round(1 / FRAME_SECONDS)
"""Frames per second of a film in real time."""


class Adapter:
    """Base class of adapters: environments of :func:`warpvox.make_vec` behind another library's interface.

    Attributes:
        vec: the environments themselves, with torch tensors.
        render_size: width and height of a picture in pixels.
    """

    vec: Any
    render_size: tuple[int, int]
    _view: Any = None

    def _make(
        self, task: Any, designs: Any, num_envs: int, options: dict[str, Any], defaults: dict[str, Any], **fixed: Any
    ) -> None:
        """Create the vector environment ``vec``.

        Args:
            options: what the adapter was given besides its own arguments.
            defaults: of the adapter, unless ``sim`` is given; ``fixed``: what it does not leave to others.

        Raises:
            ConfigError: an option that there is not. And what ``make_vec`` raises.
        """
        from warpvox.batch.options import SimOptions
        from warpvox.envs.vec_env import make_vec  # brings torch, which registering must not

        options = check_known(options, type(self).__init__, make_vec, SimOptions, without=fixed)
        if options.get("sim") is None:
            options = defaults | options
        self.vec = make_vec(task, designs, num_envs, **options, **fixed)

    def pictures(self, envs: Sequence[int] | None = None) -> Sequence[np.ndarray]:
        """Render all environments, or those in ``envs``: uint8 ``[height, width, 3]`` each."""
        if self._view is None or self._view.worlds is not self.vec.sim.world_numbers:  # bodies have been exchanged
            from warpvox.view.painter import LiveView

            self._view = LiveView(self.vec.sim, self.render_size)
        return self._view.pictures(envs)


class BatchAdapter(Adapter):
    """Base class of vector adapters that also give access to single environments.

    Attributes:
        num_envs: the number of environments.
        render_mode: None or ``rgb_array``.
        single_spaces: the spaces of observations and actions of an environment.
    """

    num_envs: int
    render_mode: str | None
    single_spaces: tuple[Box, Box]

    @cached_property
    def envs(self) -> list["SubEnv"]:
        """Single-environment views of the batch, in order."""
        return [SubEnv(self, number) for number in range(self.num_envs)]

    def restart(self, mask: np.ndarray, seeds: Sequence[int] | None) -> np.ndarray:
        """Begin an episode where ``mask``, bool ``[num_envs]``, is True; return all observations."""
        raise NotImplementedError

    def _reset(self, seeds: Sequence[int] | None, mask: np.ndarray | None = None) -> Any:
        """Reset all environments, or those in ``mask``; return all observations, a tensor ``[num_envs, num_obs]``."""
        obs, _ = self.vec.reset(seeds, mask=mask)
        if seeds is not None:
            for env, seed in zip(self.envs, seeds, strict=True):
                if mask is None or mask[env.number]:
                    gymnasium.Env.reset(env, seed=int(seed))
        return obs


class OneEnv:
    """Base class with properties of one environment of a :class:`warpvox.envs.vec_env.VoxelVecEnv`.

    Attributes:
        vec: the environments that it is one of.
        number: which of them it is.
    """

    vec: Any
    number = 0

    @property
    def sim(self) -> Any:
        """The underlying :class:`warpvox.Simulation`."""
        return self.vec.sim

    @property
    def voxels(self) -> dict[str, Any]:
        """:class:`warpvox.envs.voxels.VoxelLayout` of every robot by name, with ``obs="voxel"``."""
        return self.vec.voxels

    @property
    def body(self) -> np.ndarray | dict[str, np.ndarray]:
        """Copy of the robot's body, int8 ``[rows, columns]``; several robots: ``{name: body}``."""
        return copy.deepcopy(self.vec.designs[int(self.vec.design_index[self.number])])


class SubEnv(OneEnv, gymnasium.Env[np.ndarray, np.ndarray]):
    """View of one environment in a batch, with the attributes of a single environment inside gymnasium's TimeLimit.

    It is stepped by the batch alone. ``sim``, ``vec`` and ``voxels`` are those of the batch.

    Args:
        batch: the batch.
        number: which of its environments this is.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": FPS}  # noqa: RUF012

    def __init__(self, batch: BatchAdapter, number: int) -> None:
        self.batch = batch
        self.vec = batch.vec
        self.number = number
        self.render_mode = batch.render_mode
        self.render_size = batch.render_size
        self.observation_space, self.action_space = batch.single_spaces

    @property
    def spec(self) -> EnvSpec | None:  # pyright: ignore[reportIncompatibleVariableOverride] # as gymnasium's wrappers
        """Specification of the batch with this environment's time limit; None if made without an id."""
        spec = copy.copy(getattr(self.batch, "spec", None))
        if spec is not None:
            spec.max_episode_steps = self._max_episode_steps
        return spec

    # TimeLimit has these names, which its users read and set.
    @property
    def _max_episode_steps(self) -> int:
        """Time limit of an episode in control steps."""
        return int(self.vec.episodes.limit[self.number])

    @_max_episode_steps.setter
    def _max_episode_steps(self, steps: int) -> None:
        self.vec.episodes.limit[self.number] = check_integer("_max_episode_steps", steps, 1)

    @property
    def _elapsed_steps(self) -> int:
        """Control steps since the episode began."""
        return int(self.vec.episodes.length[self.number])

    @_elapsed_steps.setter
    def _elapsed_steps(self, steps: int) -> None:
        self.vec.episodes.length[self.number] = check_integer("_elapsed_steps", steps, 0)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode in this environment only; ``options`` are not used."""
        mask = np.arange(self.batch.num_envs) == self.number
        seeds = None if seed is None else [seed] * self.batch.num_envs
        return self.batch.restart(mask, seeds)[self.number].copy(), {}

    def step(self, action: np.ndarray) -> Any:
        """Raise SimulationError: environments of a batch can only be stepped together."""
        raise SimulationError(
            f"Environment {self.number} is part of a batch: step all of them, by step(actions) of it."
        )

    def render(self) -> np.ndarray | None:
        """Render the present state as uint8 ``[height, width, 3]``; without a mode, warn and return None."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() does nothing without render_mode='rgb_array'.")
            return None
        return self.batch.pictures([self.number])[0]


def flat(terms: Mapping[str, Values]) -> dict[str, Values]:
    """Rename reward terms to flat keys of ``info``: ``reward_terms/NAME``.

    Libraries do not take nested dictionaries.
    """
    return {f"reward_terms/{name}": value for name, value in terms.items()}


def metadata_here(metadata: dict[str, Any]) -> dict[str, Any]:
    """Return an environment's metadata with only the render modes that this machine supports."""
    if window.why_no_window() is None:
        return metadata
    return metadata | {"render_modes": [mode for mode in metadata.get("render_modes", ()) if mode not in WINDOWED]}


def spaces_of(env: Any) -> tuple[Box, Box]:
    """Return the observation and action spaces of a single environment in a ``VoxelVecEnv``.

    An entry's bounds are those of the terms (:mod:`warpvox.envs.about`) that it belongs to in some design, or with
    ``grid`` in any that may be put in; what has none, such as places and velocities, may become as large as it likes.
    Both have the precision of the environment.
    """
    dtype = np.dtype(env.sim.options.dtype)
    padding = np.arange(int(env.num_obs)) >= env.layout.num_never_padded  # may be padded with 0
    low = np.where(padding, 0.0, np.inf)
    high = np.where(padding, 0.0, -np.inf)
    for term in env.spec.observations:
        at = env.layout.possible_columns[term.name]
        low[at] = np.minimum(low[at], term.about.low)
        high[at] = np.maximum(high[at], term.about.high)
    actions = Box(ACTION_LOW, ACTION_HIGH, (env.num_actions,), dtype)
    return Box(low.astype(dtype), high.astype(dtype), dtype=dtype), actions
