"""Goals and the relaxation of lengths against plain numpy."""

import numpy as np
import pytest

from warpvox.kernels import step
from warpvox.kernels.launch import launch_stage
from warpvox.kernels.springs import goals


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_lengths_relax_toward_the_mean_of_the_actions_that_drive_them(scenes, dtype):
    scene = scenes(dtype)
    rng, sim, model = scene.scatter(0), scene.sim, scene.model
    actions = rng.uniform(0.6, 1.6, (len(scene.lanes), sim.num_actions))
    scene.write("action", actions)
    launch_stage(goals, sim._state)
    step.launch(sim._state, "runge_kutta")
    ends, packed = model.spring_ends[: scene.springs], model.spring_drive[: scene.springs, 0]
    drives = np.stack([packed & 0xFFFF, packed >> 16], axis=1) - 1
    assert {int((drive >= 0).sum()) for drive in drives} == {0, 1, 2}
    factor = [np.ones(len(actions)) if d[0] < 0 else actions[:, d[d >= 0]].mean(1) for d in drives]
    goal = np.stack(factor, 1) * model.spring_rest[: scene.springs]
    pos = scene.read("pos")
    vector = pos[:, ends[:, 1]] - pos[:, ends[:, 0]]
    length = np.linalg.norm(vector, axis=-1)
    scene.close(scene.read("goal", 1)[:, : scene.springs], goal)
    found = scene.read("spring", 4)[:, : scene.springs]
    scene.close(found[..., :2], vector)
    scene.close(found[..., 2] * length**2, np.ones_like(length))
    stretch = sim.physics.actuation_rate * (goal - length) / length
    scene.close(found[..., 3] / model.spring_k[: scene.springs, 0], -stretch)
