"""The count of folded pairs against plain numpy."""

import numpy as np
import pytest

from warpvox.kernels import step
from warpvox.kernels.state import UNSTABLE


def folded(scene):
    """For every lane the overlapping boxes of distant voxels of the robot, both orders."""
    model, pos = scene.model, scene.read("pos")
    mine = [v for v in range(int(model.voxels)) if model.robot[v] == 0]
    corners = pos[:, model.corner[mine]]  # [lanes, voxels, 4, 2]
    low, high = corners.min(2), corners.max(2)
    apart = np.abs(model.grid[mine][:, None] - model.grid[mine][None]).max(-1) > 1
    meets = ((low[:, :, None] <= high[:, None]) & (low[:, None] <= high[:, :, None])).all(-1)
    return (meets & apart).sum((1, 2))


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_as_many_pairs_fold_as_boxes_overlap(scenes, dtype):
    scene = scenes(dtype)
    verdicts = []
    for seed, squeeze in enumerate((0.95, 0.7, 0.5, 0.4)):
        scene.scatter(seed, squeeze=squeeze, noise=0.03)
        state = scene.sim._state
        state.arrays["status"].zero_()
        state.arrays["folds"].zero_()
        step.launch(state, "boxes", "collect", "check")
        expected = folded(scene)
        np.testing.assert_array_equal(scene.read("folds", 1)[:, 0], expected)
        unstable = (scene.sim._state.arrays["status"].numpy()[0] & int(UNSTABLE)) != 0
        np.testing.assert_array_equal(unstable, expected > scene.model.fold_limit[0])
        verdicts += unstable.tolist()
    assert 0 < sum(verdicts) < len(verdicts)
