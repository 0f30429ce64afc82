"""The constants of the physics mean what they say: each is changed and its effect is known exactly."""

import dataclasses

import numpy as np
import pytest
import torch
from stages import launch_stage, launch_stages
from worlds import fixed_rows, ground, world

from warpvox.design import sample_design
from warpvox.errors import ConfigError
from warpvox.kernels.springs import goals
from warpvox.simulation import STATE_FIELDS, Simulation
from warpvox.types import Physics

BOTH = pytest.mark.parametrize("dtype", ["float32", "float64"])
DEFAULT = Physics()
FORCES = (
    "drag", "contact_stiffness", "contact_damping", "floor_stiffness", "rigid_main", "rigid_structural", "soft_main",
    "soft_structural", "actuator_main", "actuator_structural",
)  # fmt: skip
BODY = sample_design((5, 5), seed=3)


def scaled(**factors: float) -> Physics:
    return dataclasses.replace(DEFAULT, **{name: getattr(DEFAULT, name) * factor for name, factor in factors.items()})


def scene(physics: Physics, dtype: str, body: np.ndarray = BODY, count: int = 1, **options: str) -> Simulation:
    """A robot and a box over ground that ends, so that both meet terrain, each other and the floor at y = 0."""
    made = world(20, 12, ground=ground(9), box=(np.full((2, 2), 1), 8, 1), robot=(body, 2, 1))
    return Simulation([made] * count, device="cpu", dtype=dtype, physics=physics, threads=1, lanes=8, **options)


def walk(sim: Simulation, steps: int = 25, times: int = 1) -> dict[str, torch.Tensor]:
    draw = torch.Generator().manual_seed(0)
    for _ in range(steps):
        actions = 0.6 + torch.rand((1, sim.num_actions), generator=draw)
        for _ in range(times):
            sim.step(actions)
    assert not sim.unstable.any()
    return sim.state()


@BOTH
def test_a_body_of_twice_the_mass_under_twice_the_forces_moves_as_before(dtype: str) -> None:
    # A power of two scales without rounding. Friction keeps its limits: they are products of coefficient and force.
    factor = 4.0
    heavy = scaled(
        **dict.fromkeys(FORCES, factor), point_mass=factor, friction=1 / factor, friction_multiplier=factor,
        floor_friction=factor,
    )  # fmt: skip
    expected, found = walk(scene(DEFAULT, dtype)), walk(scene(heavy, dtype))
    for name in STATE_FIELDS:
        assert torch.equal(expected[name], found[name]), name
    light = walk(scene(scaled(point_mass=factor), dtype))
    assert not torch.equal(expected["pos"], light["pos"])


@BOTH
def test_half_the_time_step_under_four_times_the_forces_goes_the_same_way_at_twice_the_speed(dtype: str) -> None:
    factors = dict.fromkeys(FORCES, 4.0) | {"drag": 2.0, "contact_damping": 2.0}  # these two are per velocity
    fast = scaled(**factors, gravity=4.0, dt=0.5, friction=0.5, friction_multiplier=2.0)
    # The floor at y = 0 weighs speed against force in another way: without it.
    slow, fast = (dataclasses.replace(physics, floor_friction=0.0) for physics in (DEFAULT, fast))
    expected, found = walk(scene(slow, dtype)), walk(scene(fast, dtype))
    assert torch.equal(expected["pos"], found["pos"])
    assert torch.equal(2 * expected["vel"], found["vel"])
    torch.testing.assert_close(2 * expected["true_vel"], found["true_vel"], rtol=1e-14, atol=0)


@BOTH
def test_two_control_steps_of_half_the_sub_steps_make_one(dtype: str) -> None:
    halves = scene(dataclasses.replace(DEFAULT, substeps=15), dtype)
    expected, found = walk(scene(DEFAULT, dtype)), walk(halves, times=2)
    assert int(halves.time) == 50
    for name in ("pos", "vel", "true_vel"):
        assert torch.equal(expected[name], found[name]), name


@pytest.mark.parametrize(("dtype", "arithmetic"), [("float32", "fast"), ("float64", "fast"), ("float64", "exact")])
def test_the_floor_pushes_and_rubs_as_the_plain_formula_does(dtype: str, arithmetic: str) -> None:
    depth, speed = 1e-6 * torch.linspace(-1, 2.5, 8).double(), torch.linspace(0.4, -0.3, 8).double()
    dt, tolerance = 1e-7, 1e-4  # in a sub-step as short as this, depth and speed change by less

    def after(**changes: float) -> torch.Tensor:
        """``[lanes, points, 2]``: velocities after a sub-step from these depths and speeds."""
        law = dataclasses.replace(DEFAULT, substeps=1, dt=dt, **changes)
        options = dict(device="cpu", dtype=dtype, arithmetic=arithmetic, physics=law, threads=1, lanes=8)
        sim = Simulation([world(5, 5, robot=([[3]], 2, 0))] * 8, **options)
        state = sim.state()
        state["pos"][:, 1::2] -= depth[:, None]
        state["vel"][:, ::2] = speed[:, None]
        sim.set_state(state)
        sim.step(torch.ones((8, 1)))
        return sim.state()["vel"].view(8, 4, 2)

    gained = ((after() - after(floor_stiffness=0.0)) / dt).sum(1)  # of the two lower points alike
    normal = DEFAULT.floor_stiffness * depth.clamp(min=0.0)
    most = DEFAULT.friction * normal
    expected = torch.stack([-DEFAULT.floor_friction * most * torch.tanh(speed * most), normal], dim=1)
    torch.testing.assert_close(gained / 2, expected, rtol=tolerance, atol=tolerance)


def limited(sim: Simulation, pos: np.ndarray) -> np.ndarray:
    """Positions after strain limiting, written plainly (paper section A.4)."""
    law, arrays = sim.physics, {name: sim._state.arrays[name].numpy()[0] for name in ("spring_rest", "free_lanes")}
    ends, rigid = sim._state.arrays["spring_ends"].numpy()[0], sim._state.arrays["rigid_spring"].numpy()[0]

    def excess(pos, s, limit):
        (a, b), rest = ends[s], arrays["spring_rest"][s]
        vector = pos[b] - pos[a]
        length = np.hypot(*vector)
        return vector / length * (length - np.clip(length, rest * (1 - limit), rest * (1 + limit)))

    def move(out, s, step):
        for point, way in zip(ends[s], (1, -1), strict=True):
            if arrays["free_lanes"][point]:
                out[point] += way * step

    after = pos.copy()
    for s in range(int(sim._state.arrays["springs"].numpy()[0])):
        move(after, s, law.strain_share * excess(pos, s, law.strain_limit) / 2)
    for s in rigid[: int(sim._state.arrays["rigids"].numpy()[0])]:
        move(after, s, law.rigid_strain_share * excess(after, s, law.rigid_strain_limit) / 2)
    return after


@pytest.mark.parametrize(
    "limits", [{}, dict(strain_limit=0.1, strain_share=0.3, rigid_strain_limit=0.2, rigid_strain_share=1.0),
               dict(strain_share=0.0, rigid_strain_share=0.0)]
)  # fmt: skip
@pytest.mark.parametrize(
    ("dtype", "arithmetic", "tolerance"),
    [
        ("float32", "fast", 1e-7),
        pytest.param("float64", "fast", 1e-14, marks=pytest.mark.slow),
        ("float64", "exact", 1e-14),
    ],
)
def test_strain_is_limited_as_the_plain_formula_does(dtype, arithmetic: str, tolerance: float, limits: dict) -> None:
    body = np.array([[5, 1, 3], [1, 1, 4], [2, 2, 3]])
    sim = scene(dataclasses.replace(DEFAULT, **limits), dtype, body, 8, arithmetic=arithmetic)
    rng, state = np.random.default_rng(0), sim.state()
    moving = ~fixed_rows(sim)
    for lane in (0, 3, 7):
        noise = torch.as_tensor(rng.normal(0, 0.02, state["pos"].shape))
        sim.set_state(state | {"pos": state["pos"] + noise * moving})
        launch_stage(goals, sim._state)
        launch_stages(sim._state, "runge_kutta")
        begun = displaced(sim, lane)
        launch_stages(sim._state, "limit")
        assert np.isfinite(begun).all()
        found = sim._state.arrays["pos"].numpy()[0, :, lane].reshape(-1, 2)
        np.testing.assert_allclose(found, limited(sim, begun), rtol=0, atol=tolerance)
        assert (np.abs(found - begun).max() > 1e-4) == (sim.physics.strain_share > 0)


def displaced(sim: Simulation, lane: int) -> np.ndarray:
    """``[points, 2]``: the positions on which the strain limits work, before the points are moved."""
    arrays = {name: array.numpy()[0] for name, array in sim._state.arrays.items()}
    pos, active = arrays["pos"][:, lane].copy(), arrays["active"][: 2 * sim._state.arrays["actives"].numpy()[0]]
    disp = arrays["disp"][active, lane].astype(np.float64)
    pos[active] = disp + (pos[active] if sim.arithmetic == "fast" else 0.0)
    return pos.reshape(-1, 2)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("dt", 0.0), ("dt", 1.0), ("substeps", 0), ("substeps", 2.0),
        ("substeps", 10**6), ("point_mass", 0.0), ("point_mass", float("inf")),
        ("strain_limit", 1.0), ("rigid_strain_limit", -0.1),
        ("gravity", -1.0), ("friction", float("nan")), ("shared_edge", "first"), ("drag", "0.1"), ("drag", 10**400),
    ],
)  # fmt: skip
def test_a_constant_out_of_its_range_is_refused(name: str, value: object) -> None:
    with pytest.raises(ConfigError):
        Physics.preset("evogym", **{name: value})
