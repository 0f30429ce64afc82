"""``install()`` makes ``import evogym`` mean this package."""

import importlib.util
import multiprocessing.spawn
import os
import sys
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType

from warpvox.evogym.errors import InstallError

__all__ = ["install"]

THEIRS, OURS = "evogym", "warpvox.evogym"
CHILDREN = str(Path(__file__).resolve().parent / "children")
"""Folder added to the import path of child processes; its package ``evogym`` calls :func:`install`."""


class _Alias(MetaPathFinder, Loader):
    """Import finder that serves this package's modules under the name ``evogym``."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the import specification of a module ``evogym...`` of this package, else None."""
        if fullname == THEIRS or fullname.startswith(THEIRS + "."):
            try:
                here = importlib.util.find_spec(OURS + fullname[len(THEIRS) :])
            except ModuleNotFoundError:
                return None
            if here is not None:
                return ModuleSpec(fullname, self, is_package=here.submodule_search_locations is not None)
        return None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Import this package's module and return it."""
        module = importlib.import_module(OURS + spec.name[len(THEIRS) :])
        self._own = module.__spec__, module.__loader__, module.__package__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Restore the module's own specification, which the import system replaced."""
        # The import system has set these to those of the alias.
        module.__spec__, module.__loader__, module.__package__ = self._own


def install() -> None:
    """Make ``import evogym`` and its submodules load the modules of :mod:`warpvox.evogym`.

    This holds for the present process and for those that it starts, unless they are started without its environment
    variables. An installed EvoGym stays as it is, but they can no longer import it. Harmless to repeat.

    Raises:
        InstallError (an ImportError): EvoGym itself has been imported already.
    """
    loaded = sys.modules.get(THEIRS)
    if loaded is not None and loaded is not sys.modules[OURS]:
        place = getattr(loaded, "__file__", None) or "an unknown place"
        raise InstallError(
            f"evogym has been imported already, from {place}. Call warpvox.evogym.install() before anything imports it."
        )
    if not any(isinstance(finder, _Alias) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Alias())

    # Children find a package evogym that calls this function. Multiprocessing and joblib hand sys.path on to them.
    if CHILDREN not in sys.path:
        sys.path.insert(1, CHILDREN)  # behind the folder of the script
    inherited = os.environ.get("PYTHONPATH", "")
    if CHILDREN not in inherited.split(os.pathsep):
        os.environ["PYTHONPATH"] = CHILDREN + os.pathsep * bool(inherited) + inherited


def install_everywhere() -> None:
    """Call :func:`install` here and in child processes started by spawn or forkserver.

    The script may put a folder with another evogym first on their path.
    """
    install()
    if "forkserver" in multiprocessing.get_all_start_methods():
        multiprocessing.set_forkserver_preload([])  # of Python 3.14 the server would import the script before that
    prepare = multiprocessing.spawn.get_preparation_data
    multiprocessing.spawn.get_preparation_data = lambda name: prepare(name) | {"evogym": _Everywhere()}


class _Everywhere:
    """An object that calls :func:`install_everywhere` when unpickled in a child process."""

    def __reduce__(self) -> tuple:
        return install_everywhere, ()  # called where it is unpickled
