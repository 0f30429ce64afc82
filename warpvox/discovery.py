"""Makes ``warpvox/<Task>`` known to gymnasium as soon as both libraries are there, whichever comes first.

Gymnasium has no plugins: whoever has environments must register them after it has been imported. Importing it here
would cost every user of ``import warpvox`` its time, so a finder waits for its import and then goes away.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

__all__ = ["announce"]

GYMNASIUM, ENVIRONMENTS = "gymnasium", "warpvox.envs"


def announce() -> None:
    """Register the tasks with gymnasium now if it is imported already, else when it will be."""
    if GYMNASIUM in sys.modules:
        importlib.import_module(ENVIRONMENTS)  # registers by being imported
    elif not any(isinstance(finder, _Waiter) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Waiter())


class _Waiter(MetaPathFinder):
    """Finds gymnasium by asking everyone else; stays until it is imported, since some only ask where it is."""

    _asking = False

    def find_spec(self, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        if name != GYMNASIUM or self._asking:
            return None
        self._asking = True
        try:
            spec = importlib.util.find_spec(name)
        finally:
            self._asking = False
        if spec is not None and spec.loader is not None:
            spec.loader = _ThenRegister(spec.loader)
        return spec


class _ThenRegister(Loader):
    """Loads as the loader that it stands for, puts that back, and then has the tasks registered."""

    def __init__(self, loader: Loader) -> None:
        self._loader = loader

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        module.__loader__ = module.__spec__.loader = self._loader
        sys.meta_path[:] = [finder for finder in sys.meta_path if not isinstance(finder, _Waiter)]
        self._loader.exec_module(module)
        importlib.import_module(ENVIRONMENTS)
