"""The fixed rollout of every task is the pinned one, on any machine and in any process."""

import json
import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from rollouts import PINNED, PRECISIONS, digest, digests

from warpvox.envs.registry import task_ids

PROGRAM = Path(__file__).with_name("rollouts.py")
EACH = pytest.mark.parametrize("precision", PRECISIONS)
pinned = json.loads(PINNED.read_text(encoding="utf-8"))
mine = cache(digest)


def elsewhere(tasks: list[str], options: dict[str, object], environment: dict[str, str]) -> dict[str, dict[str, str]]:
    program = [sys.executable, str(PROGRAM), json.dumps(options), *tasks]
    done = subprocess.run(program, env=os.environ | environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@EACH
@pytest.mark.parametrize("task", task_ids())
def test_a_rollout_is_the_pinned_one(task: str, precision: str) -> None:
    assert mine(task, precision) == pinned[precision][task], "if that is meant: python tests/determinism/record.py"


@pytest.mark.parametrize("tasks", [task_ids()[::8], pytest.param(task_ids(), marks=pytest.mark.slow)], ids=len)
def test_another_process_gives_the_same_bits(tasks: list[str]) -> None:
    """Started with other hashes, with two threads, and with a torch that uses no vector instructions."""
    found = elsewhere(tasks, {"threads": 2}, {"PYTHONHASHSEED": "1", "ATEN_CPU_CAPABILITY": "default"})
    assert found == {name: {task: mine(task, name) for task in tasks} for name in PRECISIONS}


WITHOUT_AVX_512 = """
import json, runpy, sys, warp
flags = [flag for flag in warp.config.cpu_compiler_flags.split() if flag != "-march=native"]
warp.config.cpu_compiler_flags = " ".join(flags)
sys.argv = {argv!r}
runpy.run_path(sys.argv[0], run_name="__main__")
"""


@pytest.mark.slow  # it compiles all kernels once more
def test_the_instructions_of_the_cpu_do_not_matter() -> None:
    program = WITHOUT_AVX_512.format(argv=[str(PROGRAM), "{}"])
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found == {name: {task: mine(task, name) for task in task_ids()} for name in PRECISIONS}


@pytest.mark.parametrize(
    ("precision", "lanes"),
    [
        ("float32", 1),
        ("float32", 32),
        ("float64", 1),
        *(pytest.param("float64", n, marks=pytest.mark.slow) for n in (16, 32)),
    ],
)
@pytest.mark.parametrize("task", ["Walker-v0", "Carrier-v0", "Climber-v0", "Catcher-v0"])
def test_the_width_of_lanes_does_not_matter(task: str, precision: str, lanes: int) -> None:
    assert digest(task, precision, lanes=lanes) == mine(task, precision)


def test_every_task_is_pinned_in_both_precisions() -> None:
    assert {name: sorted(found) for name, found in pinned.items()} == {name: sorted(task_ids()) for name in PRECISIONS}
    single, double = (pinned[name] for name in PRECISIONS)
    assert not [task for task in task_ids() if single[task] == double[task]]


def test_digests_tell_rollouts_apart() -> None:
    assert digest("Walker-v0", "float64", max_episode_steps=19) != mine("Walker-v0", "float64")
    assert digest("Catcher-v0", "float64", seed=12) != mine("Catcher-v0", "float64")
    assert digests(["Walker-v0"])["float32"]["Walker-v0"] == mine("Walker-v0", "float32")
