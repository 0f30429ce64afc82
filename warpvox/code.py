"""Import of the user's own code, named ``FILE.py:NAME`` or ``MODULE:NAME``; no other module imports such code.

A file names code, it never makes it run. What the user passes is a :class:`Code`; what a file holds is a plain string,
which :func:`load_code` refuses. To go on with a run that names code, the user passes the key again.
"""

import dataclasses
import functools
import importlib
import os
import shlex
import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

from warpvox.errors import ConfigError, StoredCodeError, did_you_mean, listing

KEYS = ("task", "policy", "search.make", "fitness.make")
"""Settings whose values may name the user's own code."""


class Code(str):
    """The name of the user's own code, ``FILE.py:NAME`` or ``MODULE:NAME``, given in a command or in Python.

    A text like any other, but that :func:`load_code` takes it. Stored and read again it is a plain string.
    """

    __slots__ = ()


def is_code(text: object) -> bool:
    """Return whether a string names code: ``FILE.py:NAME`` or ``MODULE:NAME``."""
    return isinstance(text, str) and ":" in text


def check_code(text: str | None, needs: str, made: str) -> None:
    """Raise ConfigError unless ``text`` names code; the message says that the key ``needs`` expects a ``made``."""
    place, _, name = (text or "").rpartition(":")
    if not place or not name.isidentifier():
        raise ConfigError(f"{needs}=FILE.py:NAME or MODULE:NAME, where NAME makes {made}; got {text!r}.")


def load_code(code: str, is_wanted: Callable[[Any], bool] = callable, kind: str = "class or function") -> Any:
    """Import the object that ``code`` names and return it.

    Args:
        code: a :class:`Code`; a plain string is refused.
        is_wanted, kind: whether an object is of the kind that is expected, and what this is called.

    Raises:
        ConfigError: the user has not passed it, it cannot be imported, or it is of another kind.
    """
    if not isinstance(code, Code):
        raise ConfigError(
            f"{code!r:.200} names code, which is imported only if you name it yourself: by a key of the command (task=,"
            " policy=, search.make=), or in Python as warpvox.Code('FILE.py:NAME')."
        )
    place, _, name = code.rpartition(":")

    # The module or file
    path = Path(place).expanduser().resolve()
    is_file = place.endswith(".py")
    if is_file and not path.is_file():
        raise ConfigError(f"There is no file {place}.")
    try:
        if is_file:
            module = _import_file(path)
        else:
            # A program that is started by its name does not look into the current folder.
            with _first_on_path(Path.cwd()):
                module = importlib.import_module(place)
    except (Exception, SystemExit) as error:  # code may raise anything
        missing = error.name if isinstance(error, ModuleNotFoundError) else None
        if missing and not is_file and f"{place}.".startswith(f"{missing}."):
            raise ConfigError(f"There is no module {place!r}, neither in {os.getcwd()} nor installed.") from None
        reason = f"{type(error).__name__}: {str(error).rstrip('.')}"
        raise ConfigError(f"{place!r} cannot be imported: {reason}.") from error

    # What it has of this name
    found = getattr(module, name, None)
    if found is None or not is_wanted(found):
        names = [key for key, value in vars(module).items() if not key.startswith("_") and is_wanted(value)]
        what = "does not exist" if found is None else f"is no {kind}"
        raise ConfigError(f"{name!r} {what} in {place}.{did_you_mean(name, names)} There: {listing(names)}.")
    return found


@functools.cache
def _import_file(path: Path) -> ModuleType:
    """Import a Python file with its folder first on the search path, or as a module of its package."""
    root = path.parent
    name = path.stem
    while (root / "__init__.py").is_file():
        name = f"{root.name}.{name}"
        root = root.parent
    before = set(sys.modules)
    with _first_on_path(root):
        try:
            if "." in name:
                return importlib.import_module(name)
            # json.py must not stand in for what everybody imports by that name.
            spec: Any = spec_from_file_location(f"_code_{name}", path)
            module = module_from_spec(spec)
            sys.modules[spec.name] = module  # where dataclasses look for it
            spec.loader.exec_module(module)
            return module
        finally:
            # Another file may have neighbours of the same names.
            for other in set(sys.modules) - before:
                file = Path(str(getattr(sys.modules[other], "__file__", None)))
                installed = {"site-packages", "dist-packages"}.intersection(file.parts)
                known = other.partition(".")[0] in ("warpvox", *sys.stdlib_module_names)
                if file.is_relative_to(root) and not installed and not known:
                    del sys.modules[other]


@contextmanager
def _first_on_path(folder: Path) -> Iterator[None]:
    """Put ``folder`` first on Python's import path within the block."""
    importlib.invalidate_caches()
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))


def passed_code(key: str, stored: Any, given: Any, place: object) -> Any:
    """Return a stored value; if it names code, return the code that the user passed with this command instead.

    Raises:
        StoredCodeError: the user has passed none.
    """
    if not is_code(stored) or isinstance(stored, Code):
        return stored
    if not isinstance(given, Code):
        raise StoredCodeError(key, stored, place)
    return given


def with_passed_code(settings: Any, given: Collection[str], place: object) -> Any:
    """Allow the import of code in stored settings for the keys that the user has ``given`` again.

    Raises:
        StoredCodeError: another key names code, in ``place``.
    """
    for key, text in code_of(settings).items():
        code = passed_code(key, text, Code(text) if key in given else None, place)
        part, _, name = key.rpartition(".")
        if part:
            settings = dataclasses.replace(
                settings, **{part: dataclasses.replace(getattr(settings, part), **{name: code})}
            )
        else:
            settings = dataclasses.replace(settings, **{name: code})
    return settings


def code_of(settings: Any) -> dict[str, str]:
    """Return all values of settings that name code, by dotted key."""
    found = {}
    for key in KEYS:
        value = settings
        for name in key.split("."):
            value = value.get(name) if isinstance(value, Mapping) else getattr(value, name, None)
        if is_code(value):
            found[key] = value
    return found


def words_of_code(settings: Any) -> str:
    """Return the command-line arguments that pass the code of these settings again, quoted for a shell."""
    return "".join(f" {shlex.quote(f'{key}={text}')}" for key, text in code_of(settings).items())


def same_code(one: object, other: object) -> bool:
    """Return whether two names of code end in the same NAME; file or module may differ."""
    return is_code(one) and is_code(other) and str(one).rpartition(":")[2] == str(other).rpartition(":")[2]
