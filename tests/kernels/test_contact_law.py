"""Contact and friction forces against the law written plainly (paper section A.3, docs/physics.md)."""

import numpy as np
import pytest
import torch
from stages import launch_stages
from worlds import fixed_rows, world

from warpvox.design import sample_design
from warpvox.simulation import Simulation
from warpvox.types import Physics

LANES = 8  # those of other tests, whose kernels these tests share
CONSTANTS = [{}, {"friction": 0.0}, {"contact_stiffness": 0.0}, {"contact_damping": 0.0, "contact_depth": 0.01}]


def touching(dtype: str, arithmetic: str, physics: Physics, speed: float) -> Simulation:
    """Robots pushed into two boxes and a bumpy ground, with random velocities of this size, their contacts found."""
    ground = np.full((2, 20), 5)
    ground[0, ::3] = 0
    others = {"box": (np.full((2, 2), 1), 8, 2), "other": (np.full((1, 2), 2), 3, 7)}
    made = world(20, 12, ground=(ground, 0, 0), **others, robot=(sample_design((5, 5), seed=1), 3, 2))
    options = dict(device="cpu", dtype=dtype, arithmetic=arithmetic, physics=physics, threads=1, lanes=LANES)
    sim = Simulation([made] * LANES, **options)
    state, rng = sim.state(), np.random.default_rng(4)
    shape = state["pos"].shape
    state["pos"] = state["pos"] * torch.tensor([0.96, 0.98]).repeat(shape[1] // 2) + torch.as_tensor(
        rng.normal(0.0, 0.01, shape)
    )
    state["true_vel"] = torch.as_tensor(rng.normal(0.0, speed, shape))
    sim.set_state(state)
    launch_stages(sim._state, "boxes", "collect", "contacts")
    return sim


def quads(sim: Simulation, env: int) -> list[tuple[str, np.ndarray, np.ndarray, int]]:
    """Object, places and points (-1: terrain) of the corners, and sides, clockwise, of every surface voxel."""
    pos = sim.state()["pos"][env].numpy().reshape(-1, 2)
    found = []
    for body in sim.designs[0].bodies:
        for cell, sides in body.surface.items():
            corners = body.first_point + np.array(body.corners[cell])
            found.append((body.name, pos[corners], corners, sides))
    for body in sim.designs[0].statics:
        for cell, sides in body.surface.items():
            corners = np.array(body.corners[cell])
            found.append((body.name, np.array(body.points)[corners], np.full(4, -1), sides))
    return found


def cross(a, b):
    return a[0] * b[1] - a[1] * b[0]


def inside(p, quad):
    def within(triangle):
        turns = [cross(triangle[k] - p, triangle[k - 1] - p) for k in range(3)]
        return min(turns) >= 0 or max(turns) <= 0

    return within(quad[[0, 1, 2]]) or within(quad[[0, 3, 2]])


def crossing(a, b, c, d):
    det = cross(b - a, d - c)
    if abs(det) < 1e-4:
        return False
    return 0 <= cross(c - a, d - c) / det <= 1 and 0 <= cross(c - a, b - a) / det <= 1


def forces(sim: Simulation, env: int) -> tuple[np.ndarray, int]:
    """``[points, 2]`` and the number of contacts."""
    law, voxels = sim.physics, quads(sim, env)
    speed = sim.state()["true_vel"][env].numpy().reshape(-1, 2)
    out, count = np.zeros_like(speed), 0
    for name, mine, points, _ in voxels:
        for other, theirs, ends, sides in voxels:
            for c in range(4):
                if (points[c] < 0 and ends[0] < 0) or (theirs == mine[c]).all(1).any() or not inside(mine[c], theirs):
                    continue
                depths = {}
                for e in range(4):
                    a, b = theirs[e], theirs[(e + 1) % 4]
                    edges = (mine[c], mine[(c + 1) % 4]), (mine[c], mine[c - 1])
                    if sides >> e & 1 and any(crossing(*edge, a, b) for edge in edges):
                        depths[e] = abs(cross(b - a, mine[c] - a)) / np.hypot(*(b - a))
                if not depths:
                    continue
                e = min(depths, key=depths.get)
                count += 1
                along = (theirs[(e + 1) % 4] - theirs[e]) / np.hypot(*(theirs[(e + 1) % 4] - theirs[e]))
                normal = np.array([-along[1], along[0]])
                push = law.contact_stiffness * (law.contact_depth + depths[e])
                slip = float(along @ speed[points[c]]) if points[c] >= 0 else 0.0
                grip = law.friction * push
                rub = np.tanh(slip / grip) if grip > 0 else np.sign(slip)
                force = push * normal - law.friction_multiplier * grip * rub * along
                times = 2 if name == other else 1
                for point, share in ((points[c], 1.0), (ends[e], -0.5), (ends[(e + 1) % 4], -0.5)):
                    if point >= 0:
                        damping = law.contact_damping * (normal @ speed[point]) * abs(share)
                        out[point] += times * (share * force - damping * normal)
    return out, count


def found(sim: Simulation, env: int = 0) -> np.ndarray:
    """``[points, 2]``: the forces as the kernels have them."""
    rows = sim._state.arrays["contact"].numpy()[0, :, env].reshape(-1, 2).astype(np.float64)
    return rows[sim._state.arrays["order"].numpy()[0, :, 0]]


@pytest.mark.parametrize(("changes", "speed"), [({}, 0.0), *((changes, 3.0) for changes in CONSTANTS)], ids=str)
@pytest.mark.parametrize(
    ("dtype", "arithmetic", "tolerance"),
    [
        ("float32", "fast", 1e-6),
        pytest.param("float64", "fast", 1e-12, marks=pytest.mark.slow),
        ("float64", "exact", 1e-12),
    ],
)
def test_contact_forces_follow_the_law(dtype, arithmetic: str, tolerance: float, changes: dict, speed: float) -> None:
    sim = touching(dtype, arithmetic, Physics.preset("evogym", **changes), speed)
    fixed = fixed_rows(sim)[0, ::2, None].numpy()
    for env in (0, LANES - 1):
        expected, count = forces(sim, env)
        assert count > 5
        scale = max(np.abs(expected).max(), 1.0)
        forced = np.where(fixed, 0, found(sim, env))
        np.testing.assert_allclose(forced, np.where(fixed, 0, expected), rtol=0, atol=tolerance * scale)
