"""What a batch of environments needs is known before it is made, and refused where it does not fit."""

from __future__ import annotations

import numpy as np
import pytest

import warpvox as wv
from warpvox.envs import needs
from warpvox.envs.needs import check_environments, probed, simulation_bytes
from warpvox.envs.registry import get_task
from warpvox.envs.worlds import task_world
from warpvox.errors import DeviceError, MemoryLimitError
from warpvox.simulation import Simulation

BODIES = [np.full((2, 2), 3), np.full((5, 5), 4), np.full((3, 3), 3), np.full((1, 4), 3)]


def worlds_of(task: str, bodies: list[np.ndarray]) -> list[wv.World]:
    return [task_world(get_task(task), wv.load_design(body)) for body in bodies]


def taken(sim: Simulation) -> int:
    return sum(array.capacity for array in sim._state.arrays.values())


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("task", ["Walker-v0", "Climber-v1", "Carrier-v0"])
@pytest.mark.parametrize(("bodies", "per_design"), [(BODIES[1:2], 500), (BODIES[1:2], 3), (BODIES, 96), (BODIES, 20)])
def test_arrays_are_known_beforehand(task: str, dtype: str, bodies: list[np.ndarray], per_design: int) -> None:
    worlds = worlds_of(task, bodies)
    options = {"device": "cpu", "dtype": dtype, "threads": 1}
    estimate = simulation_bytes(Simulation(probed(worlds, per_design), **options), len(worlds), per_design)
    whole = Simulation([world for world in worlds for _ in range(per_design)], **options)
    assert estimate == pytest.approx(taken(whole), rel=0.2)
    if len(bodies) == 1:
        assert estimate == pytest.approx(taken(whole), rel=0.02)


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The sizes of the simulations that are made."""
    sizes: list[int] = []
    before = Simulation.__init__

    def counted(self: Simulation, worlds: list[wv.World], *words: object, **options: object) -> None:
        sizes.append(len(worlds))
        before(self, worlds, *words, **options)

    monkeypatch.setattr(Simulation, "__init__", counted)
    return sizes


def test_what_does_not_fit_is_refused_before_it_is_made(monkeypatch: pytest.MonkeyPatch, made: list[int]) -> None:
    monkeypatch.setattr(needs, "free_memory", lambda device: 2**30)
    with pytest.raises(
        MemoryLimitError, match=r"1,000,000 environments need about .* GiB, and 1 GiB are free on cpu; "
    ) as caught:
        wv.make_vec("Walker-v0", "walker", 1_000_000, device="cpu", threads=1)
    assert max(made) <= 64
    assert isinstance(caught.value, DeviceError)
    fits = int(str(caught.value).split("num_envs=")[1].split(".")[0])
    worlds = worlds_of("Walker-v0", [wv.load_design("walker")])
    sim = Simulation(probed(worlds, fits), device="cpu", threads=1)
    assert 0.8 * 2**30 < simulation_bytes(sim, 1, fits) <= 0.9 * 2**30


def test_few_environments_are_made_at_once(made: list[int]) -> None:
    wv.make_vec("Walker-v0", "walker", 8, device="cpu", threads=1)
    assert made == [8]


def test_the_check_can_be_switched_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(needs, "free_memory", lambda device: 1)
    with pytest.raises(MemoryLimitError, match="not even the least number fits"):
        wv.make_vec("Walker-v0", "walker", 8, device="cpu", threads=1)
    wv.make_vec("Walker-v0", "walker", 8, device="cpu", threads=1, memory_check=False)


def test_where_nothing_tells_what_is_free_all_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(needs, "free_memory", lambda device: None)
    check_environments(worlds_of("Walker-v0", BODIES), 10**9, "cpu", lambda worlds: pytest.fail("measured"))
