"""Repairs Warp's cache of compiled kernels.

A full disk or a power cut may leave files there that are cut short or hold zeros. Warp takes a file that exists for
whole: it would fail at every start until somebody removes the file. Here a module that cannot be loaded is removed and
compiled once more.
"""

from __future__ import annotations

import functools
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from warpvox.errors import DeviceError
from warpvox.io.writing import OF_DISKS, complaint

__all__ = ["repaired"]


def repaired(
    load: Callable[..., Any], concerns_us: Callable[[], bool], tell: Callable[..., None]
) -> Callable[..., Any]:
    """Warp's ``Module.load``, with one more attempt without the files of the module if it fails.

    Args:
        load: what is wrapped.
        concerns_us: whether the call is on behalf of this package; kernels of others are left alone.
        tell: takes a line, with arguments as those of ``logging``, when something is removed.
    """

    @functools.wraps(load)
    def call(module: Any, device: Any, block_dim: int | None = None, *more: Any, **options: Any) -> Any:
        known = set(module.execs)
        try:
            return _checked(module, load(module, device, block_dim, *more, **options), known)
        except Exception as error:
            if more or options or not concerns_us():
                raise
            folder = _folder(module, block_dim)
            if not folder.is_dir():  # it was to be compiled, and that has failed
                raise
            _remove(module, folder, known, error)
            tell("The compiled kernels in %s are damaged: they are removed and compiled once more", folder)
        try:
            return _checked(module, load(module, device, block_dim), known)
        except Exception as error:
            raise DeviceError(_advice(folder, "compiling them once more has failed as well", error)) from error

    return call


def _folder(module: Any, block_dim: int | None) -> Path:
    """Where Warp keeps a module."""
    import warp as wp

    width = module.options["block_dim"] if block_dim is None else block_dim
    module.get_module_hash(width)
    return Path(wp.config.kernel_cache_dir) / module.get_module_identifier(width)


def _checked(module: Any, loaded: Any, known: set[Any]) -> Any:
    """A module that was loaded, if the functions of its kernels are found in it."""
    if loaded is not None and len(module.execs) > len(known):
        for kernel in module._get_live_kernels():
            if not kernel.is_generic and loaded.get_kernel_hooks(kernel).forward is None:
                raise RuntimeError(f"The kernel {kernel.key} is not in its file.")
    return loaded


def _remove(module: Any, folder: Path, known: set[Any], error: Exception) -> None:
    for key in module.execs.keys() - known:
        del module.execs[key]
    try:
        shutil.rmtree(folder)
    except FileNotFoundError:
        pass  # another process has been faster
    except OSError as refusal:
        raise DeviceError(_advice(folder, f"cannot be removed ({complaint(refusal)})", error)) from error
    module.mark_modified()


def _advice(folder: Path, problem: str, error: Exception) -> str:
    full = isinstance(error, OSError) and error.errno in OF_DISKS
    reason = complaint(error) if full else " ".join(str(error).split())[:200]
    return (
        f"The compiled kernels in {folder} are damaged, and {problem}: {reason}. See that the disk has space, remove"
        " the folder, or name another place for the cache by the variable WARP_CACHE_PATH."
    )
