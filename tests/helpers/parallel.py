"""Tests in several processes: number of processes and threads, and compilation of kernels in turn."""

import functools
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

MEMORY_OF_A_WORKER = 2.5 * 2**30
"""Memory of a test process with torch, Warp, kernels and a child process, in bytes."""
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
QUOTA = Path("/sys/fs/cgroup/cpu.max")
LIMIT = Path("/sys/fs/cgroup/memory.max")


def one_thread_each() -> None:
    """Limit linear algebra libraries, also in child processes, to one thread, unless the environment says otherwise.

    To be called before they are imported.
    """
    for name in THREADS:
        os.environ.setdefault(name, "1")


def workers() -> int:
    """Return the number of test processes, limited by cores and memory."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    share, _, period = _words(QUOTA).partition(" ")
    if share.isdigit():
        cores = min(cores, max(1, int(share) // int(period)))
    room = [int(MEMORY_OF_A_WORKER) * cores]
    if hasattr(os, "sysconf") and "SC_AVPHYS_PAGES" in os.sysconf_names:
        room.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    if (limit := _words(LIMIT)).isdigit():
        room.append(int(limit))
    return max(1, min(cores, int(min(room) / MEMORY_OF_A_WORKER)))


def _words(path: Path) -> str:
    return path.read_text(encoding="ascii").strip() if path.is_file() else ""


@contextmanager
def turn(name: str) -> Iterator[None]:
    """Exclude other test processes from blocks of the same name."""
    from filelock import FileLock

    user = os.getuid() if hasattr(os, "getuid") else "all"
    place = Path(tempfile.gettempdir()) / f"warpvox-tests-{user}"
    place.mkdir(exist_ok=True)
    with FileLock(place / f"{name}.lock"):
        yield


@contextmanager
def compiling_in_turn() -> Iterator[None]:
    """Wait for other processes that compile the same kernel, and then use the cache."""
    from warp._src.context import Module

    compile_one = Module._compile

    @functools.wraps(compile_one)
    def in_turn(module: Module, *words: object, **more: object) -> bool:
        with turn(module.name):
            return compile_one(module, *words, **more)

    Module._compile = in_turn
    try:
        yield
    finally:
        Module._compile = compile_one
