"""Killed, or refused by the disk, at every moment: what is left is true, and goes on to the undisturbed end."""

from __future__ import annotations

import random
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from fault_cases import (
    BROKEN,
    COMMANDS,
    FULL,
    KILL,
    TORN,
    WHEN_DONE,
    WHEN_LEFT,
    Victim,
    check_complaint,
    has_begun,
    only,
    resume,
)

from warpvox.io.writing import MARK

MODES = pytest.mark.parametrize("mode", [KILL, TORN, FULL, BROKEN], ids=["killed", "torn", "full", "broken"])
FEW, MANY = {"train": 1, "codesign": 1}, {"train": 24, "codesign": 12}
"""Moments of the default run and of the slow one, in which a training is killed at all of them."""


@pytest.fixture(scope="session")
def undisturbed(victim: Victim, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], tuple[Path, int]]:
    """By command: the folder of a run that nothing has happened to, and the number of its changes of the disk."""
    known: dict[str, tuple[Path, int]] = {}

    def call(command: str) -> tuple[Path, int]:
        if command not in known:
            folder = tmp_path_factory.mktemp(command)
            result = victim(folder, COMMANDS[command])
            assert result.code == 0, result
            known[command] = only(folder, command), result.count
        return known[command]

    return call


def spread(count: int, number: int, seed: int) -> list[int]:
    """``number`` of the moments 1 to ``count``, one at random of each of as many equal parts."""
    rng = random.Random(seed)
    return [1 + int((k + rng.random()) * count / number) for k in range(number)]


def strike(victim: Victim, folder: Path, command: str, at: int, mode: int, whole: Path) -> None:
    """One fault and what must follow from it."""
    result = victim(folder, COMMANDS[command], at, mode)
    run = only(folder, command)
    if mode in (KILL, TORN):
        assert result.code == -signal.SIGKILL, result
    elif result.code == 0:  # nothing was written any more that takes room, or nothing that matters
        WHEN_DONE[command](run, whole)
    else:
        check_complaint(result)
        assert "cannot be" in result.err
        if mode == FULL:
            assert "space" in result.err or "disk is full" in result.err
        assert not list(folder.rglob(f"{MARK}*"))
    if run is not None:
        WHEN_LEFT[command](run, whole)
    resume(victim, folder, command, whole)


@MODES
@pytest.mark.parametrize("command", ["train", "codesign"])
@pytest.mark.parametrize("number", [FEW, pytest.param(MANY, marks=pytest.mark.slow)], ids=["some", "many"])
def test_at_moments(
    victim: Victim, tmp_path: Path, undisturbed: Callable, command: str, mode: int, number: dict[str, int]
) -> None:
    whole, count = undisturbed(command)
    all_kills = number is MANY and (command, mode) == ("train", KILL)
    moments = spread(count, count if all_kills else number[command], seed=mode)
    for at in moments:
        strike(victim, tmp_path / str(at), command, at, mode, whole)
    print(f"{len(moments)} of {count} moments of {command}: nothing lost")


def killed_again_and_again(
    victim: Victim, folder: Path, command: str, whole: Path, kills: int, number: int, longest: float, seed: int
) -> None:
    """Signals at random times, each in the run that the one before has left; after one that is done comes another."""
    rng = random.Random(seed)
    done, place, words = 0, 0, COMMANDS[command]
    while done < kills:
        result = victim(folder / str(place), words, seconds=rng.uniform(0.05, longest), number=number)
        run = only(folder / str(place), command)
        if result.code == 0:
            WHEN_DONE[command](run, whole)
            place, words = place + 1, COMMANDS[command]
            continue
        done += 1
        if number == signal.SIGKILL:
            assert result.code == -number, result
        else:
            assert result.code == 128 + number, result
            assert "Traceback" not in result.out + result.err
            assert not list(folder.rglob(f"{MARK}*"))
        if run is not None:
            WHEN_LEFT[command](run, whole)
        begun = run is not None and has_begun(run)
        place, words = (place, [command, f"resume={run}"]) if begun else (place + 1, COMMANDS[command])
    resume(victim, folder / str(place), command, whole)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize(
    ("command", "kills", "longest"),
    [
        ("train", 1, 1.0),
        pytest.param("train", 20, 1.5, marks=pytest.mark.slow),
        pytest.param("codesign", 20, 3.0, marks=pytest.mark.slow),
    ],
)
def test_at_random_times(
    victim: Victim, tmp_path: Path, undisturbed: Callable, command: str, kills: int, longest: float, number: int
) -> None:
    killed_again_and_again(victim, tmp_path, command, undisturbed(command)[0], kills, number, longest, seed=number)
