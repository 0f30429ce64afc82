"""A small sample of what ``tests/fuzz/run.py`` feeds to every reader; the large one is marked slow."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from fuzz_arguments import Editor, Environments, function_targets
from fuzz_files import Readers
from fuzz_harness import Target, feed, make, shortened

from warpvox.errors import DesignError

SAMPLE = 100
SLOW_TARGETS = {
    "make_vec": 20,
    "Simulation": 30,
    "command line": 20,
    "sample_design": 40,
    "task files": 30,
    "checkpoint .pt": 60,
    "rollout .npz": 60,
    "config.yaml of a run": 20,
}
"""Those of which an input takes tens of milliseconds or more."""
SEED = 0


@pytest.fixture(scope="module")
def targets(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Target]]:
    folder, before = tmp_path_factory.mktemp("fuzz"), Path.cwd()
    editor = Editor(folder)
    os.chdir(folder)
    found = [*Readers(folder).targets(), *function_targets(folder), *editor.targets(), *Environments().targets()]
    yield {target.name: target for target in found}
    os.chdir(before)
    editor.close()


NAMES = [
    *("world .json", "world .json, drop-in", "object .txt, drop-in", "design .json", "design .npz", "design .npy"),
    *("rollout .npz", "checkpoint .pt", "archive .sqlite", "config.yaml of a run", "load_design", "sample_design"),
    *("World methods", "command line", "task files", "editor, HTTP requests", "editor, documents", "actions"),
    *("make_vec", "Simulation"),
]


@pytest.mark.parametrize("name", NAMES)
def test_spoilt_inputs_are_refused_or_of_use(targets: dict[str, Target], name: str) -> None:
    figures = feed(targets[name], SLOW_TARGETS.get(name, SAMPLE), SEED)
    assert not figures.defects, "\n".join(f"{shortened(given)}\n{defect}" for given, defect in figures.defects)
    assert figures.refused > figures.inputs // 10  # else the inputs are not spoilt, or nothing looks at them
    assert list(Path.cwd().rglob("pwned")) == []


def test_every_target_is_tested(targets: dict[str, Target]) -> None:
    assert sorted(targets) == sorted(NAMES)


def test_inputs_can_be_made_again(targets: dict[str, Target]) -> None:
    target = targets["design .json"]
    assert make(target, 7, 3) == make(target, 7, 3)
    assert len({make(target, number, SEED) for number in range(50)}) > 40


@pytest.mark.parametrize(
    ("run", "words"),
    [
        (lambda given: {}["x"], "KeyError"),
        (lambda given: exec("raise DesignError('')", {"DesignError": DesignError}), "without a message"),
        (lambda given: bytearray(10**8), "MB of memory"),
        (lambda given: exec("while True: pass"), "of the processor"),
        (lambda given: 1 / (given == 0), "ZeroDivisionError"),
    ],
)
def test_the_harness_notices(run, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fuzz_harness.SECONDS", 0.2)
    figures = feed(Target("made up", lambda draw: 1, run), 1, SEED)
    assert len(figures.defects) == 1
    assert words in figures.defects[0][1]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["design .npz", "world .json", "rollout .npz", "checkpoint .pt"])
def test_readers_under_the_eyes_of_atheris(repository: Path, name: str) -> None:
    pytest.importorskip("atheris", reason="atheris is not installed (pip install atheris)")
    command = [sys.executable, str(repository / "tests" / "fuzz" / "guided.py"), name, "-runs=5000"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-4000:]


@pytest.mark.slow
def test_a_hundred_thousand_inputs(repository: Path) -> None:
    script = repository / "tests" / "fuzz" / "run.py"
    done = subprocess.run([sys.executable, str(script), "count=100000"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
