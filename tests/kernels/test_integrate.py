"""The Runge-Kutta step with springs, gravity, drag and the floor against plain numpy."""

import numpy as np
import pytest

from warpvox.kernels import step
from warpvox.kernels.launch import launch_stage
from warpvox.kernels.springs import goals


def acceleration(scene, pos, vel, rest, contact):
    """``[lanes, points, 2]`` (paper section A.2)."""
    law, ends = scene.law, scene.model.spring_ends[: scene.springs]
    force = contact - law.drag * vel
    force[..., 1] -= law.weight
    vector = pos[:, ends[:, 1]] - pos[:, ends[:, 0]]
    length = np.linalg.norm(vector, axis=-1)
    pull = (scene.model.spring_k[: scene.springs, 0] * (length - rest) / length)[..., None] * vector
    for s, (a, b) in enumerate(ends):
        force[:, a] += pull[:, s]
        force[:, b] -= pull[:, s]
    normal = np.where(pos[..., 1] <= 0, -law.floor_stiffness * pos[..., 1], 0.0)
    force[..., 1] += normal
    force[..., 0] -= law.floor_friction * law.friction * normal * np.tanh(vel[..., 0] * law.friction * normal)
    return force * law.inverse_mass


@pytest.mark.parametrize(
    ("drop", "speed"), [(0.0, 3.0), (0.25, 3.0), pytest.param(0.0, 60.0, id="springs change by a tenth")]
)
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_a_sub_step_is_one_of_runge_and_kutta(scenes, dtype, drop, speed):
    scene = scenes(dtype)
    rng, sim = scene.scatter(1, drop=drop, speed=speed), scene.sim
    scene.write("action", rng.uniform(0.6, 1.6, (len(scene.lanes), sim.num_actions)))
    contact = rng.normal(0, 50.0, (len(scene.lanes), scene.points, 2)).astype(dtype)
    launch_stage(goals, sim._state)
    scene.write("contact", contact)
    scene.sim._state.arrays["in_contact"].fill_(1)
    pos, vel = (scene.read(name)[:, : scene.points] for name in ("pos", "vel"))
    assert (pos[..., 1] < 0).any() == (drop > 0)
    step.launch(sim._state, "runge_kutta")
    inverse_square, density = np.moveaxis(scene.read("spring", 4)[:, : scene.springs, 2:], -1, 0)
    rest = (1 - density / scene.model.spring_k[: scene.springs, 0]) / np.sqrt(inverse_square)

    dt, path, gain = sim.physics.dt, 0.0, 0.0
    x, v = pos, vel
    for ahead, weight in ((dt / 2, 1), (dt / 2, 2), (dt, 2), (dt, 1)):
        a = acceleration(scene, x, v, rest, contact.astype(np.float64))
        path, gain = path + weight * v, gain + weight * a
        x, v = pos + ahead * v, vel + ahead * a
    free = scene.active[scene.free[scene.active]]
    expected = (vel + gain * dt / 6)[:, free]
    scene.close(scene.read("vel")[:, free], expected)
    moves = (path * dt / 6)[:, free]
    scene.close(scene.read("true_vel")[:, free], moves)
