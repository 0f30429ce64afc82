"""Pictures of a simulation as it stands, without a recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from warpvox.errors import RolloutError
from warpvox.view.painter import Canvas, camera_path, fitting_scale
from warpvox.view.rollout import scenes_of


class LiveView:
    """Looks at environments of a simulation; each picture depends on the present state alone.

    Args:
        sim: a :class:`warpvox.Simulation`.
        size: width and height of a picture in pixels.
        voxels: voxels from the bottom to the top of a picture; None fits the robot as it begins.

    Raises:
        RolloutError: a size of less than 16 pixels.
    """

    def __init__(self, sim: Any, size: tuple[int, int] = (640, 360), voxels: float | None = None) -> None:
        self.size = (int(size[0]), int(size[1]))
        if min(self.size) < 16:
            raise RolloutError(f"A picture must be at least 16 pixels wide and high, got {size}.")
        scenes, self._positions = scenes_of(sim)
        self._design = sim.design_index.tolist()
        self._canvases = [Canvas(scene, self.size, fitting_scale(scene, self.size, voxels)) for scene in scenes]

    def pictures(self, envs: Sequence[int] | None = None) -> list[np.ndarray]:
        """A picture of each environment (None: all), uint8 ``[height, width, 3]``."""
        positions, pictures = self._positions().cpu().numpy(), []
        for env in envs or range(len(self._design)):
            canvas, points = self._canvases[self._design[env]], positions[env]
            view = (self.size[0] / canvas.scale, self.size[1] / canvas.scale)
            corner = np.rint(camera_path(canvas.scene, points[None], view)[0] * canvas.scale).astype(int)
            pictures.append(np.array(canvas.picture(points, corner)))
        return pictures
