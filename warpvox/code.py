"""Code of the user's own, ``FILE.py:NAME`` or ``MODULE:NAME``: the only module that imports any.

It takes a :class:`Code`, text that the user has typed. What a file holds is a plain string, and a string is never code.

A file is imported with its folder first on the search path. If the folder is a package (it holds ``__init__.py``), the
file is a module of that package. The modules beside it are forgotten afterwards, so that two files may have neighbours
of the same name. A module is looked for in the current folder and among what is installed, and stays imported.
"""

import ast
import importlib
import os
import sys
import sysconfig
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

from warpvox.errors import ConfigError, did_you_mean, listing

invocation: ContextVar[tuple[str, ...]] = ContextVar("invocation", default=())
"""The command line without the program's name, for advice that can be pasted."""

INSTALLED = tuple({sysconfig.get_paths()[name] for name in ("stdlib", "platstdlib", "purelib", "platlib")})
"""Folders of Python's own and of installed modules."""


class Code(str):
    """``FILE.py:NAME`` or ``MODULE:NAME`` that the user has typed, on the command line or in Python.

    A text like any other, but that :func:`load_code` takes it. Stored and read again it is a plain string.
    """

    __slots__ = ()


def is_code(text: object) -> bool:
    """True if a text names code, typed or not: ``FILE.py:NAME`` or ``MODULE:NAME``."""
    return isinstance(text, str) and ":" in text


def check_code(text: str | None, needs: str, made: str) -> None:
    """Raise ConfigError, which says what ``needs`` the code and what is ``made`` by it, unless ``text`` names some."""
    place, _, name = (text or "").rpartition(":")
    if not place or not name.isidentifier():
        raise ConfigError(f"{needs}=FILE.py:NAME or MODULE:NAME, where NAME makes {made}; got {text!r}.")


def load_code(code: str, is_wanted: Callable[[Any], bool] = callable, kind: str = "class or function") -> Any:
    """Import what ``code`` names.

    Args:
        code: a :class:`Code`; a plain string is refused.
        is_wanted, kind: whether an object is of the kind that is expected, and what this is called.

    Raises:
        ConfigError: the user has not typed it, it cannot be imported, or it is of another kind.
    """
    if not isinstance(code, Code):
        raise ConfigError(
            f"{code!r:.200} names code, which is imported only if you name it yourself: by a key of the command (task=,"
            " policy=, search.make=), or in Python as warpvox.Code('FILE.py:NAME')."
        )
    place, _, name = code.rpartition(":")
    module = _loaded(place).module
    found = getattr(module, name, None)
    if found is None or not is_wanted(found):
        names = [key for key, value in vars(module).items() if not key.startswith("_") and is_wanted(value)]
        what = "does not exist" if found is None else f"is no {kind}"
        raise ConfigError(f"{name!r} {what} in {place}.{did_you_mean(name, names)} There: {listing(names)}.")
    return found


def sources_of(code: Code) -> tuple[Path, list[Path]]:
    """The files that imported code consists of, to be copied, and the folder that they lie below.

    These are its source, the modules beside it that are imported, and files beside these that they name by a text.
    Nothing for an installed module.
    """
    loaded = _loaded(code.rpartition(":")[0])
    return loaded.root, [*loaded.files, *sorted(_named_in(loaded.files) - set(loaded.files))]


@dataclass(frozen=True)
class _Loaded:
    """A module, the folder that it is imported from, and the files below it that were imported."""

    module: ModuleType
    root: Path
    files: list[Path]


_cache: dict[tuple[str, ModuleType | None], _Loaded] = {}


def _loaded(place: str) -> _Loaded:
    is_file = place.endswith(".py")
    path = Path(place).expanduser().resolve()
    if is_file and not path.is_file():
        raise ConfigError(f"There is no file {place}.")
    key = (str(path), None) if is_file else (place, sys.modules.get(place))
    if key not in _cache:
        try:
            loaded = _load_file(path) if is_file else _load_module(place)
        except (Exception, SystemExit) as error:  # code may raise anything
            missing = error.name if isinstance(error, ModuleNotFoundError) else None
            if missing and not is_file and f"{place}.".startswith(f"{missing}."):
                raise ConfigError(f"There is no module {place!r}, neither in {os.getcwd()} nor installed.") from None
            reason = f"{type(error).__name__}: {str(error).rstrip('.')}"
            raise ConfigError(f"{place!r} cannot be imported: {reason}.") from error
        key = key if is_file else (place, loaded.module)
        _cache[key] = loaded
    return _cache[key]


def _load_file(path: Path) -> _Loaded:
    root, names = path.parent, [path.stem]
    while (root / "__init__.py").is_file() and root != root.parent:
        root, names = root.parent, [root.name, *names]
    before = set(sys.modules)
    with _first_on_the_path(root):
        try:
            module = importlib.import_module(".".join(names)) if len(names) > 1 else _run(path)
            return _Loaded(module, root, sorted({path, *(_own(root).values())}))
        finally:
            for name in _own(root).keys() - before:
                del sys.modules[name]


def _run(path: Path) -> ModuleType:
    name = f"_code_{path.stem}"  # json.py must not stand in for what everybody uses
    spec: Any = spec_from_file_location(name, path)  # there is one for every .py
    module = sys.modules[name] = module_from_spec(spec)  # dataclasses look their module up
    try:
        spec.loader.exec_module(module)
    finally:
        del sys.modules[name]
    return module


def _load_module(name: str) -> _Loaded:
    with _first_on_the_path(Path.cwd()):  # a program that is started by its name does not look into the current folder
        module = importlib.import_module(name)
    source = Path(getattr(module, "__file__", None) or "").resolve()
    if name not in _own(Path("/")) or not source.is_file():
        return _Loaded(module, source.parent, [])
    root = source.parents[len(name.split(".")) - (source.name != "__init__.py")]
    return _Loaded(module, root, sorted({source, *_own(root).values()}))


@contextmanager
def _first_on_the_path(folder: Path) -> Iterator[None]:
    importlib.invalidate_caches()
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))


def _own(root: Path) -> dict[str, Path]:
    """The user's own among the imported modules: those whose sources lie below ``root``, by name."""
    found = {}
    for name, module in list(sys.modules.items()):
        file = getattr(module, "__file__", None)
        if name.partition(".")[0] in (*sys.stdlib_module_names, "warpvox", "__main__") or not isinstance(file, str):
            continue
        if not file.endswith(".py") or not os.path.isabs(file) or file.startswith(INSTALLED):
            continue
        if Path(file).resolve().is_relative_to(root):
            found[name] = Path(file).resolve()
    return found


def _named_in(sources: list[Path]) -> set[Path]:
    """Files beside ``sources`` that a text in them names, such as a world."""
    texts = {
        (source.parent, node.value)
        for source in sources
        for node in ast.walk(ast.parse(source.read_bytes()))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and 0 < len(node.value) < 200
    }
    found = {folder / text for folder, text in texts if not text.startswith(("/", "."))}
    # os.path's test takes any text, also with NUL or of more bytes than a name may have
    return {file for file in found if ".." not in file.parts and os.path.isfile(file) and not file.is_symlink()}
