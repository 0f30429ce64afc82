"""Counts what a piece of work launches on a device, and where the host waits for it; tells so on the CPU, too."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from functools import wraps
from typing import Any
from unittest import mock

import torch
import warp as wp
from torch.utils._python_dispatch import TorchDispatchMode

__all__ = ["Launches", "caller"]

WAITING = ("_local_scalar_dense", "nonzero", "masked_select", "unique", "lift_fresh", "repeat_interleave.Tensor")
"""Operations that read a value on the host, give a result whose size does, or bring data from the host."""
READING = ("tolist", "numpy", "cpu")
"""Methods of tensors that bring a whole tensor to the host; on the CPU no operation shows it."""
OURS = "warpvox"


class Launches(TorchDispatchMode):
    """Within, counts operations of torch that compute something, launches of Warp kernels, and waits.

    Attributes:
        operations: of torch, views not counted: at least so many kernels on CUDA.
        kernels: of Warp.
        waits: how often the host would wait for a device, by the operation and the innermost function of warpvox or
            rsl-rl that led to it, ``(operation, module, function)``.
    """

    def __init__(self) -> None:
        super().__init__()
        self.operations = self.kernels = 0
        self.waits: Counter[tuple[str, str, str]] = Counter()
        self._stack = ExitStack()

    def __enter__(self) -> Launches:
        for owner, name in ((wp.Launch, "launch"), (wp, "launch")):
            self._stack.enter_context(mock.patch.object(owner, name, self._counted(getattr(owner, name))))
        for name in READING:
            method = getattr(torch.Tensor, name)
            self._stack.enter_context(mock.patch.object(torch.Tensor, name, self._read(name, method)))
        super().__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        super().__exit__(*error)
        self._stack.close()

    def _counted(self, launch: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(launch)
        def counted(*args: Any, **options: Any) -> Any:
            self.kernels += not options.get("record_cmd", False)
            return launch(*args, **options)

        return counted

    def _read(self, name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(method)
        def read(tensor: torch.Tensor, *args: Any, **options: Any) -> Any:
            self.waits[(name, *caller())] += 1
            return method(tensor, *args, **options)

        return read

    def __torch_dispatch__(self, func: Any, types: Any, args: tuple = (), kwargs: dict | None = None) -> Any:
        name, schema = str(func), func._schema
        self.operations += schema.is_mutable or all(value.alias_info is None for value in schema.returns)
        by_mask = name.startswith(("aten.index.", "aten.index_put")) and any(
            isinstance(index, torch.Tensor) and index.dtype == torch.bool for index in args[1]
        )
        if by_mask or any(word in name for word in WAITING):
            self.waits[(f"{name} by a mask" if by_mask else name, *caller())] += 1
        return func(*args, **(kwargs or {}))

    def by(self, package: str) -> Counter[tuple[str, str]]:
        """Waits of a package's functions, ``(module, function)``."""
        found: Counter[tuple[str, str]] = Counter()
        for (_, module, function), count in self.waits.items():
            if module.split(".")[0] == package:
                found[module, function] += count
        return found


def caller() -> tuple[str, str]:
    """Module and name of the innermost function of warpvox or rsl-rl, besides this file."""
    frame = sys._getframe(2)
    while frame is not None:
        module = str(frame.f_globals.get("__name__", ""))
        if module.split(".")[0] in (OURS, "rsl_rl") and module != __name__:
            return module, frame.f_code.co_name
        frame = frame.f_back
    return "", ""
