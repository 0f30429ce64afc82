"""Base classes of environments, under the names of EvoGym's module ``evogym.envs.base``."""

from __future__ import annotations

import functools
import math
import os
import random
import warnings
from collections.abc import Callable
from typing import Any, Dict, List, Optional, Tuple  # noqa: UP035  # scripts take these from here

import gymnasium as gym
import numpy as np
from gymnasium import error, spaces
from gymnasium.utils import seeding

from warpvox.checks import check_choice, is_mapping
from warpvox.envs.adapters.base import WINDOWED, metadata_here
from warpvox.errors import did_you_mean, listing
from warpvox.evogym import sim, simulator_cpp, utils, viewer, world
from warpvox.evogym.envs.files import world_files
from warpvox.evogym.errors import ArgumentTypeError
from warpvox.evogym.sim import EvoSim
from warpvox.evogym.utils import *  # noqa: F403
from warpvox.evogym.viewer import EvoViewer
from warpvox.evogym.world import EvoWorld, WorldObject
from warpvox.types import ACTION_HIGH, ACTION_LOW, VOXEL

# As in the release, `from evogym.envs import *` also gives what the modules import.
__all__ = ["Any", "BenchmarkBase", "Dict", "EvoGymBase", "EvoSim", "EvoViewer", "EvoWorld", "List", "Optional", "Tuple"]
__all__ += ["WorldObject", "error", "gym", "math", "np", "os", "random", "seeding", "sim", "simulator_cpp", "spaces"]
__all__ += ["utils", "viewer", "world"]
__all__ += utils.__all__


def _delegated(method: Callable) -> Callable:
    """Decorate a method so that it calls the simulation's method of the same name."""

    @functools.wraps(method)
    def call(self: EvoGymBase, *args: Any, **options: Any) -> Any:
        return getattr(self._sim, method.__name__)(*args, **options)

    return call


def _in_simulator_units(method: Callable) -> Callable:
    """Decorate a method so that its result is in simulator units (0.1 a voxel) instead of voxels."""

    @functools.wraps(method)
    def scaled(self: EvoGymBase, *args: Any, **options: Any) -> np.ndarray | None:
        found = method(self, *args, **options)
        return None if found is None else found * VOXEL

    return scaled


class EvoGymBase(gym.Env):
    """Base class of environments: a simulation, a viewer, and helpers for observations, with lengths in voxels.

    ``metadata`` of the class names all render modes, that of an instance those which work on this machine.

    A subclass makes a world, calls this constructor, sets ``action_space`` and ``observation_space``, and has
    ``step`` and ``reset`` that call those of this class.

    Args:
        render_mode: ``human`` or ``screen`` show every step in a window; with ``rgb_array`` or ``img``
            :meth:`render` returns a picture; None: nothing is rendered.
        render_options: ``verbose``, ``hide_background``, ``hide_grid``, ``hide_edges``, ``hide_voxels``, all False by
            default; see :meth:`EvoViewer.render`. Others have no effect, as released, but a warning.

    Raises:
        ConfigError: an unknown mode. DisplayError: a window where there is no display.
    """

    metadata: dict[str, Any] = {"render_modes": ["screen", "human", "img", "rgb_array"], "render_fps": 50}  # noqa: RUF012

    def __init__(
        self, world: EvoWorld, render_mode: str | None = None, render_options: dict[str, Any] | None = None
    ) -> None:
        check_choice("render_mode", render_mode, [None, *EvoGymBase.metadata["render_modes"]])
        self._sim = EvoSim(world)
        self._default_viewer = EvoViewer(self._sim)
        self.render_mode = self._render_mode = render_mode
        self._render_options = {}
        for name, value in (render_options or {}).items():
            known = ("verbose", "hide_background", "hide_grid", "hide_edges", "hide_voxels")
            if name in known:
                self._render_options[name] = value
            else:
                hint = did_you_mean(name, known)
                text = f"There is no render option {name!r}; there are {listing(known)}.{hint}"
                warnings.warn(text, stacklevel=2)
        if render_mode in WINDOWED:
            self._default_viewer.show_debug_window()  # fails now rather than in the first step
        self.metadata = metadata_here(self.metadata)

    def step(self, action: Any) -> Any:
        """Do a control step; return True if the robot folded into itself and the step was undone.

        Args:
            action: target lengths ``[actuators]`` by the name of the robot, clipped to [0.6, 1.6]. A robot that is not
                named keeps its targets.

        Raises:
            ArgumentError (a ValueError): no such robot, or another number of values. ArgumentTypeError: no numbers.
        """
        if not is_mapping(action):
            raise ArgumentTypeError(f"An action must be arrays by the name of the robot, got {action!r:.80}.")
        for name, goals in action.items():
            try:
                clipped = np.minimum(np.maximum(goals, ACTION_LOW), ACTION_HIGH)  # faster than clip
            except TypeError:
                raise ArgumentTypeError(f"The action of '{name}' must be numbers, got {goals!r:.80}.") from None
            self._sim.set_action(name, clipped)
        stopped = self._sim.step()
        if self._render_mode in WINDOWED:
            self.render()
        return stopped

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        """Reset the simulation to time 0; ``seed`` seeds :attr:`np_random`, and ``options`` are not used."""
        gym.Env.reset(self, seed=seed)
        self._sim.reset()

    @property
    def sim(self) -> EvoSim:
        """The simulation."""
        return self._sim

    @property
    def default_viewer(self) -> EvoViewer:
        """The viewer that :meth:`render` uses."""
        return self._default_viewer

    def render(self) -> np.ndarray | None:
        """Render the present state as uint8 ``[height, width, 3]``; returns None without a mode or in a window."""
        if self._render_mode is None:
            return None
        return self.default_viewer.render(self._render_mode, **self._render_options)

    def close(self) -> None:
        """Close the window, if it is open."""
        self.default_viewer.close()

    get_actuator_indices = _delegated(EvoSim.get_actuator_indices)
    get_dim_action_space = _delegated(EvoSim.get_dim_action_space)
    get_time = _delegated(EvoSim.get_time)
    pos_at_time = _delegated(EvoSim.pos_at_time)
    vel_at_time = _delegated(EvoSim.vel_at_time)
    object_pos_at_time = _delegated(EvoSim.object_pos_at_time)
    object_vel_at_time = _delegated(EvoSim.object_vel_at_time)
    object_orientation_at_time = _delegated(EvoSim.object_orientation_at_time)

    def _points_of(self, name: str) -> np.ndarray:
        """Return an object's points in voxels, ``[2, points]``, even in subclasses with other units."""
        return self._sim.object_pos_at_time(self._sim.get_time(), name)

    def get_pos_com_obs(self, object_name: str) -> np.ndarray:
        """Return an object's centre of mass, ``[2]``."""
        return self._points_of(object_name).mean(axis=1)

    def get_vel_com_obs(self, object_name: str) -> np.ndarray:
        """Return the velocity of an object's centre of mass, ``[2]``."""
        return self._sim.object_vel_at_time(self._sim.get_time(), object_name).mean(axis=1)

    def get_relative_pos_obs(self, object_name: str) -> np.ndarray:
        """Return an object's points relative to its centre of mass, all x before all y: ``[2 points]``."""
        points = self._points_of(object_name)
        return (points - points.mean(axis=1, keepdims=True)).flatten()

    def get_ort_obs(self, object_name: str) -> np.ndarray:
        """Return the orientation of an object, ``[1]``."""
        return np.array([self.object_orientation_at_time(self.get_time(), object_name)])

    def get_floor_obs(
        self, object_name: str, terrain_list: list[str], sight_dist: int, sight_range: float = 5
    ) -> np.ndarray | Any:
        """Return the depth of the terrain below an object's centre of mass, ``[2 sight_dist + 1]``.

        Without terrain None, as in the release.

        Args:
            terrain_list: names of the objects that are terrain.
            sight_dist: windows to the left and to the right; each is a voxel wide, one lies about the centre of mass.
            sight_range: how far down is seen, where there is no point of the terrain.
        """
        return self._scan(object_name, terrain_list, sight_dist, sight_range, -1)

    def get_ceil_obs(
        self, object_name: str, terrain_list: list[str], sight_dist: int, sight_range: float = 5
    ) -> np.ndarray | Any:
        """Return the height of the terrain above an object's centre of mass, ``[2 sight_dist + 1]``."""
        return self._scan(object_name, terrain_list, sight_dist, sight_range, 1)

    def _scan(self, name: str, terrain: list[str], reach: int, sight: float, up: int) -> np.ndarray | Any:
        """Return the distance to the terrain above (``up`` 1) or below (-1) in each window; None without terrain."""
        if len(terrain) == 0:
            return None
        x, y = self._points_of(name).mean(axis=1)
        points = np.concatenate([self._points_of(each) for each in terrain], axis=1)
        left, right = (x + (np.arange(-reach, reach + 1) + half) for half in (-0.5, 0.5))
        beyond = points[1] > y if up > 0 else points[1] < y
        points = points[:, beyond & (points[0] > left[0]) & (points[0] < right[-1])]
        inside = (points[0] > left[:, None]) & (points[0] < right[:, None])
        distance = np.where(inside, up * (points[1] - y), sight).min(axis=1, initial=sight)
        return np.clip(distance, 0, sight)


class _WorldFiles:
    """A class attribute that is the folder of the world files; they are written on first access."""

    def __get__(self, instance: object, owner: type) -> str:
        return world_files()


class BenchmarkBase(EvoGymBase):
    """Base class of the benchmark's environments: :class:`EvoGymBase` with lengths in simulator units (0.1 a voxel).

    The viewer follows the object ``robot``.

    Attributes:
        DATA_PATH: a folder that holds the worlds of the benchmark as files, for instance ``Walker-v0.json``; a copy
            for this process.
        VOXEL_SIZE: 0.1.
    """

    DATA_PATH = _WorldFiles()
    VOXEL_SIZE = VOXEL

    def __init__(
        self, world: EvoWorld, render_mode: str | None = None, render_options: dict[str, Any] | None = None
    ) -> None:
        EvoGymBase.__init__(self, world=world, render_mode=render_mode, render_options=render_options)
        self.default_viewer.track_objects("robot")

    pos_at_time = _in_simulator_units(EvoGymBase.pos_at_time)
    vel_at_time = _in_simulator_units(EvoGymBase.vel_at_time)
    object_pos_at_time = _in_simulator_units(EvoGymBase.object_pos_at_time)
    object_vel_at_time = _in_simulator_units(EvoGymBase.object_vel_at_time)
    get_pos_com_obs = _in_simulator_units(EvoGymBase.get_pos_com_obs)
    get_vel_com_obs = _in_simulator_units(EvoGymBase.get_vel_com_obs)
    get_relative_pos_obs = _in_simulator_units(EvoGymBase.get_relative_pos_obs)
    get_floor_obs = _in_simulator_units(EvoGymBase.get_floor_obs)  # sight_range stays in voxels, as released
    get_ceil_obs = _in_simulator_units(EvoGymBase.get_ceil_obs)
