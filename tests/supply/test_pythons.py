"""The wheel in clean environments of every supported Python that this machine has: ``make packaging``.

Everything that a user gets, torch included, is installed into the Python of the tests, or into all of them with
WARPVOX_PACKAGING=full: torch's builds weigh up to gigabytes. The others get the rest, from the hashed lock.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from tiny import tiny

pytestmark = pytest.mark.packaging

PYTHONS = ("3.10", "3.11", "3.12", "3.13", "3.14")
THIS = "{}.{}".format(*sys.version_info)
FULL = os.environ.get("WARPVOX_PACKAGING") == "full"


def candidates(version: str) -> Iterator[str]:
    """Where a Python of this version may be: the one that runs, on PATH, among pyenv's."""
    if version == THIS:
        yield sys.executable
    for folder in os.environ.get("PATH", "").split(os.pathsep):
        found = shutil.which(f"python{version}", path=folder)
        if found:
            yield found
    root = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    for path in sorted(root.glob(f"versions/{version}.*/bin/python"), reverse=True):
        yield str(path)


def interpreter(version: str) -> str:
    """A Python of this version that can make virtual environments; skips the test where there is none."""
    code = "import sys, venv, ensurepip; print('{}.{}'.format(*sys.version_info))"
    for path in candidates(version):
        run = subprocess.run([path, "-c", code], capture_output=True, text=True)  # pyenv's shims may lead nowhere
        if run.returncode == 0 and run.stdout.strip() == version:
            return path
    pytest.skip(f"no Python {version} with venv on this machine")


class Clean:
    """A virtual environment of its own, with nothing of the one that runs the tests."""

    def __init__(self, base: str, folder: Path) -> None:
        self.folder = folder
        self.bin = folder / "venv" / ("Scripts" if os.name == "nt" else "bin")
        leaks = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
        self.environment = {key: value for key, value in os.environ.items() if key not in leaks}
        self.environment["PYTHONNOUSERSITE"] = "1"
        self.run(base, "-m", "venv", str(folder / "venv"))

    def run(self, *command: str, expect: int = 0) -> str:
        run = subprocess.run(command, cwd=self.folder, env=self.environment, capture_output=True, text=True)
        assert run.returncode == expect, f"{command}\n{run.stdout[-4000:]}\n{run.stderr[-4000:]}"
        return run.stdout

    def python(self, *words: str, expect: int = 0) -> str:
        return self.run(str(self.bin / "python"), *words, expect=expect)

    def pip(self, *words: str) -> None:
        # packages run a handful of modules: compiling all of them to bytecode would take longer than the rest
        self.python("-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile", *words)

    def warpvox(self, line: str) -> str:
        return self.run(str(self.bin / "warpvox"), *line.split())


@pytest.fixture
def clean(version: str, tmp_path: Path) -> Iterator[Clean]:
    yield Clean(interpreter(version), tmp_path)
    shutil.rmtree(tmp_path / "venv")


@pytest.mark.parametrize("version", PYTHONS if FULL else [THIS])
def test_the_wheel_trains(clean: Clean, repository: Path, wheel: Path) -> None:
    clean.pip("-c", str(repository / "constraints.txt"), str(wheel))
    clean.python("-m", "pip", "check")
    assert "torch" in clean.warpvox("info")
    assert "Walker-v0" in clean.warpvox("tasks")
    clean.warpvox(" ".join(tiny("train", "max_iterations=2")))
    (summary,) = clean.folder.glob("outputs/train/Walker-v0/*/summary.json")
    assert summary.stat().st_size > 0


@pytest.mark.parametrize("version", [version for version in PYTHONS if version != THIS])
def test_the_wheel_works_without_torch(clean: Clean, repository: Path, wheel: Path) -> None:
    clean.pip("--no-deps", "--require-hashes", "-r", str(repository / "locks" / "run.txt"))
    clean.pip("--no-deps", str(wheel))
    missing = clean.python("-m", "pip", "check", expect=1).splitlines()
    assert missing
    assert all("torch, which is not installed" in line for line in missing), missing
    script = Path(__file__).with_name("without_torch.py")
    assert "fine" in clean.python("-I", str(script), str(clean.folder))
