"""Tests of each benchmark at a tiny size; wrong results must not be timed."""

from __future__ import annotations

import json
import runpy
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

SCRIPTS = Path(__file__).resolve().parents[1]
TINY = "--design mini --num-envs 8 --steps 2 --repeats 1 --no-training".split()
NO_REFERENCE = "--reference nowhere".split()

# A package that looks like EvoGym to the worker, and is warpvox: the whole exchange runs without EvoGym.
FAKE = """
import gymnasium, numpy as np
from warpvox.envs.adapters.gym import VoxelEnv

class Env(VoxelEnv):
    def __init__(self, task, body, **rest):
        super().__init__(task, body.astype(int), **rest)
    def get_time(self):
        return 0
    def object_pos_at_time(self, time, name):
        return self.sim.object_positions(name)[0].double().numpy().T + OFFSET

gymnasium.register("Walker-v0", entry_point=Env, max_episode_steps=100, kwargs={"task": "Walker-v0"})
"""


class Outcome(NamedTuple):
    """Results of a benchmark: exit code (None after an error), tables, and rows by name."""

    code: int | None
    tables: str
    rows: dict[str, list[Any]]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Outcome]]:
    """Run a benchmark, such as ``run("tasks", "--tasks", "Walker-v0")``; ``fails``: the expected error."""
    monkeypatch.syspath_prepend(str(SCRIPTS))
    names = [path.stem for path in SCRIPTS.glob("*.py")]
    for name in names:
        monkeypatch.delitem(sys.modules, name, raising=False)  # tests elsewhere may have modules of these names

    def run(name: str, *words: str, fails: str | None = None) -> Outcome:
        main = runpy.run_path(str(SCRIPTS / f"{name}.py"))["main"]
        arguments = [*TINY, *words, "--output", str(tmp_path)]
        code = None
        if fails is None:
            code = main(arguments) or 0
        else:
            with pytest.raises(Exception, match=fails):
                main(arguments)
        tables = tmp_path / name / "tables.md"
        rows = [json.loads(line) for line in (tmp_path / name / "rows.jsonl").read_text().splitlines()]
        return Outcome(code, tables.read_text() if tables.is_file() else "", {row[0]: row[1:] for row in rows})

    yield run
    for name in names:
        sys.modules.pop(name, None)


@pytest.fixture
def fake_evogym(tmp_path: Path) -> Callable[..., list[str]]:
    """Create an interpreter with a fake package ``evogym`` whose centres of mass are off; return the option."""

    def make(offset: float = 0.0) -> list[str]:
        (tmp_path / "evogym").mkdir()
        (tmp_path / "evogym" / "__init__.py").touch()
        (tmp_path / "evogym" / "envs.py").write_text(f"OFFSET = {offset}\n{FAKE}")
        (tmp_path / "evogym-2.0.0.dist-info").mkdir()
        (tmp_path / "evogym-2.0.0.dist-info" / "METADATA").write_text(
            "Metadata-Version: 2.1\nName: evogym\nVersion: 2.0.0\n"
        )
        # Called as `python -I worker.py`: evogym must be found, but not what lies beside the worker.
        python = tmp_path / "python"
        worker = tmp_path / "worker.py"
        command = f'cp "$2" {worker}; PYTHONPATH={tmp_path} exec {sys.executable} {worker}'
        python.write_text(f"#!/bin/sh\n{command}\n")
        python.chmod(0o755)
        return ["--reference", str(python)]

    return make


def test_peer_compares_and_then_times(run: Callable, fake_evogym: Callable) -> None:
    _, tables, rows = run("peer", *fake_evogym())
    assert tables.startswith("Checked: within ")
    batch, alone, drop_in, (theirs, ratio) = rows.values()
    assert batch[1] == pytest.approx(batch[0][0] / theirs[0])
    assert alone[0][0] > 0 < drop_in[0][0]
    assert ratio == 1.0
    assert any(name.startswith("evogym 2.0.0, Python 3") for name in rows)
    assert "Machine: " in tables


def test_a_wrong_result_gets_no_time(run: Callable, fake_evogym: Callable) -> None:
    _, tables, rows = run("peer", *fake_evogym(1e-5), fails="differs from EvoGym by 1.0e-05")
    assert (tables, rows) == ("", {})


def test_tasks_keeps_the_rows_before_a_failure(run: Callable, fake_evogym: Callable) -> None:
    _, _, rows = run("tasks", *fake_evogym(), "--tasks", "Walker-v0", "Walked-v0", fails="Did you mean 'Walker-v0'")
    physics, step, training, theirs, ratio = rows["Walker-v0"]
    assert physics[0] > 0 < step[0]
    assert training == []
    assert ratio == pytest.approx(step[0] / theirs[0])


def test_tasks_without_evogym(run: Callable) -> None:
    _, tables, rows = run("tasks", *NO_REFERENCE, "--tasks", "Lifter-v0")
    assert rows["Lifter-v0"][-2:] == [None, None]
    assert "of one environment alone in float64" in tables


def test_scaling_in_five_ways(run: Callable) -> None:
    words = "--sizes 2 3 --bodies 2 --simulated 0.04 --envs 1 8".split()
    _, tables, rows = run("scaling", *NO_REFERENCE, *words)
    assert {"2 x 2 sampled", "3 x 3 sampled", "1", "8"} <= rows.keys()
    for heading in (
        "robots | voxels",
        "environments | physics alone",
        "threads | step only",
        "arithmetic | ",
        "| 8 different bodies",
    ):
        assert heading in tables
    assert "1 of 8 were exchanged" in tables


def test_learning_ends_with_its_time(run: Callable) -> None:
    _, tables, rows = run("learning", "--ppo", "evogym", "--seeds", "1", "--seconds", "0.1")
    assert "0 of 1" in tables
    assert rows["ppo=evogym, seed 0"][1] >= 512


@pytest.mark.slow
def test_learning_ends_with_its_goal(run: Callable) -> None:
    _, tables, rows = run("learning", "--ppo", "parallel", "--seeds", "1", "--goal", "-100")
    assert "1 of 1" in tables
    assert rows["ppo=parallel, seed 0"][1] == 10 * 512 * 16


def test_gpu_goes_on_after_a_failure(run: Callable) -> None:
    parts = "--parts nothing learners designs tasks --tasks Walker-v0".split()
    code, tables, rows = run("gpu", "--device", "cpu", *parts)
    assert code == 1
    assert "FAILED, nothing: KeyError" in tables
    assert [len(rates) for rates in rows["learners, 8"]] == [1, 1]
    assert "one graph an iteration" in tables
    assert rows["designs"][:2] == [2, 8]
    assert rows["Walker-v0"][1][0] > 0


def test_gpu_leaves_out_what_it_has_no_time_for(run: Callable) -> None:
    code, tables, rows = run("gpu", "--device", "cpu", "--seconds", "0", "--parts", "tasks", "learning")
    assert (code, rows) == (0, {})
    assert "Left out, for the 0 s were over: tasks, learning." in tables


@pytest.mark.slow
def test_gpu_does_every_part(run: Callable) -> None:
    words = "--device cpu --tasks Walker-v0 --goal -100 --seconds 3000".split()
    code, tables, rows = run("gpu", *words)
    assert code == 0, tables
    assert "Tests of tests/envs/test_device.py" in tables
    assert {"8", "1", "learners, 8", "designs", "ppo=parallel, seed 0", "Walker-v0", "3 x 3 in 8"} <= rows.keys()


def test_short_lives_have_a_table_of_their_own() -> None:
    command = [sys.executable, str(SCRIPTS / "lives.py"), "--bodies", "2", "Walker-v0"]
    table = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    assert table[1].split() == ["task", "gymnasium", "drop-in"]
    assert all(float(value) > 0 for value in table[2].split()[1:])
