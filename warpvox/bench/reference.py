"""The reference in a Python of its own: how it is made, started and asked."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from warpvox.errors import ConfigError
from warpvox.io.console import echo
from warpvox.system import python_of
from warpvox.types import ACTION_HIGH, ACTION_LOW

__all__ = ["Reference", "find_python310", "make_reference", "open_reference", "reference_folder", "reference_python"]

PACKAGE = "evogym==2.0.0"
WORKS_WITH = "numpy<2"
"""The numpy that the release was built against."""
WORKER = Path(__file__).with_name("reference_worker.py")
HOW_TO_GET_IT = (
    f"peer.make=true makes it, or python3.10 -m venv ref && ref/bin/pip install {PACKAGE}, peer.python=ref/bin/python"
)


def open_reference(config: Any, report: Any) -> AbstractContextManager[Reference | None]:
    """The reference that ``peer.*`` names, made first if so asked; None where there is none.

    Raises:
        ConfigError: it cannot be made or run.
    """
    python = reference_python(config, report)
    return nullcontext() if python is None else Reference(python)


def reference_python(config: Any, report: Any) -> str | None:
    """The interpreter of the reference, whose environment is made first if so asked; None where there is none.

    Raises:
        ConfigError: it cannot be made.
    """
    python = config.peer.python
    if config.peer.make and python is None:
        with report.status(f"making an environment with {PACKAGE}"):
            python = str(make_reference(reference_folder()))
        echo(report.console, f"the reference: {python}")
    made = python_of(reference_folder())
    return str(made) if python is None and made.is_file() else python


def reference_folder() -> Path:
    """The folder where ``peer.make`` puts the environment, and where it is looked for."""
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(cache) / "warpvox" / "reference"


def make_reference(folder: Path) -> Path:
    """Make a virtual environment with the reference, unless it is there; returns its interpreter.

    Raises:
        ConfigError: no Python 3.10 (the release has wheels for no newer one), or the installation failed.
    """
    python = python_of(folder)
    if python.is_file() and _runs(python, "import evogym"):
        return python
    base = find_python310()
    if base is None:
        raise ConfigError(
            "The reference needs Python 3.10, and none was found on PATH, with pyenv or with uv; install one"
            " (pyenv install 3.10, uv python install 3.10)."
        )
    shutil.rmtree(folder, ignore_errors=True)
    folder.parent.mkdir(parents=True, exist_ok=True)
    try:
        _run([base, "-m", "venv", folder])
        _run([python, "-m", "pip", "install", "--disable-pip-version-check", PACKAGE, WORKS_WITH])
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)  # half an environment would be taken for a whole one
        raise
    return python


def find_python310() -> Path | None:
    """An interpreter of version 3.10 that runs: this one, one on PATH, of pyenv or of uv."""
    for candidate in _candidates():
        if candidate.is_file() and _runs(candidate, "import sys, venv; sys.exit(sys.version_info[:2] != (3, 10))"):
            return candidate
    return None


def _candidates() -> Iterator[Path]:
    on_path = map(shutil.which, ("python3.10", "python3", "python"))
    yield from map(Path, [sys.executable, *filter(None, on_path)])
    yield from sorted(Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")).glob("versions/3.10*/bin/python"))
    yield from sorted(Path.home().glob(".local/share/uv/python/cpython-3.10*/bin/python3.10"))


def _runs(python: Path, code: str) -> bool:
    try:
        done = subprocess.run([python, "-I", "-c", code], capture_output=True, timeout=60)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


def _run(words: Sequence[object]) -> None:
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True)
    if done.returncode:
        lines = (done.stderr or done.stdout).strip().splitlines() or ["no reason given"]
        raise ConfigError(f"The reference could not be installed: {lines[-1]}")


class Reference:
    """The reference in a process of its own.

    Raises:
        ConfigError: no interpreter is named, or it cannot run evogym.
    """

    def __init__(self, python: str | None) -> None:
        if not python:
            raise ConfigError(f"The reference is missing: {HOW_TO_GET_IT}")
        path = Path(python).expanduser()
        if not path.is_file():
            raise ConfigError(f"peer.python={python} is no file. The reference: {HOW_TO_GET_IT}")
        self.versions: dict[str, str] = {}
        try:
            # isolated, so that neither this folder nor PYTHONPATH can shadow what the reference imports
            self._process: Any = subprocess.Popen(
                [str(path), "-I", str(WORKER)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
        except OSError as error:
            raise ConfigError(f"peer.python={python} cannot be run: {error.strerror}.") from None

    def __enter__(self) -> Reference:
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        try:
            self._process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    @property
    def name(self) -> str:
        """Package and versions, once it has started a task."""
        return f"evogym {self.versions['evogym']}, Python {self.versions['python']}"

    def start(self, task: str, body: Any) -> None:
        """Make the environment that the next questions are about; ``task`` is our id."""
        from warpvox.envs.registry import released_id

        self.versions = self.ask(do="start", task=released_id(task), body=body.tolist())

    def centres(self, actions: Any) -> list[list[float]]:
        """The robot's centre of mass after each of the steps, from a reset on."""
        return self.ask(do="check", actions=actions.tolist())["com"]

    def rate(self, actions: Any) -> float:
        """Control steps per second of CPU time, going on with the episode; rewards and observations included."""
        return len(actions) / self.ask(do="time", actions=actions.tolist())["seconds"]

    def timer(self, steps: int, actuators: int, seed: int) -> Callable[[], float]:
        """A function that measures the rate of so many steps under random actions, other ones each time."""
        rng = np.random.default_rng(seed)
        return lambda: self.rate(rng.uniform(ACTION_LOW, ACTION_HIGH, (steps, actuators)))

    def ask(self, **request: Any) -> dict[str, Any]:
        """Send a request and return its answer.

        Raises:
            ConfigError: the reference has failed.
        """
        line = ""
        try:
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
            line = self._process.stdout.readline()
        except BrokenPipeError:
            pass
        try:
            answer = json.loads(line)
        except json.JSONDecodeError:
            answer = {"error": f"it ended without an answer to '{request['do']}'"}
        if "error" in answer:
            reason = str(answer["error"]).splitlines()[0]
            raise ConfigError(f"The reference failed ({reason}). A fresh one: {HOW_TO_GET_IT}")
        return answer
