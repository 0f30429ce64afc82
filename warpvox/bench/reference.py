"""The reference in a Python of its own: how it is made, started and asked."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from warpvox.bench import reference_worker
from warpvox.envs.registry import released_id
from warpvox.errors import ConfigError
from warpvox.io.console import echo
from warpvox.system import python_of
from warpvox.types import ACTION_HIGH, ACTION_LOW

PACKAGE = "evogym==2.0.0"
WORKS_WITH = "numpy<2"
"""The numpy that the release was built against."""
MAKE = "make"
HOW_TO_GET_IT = f"peer=make makes it, or python3.10 -m venv ref && ref/bin/pip install {PACKAGE}, peer=ref/bin/python"


def open_reference(config: Any, report: Any) -> AbstractContextManager[Reference | None]:
    """The reference that ``peer`` names, made first if so asked; None: none; ConfigError: it does not run."""
    made = python_of(reference_folder())
    if config.peer == MAKE:
        with report.console.status(f"making an environment with {PACKAGE}"):
            make_reference(reference_folder())
        echo(report.console, f"the reference: {made}")
    if config.peer in (None, MAKE):
        return Reference(made) if made.is_file() else nullcontext()
    return Reference(Path(config.peer))


def reference_folder() -> Path:
    """The folder where ``peer=make`` puts the environment, and where it is looked for."""
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(cache) / "warpvox" / "reference"


def make_reference(folder: Path) -> None:
    """Make a virtual environment with the reference, unless it is there."""
    python = python_of(folder)
    if python.is_file() and not subprocess.run([python, "-I", "-c", "import evogym"], capture_output=True).returncode:
        return
    base = shutil.which("python3.10")
    if base is None:
        raise ConfigError(
            "The reference needs Python 3.10, and there is no python3.10 on PATH; install one"
            " (pyenv install 3.10, uv python install 3.10)."
        )
    install = [python, "-m", "pip", "install", "--disable-pip-version-check", PACKAGE, WORKS_WITH]
    try:
        for words in ([base, "-m", "venv", "--clear", folder], install):
            subprocess.run(list(map(str, words)), capture_output=True, text=True, check=True)
    except subprocess.CalledProcessError as error:
        shutil.rmtree(folder, ignore_errors=True)  # half an environment would be taken for a whole one
        lines = (error.stderr or error.stdout).strip().splitlines() or ["no reason given"]
        raise ConfigError(f"The reference could not be installed: {lines[-1]}") from None


class Reference:
    """The reference in a process of its own; ConfigError: the interpreter cannot be run."""

    def __init__(self, python: Path) -> None:
        python, self.versions = python.expanduser(), {}
        if not python.is_file():
            raise ConfigError(f"peer={python} is no file. The reference: {HOW_TO_GET_IT}")
        try:
            # isolated, so that neither this folder nor PYTHONPATH can shadow what the reference imports
            self._process: Any = subprocess.Popen(
                [str(python), "-I", reference_worker.__file__],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
        except OSError as error:
            raise ConfigError(f"peer={python} cannot be run: {error.strerror}.") from None

    def __enter__(self) -> Reference:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()  # it has nothing to save
        self._process.communicate()

    def start(self, task: str, body: Any) -> None:
        """Make the environment that the next questions are about; ``task`` is our id."""
        self.versions = self._ask(do="start", task=released_id(task), body=body.tolist())

    def centres(self, actions: np.ndarray) -> list[list[float]]:
        """The robot's centre of mass after each of the steps, from a reset on."""
        return self._ask(do="check", actions=actions.tolist())

    def timer(self, steps: int, actuators: int, seed: int) -> Callable[[], float]:
        """Gives control steps per second of CPU time, going on with the episode; rewards and observations included."""
        return random_rate(lambda actions: self._ask(do="time", actions=actions.tolist()), steps, actuators, seed)

    def _ask(self, **request: Any) -> Any:
        """The answer to a request; ConfigError: the reference has failed."""
        line = ""
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
            line = self._process.stdout.readline()
        try:
            answer = json.loads(line)
        except json.JSONDecodeError:
            answer = {"error": f"it ended without an answer to '{request['do']}'"}
        if isinstance(answer, dict) and "error" in answer:
            reason = str(answer["error"]).splitlines()[0]
            raise ConfigError(f"The reference failed ({reason}). A fresh one: {HOW_TO_GET_IT}")
        return answer


def random_rate(seconds: Callable[[np.ndarray], float], steps: int, actuators: int, seed: int) -> Callable[[], float]:
    """A function that measures steps per second under random actions, other ones each time.

    ``seconds`` says how long actions ``[steps, actuators]`` take.
    """
    rng = np.random.default_rng(seed)
    return lambda: steps / seconds(rng.uniform(ACTION_LOW, ACTION_HIGH, (steps, actuators)))
