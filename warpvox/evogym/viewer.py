"""Pictures and a window, under the names of EvoGym's module ``evogym.viewer``, with lengths in voxels."""

import time

import numpy as np

from warpvox.checks import check_choice
from warpvox.evogym.errors import ArgumentError, ArgumentTypeError, RangeError
from warpvox.evogym.sim import EvoSim
from warpvox.evogym.simulator_cpp import Camera, Viewer
from warpvox.evogym.utils import Timer
from warpvox.types import VOXEL

__all__ = ["EvoViewer"]

_SCREEN, _IMAGE = ("screen", "human"), ("img", "rgb_array")
_LOCKS = ("lock_x", "lock_y", "lock_width", "lock_height")


class EvoViewer:
    """A camera on a simulation, at a fixed position or following objects.

    Args:
        sim_to_view: the simulation.
        target_rps: pictures per second at most; None: as many as possible.
        pos: middle of the picture.
        view_size: width and height of what is seen; stretched to the picture.
        resolution: width and height of the picture in pixels.

    Raises:
        ArgumentTypeError, RangeError: as the setters.
    """

    def __init__(
        self,
        sim_to_view: EvoSim,
        target_rps: int | None = 50,
        pos: tuple[float, float] = (12, 4),
        view_size: tuple[float, float] = (40, 20),
        resolution: tuple[int, int] = (1200, 600),
    ) -> None:
        self._viewer = Viewer(sim_to_view)
        self._tracked: list[str] = []
        self._tracking = {"padding": (5.0, 3.0), "scale": (0.2, 0.2)}
        self._locks: dict[str, float] = {}
        self._target: np.ndarray | None = None  # where the camera would be without inertia: x, y, width, height
        self._aims: list[np.ndarray] = []  # the last two places that the filter has aimed at
        self._sum = np.zeros(4)
        self._last_rendered = -1
        self.set_target_rps(target_rps)
        self.set_pos(pos)
        self.set_view_size(view_size)
        self.set_resolution(resolution)

    def look_at(self, sim: EvoSim) -> None:
        """Show another simulation in the same window and with the same camera."""
        self._viewer.sim = sim

    def set_pos(self, pos: tuple[float, float]) -> None:
        """Set the centre of the picture; ArgumentTypeError: no tuple. ArgumentError: not two numbers."""
        self.pos = _finite_pair("pos", pos)

    def set_view_size(self, view_size: tuple[float, float]) -> None:
        """Set the width and height of the visible area, 0.001 or more; errors as of :meth:`set_pos`."""
        self.view_size = _finite_pair("view_size", view_size, least=1e-3)

    def set_resolution(self, resolution: tuple[int, int]) -> None:
        """Set the width and height of the picture in pixels, 1 or more; errors as of :meth:`set_pos`."""
        self.resolution = _finite_pair("resolution", resolution, least=1)

    def set_target_rps(self, target_rps: int | None) -> None:
        """Limit the pictures per second to 2 or more (else RangeError); None: no limit."""
        if target_rps is not None and int(target_rps) < 2:
            raise RangeError(f"The lowest target rps is 2, got {target_rps}.")
        self._timer = Timer(None if target_rps is None else int(target_rps))

    def track_objects(self, *objects: str) -> None:
        """Follow objects with the camera; ``pos`` and ``view_size`` are then set before every picture."""
        self._tracked = list(objects)

    def set_tracking_settings(self, **settings: object) -> None:
        """Set how the camera follows tracked objects.

        Args:
            padding: (x, y), voxels left free around the objects.
            scale: (x, y), further room as a share of what is seen.
            lock_x, lock_y, lock_width, lock_height: a number fixes that entry of the view, False frees it again.

        Raises:
            ArgumentError, ArgumentTypeError: an unknown setting, or a value that it cannot have.
        """
        valid = (*self._tracking, *_LOCKS)
        for name, value in settings.items():
            check_choice("A tracking setting", name, valid, ArgumentError)
            if name in _LOCKS:
                if value is True or not isinstance(value, bool | int | float):
                    raise ArgumentError(f"{name} must be a number or False, got {value!r}.")
                self._locks.pop(name, None)
                if value is not False:
                    self._locks[name] = float(value)
            else:
                self._tracking[name] = _finite_pair(name, value)

    def _box(self) -> np.ndarray:
        """Return x, y, width and height of the padded and scaled box around the tracked objects."""
        sim = self._viewer.sim
        padding = self._tracking["padding"]
        scale = np.array(self._tracking["scale"])
        points = np.concatenate([sim.object_pos_at_time(sim.get_time(), name) for name in self._tracked], axis=1)
        low = points.min(axis=1) - padding
        high = points.max(axis=1) + padding
        # As released, the right and upper sides get a share of what the left and lower ones have added already.
        low = low - scale * (high - low) / 2
        high = high + scale * (high - low) / 2
        return np.concatenate([(low + high) / 2, high - low])

    def _follow(self) -> None:
        """Move the camera towards the tracked objects by one step of its smoothing filter."""
        target = self._box()
        if self._target is None:
            self.pos = tuple(target[:2].tolist())
            self.view_size = tuple(target[2:].tolist())
            self._target = target
            self._aims = [target, target]
        # Dead bands, as released: voxels of positions, a share of sizes
        moved = np.abs(self._target[:2] - target[:2])
        grown = np.abs(1 - self._target[2:] / target[2:])
        still = np.concatenate([moved < 1.0, grown < 0.3])
        target = self._target = np.where(still, self._target, target)
        # The gains of the filter and the decay of its integral, as released
        before, last = self._aims
        self._sum = (self._sum + target - last) * 0.9
        aim = np.array([*self.pos, *self.view_size])
        aim = aim + 0.04 * (target - last) + 0.08 * (last - before) + 0.005 * self._sum
        for entry, name in enumerate(_LOCKS):
            aim[entry] = self._locks.get(name, aim[entry])
        self._aims = [last, aim]
        x, y, width, height = aim.tolist()
        aspect = self.resolution[0] / self.resolution[1]
        self.pos = (x, y)
        self.view_size = (max(width, height * aspect), max(height, width / aspect))

    def render(
        self,
        mode: str = "screen",
        verbose: bool = False,
        hide_background: bool = False,
        hide_grid: bool = False,
        hide_edges: bool = False,
        hide_voxels: bool = False,
    ) -> np.ndarray | None:
        """Show a picture of the present state in the window, or return it as an array.

        Args:
            mode: ``screen`` or ``human`` show it in a window and return None; ``img`` or ``rgb_array`` return it, uint8
                ``[height, width, 3]``.
            verbose: print once a second how many pictures a second are made.
            hide_background, hide_grid, hide_edges, hide_voxels: leave out the colour of the sky, the grid, the outlines
                of objects, the cells.

        Raises:
            ArgumentError: unknown mode. DisplayError: there is no display for a window.
        """
        check_choice("mode", mode, (*_SCREEN, *_IMAGE), ArgumentError)
        if mode in _SCREEN and not self._viewer.shown:
            self.show_debug_window()
        self._catch_up()
        camera = Camera(mode in _IMAGE)
        width, height = self.resolution
        camera.set_pos(*(VOXEL * value for value in self.pos))
        camera.set_size(*(VOXEL * value for value in self.view_size))
        camera.set_resolution(width, height)
        self._viewer.render(camera, hide_background, hide_grid, hide_edges, hide_voxels)
        picture = None
        if mode in _IMAGE:
            picture = np.frombuffer(camera.get_image(), np.uint8).reshape(int(height), int(width), 3).copy()
        self._timer.step(verbose=verbose)
        while not self._timer.should_step():
            time.sleep(0.001)
        return picture

    def _catch_up(self) -> None:
        """Move the camera once for each simulated step since the last picture."""
        now = self._viewer.sim.get_time()
        if now < self._last_rendered:
            # After time has gone back the camera makes 50 steps in one go.
            self._last_rendered = now - 50
        for _ in range(now - self._last_rendered if self._tracked else 0):
            self._follow()
        self._last_rendered = now

    def show_debug_window(self) -> None:
        """Show the window; DisplayError if the machine has no display."""
        self._viewer.show_debug_window()

    def hide_debug_window(self) -> None:
        """Hide the window."""
        self._viewer.hide_debug_window()

    def close(self) -> None:
        """Close the window, if it is open."""
        self._viewer.close()


def _finite_pair(name: str, value: object, least: float = -np.inf) -> tuple:
    """Return ``value`` if it is a tuple of two finite numbers of at least ``least``, else raise an ArgumentError."""
    if not isinstance(value, tuple) or len(value) != 2:
        raise ArgumentTypeError(f"{name} must be a tuple of two numbers, got {value!r} of type {type(value).__name__}.")
    if not all(isinstance(each, int | float | np.number) and abs(each) < np.inf and each >= least for each in value):
        limit = f" >= {least:g}" if least > -np.inf else ""
        raise ArgumentError(f"{name} must hold two finite numbers{limit}, got {value!r:.80}.")
    return value
