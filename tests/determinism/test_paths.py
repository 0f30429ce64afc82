"""What is promised of results holds on other CPUs: here, on the code paths that libraries take there."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from rollouts import PRECISIONS, digest

AVX2 = {"ATEN_CPU_CAPABILITY": "avx2", "ONEDNN_MAX_CPU_ISA": "AVX2", "MKL_ENABLE_INSTRUCTIONS": "AVX2"}
PATHS: dict[str, dict[str, str]] = {
    "plain": {"ATEN_CPU_CAPABILITY": "default", "ONEDNN_MAX_CPU_ISA": "SSE41", "MKL_CBWR": "COMPATIBLE"},
    "avx2": AVX2,
    "intel": {"LD_PRELOAD": "mkl.c"},
    "intel-avx2": {"LD_PRELOAD": "mkl.c", **AVX2},
}
"""Name -> environment: vector instructions of torch, oneDNN and MKL, and MKL as on a CPU of Intel's."""
SLOW = pytest.mark.slow
EACH = pytest.mark.parametrize(
    "path", [pytest.param(path, marks=[] if path in ("plain", "intel") else SLOW) for path in PATHS]
)
TASKS = ["Walker-v0", "Catcher-v0"]
PROGRAM = Path(__file__).with_name("rollouts.py")
PROMISES = "company[fast-Catcher-v0] or survivor[Walker-v0] or threads[2]"
"""Of the tests of trainings side by side, some that compare one training with another. Where MKL takes a CPU for one of
Intel's, the bits of a design do depend on the other designs of its batch in these."""

PRODUCT = """
import torch
generator = torch.Generator().manual_seed(0)
one, other = (torch.randn((5, 67, 67), generator=generator) for _ in range(2))
print(float((one @ other).double().square().sum()).hex())
"""


@pytest.fixture(scope="module")
def environment_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], dict[str, str]]:
    """``environment_of(path)``: the environment of a process that takes a code path of :data:`PATHS`."""

    def call(path: str) -> dict[str, str]:
        found = os.environ | PATHS[path]
        if "LD_PRELOAD" in PATHS[path]:
            compiler = shutil.which("cc")
            if compiler is None or not sys.platform.startswith("linux"):
                pytest.skip("MKL is told of another CPU on Linux with a C compiler (cc)")
            library = tmp_path_factory.mktemp("mkl") / "mkl.so"
            source = Path(__file__).with_name(PATHS[path]["LD_PRELOAD"])
            subprocess.run([compiler, "-shared", "-fPIC", str(source), "-o", str(library)], check=True)
            found["LD_PRELOAD"] = " ".join(filter(None, [str(library), os.environ.get("LD_PRELOAD")]))
        return found

    return call


def run(environment: dict[str, str], *words: str) -> str:
    """The output of a Python program."""
    done = subprocess.run([sys.executable, *words], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_paths_are_different_ones(environment_of: Callable) -> None:
    """On some CPU others of them may be the same."""
    assert len({run(environment_of(path), "-c", PRODUCT) for path in ("plain", "intel-avx2")}) == 2


@pytest.mark.parametrize("path", ["plain", "intel-avx2"])
def test_a_rollout_has_the_same_bits(environment_of: Callable, path: str) -> None:
    found = json.loads(run(environment_of(path), str(PROGRAM), "{}", *TASKS).splitlines()[-1])
    assert found == {name: {task: digest(task, name) for task in TASKS} for name in PRECISIONS}


@EACH
def test_trainings_keep_their_promises(environment_of: Callable, path: str, repository: Path) -> None:
    names = ("codesign/test_population_evaluator.py", "population/test_ppo.py")
    files = [str(repository / "tests" / "algos" / name) for name in names]
    said = run(environment_of(path), "-m", "pytest", "-p", "no:cacheprovider", "-p", "no:xdist", *files, "-k", PROMISES)
    assert "3 passed" in said
