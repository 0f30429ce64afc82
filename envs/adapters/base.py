"""Common parts of the adapters: environments from their arguments, bounds of observations and actions, pictures."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box

from warpvox.checks import check_known
from warpvox.types import ACTION_HIGH, ACTION_LOW
from warpvox.view import window

WINDOWED = ("human", "screen")
"""Render modes that show a window."""


class Adapter:
    """Environments of :func:`warpvox.make_vec` behind another interface.

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
        """Make the environments.

        Args:
            options: what the adapter was given besides its own arguments.
            defaults: of the adapter, unless ``sim`` is given; ``fixed``: what it does not leave to others.

        Raises:
            ConfigError: an option that there is not. And what ``make_vec`` raises.
        """
        from warpvox.batch.options import SimOptions
        from warpvox.envs.vec_env import make_vec  # brings torch, which registering must not

        check_known(options, type(self).__init__, make_vec, SimOptions, without=fixed)
        if options.get("sim") is None:
            options = defaults | options
        self.vec = make_vec(task, designs, num_envs, **options, **fixed)

    def _pictures(self) -> Sequence[np.ndarray]:
        """A picture of every environment as it is now, uint8 ``[height, width, 3]`` each."""
        if self._view is None or self._view.worlds is not self.vec.sim.world_numbers:  # bodies have been exchanged
            from warpvox.view.painter import LiveView

            self._view = LiveView(self.vec.sim, self.render_size)
        return self._view.pictures()


def metadata_here(metadata: dict[str, Any]) -> dict[str, Any]:
    """Metadata of an environment with those render modes alone that work on this machine."""
    if window.why_no_window() is None:
        return metadata
    return metadata | {"render_modes": [mode for mode in metadata.get("render_modes", ()) if mode not in WINDOWED]}


def spaces_of(env: Any) -> tuple[Box, Box]:
    """The spaces of observations and actions of a single environment of a :class:`warpvox.envs.vec_env.VoxelVecEnv`.

    An entry's bounds are those of the terms (:mod:`warpvox.envs.about`) that it belongs to in some design, or with
    ``grid`` in any that may be put in; what has none, such as places and velocities, may become as large as it likes.
    Both have the precision of the environment.
    """
    dtype = np.dtype(env.sim.options.dtype)
    padding = np.arange(int(env.num_obs)) >= env.layout.always  # is 0
    low, high = np.where(padding, 0.0, np.inf), np.where(padding, 0.0, -np.inf)
    for term in env.spec.observations:
        at = env.layout.places[term.name]
        low[at], high[at] = np.minimum(low[at], term.about.low), np.maximum(high[at], term.about.high)
    actions = Box(ACTION_LOW, ACTION_HIGH, (env.num_actions,), dtype)
    return Box(low.astype(dtype), high.astype(dtype), dtype=dtype), actions
