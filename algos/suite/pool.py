"""Processes that make the members of a suite, on this machine or by Ray; a member that dies takes no other with it."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import platform
import signal
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from warpvox.algos.interrupt import handling, terminable
from warpvox.system import HANGUP, safe_start

INTERRUPTED = "interrupted"
LOG = "log.txt"
"""What a member prints, in the folder of its run."""
Outcome = dict[str, Any]
"""``status`` of a member that has ended, done, failed or interrupted, and its ``error``."""
Make = Callable[[Any, Path], Outcome]
"""Makes a member, given what describes it and the folder of its run."""


class LocalPool:
    """Processes of this machine, each of which makes one member after another.

    ``make`` must be a function of a module, so that other processes find it.
    """

    def __init__(self, make: Make, size: int) -> None:
        self.size, self._make, self._stopping = size, make, False
        self._workers: list[_Worker] = []

    def begin(self, number: int, job: Any, folder: Path) -> None:
        """Begin to make a member; at most ``size`` at a time."""
        worker = next((worker for worker in self._workers if worker.number is None), None)
        if worker is None:
            worker = _Worker.start(self._make)
            self._workers.append(worker)
        worker.number = number
        with contextlib.suppress(OSError):  # it has died, which `wait` finds out
            worker.pipe.send((job, folder))

    def wait(self, seconds: float) -> list[tuple[int, Outcome]]:
        """The members that have ended, by number, as soon as there is one or the time is over."""
        busy: dict[Any, _Worker] = {worker.pipe: worker for worker in self._workers if worker.number is not None}
        ended = []
        for pipe in wait(list(busy), seconds):
            worker = busy[pipe]
            try:
                outcome = worker.pipe.recv()
            except (EOFError, OSError):
                outcome = self._lost(worker)
            ended.append((worker.number, outcome))
            worker.number = None
        return ended

    def _lost(self, worker: _Worker) -> Outcome:
        """The error of a member whose process has ended without a result."""
        self._workers.remove(worker)
        worker.process.join()
        code = worker.process.exitcode or 0
        # what asks all of a group to end ends a process that makes no member at the moment
        if self._stopping or code == -signal.SIGTERM:
            return {"status": INTERRUPTED}
        name = signal.Signals(-code).name if -code in set(signal.Signals) else ""
        how = f"was ended by {name}" if name else f"ended with exit code {code}"
        hint = "; the system does so where memory runs out" if name == "SIGKILL" else f"; see its {LOG}"
        return {"status": "failed", "error": f"Its process {how}{hint}."}

    def stop(self) -> None:
        """Ask all members that are being made to save their state and end; :meth:`wait` returns when they have."""
        self._stopping = True
        for worker in self._workers:
            worker.process.terminate()

    def close(self) -> None:
        """Release the processes; what still runs is ended at once."""
        for worker in self._workers:
            worker.process.kill()
            worker.process.join()
            worker.pipe.close()
        self._workers = []


@dataclass
class _Worker:
    """A process, the pipe to it, and the member that it makes."""

    process: BaseProcess
    pipe: Connection
    number: int | None = None

    @classmethod
    def start(cls, make: Make) -> _Worker:
        context = multiprocessing.get_context("spawn")  # a fork would copy threads of torch and Warp half
        ours, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(theirs, make, Path.cwd()))
        # from its first moment: the process takes over what is ignored
        with safe_start(), handling((signal.SIGINT, HANGUP), signal.SIG_IGN):
            process.start()
        theirs.close()
        return cls(process, ours)


def _serve(pipe: Connection, make: Make, here: Path) -> None:
    """The main loop of a worker in the folder ``here``: it ends with the process that has started it.

    What a terminal sends to all processes, SIGINT and SIGHUP, it ignores; SIGTERM is what :meth:`LocalPool.stop` sends.
    """
    os.chdir(here)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Windows does not hand down what is ignored
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with contextlib.suppress(EOFError):
        while True:
            job, folder = pipe.recv()
            _print_to(folder / LOG)
            outcome: Outcome = {"status": INTERRUPTED}
            with contextlib.suppress(KeyboardInterrupt), terminable():
                outcome = make(job, folder)
            sys.stdout.flush()
            pipe.send(outcome)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None  # of a worker
    parent.join()
    os._exit(1)


def _print_to(file: Path) -> None:
    """Send what the process prints, its libraries and the interpreter included, to the end of a file."""
    with file.open("ab") as log:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        for number in (1, 2):
            os.dup2(log.fileno(), number)


class RayPool:
    """As :class:`LocalPool`, by tasks of Ray, on a cluster whose machines share the disk that the suite lies on.

    Args:
        make: as for :class:`LocalPool`.
        workers, address, cpus, gpus: as for :class:`warpvox.algos.codesign.ray_executor.RayExecutor`; of a member.
    """

    def __init__(self, make: Make, workers: int | None, address: str | None, cpus: int, gpus: float | None) -> None:
        from warpvox.algos.codesign.ray_executor import connect

        self._ray, self.size, gpus = connect(address, workers, cpus, gpus)
        # a member whose machine is lost goes on from its folder
        options = {"num_cpus": cpus, "num_gpus": gpus, "max_retries": 2, "max_calls": 1}
        self._task = self._ray.remote(**options)(_make_there)
        self._make, self._stopping = make, False
        self._numbers: dict[Any, int] = {}

    def begin(self, number: int, job: Any, folder: Path) -> None:
        self._numbers[self._task.remote(self._make, job, folder.absolute(), Path.cwd())] = number

    def wait(self, seconds: float) -> list[tuple[int, Outcome]]:
        if not self._numbers:
            return []
        ended, _ = self._ray.wait(list(self._numbers), num_returns=len(self._numbers), timeout=0)
        if not ended:
            ended, _ = self._ray.wait(list(self._numbers), timeout=seconds)
        return [(self._numbers.pop(task), self._outcome(task)) for task in ended]

    def _outcome(self, task: Any) -> Outcome:
        try:
            return self._ray.get(task)
        except self._ray.exceptions.RayError as error:
            if self._stopping:
                return {"status": INTERRUPTED}
            return {"status": "failed", "error": " ".join(str(error).split())[:300]}

    def stop(self) -> None:
        self._stopping = True
        for task in self._numbers:
            self._ray.cancel(task)

    def close(self) -> None:
        self._ray.shutdown()


def _make_there(make: Make, job: Any, folder: Path, here: Path) -> Outcome:
    from warpvox.algos.codesign.ray_executor import change_folder

    change_folder(here)
    if not folder.is_dir():
        error = f"There is no folder {folder} on {platform.node()}: a suite needs a disk that all machines share."
        return {"status": "failed", "error": error}
    log = folder / LOG
    with log.open("a", encoding="utf-8") as out, contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        return make(job, folder)
