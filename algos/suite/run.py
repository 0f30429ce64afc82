"""The making of a suite's members: several at a time, in processes of this machine or in tasks of Ray."""

import dataclasses
import time
import traceback
from collections import deque
from pathlib import Path
from typing import Any

from rich.console import Console

from warpvox.algos.codesign.progress import SearchProgress
from warpvox.algos.codesign.run import environments, run_codesign
from warpvox.algos.codesign.settings import Codesign
from warpvox.algos.interrupt import deferred_interrupts
from warpvox.algos.suite.members import DONE, FAILED, RUNNING, WAITING, Table
from warpvox.algos.suite.pool import INTERRUPTED, LocalPool, RayPool
from warpvox.algos.suite.progress import SuiteProgress
from warpvox.devices.names import resolve_device
from warpvox.errors import StorageError, WarpvoxError, counted
from warpvox.io.console import echo
from warpvox.io.writing import OF_FULL_DISKS
from warpvox.system import available_memory, usable_cores

POLL_SECONDS = 0.5
FULL = "full"
"""Status of a member that has ended for lack of room on its disk: when there is some, it goes on."""
PROCESS_BYTES = 1_000_000_000
"""Of memory that a process should find free: PyTorch, Warp and a small search take half of it."""


def make_members(table: Table, config: Any, console: Console) -> None:
    """Make the members of the table that wait, several at a time.

    Args:
        config: ``executor``, ``workers``, ``address``, ``device`` and ``threads``, as the keys of ``warpvox suite``.

    Raises:
        KeyboardInterrupt: interrupted; the members have saved their states. StorageError: the disk is full.
    """
    waiting, running = deque(enumerate(table.of(WAITING))), {}
    pool, threads = _pool(config, [member.settings for _, member in waiting])
    echo(console, f"{pool.size} at a time, each with {counted(threads, 'threads')}")
    try:
        with deferred_interrupts() as interrupt, SuiteProgress(table, console) as progress:
            stopping, full = False, ""
            while running or (waiting and not interrupt and not full):
                while waiting and len(running) < pool.size and not interrupt and not full:
                    number, member = waiting.popleft()
                    member.folder.mkdir(parents=True, exist_ok=True)
                    given = {"threads": threads, "name": table.folder.name}  # the group of its members
                    pool.begin(number, dataclasses.replace(member.settings, **given), member.folder)
                    member.state, member.began, running[number] = RUNNING, time.monotonic(), member
                for number, outcome in pool.wait(POLL_SECONDS):
                    member = running.pop(number)
                    member.state = outcome["status"] if outcome["status"] in (DONE, FAILED) else WAITING
                    member.error = outcome.get("error", "") if member.state == FAILED else ""
                    full = outcome["error"] if outcome["status"] == FULL else full
                    table.write()
                    table.write_curves()
                    progress.ended(member)
                if (interrupt or full) and not stopping:
                    why = "the disk is full" if full else "interrupted"
                    echo(console, f"{why}: waiting for the members to save their states")
                    pool.stop()
                    stopping = True
                progress.refresh()
            if stopping:
                echo(console, f"stopped, state saved; {len(table.of(DONE))} of {len(table.members)} members are done")
            if interrupt:
                interrupt.stop()
            if full:
                raise StorageError(full)
    finally:
        pool.close()


def _pool(config: Any, members: list[Codesign]) -> tuple[LocalPool | RayPool, int]:
    """The processes that make the members, and the threads of each."""
    if config.executor == "ray":
        threads, gpus = config.threads or 1, 0 if config.device == "cpu" else None
        return RayPool(make_member, config.workers, config.address, threads, gpus), threads
    cores, free = usable_cores(), available_memory()
    room = cores if resolve_device(config.device, max(map(environments, members))) == "cpu" else 1
    room = room if free is None else max(1, min(room, free // PROCESS_BYTES))
    workers = min(config.workers or room, len(members))
    return LocalPool(make_member, workers), config.threads or max(1, cores // workers)


def make_member(settings: Codesign, folder: Path) -> dict[str, Any]:
    """Make a design search in ``folder``, or go on with the one that is there; returns how it has ended."""
    console, full = Console(), False
    try:
        run_codesign(settings, folder, [SearchProgress(console)], console=console)
    except KeyboardInterrupt:
        return {"status": INTERRUPTED}
    except (WarpvoxError, OSError) as error:
        full = isinstance(error, OSError) and error.errno in OF_FULL_DISKS
        text = " ".join(str(error).split())
        echo(console, f"failed: {text}")
        return {"status": FULL if full else FAILED, "error": text}
    except Exception as error:  # a defect; the others have nothing to do with it
        traceback.print_exc()
        return {"status": FAILED, "error": f"{type(error).__name__}: {error}"}
    return {"status": DONE}
