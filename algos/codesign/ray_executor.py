"""Executor on many processes and machines by Ray; batches of lost workers are repeated."""

from __future__ import annotations

import logging
import os
import signal
import socket
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

from warpvox.algos.candidate import Candidate, DesignEvaluator, Outcome, Parents
from warpvox.algos.codesign.loop import Batch, Report
from warpvox.errors import ConfigError, RunError, WarpvoxError, first_line
from warpvox.system import safe_start

POLL_SECONDS = 0.5
"""Seconds between requests for progress."""
MAX_ATTEMPTS = 3
"""Number of lost workers after which a batch is given up."""
WORKER_TIMEOUT = 600.0
"""Seconds to wait while no worker is running."""


class _Worker:
    """Ray actor that evaluates batches in one thread and reports progress from another."""

    def __init__(self, make: Callable[[], DesignEvaluator], here: Path) -> None:
        """Change to the folder ``here`` if it exists; ``make`` creates the evaluator on first use."""
        # Relative paths mean what they mean in the program; other machines may lack its folder.
        with suppress(OSError):
            os.chdir(here)
        self._make = make
        self._evaluator = None
        self._events: deque[dict[str, Any]] = deque(maxlen=100)

    def ready(self) -> int:
        """Return the process id, as proof that the process runs."""
        return os.getpid()

    def evaluate(self, candidates: Sequence[Candidate], parents: Parents) -> list[Outcome]:
        """Evaluate ``candidates`` and return their outcomes."""
        self._events.clear()  # drop unread events of the batch before
        # Build it in this thread: some settings of torch belong to the thread that sets them.
        self._evaluator = self._evaluator or self._make()
        return self._evaluator.evaluate(candidates, parents, self._events.append)

    def events(self) -> list[dict[str, Any]]:
        """Return and clear the progress events since the last call."""
        return [self._events.popleft() for _ in range(len(self._events))]


class RayExecutor:
    """Executor that distributes batches over Ray workers, each a process with its own evaluator.

    Results do not depend on the workers: a batch is evaluated whole, by its candidates' seeds.

    Args:
        make: builds the evaluator in a worker; must be picklable.
        workers: number of workers; None: one for each GPU if workers use GPUs, else as many as the CPUs allow.
        address: of a running cluster (``auto`` or ``host:port``); None: start Ray on this machine.
        cpus, gpus: CPUs and GPUs of each worker; ``gpus=None``: one GPU if the cluster has any, else none.
    """

    def __init__(
        self,
        make: Callable[[], DesignEvaluator],
        workers: int | None = None,
        address: str | None = None,
        cpus: int = 1,
        gpus: float | None = 0.0,
    ) -> None:
        self._ray, workers, gpus = connect(address, workers, cpus, gpus)
        groups = {"train": 1, "watch": 1}
        remote = self._ray.remote(num_cpus=cpus, num_gpus=gpus, concurrency_groups=groups, max_restarts=0)
        self._class = remote(_Worker)
        self._make = make
        self._workers = [self._start_worker() for _ in range(workers)]

    @property
    def size(self) -> int:
        return len(self._workers)

    def _start_worker(self) -> _Handle:
        """Start a worker process and return its handle."""
        actor = self._class.remote(self._make, Path.cwd())
        return _Handle(actor, actor.ready.options(concurrency_group="watch").remote())

    def run(self, work: Sequence[Batch], parents: Parents, report: Report) -> Iterator[tuple[int, list[Outcome]]]:
        """Evaluate the batches in ``work`` on the workers; yield each one's index and outcomes as they finish.

        Raises:
            RunError: no worker was available for too long, or a batch has ended too many workers.
        """
        waiting = deque(range(len(work)))
        losses = Counter()
        idle_since = time.monotonic()
        while waiting or any(worker.place is not None for worker in self._workers):
            self._assign(work, parents, waiting)
            busy = [worker for worker in self._workers if worker.place is not None]
            if busy:
                idle_since = time.monotonic()
            elif time.monotonic() - idle_since > WORKER_TIMEOUT:
                raise RunError(f"No worker has come up for {WORKER_TIMEOUT:.0f} s; see `ray status`.")
            awaited = [worker.task for worker in busy] or [worker.up for worker in self._workers]
            self._ray.wait(awaited, timeout=POLL_SECONDS)
            for worker in busy:
                for event in self._events(worker):
                    report(cast(int, worker.place), event)
            for worker in busy:
                if not self._is_done(worker.task):
                    continue
                place = cast(int, worker.place)
                outcomes = self._collect(worker)
                if outcomes is None:
                    losses[place] += 1
                    if losses[place] == MAX_ATTEMPTS:
                        ids = [candidate.id for candidate in work[place].candidates]
                        raise RunError(
                            f"The evaluation of the candidates {ids} has ended its worker {MAX_ATTEMPTS} times."
                        )
                    waiting.appendleft(place)
                else:
                    yield place, outcomes

    def _assign(self, work: Sequence[Batch], parents: Parents, waiting: deque[int]) -> None:
        """Assign waiting batches to idle workers, and replace workers that failed to start."""
        for number, worker in enumerate(self._workers):
            if not waiting:
                return
            if worker.place is not None or not self._is_done(worker.up):
                continue
            try:
                self._ray.get(worker.up)
            except self._ray.exceptions.RayError:
                self._workers[number] = self._start_worker()
                continue
            worker.place = waiting.popleft()
            batch = work[worker.place]
            own = {parent: parents[parent] for item in batch.candidates for parent in item.parents if parent in parents}
            method = worker.actor.evaluate.options(concurrency_group="train")
            worker.task = method.remote(list(batch.candidates), own)

    def _collect(self, worker: _Handle) -> list[Outcome] | None:
        """Return the outcomes of a finished worker; replace a lost worker and return None."""
        errors = self._ray.exceptions
        task = worker.task
        worker.place = worker.task = worker.news = None
        try:
            return self._ray.get(task)
        except errors.RayTaskError as error:
            # raised by the evaluator itself: as it would have been in this process
            cause = error.cause if isinstance(error.cause, WarpvoxError) else None
            raise (RunError(str(cause)) if cause else error) from None
        except errors.RayError:
            self._workers[self._workers.index(worker)] = self._start_worker()
            return None

    def _events(self, worker: _Handle) -> list[dict[str, Any]]:
        """Return a busy worker's new progress events; empty if it does not answer."""
        if worker.news is None:
            worker.news = worker.actor.events.options(concurrency_group="watch").remote()
        if not self._is_done(worker.news):
            return []
        try:
            return self._ray.get(worker.news)
        except self._ray.exceptions.RayError:
            return []
        finally:
            worker.news = None

    def _is_done(self, reference: Any) -> bool:
        """Return whether the result of a Ray task is available."""
        return bool(self._ray.wait([reference], timeout=0)[0])

    def close(self) -> None:
        """Stop the workers, and Ray itself if started by this process."""
        self._ray.shutdown()


class _Handle:
    """A worker and its present batch, in the main process.

    ``actor``: Ray's handle; ``up``: future of its start; ``place``: index of the batch that it evaluates (None: idle);
    ``task`` and ``news``: futures of the evaluation and of the next progress events.
    """

    def __init__(self, actor: Any, up: Any) -> None:
        self.actor = actor
        self.up = up
        self.place: int | None = None
        self.task: Any = None
        self.news: Any = None


def connect(address: str | None, workers: int | None, cpus: int, gpus: float | None) -> tuple[Any, int, float]:
    """Connect to a Ray cluster or start Ray here; return the module, number of workers and GPUs per worker.

    Args:
        workers, address, cpus, gpus: as for :class:`RayExecutor`, which also says what is raised.
    """
    ray = _start(address, (workers or 1) * cpus)
    room = ray.cluster_resources()
    if gpus is None:
        gpus = 1 if room.get("GPU", 0) else 0
    if workers is None:
        workers = int(room.get("GPU", 0) // gpus if gpus else room.get("CPU", 0) // cpus)
    if workers < 1 or room.get("CPU", 0) < cpus or room.get("GPU", 0) < gpus:
        ray.shutdown()
        raise RunError(
            f"The cluster has {room.get('CPU', 0):g} CPUs and {room.get('GPU', 0):g} GPUs; a worker takes {cpus}"
            f" and {gpus:g}."
        )
    return ray, workers, gpus


def _start(address: str | None, cpus: int) -> Any:
    """Connect to a Ray cluster or start Ray here with at least ``cpus`` CPUs; return the module."""
    # Ray gives its workers a low priority and reports usage, unless told otherwise before it starts
    os.environ.setdefault("RAY_worker_niceness", "0")
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    try:
        import ray
    except ImportError:
        raise ConfigError("executor=ray needs Ray, which is not installed: pip install 'warpvox[ray]'.") from None
    where = f"at {address}" if address else "on this machine"
    if address:
        # Ray itself would try for minutes. It resolves `auto` and the like.
        host, _, port = address.removeprefix("ray://").rpartition(":")
        if port.isdigit():
            try:
                socket.create_connection((host, int(port)), timeout=10).close()
            except OSError as error:
                raise RunError(f"Ray cannot be reached {where}: {error.strerror or error}.") from None
    options: dict[str, Any] = {"address": address} if address else {}
    if address is None:
        options = {"include_dashboard": False, "num_cpus": max(cpus, os.cpu_count() or 1)}
    before = signal.getsignal(signal.SIGTERM)
    try:
        with safe_start():
            ray.init(**options, logging_level=logging.ERROR, log_to_driver=False)
    except (ConnectionError, RuntimeError, ValueError, OSError) as error:
        raise RunError(f"Ray cannot be reached {where}: {first_line(error)}") from None
    finally:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, before)  # Ray's handler would end this process before anything is saved
    return ray
