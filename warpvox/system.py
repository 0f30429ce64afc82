"""Operating system: signals, locks, pipes, flushing to disk, memory, processors.

Tests run on Linux. Elsewhere commands are meant to run without what only Linux has: locks need ``fcntl``,
and the free memory is not known. No other module of warpvox asks which system it runs on.
"""

import errno
import math
import os
import platform
import re
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:
    fcntl = None

WINDOWS = sys.platform == "win32"

GONE = {errno.EPIPE, errno.ECONNRESET, errno.ESHUTDOWN, *([errno.EINVAL] if WINDOWS else [])}
"""Error numbers of a pipe or socket that was closed at the other end."""

SAFE_PATH = "PYTHONSAFEPATH"
"""Environment variable that keeps Python 3.11 and later from importing from the current folder."""
_starting = threading.RLock()
"""Lock held while environment and current folder are changed for starting an interpreter."""


HANGUP: int | None = getattr(signal, "SIGHUP", None)
"""Signal number for a closed terminal; None on Windows."""


def stop_signals() -> tuple[int, ...]:
    """Return the signals that ask a process to end, except Ctrl-C.

    SIGTERM, and SIGHUP where there is one, unless this process ignores it (``nohup``).
    """
    found: list[int] = [signal.SIGTERM]
    if HANGUP is not None and signal.getsignal(HANGUP) is not signal.SIG_IGN:
        found.append(HANGUP)
    return tuple(found)


@contextmanager
def safe_start(move: bool = True) -> Iterator[None]:
    """Keep interpreters started within the block from importing from the current folder.

    ``python -c`` and ``python -m``, by which libraries start theirs, look into the current folder first, and Ray has
    its workers do so. Python 3.11 and later can be told not to by :data:`SAFE_PATH`. For Python 3.10 and for Ray the
    block runs in the folder of the standard library; a child whose place matters changes to the right folder itself.

    Args:
        move: False: the block stays in the current folder. Nothing then protects children of Python 3.10.
    """
    with _starting:
        here = os.getcwd()
        before = os.environ.get(SAFE_PATH)
        if any(os.path.realpath(entry) == os.path.realpath(here) for entry in sys.path):
            yield
            return
        os.environ[SAFE_PATH] = "1"
        try:
            if move:
                # The folder of the standard library: what is imported from there would be imported anyway.
                os.chdir(os.path.dirname(os.__file__))
            yield
        finally:
            if move:
                os.chdir(here)
            if before is None:
                del os.environ[SAFE_PATH]
            else:
                os.environ[SAFE_PATH] = before


@contextmanager
def path_lock(path: Path, wait: bool = False) -> Iterator[None]:
    """Hold a lock on a file or folder within the block; the system releases it if the process dies.

    Where a lock cannot be had at all (a network disk without locks, Windows) the block runs without.

    Raises:
        BlockingIOError: another process holds it, and it should not ``wait``. OSError: it cannot be opened.
    """
    if fcntl is None:
        yield
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except OSError as error:
            if isinstance(error, BlockingIOError):  # else a network disk without locks
                raise
        yield
    finally:
        os.close(handle)


def flush_to_disk(path: Path) -> None:
    """Flush a written file, or a folder's entries, to the disk; OSError: the disk failed."""
    if WINDOWS and path.is_dir():
        return  # NTFS keeps a journal of names; folders cannot be opened
    handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # some network disks have no such thing
            raise
    finally:
        os.close(handle)


def unquoted(argument: str) -> str:
    """Strip single quotes around a command-line argument, which cmd.exe does not remove."""
    return argument[1:-1] if WINDOWS and len(argument) > 1 and argument[0] == argument[-1] == "'" else argument


def usable_cores() -> int:
    """Return the number of cores that this process may use, limited by affinity and control groups (containers)."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min([cores, *_quotas()])


def _quotas(root: Path = Path("/")) -> Iterator[int]:
    """Yield the number of cores that each limited control group allows, rounded up."""
    for names, folder in _control_groups(root, "cpu", ["cpu.max"], ["cpu.cfs_quota_us", "cpu.cfs_period_us"]):
        with suppress(OSError):
            quota, period = " ".join((folder / name).read_text() for name in names).split()
            if quota.isdigit():  # neither "max" nor version 1's -1
                yield math.ceil(int(quota) / int(period))


def is_device_name(name: str) -> bool:
    """Return whether Windows takes a file's name for a device (CON, NUL, ...), whatever its suffix."""
    # Names that Windows keeps
    kept = {"CON", "PRN", "AUX", "NUL", *(f"{port}{number}" for port in ("COM", "LPT") for number in range(10))}
    return name.partition(".")[0].rstrip(" ").upper() in kept


def processor_name() -> str:
    """Return the processor's model name."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def has_display(*variables: str) -> bool:
    """Return whether the machine can show windows: Windows, macOS, or a display named in ``variables``."""
    return sys.platform in ("win32", "darwin", "cygwin") or any(os.environ.get(name) for name in variables)


def available_memory() -> int | None:
    """Return the memory that this process can still allocate without swapping, in bytes; None if unknown.

    On Linux the least of what the machine has available, what is left below the limits of its control groups
    (containers, jobs of clusters) and below its limit of addresses (``ulimit -v``).
    """
    left = [value for value in (_linux_memory(), _memory_left_in_groups(), _address_space_left()) if value is not None]
    return max(0, min(left)) if left else None


def _linux_memory(root: Path = Path("/")) -> int | None:
    """Return the machine's available memory in bytes, or None."""
    with suppress(OSError):
        found = re.search(r"^MemAvailable:\s+(\d+) kB", (root / "proc/meminfo").read_text(), re.MULTILINE)
        if found:
            return 1024 * int(found[1])
    with suppress(AttributeError, ValueError, OSError):
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return None


def _memory_left_in_groups(root: Path = Path("/")) -> int | None:
    """Return the unused memory below the limits of all control groups, in bytes; None without limits."""
    files = ["memory.max", "memory.current", "inactive_file"]
    older = ["memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"]
    found = (_memory_left_in_group(folder, *names) for names, folder in _control_groups(root, "memory", files, older))
    return min((left for each in found for left in each), default=None)


def _control_groups(root: Path, controller: str, new: list[str], old: list[str]) -> Iterator[tuple[list[str], Path]]:
    """Yield each control group's folder and the names of its files: ``new`` (version 2) or ``old`` (version 1)."""
    try:
        lines = (root / "proc/self/cgroup").read_text().splitlines()
    except OSError:
        return
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if controllers == "":
            names = new
            top = root / "sys/fs/cgroup"
        elif controller in controllers.split(","):
            names = old
            top = root / "sys/fs/cgroup" / controller
        else:
            continue
        # inside a container the path is that of the host, and the group itself is mounted at the top
        place = top / path.strip("/")
        for folder in {top, place, *(parent for parent in place.parents if top in parent.parents)}:
            yield names, folder


def _memory_left_in_group(folder: Path, limit: str, used: str, cache: str) -> list[int]:
    """Return the unused memory below one control group's limit as a list of one number; empty without a limit."""
    try:
        most = (folder / limit).read_text().strip()
        now = (folder / used).read_text().strip()
        if not most.isdigit() or int(most) >= 1 << 60:  # "max", or version 1's way to say so
            return []
        statistics = (folder / "memory.stat").read_text()
    except OSError:
        return []
    reclaimable = re.search(rf"^{cache} (\d+)$", statistics, re.MULTILINE)
    return [int(most) - int(now) + (int(reclaimable[1]) if reclaimable else 0)]


def _address_space_left() -> int | None:
    """Return the unused address space below ``ulimit -v``, in bytes; None without a limit."""
    try:
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        if limit == resource.RLIM_INFINITY:
            return None
        pages = int(Path("/proc/self/statm").read_text().split()[0])
    except (ImportError, OSError, ValueError):
        return None
    return limit - pages * os.sysconf("SC_PAGE_SIZE")
