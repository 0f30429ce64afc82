"""Gradients of control steps: against finite differences, the law of smoothed contact, and what they leave alone."""

import functools
import itertools

import numpy as np
import pytest
import torch
from worlds import fixed_rows, ground, world

from warpvox.design import sample_design
from warpvox.errors import ActionError, SimulationError
from warpvox.gradients import Gradients
from warpvox.simulation import Simulation
from warpvox.types import VOXEL, Physics

FIELDS = dict(device="cpu", dtype="float64", arithmetic="fast", lanes=8)
HEIGHT = 3.0  # in the air, in simulator units


def world_of(body):
    fixed = {"ground": ground(12), "step": (np.full((2, 2), 5), 7, 1), "shelf": (np.full((1, 4), 5), 0, 7)}
    return world(12, 8, **fixed, robot=(body, 1, 1))


def bodies(count=8):
    """Of all kinds of cells, with holes: lanes differ, so that there are twins; no cells that meet at a corner only."""
    found = (sample_design((4, 4), seed=seed) for seed in itertools.count())

    def apart(body):
        full = np.pad(body > 0, 1)
        blocks = np.stack([full[:-1, :-1], full[:-1, 1:], full[1:, :-1], full[1:, 1:]])
        return not ((blocks[0] == blocks[3]) & (blocks[1] == blocks[2]) & (blocks[0] != blocks[1])).any()

    return list(itertools.islice(filter(apart, found), count))


def simulation(**options):
    return Simulation([world_of(body) for body in bodies()], **FIELDS | options)


@functools.cache
def gradients():
    return Gradients(simulation())


@pytest.fixture
def grads():
    made = gradients()
    made.sim.set_frozen(torch.zeros(made.sim.num_envs, dtype=torch.bool))
    made.sim.reset()
    return made


def lifted(grads):
    state = grads.state()
    state[:, 0, 1::2] += HEIGHT * grads.sim.rows[1][:, 1::2]
    return state


def noise(like, seed=0):
    return torch.randn(like.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def errors(grads, state, actions):
    """Relative errors of directional derivatives by actions, positions and velocities, against central differences."""
    real = grads.sim.rows[1][:, None]
    weights = noise(state) * real * torch.tensor([1.0, 0.01, 0.0])[:, None]

    def loss(state, actions):
        return (grads.step(state, actions) * weights).sum((1, 2))

    start, acts = state.clone().requires_grad_(), actions.clone().requires_grad_()
    grads.step(start, acts).backward(weights.where(real, torch.nan))  # padding is no matter
    found = []
    for part, step in ((None, 1e-5), (0, 1e-6), (1, 1e-4)):
        by, given = (acts.grad, actions) if part is None else (start.grad, state)
        way = noise(given, 1) * (1 if part is None else real)
        if part is not None:
            way[:, [k for k in range(3) if k != part]] = 0.0
        ahead, behind = given + step * way, given - step * way
        if part is None:
            ends = loss(state, ahead), loss(state, behind)
        else:
            ends = loss(ahead, actions), loss(behind, actions)
        expected = (ends[0] - ends[1]) / (2 * step)
        found.append(float(((by * way).flatten(1).sum(1) - expected).norm() / expected.norm()))
    return found


@pytest.mark.parametrize("physics", [Physics(), Physics(point_mass=2.0, drag=50.0)])
def test_at_rest_in_the_air_derivatives_are_those_of_the_physics(physics):
    grads = Gradients(simulation(physics=physics))
    actions = torch.ones(8, grads.sim.num_actions, dtype=torch.float64)
    assert max(errors(grads, lifted(grads), actions)) < 1e-5


def test_velocities_of_points_that_never_move_count_in_what_hangs_on_them():
    hanging, physics = world(6, 4, robot=([[5, 3, 2]], 1, 2)), Physics(gravity=0.0)
    grads = Gradients(Simulation([hanging], physics=physics, **FIELDS))
    assert max(errors(grads, grads.state(), torch.ones(1, 1, dtype=torch.float64))) < 1e-5


@pytest.mark.parametrize("amplitude", [0.1, 0.4])
def test_in_motion_they_are_near(grads, amplitude):
    state, turns = lifted(grads), noise(grads.sim.actions)
    for step in range(5):
        state = grads.step(state, 1 + amplitude * torch.sin(step / 3 + turns))
    by_actions, by_positions, by_velocities = errors(grads, state, 1 + amplitude * torch.sin(5 / 3 + turns))
    assert by_actions < 0.02
    assert by_positions < 0.1  # strain limits, which depend on how far a spring is beyond them
    assert by_velocities < 0.03


def test_several_steps_in_a_row(grads):
    state, turns = lifted(grads), noise(grads.sim.actions)

    def end(actions):
        after = state
        for k in range(6):
            after = grads.step(after, 1 + 0.15 * torch.sin(actions + k))
        return (after[:, 0] * noise(after[:, 0], 2) * grads.sim.rows[1]).sum(1)

    actions = turns.clone().requires_grad_()
    end(actions).sum().backward()
    way = noise(turns, 3)
    expected = (end(turns + 1e-5 * way) - end(turns - 1e-5 * way)) / 2e-5
    assert float(((actions.grad * way).sum(1) - expected).norm() / expected.norm()) < 0.1


def test_forward_is_the_simulation_and_backward_leaves_it_alone(grads):
    other, actions = simulation(), 1 + 0.3 * torch.sin(noise(grads.sim.actions)).requires_grad_()
    state = grads.state()
    for _ in range(10):
        state = grads.step(state, actions)
        other.step(actions.detach())
    expected = other.state()
    for part, name in enumerate(("pos", "vel", "true_vel")):
        assert torch.equal(state[:, part], expected[name])
    taken = grads.sim.actions
    assert not taken.requires_grad
    state.sum().backward()
    assert actions.is_leaf or torch.equal(grads.sim.actions, taken)
    grads.sim.step(taken * 0.9)
    other.step(taken * 0.9)
    assert all(torch.equal(value, other.state()[name]) for name, value in grads.sim.state().items())


def test_actions_of_the_host_are_those_of_the_device(grads):
    """Arrays are, as every tensor that the simulation takes is brought to its device."""
    state, actions, found = lifted(grads), 1 + 0.3 * torch.sin(noise(grads.sim.actions)), []
    for given in (actions, actions.numpy()):
        start = state.clone().requires_grad_()
        grads.step(start, given).square().sum().backward()
        found.append(start.grad)
    assert torch.equal(*found)


def test_threads_and_neighbours_change_nothing():
    def derivative(sim):
        grads = Gradients(sim)
        actions = 1 + 0.3 * torch.sin(torch.arange(sim.num_actions, dtype=torch.float64)).expand(sim.num_envs, -1)
        actions = actions.clone().requires_grad_()
        state = grads.state()
        for _ in range(20):
            state = grads.step(state, actions)
        grads.com(state, "robot")[:, 0].sum().backward()
        return actions.grad

    worlds = [world_of(body) for body in bodies()] * 2
    expected = derivative(Simulation(worlds, threads=1, **FIELDS))
    assert torch.equal(derivative(Simulation(worlds, threads=2, **FIELDS)), expected)
    assert float(expected.abs().max()) > 0
    alone = derivative(Simulation(worlds[3:4], **FIELDS))
    torch.testing.assert_close(alone[0], expected[3, : alone.shape[1]], rtol=1e-6, atol=1e-12)


@pytest.mark.gpu
def test_a_gpu_gives_the_derivatives_of_a_cpu():
    def derivative(device):
        lanes = 1 if device == "cpu" else None
        sim = Simulation(
            [world_of(body) for body in bodies()], device=device, dtype="float64", arithmetic="fast",
            layout="lanes", lanes=lanes,
        )  # fmt: skip
        grads = Gradients(sim)
        actions = torch.full((8, sim.num_actions), 1.2, dtype=torch.float64, device=device, requires_grad=True)
        state = lifted(grads)
        for _ in range(5):
            state = grads.step(state, actions)
        state[:, 0].square().sum().backward()
        return actions.grad.cpu()

    torch.testing.assert_close(derivative("cuda"), derivative("cpu"), rtol=1e-6, atol=1e-12)


def law(sim, x, y, size, smoothing, slip):
    """Derivatives of the force on a corner: [x by x, x by y, y by x, y by y, x by velocity, y by velocity]."""
    found, contact = np.zeros(6), sim.buffers.model.contact
    sides, boxes = sim.array("terrain_side").numpy()[0], sim.array("terrain_box").numpy()[0]
    column, row = int(np.floor(x / VOXEL)), int(np.floor(y / VOXEL))

    def side(cell, n):
        left, right, bottom, top = boxes[cell]
        height = (y - top, x - right, bottom - y, left - x)[n]
        way, sign = np.array(((0, 1), (1, 0), (0, -1), (-1, 0))[n]), (1, 1, -1, -1)[n]
        return height, way, sign

    def touched():
        cell = row * size[0] + column
        if 0 <= column < size[0] and 0 <= row < size[1] and sides[cell]:
            inside = [side(cell, n) for n in range(4) if sides[cell] >> n & 1]
            yield max(inside, key=lambda found: found[0])
            return
        for n, (dx, dy) in enumerate(((0, -1), (-1, 0), (0, 1), (1, 0))):
            to_x, to_y = column + dx, row + dy
            if 0 <= to_x < size[0] and 0 <= to_y < size[1] and sides[to_y * size[0] + to_x] >> n & 1:
                yield side(to_y * size[0] + to_x, n)

    for height, way, sign in touched():
        z = height / smoothing
        if z >= 30:
            continue
        share, growth = (1 - z / np.hypot(z, 2)) / 2, 2 / smoothing / np.hypot(z, 2) ** 3
        normal, along = int(way[1] != 0), int(way[0] != 0)
        found[2 * normal + normal] -= contact.stiffness * (contact.depth * growth + share)
        found[2 * along + normal] += contact.friction_multiplier * slip[along] * growth * sign
        found[4 + normal] -= contact.damping * share
        found[4 + along] -= contact.friction_multiplier * share
    return found


@pytest.mark.parametrize("place", [(3.0, 0.0), (4.98, 0.5), (0.2, 4.99), (6.5, 1.98), (5.0, 0.005)])
def test_contact_with_terrain_has_the_derivative_of_a_gradual_push(place):
    """Of one voxel in each lane, at random about the floor, a wall, a ceiling and an inner corner."""
    sim = Simulation([world_of(np.array([[3]]))] * 8, **FIELDS)
    grads, random = Gradients(sim, smoothing=2e-3), np.random.default_rng(0)
    state = grads.state()
    shift = torch.tensor(np.array(place) * VOXEL + random.normal(0, 0.003, (8, 2)))
    state[:, 0] += shift.repeat(1, 4)
    state[:, 2] = torch.tensor(random.normal(0, 1, state[:, 2].shape))
    start = state.clone().requires_grad_()
    grads.step(start, torch.ones(8, 1)).sum().backward()
    contact = grads.tape["contact"].numpy()[0]
    rows = sim.rows[0].numpy()
    points = int(sim.array("points").numpy()[0])
    pack, lane = sim.buffers.env_pack.numpy(), sim.buffers.env_lane.numpy()
    assert set(pack) == {0}
    checked = 0
    for env, at in itertools.product(range(8), range(4)):
        point = rows[env, 2 * at] // 2
        assert point < points
        x, y = state[env, 0, 2 * at : 2 * at + 2].tolist()
        expected = law(sim, x, y, sim.array("terrain").numpy()[0], 2e-3, state[env, 2, 2 * at : 2 * at + 2].numpy())
        np.testing.assert_allclose(contact[6 * point : 6 * point + 6, lane[env]], expected, rtol=1e-9, atol=1e-6)
        checked += bool(expected.any())
    assert checked >= 8


def test_who_stands_still_keeps_its_state_and_its_derivative(grads):
    sim = grads.sim
    sim.set_frozen(torch.arange(8) == 2)
    state = lifted(grads)
    state[5, 1] += 1e6 * sim.rows[1][5]  # diverges: the step is undone
    start = state.clone().requires_grad_()
    actions = torch.full((8, sim.num_actions), 1.1, dtype=torch.float64, requires_grad=True)
    after = grads.step(start, actions)
    assert sim.unstable.tolist() == [env == 5 for env in range(8)]
    weights = noise(state) * sim.rows[1][:, None]
    (after * weights).sum().backward()
    for env in (2, 5):
        assert torch.equal(start.grad[env], weights[env])
        assert not actions.grad[env].any()
    assert torch.isfinite(start.grad).all()
    assert actions.grad[3].any()
    assert torch.equal(after[2], state[2])


@pytest.mark.parametrize("lanes", [8, pytest.param(1, marks=pytest.mark.slow)])  # which has kernels of its own
def test_limits_pass_no_derivative_of_points_that_never_move(lanes):
    sim = Simulation([world(6, 4, robot=([[5, 1, 3]], 1, 2))], **FIELDS | {"lanes": lanes})
    grads, fixed = Gradients(sim), fixed_rows(sim)[0]
    state = grads.state()
    state[0, 0, 0::2] += 0.1 * VOXEL * ~fixed[0::2]  # beyond the limits of rigid and of other springs
    state.requires_grad_()
    actions = torch.full((1, 1), 1.5, dtype=torch.float64, requires_grad=True)
    end = grads.step(state, actions)[0, 0, fixed]
    assert torch.equal(end, state[0, 0, fixed])
    end.sum().backward()
    assert bool((state.grad[0, 0, fixed] == 1).all())
    assert not state.grad[0, :, ~fixed].any()
    assert not actions.grad.any()


def test_what_is_frozen_later_has_moved_before(grads):
    def derivative(frozen):
        grads.sim.set_frozen(torch.zeros(8, dtype=torch.bool))
        grads.sim.reset()
        actions = torch.full((8, grads.sim.num_actions), 1.3, dtype=torch.float64, requires_grad=True)
        state = grads.state()
        for _ in range(5):
            state = grads.step(state, actions)
        grads.sim.set_frozen(torch.full((8,), frozen))
        grads.com(state, "robot").sum().backward()
        assert grads.sim.frozen.tolist() == [frozen] * 8
        return actions.grad

    assert torch.equal(derivative(True), derivative(False))


def test_actions_beyond_the_range_have_no_derivative(grads):
    actions = torch.full((8, grads.sim.num_actions), 1.2, dtype=torch.float32)
    actions[:, 0] = 2.0
    actions.requires_grad_()
    grads.step(lifted(grads), actions)[:, 0].square().sum().backward()
    assert not actions.grad[:, 0].any()
    assert actions.grad[0, 1].any()
    assert actions.grad.dtype is torch.float32


def test_mistakes(grads):
    one = world_of(np.array([[3]]))
    with pytest.raises(SimulationError):
        Gradients(Simulation([one], device="cpu", dtype="float64"))
    with pytest.raises(SimulationError):
        Gradients("walker")
    with pytest.raises(SimulationError):
        Gradients(Simulation([one], device="cpu", layout="group"))
    for smoothing in (0, -1.0, float("inf"), float("nan"), "thin", True, 1e-300):
        with pytest.raises(SimulationError):
            Gradients(grads.sim, smoothing)
    with pytest.raises(SimulationError):
        grads.com(grads.state(), "ground")
    actions = grads.sim.actions
    for state in (grads.state()[:3], grads.state()[:, :2], grads.state().float(), None):
        with pytest.raises(SimulationError):
            grads.step(state, actions)
    with pytest.raises(ActionError):
        grads.step(grads.state(), actions[:, :1])


def test_a_step_of_bodies_that_have_gone_cannot_be_differentiated():
    grads = Gradients(simulation(grid=(4, 4)))
    sim, actions = grads.sim, torch.ones((8, grads.sim.num_actions), dtype=torch.float64, requires_grad=True)
    kept = grads.step(grads.state(), actions)
    mask = torch.arange(8) == 5
    sim.set_worlds([sim.worlds[0]], mask)
    with pytest.raises(SimulationError):
        kept.sum().backward()
