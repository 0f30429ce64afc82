"""Commands that start interpreters import nothing from the current folder, whatever it holds."""

import multiprocessing
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from tiny import tiny

from warpvox.system import safe_start

MODULES = (
    *("socket", "struct", "signal", "pickle", "selectors", "contextlib", "warnings", "types", "threading", "tempfile"),
    *(
        "functools",
        "runpy",
        "json",
        "logging",
        "_compat_pickle",
        "msgpack",
        "psutil",
        "yaml",
        "colorama",
        "setproctitle",
    ),
    *("torch", "numpy", "hydra", "ray", "warp", "sitecustomize", "usercustomize"),
)
"""Names of modules that interpreters and libraries import when they start."""
SEARCH = ("task=Walker-v0", "search=random", "search.population=2")
BY_RAY = tiny("codesign", *SEARCH, "search.max_designs=2", "executor=ray", "workers=1")


@pytest.fixture
def trapped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], list[str]]:
    """The current folder has a module of each name; which of them have run."""
    marks = tmp_path / "marks"
    marks.mkdir()
    here = tmp_path / "here"
    here.mkdir()
    for name in MODULES:
        (here / f"{name}.py").write_text(f"open({str(marks / name)!r}, 'w').close()\nraise ImportError('a trap')\n")
    monkeypatch.chdir(here)
    return lambda: sorted(path.name for path in marks.iterdir())


@pytest.mark.slow  # those of Ray take their time
def test_a_command_that_starts_interpreters(warpvox: Callable, trapped: Callable) -> None:
    pytest.importorskip("ray")
    warpvox(*BY_RAY)
    assert trapped() == []


def test_children_are_safe_by_the_folder_alone(trapped: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    """As with Python 3.10, which does not know the variable."""
    monkeypatch.setattr("warpvox.system.SAFE_PATH", "NO_SUCH_VARIABLE")
    with safe_start():
        child = multiprocessing.get_context("spawn").Process(target=print)
        child.start()
        subprocess.run([sys.executable, "-c", f"import {','.join(MODULES[:12])}"], check=True)
        subprocess.run([sys.executable, "-m", "json.tool", "--help"], check=True, capture_output=True)
    child.join()
    assert (child.exitcode, trapped()) == (0, [])


@pytest.mark.skipif(sys.version_info < (3, 11), reason="Python 3.10 has no such variable")
def test_children_of_a_block_that_stays_are_safe(trapped: Callable) -> None:
    here = Path.cwd()
    with safe_start(move=False):
        assert Path.cwd() == here
        subprocess.run([sys.executable, "-c", f"import {','.join(MODULES[:12])}"], check=True)
        subprocess.run([sys.executable, "-m", "json.tool", "--help"], check=True, capture_output=True)
    assert trapped() == []
    done = subprocess.run([sys.executable, "-c", "import socket"], capture_output=True, check=False)
    assert (done.returncode, trapped()) == (1, ["socket"])  # the trap works, and the block has ended


def test_a_program_that_imports_from_its_folder_has_children_that_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine.py").write_text("")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend("")  # as in a notebook
    with safe_start():
        assert Path.cwd() == tmp_path
        subprocess.run([sys.executable, "-c", "import mine"], check=True)
