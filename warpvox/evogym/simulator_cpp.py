"""EvoGym's low-level module ``evogym.simulator_cpp``: ``Sim``, ``Camera`` and ``Viewer``.

Lengths are in simulator units here (0.1 a voxel); :class:`warpvox.evogym.EvoSim` speaks of voxels.
"""

from __future__ import annotations

import errno
from typing import TYPE_CHECKING

import numpy as np

from warpvox.errors import DisplayError, SimulationError, WorldError
from warpvox.evogym.errors import ArgumentError
from warpvox.evogym.picture import paint
from warpvox.io.reading import Missing, Unreadable, read_text
from warpvox.view.window import OTHERWISE, Window, why_no_window
from warpvox.world import LARGEST_FILE, World, WorldObject

if TYPE_CHECKING:
    from warpvox.evogym.engine import Engine

__all__ = ["Camera", "Sim", "Viewer"]


class Sim:
    """A simulation: add objects first, then step.

    The order of objects does not depend on the order of reading: robots first, then the others, each by name.

    Attributes:
        history: how many of the last control steps are kept, besides time 0; None keeps all since the reset, as the
            release does. May be set for a simulation, or for the class.
    """

    history: int | None = None

    def __init__(self) -> None:
        self._plan = World()
        self._running: Engine | None = None

    @property
    def _engine(self) -> Engine:
        """The running simulation; objects cannot be added after its first use."""
        if self._running is None:
            import warp  # and torch, which worlds alone do not need

            from warpvox.evogym.engine import Engine

            if warp.config.log_level == warp.LOG_INFO:  # unless the script has chosen what Warp reports
                warp.config.log_level = warp.LOG_WARNING
            self._running = Engine(self._plan)
        return self._running

    def init(self, x: int, y: int) -> None:
        """Start with an empty grid of ``x`` by ``y`` cells."""
        self._plan = World(int(x), int(y))
        self._running = None

    def get_version(self) -> None:
        """Print the version of the simulator."""
        print("warpvox, with the physics of Evolution Gym Simulator v2.2.5")

    def read_object_from_array(
        self, grid: np.ndarray, connections: np.ndarray, object_name: str, x: float, y: float
    ) -> bool:
        """Add an object from cells ``[rows, columns]``, row 0 on top, and index pairs ``[2, k]``; return True.

        ``x``, ``y``: cell of its lower left corner.

        Raises:
            WorldError: it is not valid or overlaps another object. SimulationError: the simulation has begun.
        """
        obj = WorldObject.from_array(object_name, grid, int(x), int(y), connections)
        if self._running is not None:
            raise SimulationError(f"'{obj.name}' cannot be added: the simulation has begun. Add objects before.")
        self._plan.add_object(obj)
        return True

    def read_robot_from_array(
        self, grid: np.ndarray, connections: np.ndarray, robot_name: str, x: float, y: float
    ) -> bool:
        """Add a robot; arguments as in :meth:`read_object_from_array`."""
        return self.read_object_from_array(grid, connections, robot_name, x, y)

    def read_object_from_file(self, file_name: str, object_name: str, x: float, y: float) -> bool:
        """Add an object from a file of integers: columns, rows, cells from the top row on, index pairs."""
        try:
            words = read_text(file_name, LARGEST_FILE).split()
        except Missing:
            raise FileNotFoundError(errno.ENOENT, "There is no file", str(file_name)) from None
        except Unreadable as error:
            raise WorldError(f"The file '{file_name}' cannot be read: {error}.") from None
        try:
            columns, rows, *rest = (int(word) for word in words)
            if min(columns, rows) < 1 or len(rest) < rows * columns:
                raise ValueError
            grid = np.array(rest[: rows * columns]).reshape(rows, columns)
            pairs = np.array(rest[rows * columns :], int).reshape(-1, 2).T
        except (ValueError, OverflowError):
            raise WorldError(
                f"The file '{file_name}' must hold columns, rows, as many cells, and pairs of indices of cells."
            ) from None
        return self.read_object_from_array(grid, pairs, object_name, x, y)

    def read_robot_from_file(self, file_name: str, robot_name: str, x: float, y: float) -> bool:
        """Add a robot from a file; arguments as in :meth:`read_object_from_file`."""
        return self.read_object_from_file(file_name, robot_name, x, y)

    def step(self) -> bool:
        """Do a control step of 30 sub-steps; return True if a robot folded into itself and the step was undone.

        ArgumentError: :attr:`history` is neither None nor an integer from 1 on.
        """
        return self._engine.step(self.history)

    def set_action(self, robot_name: str, action: np.ndarray) -> None:
        """Set the targets of a robot's actuators; they hold until set again.

        ``action``: ``[k, 2]``, the flat index of an actuator's cell and the target length of its sides in units of
        their rest length (1.0 before anything is set). Not clipped. ArgumentError: no such robot, or no actuator there.
        """
        action = np.asarray(action, float).reshape(-1, 2)
        known = self._engine.actuators(robot_name)
        wrong = np.setdiff1d(action[:, 0], known)
        if len(wrong):
            raise ArgumentError(f"'{robot_name}' has no actuator at index {wrong[0]:g}; they are at {known.tolist()}.")
        self._engine.goals[robot_name][np.searchsorted(known, action[:, 0])] = action[:, 1]

    def revert(self, sim_time: int) -> None:
        """Restore the state at a recorded time; targets stay, later records are dropped. ArgumentError: no record."""
        self._engine.revert(sim_time)

    def translate_object(self, x: float, y: float, object_name: str) -> None:
        """Shift an object by (x, y) without checking for overlaps; ArgumentError: no such object."""
        self._engine.translate(object_name, x, y)

    def get_time(self) -> int:
        """Return the number of completed control steps."""
        return self._engine.time

    def pos_at_time(self, sim_time: int) -> np.ndarray:
        """Return the positions of all points ``[2, points]``, object by object.

        ArgumentError: the time is not recorded. ArgumentTypeError: it is not an integer.
        """
        return _rows(self._engine.positions(sim_time))

    def vel_at_time(self, sim_time: int) -> np.ndarray:
        """Return the velocities of all points ``[2, points]``, in simulator units per inner time (30 x 1e-4 a step)."""
        return _rows(self._engine.velocities(sim_time))

    def object_pos_at_time(self, sim_time: int, object_name: str) -> np.ndarray:
        """Return the positions of an object's points ``[2, points]``; ArgumentError: no such object or time."""
        return _rows(self._engine.positions(sim_time, object_name))

    def object_vel_at_time(self, sim_time: int, object_name: str) -> np.ndarray:
        """Return the velocities of an object's points, ``[2, points]``."""
        return _rows(self._engine.velocities(sim_time, object_name))

    def object_orientation_at_time(self, time: int, object_name: str) -> float:
        """Return the rotation of an object since time 0, counter-clockwise, radians in [0, 2 pi]."""
        return self._engine.orientation(time, object_name)

    def get_indices_of_actuators(self, robot_name: str) -> np.ndarray:
        """Return the flat indices of a robot's actuators, row by row from the top: int32 ``[1, actuators]``."""
        return self._engine.actuators(robot_name)[None]


def _rows(points: np.ndarray) -> np.ndarray:
    """Transpose ``[n, 2]`` to ``[2, n]`` in a copy with the release's memory layout, point by point."""
    return points.T.copy(order="F")


class Camera:
    """A camera: position, size and resolution of a picture, and the last image."""

    def __init__(self, is_renderable: bool) -> None:
        self.is_renderable = is_renderable
        self.set_pos(0.0, 0.0)
        self.set_size(1.0, 1.0)
        self.set_resolution(320, 320)
        self._image = np.zeros(0, np.uint8)

    def set_pos(self, x: float, y: float) -> None:
        """Set the centre of the picture, in simulator units."""
        self.pos = (float(x), float(y))

    def set_size(self, x: float, y: float) -> None:
        """Set the width and height of the visible area, in simulator units."""
        self.size = (float(x), float(y))

    def set_resolution(self, x: float, y: float) -> None:
        """Set the width and height of the picture in pixels."""
        self.resolution = (int(x), int(y))

    def get_resolution_width(self) -> int:
        """Return the width of the picture in pixels."""
        return self.resolution[0]

    def get_resolution_height(self) -> int:
        """Return the height of the picture in pixels."""
        return self.resolution[1]

    def get_image(self) -> memoryview:
        """Return the last picture as bytes: rows from the top, red, green and blue."""
        return self._image.reshape(-1).data


class Viewer:
    """Paints the simulation ``sim`` for cameras or in a window; ``sim`` may be replaced."""

    def __init__(self, sim: Sim) -> None:
        self.sim = sim
        self.shown = False
        self._window = None

    def init(self) -> None:
        """Do nothing; exists for scripts that call it."""

    def render(
        self,
        camera: Camera,
        hide_background: bool = False,
        hide_grid: bool = False,
        hide_edges: bool = False,
        hide_boxels: bool = False,
        dont_clear: bool = False,
    ) -> None:
        """Paint a camera's view: into the camera's image if renderable, else into the window if visible.

        Raises:
            ArgumentError: ``dont_clear``, which is not available.
        """
        if dont_clear:
            raise ArgumentError("dont_clear=True is not available: every picture is painted anew.")
        if not camera.is_renderable and self.shown and self._window is None:
            self._window = Window(camera.resolution, "warpvox")
        if camera.is_renderable or (self.shown and self._window is not None and self._window.visible):
            hidden = (hide_background, hide_grid, hide_edges, hide_boxels)
            picture = paint(self.sim._engine, camera.pos, camera.size, camera.resolution, *hidden)
            if camera.is_renderable or self._window is None:
                camera._image = picture
            else:
                self._window.show(picture)

    def show_debug_window(self) -> None:
        """Open a window for the next picture; DisplayError: this machine cannot show one."""
        reason = why_no_window()
        if reason is not None:
            raise DisplayError(f"The modes 'screen' and 'human' show a window, but {reason}. {OTHERWISE}")
        self.shown = True
        if self._window is not None:
            self._window.unhide()

    def hide_debug_window(self) -> None:
        """Hide the window."""
        self.shown = False
        if self._window is not None:
            self._window.hide()

    def close(self) -> None:
        """Close the window, if it is open."""
        self.shown = False
        if self._window is not None:
            self._window.close()
            self._window = None

    def get_debug_window_pos(self) -> list[int]:
        """Return the position (x, y) of the window on the screen; [0, 0] without a window."""
        return [0, 0] if self._window is None else list(self._window.place)
