"""Code of the user's own, named by ``FILE.py:NAME`` or ``MODULE:NAME``: imported, and what it consists of.

A file is imported as if its folder were the current one: its imports look there first and relative names of files begin
there. If the folder is a package (it holds ``__init__.py``), the file is a module of that package. Afterwards
``sys.path``, ``sys.modules`` and the current folder are as they were, so that two files may have neighbours of the same
name. What comes out of a file is read from its source, never from compiled code beside it.

A module is looked for in the current folder and among what is installed, and stays imported, as modules do.
"""

from __future__ import annotations

import ast
import importlib
import itertools
import os
import sys
import sysconfig
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.machinery import FileFinder, ModuleSpec, PathFinder, SourceFileLoader
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import CodeType, ModuleType

__all__ = ["Code", "find_source", "is_code", "lacks_module", "load_code", "split"]

INSTALLED = tuple({sysconfig.get_paths()[name] for name in ("stdlib", "platstdlib", "purelib", "platlib")})
"""Folders of Python's own and of installed modules."""


@dataclass(frozen=True)
class Code:
    """What was imported.

    Attributes:
        module: the module that holds the name.
        source: its file; None: it has none of its own.
        root: the folder that it and what it imports lie in or below; None: the module is installed.
        files: all that it consists of below the root: sources, and files that were read when it was imported.
    """

    module: ModuleType
    source: Path | None
    root: Path | None
    files: tuple[Path, ...]


def is_code(text: object) -> bool:
    """Whether a name stands for code of the user's: ``FILE.py:NAME`` or ``MODULE:NAME``."""
    return isinstance(text, str) and ":" in text


def split(text: str) -> tuple[str, str]:
    """File or module, and name."""
    place, _, name = text.rpartition(":")
    return place, name


def load_code(place: str) -> Code:
    """Import a file (``FILE.py``) or a module.

    Raises:
        FileNotFoundError: there is no such file. ModuleNotFoundError: there is no such module, or one that it needs;
            ``name`` says which. And whatever the code raises.
    """
    if not place.endswith(".py"):
        known = _modules.get(place)
        if known is None or sys.modules.get(place) is not known.module:
            known = _modules[place] = _load_module(place)
        return known
    path = Path(place).expanduser().resolve()
    if path not in _files:
        if not path.is_file():
            raise FileNotFoundError(place)
        _files[path] = _load_file(path)
    return _files[path]


def lacks_module(place: str, error: BaseException) -> bool:
    """Whether the module that a name stands for is not there, rather than one that it needs."""
    missing = error.name if isinstance(error, ModuleNotFoundError) else None
    return bool(missing) and not place.endswith(".py") and f"{place}.".startswith(f"{missing}.")


def find_source(place: str) -> Path | None:
    """The file that :func:`load_code` would import, without importing anything; None: there is none to be found."""
    if place.endswith(".py"):
        path = Path(place).expanduser().resolve()
        return path if path.is_file() else None
    top, *inner = place.split(".")
    spec = PathFinder.find_spec(top, [os.getcwd(), *sys.path])
    if spec is None or spec.origin is None:
        return None
    found = Path(spec.origin)
    if not inner:
        return found
    below = found.parent.joinpath(*inner)
    return next((path for path in (below.with_suffix(".py"), below / "__init__.py") if path.is_file()), found)


# ---------------------------------------------------------------------------------------------------- import

_files: dict[Path, Code] = {}
_modules: dict[str, Code] = {}
_neighbours: dict[Path, dict[str, ModuleType]] = {}
"""Modules that files of a folder have imported from it, by folder."""


class _FromSource(SourceFileLoader):
    """Compiles the source, whatever compiled code lies beside it: what is read is what is run."""

    def get_code(self, fullname: str) -> CodeType:
        path = self.get_filename(fullname)
        return self.source_to_code(self.get_data(path), path)


class _Neighbours:
    """Finds modules in folders, by their sources."""

    def __init__(self, *folders: Path) -> None:
        self.folders = folders
        self.found: set[str] = set()

    def find_spec(self, name: str, path: list[str] | None = None, target: object = None) -> ModuleSpec | None:
        """As importlib asks for it."""
        if path is None and name in sys.stdlib_module_names:
            return None
        for place in self.folders if path is None else [Path(p) for p in path if self._is_ours(Path(p))]:
            spec = FileFinder(str(place), (_FromSource, [".py"])).find_spec(name)
            # a folder without __init__.py is a package only where there is no other of its name
            if spec is None or (spec.loader is None and path is None and PathFinder.find_spec(name) is not None):
                continue
            self.found.add(name)
            return spec
        return None

    def _is_ours(self, place: Path) -> bool:
        return any(place.is_relative_to(folder) for folder in self.folders)


def _load_file(path: Path) -> Code:
    root, opened = path.parent, set()
    while (root / "__init__.py").is_file() and root != root.parent:
        root = root.parent
    with _at_home(path.parent, root), _opened(root, opened):
        module = _run(path) if root == path.parent else importlib.import_module(_dotted(path, root))
    return Code(module, path, root, _parts(root, path, opened))


def _run(path: Path) -> ModuleType:
    """Execute a file as a module of its own name."""
    name = path.stem
    if name in sys.modules and _is_installed(sys.modules[name]):
        name = f"_{name}"  # a file named as a module that everybody uses must not stand in for it
    spec = spec_from_file_location(name, path, loader=_FromSource(name, str(path)))
    module = module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    try:
        spec.loader.exec_module(module)
    finally:
        sys.modules.pop(name, None)
    return module


def _dotted(path: Path, root: Path) -> str:
    return ".".join(path.parent.relative_to(root).parts + (() if path.stem == "__init__" else (path.stem,)))


def _load_module(name: str) -> Code:
    here = os.getcwd()
    sys.path.insert(0, here)  # a program that is started by its name does not look into the current folder
    importlib.invalidate_caches()
    opened: set[Path] = set()
    try:
        with _opened(Path(here), opened):
            module = importlib.import_module(name)
    finally:
        sys.path.remove(here)
    file = getattr(module, "__file__", None)
    if not file or not file.endswith(".py") or _is_installed(module):
        return Code(module, Path(file) if file else None, None, ())
    source = Path(file).resolve()
    above = len(name.split(".")) + (source.name == "__init__.py") - 1
    root = source.parents[above]
    return Code(module, source, root, _parts(root, source, opened))


def _is_installed(module: ModuleType) -> bool:
    """Whether a module is Python's own or installed, rather than one of the user's files."""
    if module.__name__.partition(".")[0] in (*sys.stdlib_module_names, "warpvox", "__main__"):
        return True
    places = [getattr(module, "__file__", None) or ""] if not hasattr(module, "__path__") else list(module.__path__)
    return all(not place or place.startswith(INSTALLED) for place in places)


@contextmanager
def _at_home(folder: Path, root: Path) -> Iterator[None]:
    """Within the block ``folder`` is the current one; it and ``root`` are the first that are searched for modules."""
    finder, here, path = _Neighbours(*dict.fromkeys((root, folder))), os.getcwd(), list(sys.path)
    own = {file.stem for place in finder.folders for file in place.glob("*.py")}
    own |= {file.parent.name for place in finder.folders for file in place.glob("*/*.py")}
    hidden = {
        name: module
        for name, module in list(sys.modules.items())
        if name.partition(".")[0] in own and module is not None and not _is_installed(module)
    }
    for name in hidden:
        del sys.modules[name]
    kept = _neighbours.setdefault(folder, {})
    sys.modules.update(kept)
    sys.meta_path.insert(0, finder)
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(here)
        sys.meta_path.remove(finder)
        sys.path[:] = path
        kept.update({name: sys.modules[name] for name in finder.found if name in sys.modules})
        for name in kept:
            sys.modules.pop(name, None)
        sys.modules.update(hidden)


# ------------------------------------------------------------------------------------------------ its files

_watched: list[tuple[Path, set[Path]]] = []
_is_hooked = False


@contextmanager
def _opened(root: Path, found: set[Path]) -> Iterator[None]:
    """Within the block files below ``root`` that are opened for reading are added to ``found``."""
    global _is_hooked
    if not _is_hooked:
        sys.addaudithook(_notice)  # it stays, and does nothing outside of such a block
        _is_hooked = True
    entry = (root, found)
    _watched.append(entry)
    try:
        yield
    finally:
        _watched.remove(entry)


def _notice(event: str, arguments: tuple) -> None:
    if not _watched or event != "open":
        return
    name, mode, _ = arguments
    if not isinstance(name, str) or (mode is not None and set(str(mode)) & set("wax+")):
        return
    path = Path(os.path.realpath(name))
    for root, found in _watched:
        if path.is_relative_to(root) and path.suffix not in (".py", ".pyc") and path.is_file():
            found.add(path)


def _parts(root: Path, source: Path, opened: set[Path]) -> tuple[Path, ...]:
    """A source, those below ``root`` that it imports, directly or not, and what was opened."""
    found: dict[Path, None] = {}
    todo = [source]
    while todo:
        path = todo.pop()
        if path in found:
            continue
        found[path] = None
        todo += [near for near in _imported(root, path) if near not in found]
    return (*sorted(found), *sorted(opened - found.keys()))


def _imported(root: Path, source: Path) -> Iterator[Path]:
    """Files below ``root`` that the imports of a source name, wherever in it they stand."""
    try:
        tree = ast.parse(source.read_bytes())
    except (SyntaxError, ValueError, OSError):
        return
    package = source.parent.relative_to(root).parts
    for node in ast.walk(tree):
        names: list[tuple[str, ...]] = []
        if isinstance(node, ast.Import):
            names = [tuple(alias.name.split(".")) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            base += tuple(node.module.split(".")) if node.module else ()
            names = [base, *((*base, alias.name) for alias in node.names)]
        for start, name in itertools.product({root, source.parent}, names):
            for length in range(1, len(name) + 1):
                place = start.joinpath(*name[:length])
                files = (place.with_name(f"{place.name}.py"), place / "__init__.py")
                yield from (file for file in files if file.is_file())
