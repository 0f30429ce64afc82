"""Start of Warp and torch in a process: no banner, a message when kernels compile, threads and seed.

Warp prints a banner when it starts and a line for every module that it loads, but nothing when it begins to compile,
which takes 10 to 40 seconds. Who has set ``warp.config.log_level``, or started Warp, before the first simulation gets
what was asked for.
"""

from __future__ import annotations

import functools
import logging
import os
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

from warpvox.errors import StorageError
from warpvox.io.writing import complaint

if TYPE_CHECKING:
    import torch

LOGGER = logging.getLogger("warpvox")
"""Logger of the message about compilation; a warning, because those show without configuration."""
_PROCESS = threading.RLock()
"""Lock held by the thread that changes settings of the whole process."""


def start_warp() -> None:
    """Initialise Warp once, and hide its message about a missing GPU.

    Raises:
        StorageError: Warp's folder for kernels cannot be made.
    """
    with _PROCESS:  # its output is redirected meanwhile
        _start_warp()


@functools.cache
def _start_warp() -> None:
    """Initialise Warp and make it announce kernel compilation."""
    import warp as wp
    from warp._src import build, context

    # The functions in which Warp compiles; it offers no other way to learn of it before it is over.
    for name, where in (("build_cpu", "the CPU"), ("build_cuda", "CUDA")):
        if hasattr(build, name):
            setattr(build, name, _with_announcement(getattr(build, name), where))
    if getattr(context, "runtime", None) is not None:
        return
    try:
        if wp.config.log_level != wp.LOG_INFO:  # not the default: somebody has chosen it
            wp.init()
            return
        wp.config.log_level = wp.LOG_WARNING
        _init_quietly()
    except OSError as error:
        place = f"{error.filename} cannot be written: {complaint(error)}."
        raise StorageError(f"{place} WARP_CACHE_PATH=FOLDER is where Warp keeps kernels.", error) from None


def _with_announcement(build: Callable[..., Any], where: str) -> Callable[..., Any]:
    """Wrap ``build`` so that its first call by this package prints a message about compilation."""
    announced = False

    @functools.wraps(build)
    def call(*args: Any, **options: Any) -> Any:
        nonlocal announced
        if not announced and _is_ours():
            announced = True
            LOGGER.warning("Compiling kernels for %s (once per version and machine; 10 to 40 s)", where)
        return build(*args, **options)

    return call


def _is_ours() -> bool:
    """Return whether the present call comes from this package, not from another user of Warp."""
    frame = sys._getframe(2)  # above the function that asks
    while frame is not None:
        name = str(frame.f_globals.get("__name__", ""))
        if name.startswith("warpvox.") and name != __name__:
            return True
        frame = frame.f_back
    return False


def _init_quietly() -> None:
    """Initialise Warp and print its messages, except the one about a missing GPU."""
    import warp as wp

    sys.stderr.flush()
    try:
        caught = tempfile.TemporaryFile()  # noqa: SIM115  (closed below)
        kept = os.dup(2)
    except OSError:  # no stderr to keep clean, or no room to keep it
        wp.init()
        return
    with caught:
        os.dup2(caught.fileno(), 2)
        try:
            wp.init()
        finally:
            os.dup2(kept, 2)
            os.close(kept)
        caught.seek(0)
        for line in caught:
            # Warp's native code prints this on every machine without a GPU, whatever its log level is.
            if b"Could not find or load the NVIDIA CUDA driver" not in line:
                sys.stderr.write(line.decode(errors="replace"))


class _Console(logging.Handler):
    """Logging handler that prints the library's messages to standard output."""

    def emit(self, record: logging.LogRecord) -> None:
        print(record.getMessage(), flush=True)


def prepare(torch_threads: int, seed: int) -> None:
    """Set up a command's process: log messages, Warp, torch's threads and seed."""
    if not LOGGER.handlers:
        LOGGER.addHandler(_Console())
    import torch

    start_warp()
    torch.set_num_threads(torch_threads)
    torch.manual_seed(seed)


@contextmanager
def own_torch(threads: int | None = None, seed: int | None = None, dtype: torch.dtype | None = None) -> Iterator[None]:
    """Give this thread exclusive use of torch within the block, with the settings of :func:`ambient`.

    Nothing inside may wait for another thread. torch's global generators are the caller's again afterwards.

    Args:
        threads: that torch computes with; None: as many as before.
        seed: of torch's global generators; None: they go on as they are.
        dtype: default type of torch; None: float32.
    """
    with _PROCESS, ambient(threads, dtype), _restoring_torch():
        if seed is not None:
            import torch

            torch.manual_seed(seed)
        yield


@contextmanager
def ambient(threads: int | None = None, dtype: torch.dtype | None = None) -> Iterator[None]:
    """Set torch to its defaults within the block: float32, CPU as default device, gradients on.

    Neither inference mode nor autocast are on. Several threads may be inside at the same time.

    Args:
        threads: that torch computes with; None: as many as before.
        dtype: default type of torch; None: float32.
    """
    import torch

    used = torch.get_num_threads()
    with ExitStack() as changed:
        # settings of this thread
        changed.enter_context(torch.inference_mode(False))
        changed.enter_context(torch.enable_grad())
        if torch.empty(0).device.type != "cpu":  # such a context costs time in each call of torch
            changed.enter_context(torch.device("cpu"))
        for kind in ("cpu", "cuda"):
            if torch.is_autocast_enabled(kind):
                changed.enter_context(torch.autocast(kind, enabled=False))
        if threads is not None:
            changed.callback(torch.set_num_threads, used)
            torch.set_num_threads(threads)

        # settings of the process
        changed.enter_context(_shared)
        torch.set_default_dtype(dtype or torch.float32)
        yield


class _Shared:
    """A reentrant context for several threads; the last thread to leave restores torch's process-wide settings."""

    def __init__(self) -> None:
        self._inside = 0
        self._kept = ExitStack()

    def __enter__(self) -> None:
        with _PROCESS:
            if not self._inside:
                self._kept.enter_context(_restoring_torch())
            self._inside += 1

    def __exit__(self, *error: object) -> None:
        with _PROCESS:
            self._inside -= 1
            if not self._inside:
                self._kept.close()


_shared = _Shared()


@contextmanager
def _restoring_torch() -> Iterator[None]:
    """Restore torch's default type and global random generators after the block."""
    import torch

    dtype = torch.get_default_dtype()
    gpus = range(torch.cuda.device_count()) if torch.cuda.is_initialized() else ()
    try:
        with torch.random.fork_rng(gpus, device_type="cuda"):
            yield
    finally:
        torch.set_default_dtype(dtype)
        if not gpus:  # a seed is also that with which torch begins on a GPU
            torch.cuda.manual_seed_all(torch.initial_seed())
