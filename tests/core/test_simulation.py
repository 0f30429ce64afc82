"""Contracts of the simulator that hold for every body: batching, determinism, reset, freezing, physics."""

import copy
import os
import pickle
from collections.abc import Callable

import numpy as np
import pytest
import torch
import warp as wp
from warp._src.context import Module
from worlds import ground, world

from warpvox.batch.options import lanes_for
from warpvox.design import sample_design
from warpvox.errors import SimulationError
from warpvox.simulation import Simulation
from warpvox.types import Physics


def world_of(body):
    return world(40, 12, ground=ground(40), robot=(body, 1, 1))


def worlds(count=4):
    return [world_of(sample_design((5, 5), seed=k)) for k in range(count)]


def actions_for(sim, steps, seed=0):
    """[steps, env, action]; an environment's own actions do not depend on the batch."""
    rows = [np.random.default_rng([seed, e]).uniform(0.6, 1.6, (steps, 25)) for e in range(sim.num_envs)]
    return torch.tensor(np.stack(rows, 1)[:, :, : sim.num_actions], dtype=sim.dtype)


def run(sim, actions):
    for action in actions:
        sim.step(action)
    return sim.object_positions("robot")


def test_a_frozen_environment_keeps_its_state():
    sim = Simulation(worlds(1) * 3, device="cpu", lanes=8)
    actions = actions_for(sim, 12)
    run(sim, actions[:6])
    held = sim.object_positions("robot")[1]
    sim.set_frozen(torch.tensor([False, True, False]))
    moved = run(sim, actions[6:])
    assert torch.equal(moved[1], held)
    assert sim.time.tolist() == [12, 6, 12]
    assert sim.frozen.tolist() == [False, True, False]
    reference = Simulation(worlds(1) * 3, device="cpu", lanes=8)
    assert torch.equal(run(reference, actions)[[0, 2]], moved[[0, 2]])


def test_stiffest_side_wins_under_the_paper_and_the_last_voxel_in_the_release():
    body = np.array([[2, 3]])  # the shared side: soft, then actuator
    found = {}
    for name in ("evogym", "paper"):
        physics = Physics.preset(name)
        sim = Simulation([world_of(body)], device="cpu", physics=physics, dtype="float64")
        mesh = sim.designs[0].bodies[0]
        found[name] = mesh.springs[mesh.sides[(0, 1)][3]][3]
    assert found["evogym"] == Physics.preset("evogym").actuator_main
    assert found["paper"] == max(Physics.preset("paper").soft_main, Physics.preset("paper").actuator_main)


def test_bad_worlds_and_names_are_refused():
    with pytest.raises(SimulationError):
        Simulation([])
    with pytest.raises(SimulationError):
        Simulation([world(3, 1, ground=ground(3))], device="cpu")
    sim = Simulation(worlds(1), device="cpu")
    for ask in (sim.com, sim.point_mask):
        with pytest.raises(SimulationError):
            ask("robto")
    with pytest.raises(SimulationError):
        sim.array("poss")
    with pytest.raises(SimulationError):
        sim.com("ground")


def test_an_environment_keeps_its_terrain():
    high, low = (world(6, 4, ground=ground(6, rows), robot=([[3, 4]], 2, rows)) for rows in (2, 1))
    other = world(6, 4, ground=ground(6), robot=([[4, 3]], 2, 1))
    sim = Simulation([high, high, low], grid=(2, 2), device="cpu", lanes=8)
    before = sim.state()
    for given, mask in (([low], [True, False, False]), ([other, other], [False, True, True])):
        with pytest.raises(SimulationError):
            sim.set_worlds(given, torch.tensor(mask))
    sim.set_worlds([high, other], torch.tensor([True, False, True]))
    assert [sim.worlds[k] for k in sim.design_index] == [high, high, other]
    assert all(torch.equal(values, before[name]) for name, values in sim.state().items())


def test_lanes_without_an_environment_are_at_rest_after_an_exchange():
    """Torn apart they would have the candidates of all lanes made again in nearly every sub-step."""
    small, large = (world(9, 8, ground=ground(9), robot=(np.full((n, n), 3), 2, 1)) for n in (2, 5))
    sim = Simulation([small] * 3, grid=(5, 5), device="cpu", lanes=8)
    sim.set_worlds([large] * 3, torch.ones(3, dtype=torch.bool))
    assert torch.equal(sim.array("pos"), sim.array("rest_pos"))


def test_worlds_without_robots_can_be_exchanged():
    narrow, wide = (world(width, 6, ground=ground(8), box=([[2]], 2, 3)) for width in (8, 12))
    sim = Simulation([narrow], grid=(2, 2), device="cpu")
    sim.set_worlds([wide], torch.tensor([True]))
    assert sim.worlds[0].width == 12


def test_more_actuators_than_a_spring_can_name_are_refused():
    many = world(256, 256, robot=(np.full((256, 256), 3), 0, 0))
    with pytest.raises(SimulationError):
        Simulation([many], device="cpu")


def test_a_world_that_is_changed_afterwards_changes_no_simulation():
    changed = world_of(np.array([[3, 4]]))
    sim = Simulation([changed], device="cpu", lanes=8)
    changed.add_from_array("stone", [[2]], 20, 3)
    assert set(sim.worlds[0].objects) == set(sim.object_names) == {"ground", "robot"}


class Rewards(torch.utils.data.Dataset):
    """Steps a simulation in another process."""

    def __init__(self, sim):
        self.sim = sim

    def __len__(self):
        return 1

    def __getitem__(self, index):
        self.sim.step(torch.ones((self.sim.num_envs, self.sim.num_actions)))
        return self.sim.time


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_forked_process_steps_it():
    sim = Simulation(worlds(2), device="cpu", lanes=1, threads=2)
    sim.step(torch.ones((2, sim.num_actions)))  # its threads are at work
    loader = torch.utils.data.DataLoader(Rewards(sim), num_workers=1, timeout=60, multiprocessing_context="fork")
    assert next(iter(loader)).tolist() == [[2, 2]]
    assert sim.time.tolist() == [1, 1]


@wp.kernel(module="unique")
def fresh(numbers: wp.array(dtype=int)):
    numbers[wp.tid()] += 1


def test_no_kernel_is_built_after_the_first_step(monkeypatch):
    built, build = [], Module._compile

    def seen(module, *words, **more):
        built.append(module.name)
        return build(module, *words, **more)

    monkeypatch.setattr(Module, "_compile", seen)
    sim = Simulation(worlds(1), device="cpu")
    run(sim, actions_for(sim, 1))
    built.clear()
    run(sim, actions_for(sim, 2))
    assert built == []
    wp.launch(fresh, 1, [wp.zeros(1, dtype=int, device="cpu")], device="cpu")
    assert built == [fresh.module.name]  # one that is built would have been seen


@pytest.mark.parametrize(("vectors", "most"), [("AVX512", 32), ("AVX2", 16), ("DEFAULT", 16)])
def test_lanes_go_by_the_environments_and_the_processor(vectors, most, monkeypatch):
    monkeypatch.setattr("torch.backends.cpu.get_cpu_capability", lambda: vectors)
    assert [lanes_for(count) for count in (1, 2, 9, 17, 512)] == [1, 8, 16, most, most]


@pytest.mark.parametrize("copied", [copy.deepcopy, pickle.dumps])
def test_copies_are_refused_with_what_to_do_instead(copied: Callable[[object], object]) -> None:
    sim = Simulation(worlds(1), device="cpu")
    for holder in (sim, [sim]):
        with pytest.raises(SimulationError):
            copied(holder)
    copied(sim.state())
