"""Both passes of the strain limits against plain numpy, in fast arithmetic."""

import numpy as np
import pytest

from warpvox.kernels import step
from warpvox.kernels.launch import launch_stage
from warpvox.kernels.springs import goals


def limited(scene, pos):
    """Positions of one lane after all springs from one snapshot, then rigid sides one after another."""
    law, model, after = scene.sim.physics, scene.model, pos.copy()

    def correct(s, source, limit, share):
        (a, b), rest = model.spring_ends[s], model.spring_rest[s]
        vector = source[b] - source[a]
        length = np.linalg.norm(vector)
        step = share / 2 * (length - np.clip(length, rest * (1 - limit), rest * (1 + limit))) * vector / length
        after[a] += step * scene.free[a]
        after[b] -= step * scene.free[b]

    for s in range(scene.springs):
        correct(s, pos, law.strain_limit, law.strain_share)
    for s in model.rigid_spring[: int(model.rigids)]:
        correct(s, after, law.rigid_strain_limit, law.rigid_strain_share)
    return after


@pytest.mark.parametrize("noise", [0.001, 0.03])
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_strain_is_limited_as_the_plain_formula_does(scenes, dtype, noise):
    scene = scenes(dtype)
    scene.scatter(2, squeeze=1.0, noise=noise, speed=1.0)
    state = scene.sim._state
    launch_stage(goals, state)
    scene.write("contact", np.zeros((len(scene.lanes), scene.points, 2)))
    step.launch(state, "runge_kutta")
    start = scene.read("pos")[:, : scene.points]
    moves = scene.read("move")[:, : scene.points] * np.repeat(scene.free, 2).reshape(-1, 2)
    moves[:, np.setdiff1d(np.arange(scene.points), scene.active)] = 0.0
    step.launch(state, "limit")
    found = scene.read("pos")[:, : scene.points] - start
    for lane in scene.lanes:
        expected = limited(scene, start[lane] + moves[lane]) - start[lane]
        scene.close(found[lane, scene.active], expected[scene.active])
        assert np.abs(expected - moves[lane]).max() > (1e-3 if noise > 0.01 else 0)
    assert found[:, scene.active[~scene.free[scene.active]]].max() == 0.0
