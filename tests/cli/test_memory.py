"""Trainings, searches and plays that do not fit into memory are refused, with the key and the value that would."""

import re
from collections.abc import Callable

import pytest
from tiny import tiny

GIB = 2**30


@pytest.fixture
def free(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """``free(gibibytes)``: what the machine has left."""
    return lambda size: monkeypatch.setattr("warpvox.envs.memory.free_memory", lambda device: int(size * GIB))


@pytest.mark.parametrize(
    ("size", "key", "words"),
    [
        (20, "num_envs", "train num_envs=10000000"),
        (1, "num_envs", "train designs=random:64 policy=transformer num_envs=200000"),
        (1, "batch", "codesign training.envs=4096 training.ppo.steps=64"),
        (8, "training.episodes", "codesign training.episodes=10000000"),
        (8, "fitness.beam", "codesign fitness=gaits fitness.beam=10000000 fitness.passes=1"),
    ],
)
def test_what_does_not_fit_is_refused_with_what_does(warpvox, tmp_path, free, size, key: str, words: str) -> None:
    free(size)
    outcome = warpvox(*words.split(), "device=cpu", fails="memory_check=false")
    fits = re.search(rf"[\d,]+ fit: {key}=(\d+)\.", outcome.err)
    assert fits, outcome.err
    asked = re.search(rf" {key}=(\d+)", words)
    assert 0 < int(fits[1]) < (int(asked[1]) if asked else 25)
    assert list(tmp_path.iterdir()) == []


def test_a_training_takes_the_advice_or_goes_without(warpvox: Callable, free: Callable) -> None:
    free(0.004)
    several = "design=[mini,worm,walker]"
    refused = warpvox(*tiny("train", several, "num_envs=3000"), fails="memory_check=false")
    fits = int(re.search(r"num_envs=(\d+)", refused.err)[1])
    assert fits % 3 == 0
    warpvox(*tiny("train", several, f"num_envs={fits}"))
    warpvox(*tiny("train", several, "num_envs=600", "memory_check=false"))
    warpvox("train", "resume=latest", "max_iterations=2", "memory_check=true", fails="96 fit: num_envs=96")
    warpvox("train", "resume=latest", "max_iterations=2")  # as the run was begun


def test_playing_many_is_refused_and_can_be_tried(warpvox: Callable, free: Callable) -> None:
    free(0.0001)
    words = "play agent=zero num_envs=64 steps=1 window=off export=[] record=false device=cpu threads=1".split()
    warpvox(*words, fails="memory_check=false")
    warpvox(*words, "memory_check=false")
