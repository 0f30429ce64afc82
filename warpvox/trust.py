"""Code on the command line: what the user types becomes a :class:`warpvox.code.Code`, what a file holds does not.

A run keeps a copy of the code of its own task, search and policy in the folder ``code``. On the command line
``task=stored`` names that copy, ``task=FILE.py:NAME`` another place; the same holds for the other keys.
"""

import dataclasses
import re
import shlex
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

from rich.console import Console

from warpvox.algos.training.metrics import SERVICES
from warpvox.code import Code, invocation, is_code, sources_of
from warpvox.errors import ConfigError, RunError
from warpvox.io.console import echo, escaped
from warpvox.io.writing import write_bytes

STORED = "stored"
"""Value of a key that names the copy in the folder of the run."""
COPIES = {
    "task": "task", "search.make": "search", "evaluation.make": "evaluation", "policy": "policy",
    "evaluation.policy": "policy",
}  # fmt: skip
"""Keys whose values may be code, and the folders of the copies in a run's folder ``code``."""
KEYS = (*COPIES, "tasks")
FOLDER, HERE = "code", Path()


def typed(config: Any, keys: Iterable[str] = KEYS) -> dict[str, Any]:
    """The values of ``keys``, which the user has typed, by key: what names code is a :class:`warpvox.code.Code`."""
    return {key: _as_code(_value(config, key)) for key in KEYS if key in keys}


def with_code(config: Any, given: Mapping[str, Any], stored: Mapping[str, Any] | None = None, home: Path = HERE) -> Any:
    """A configuration with the code that the user has named.

    Args:
        config: with all values.
        given: those of the user, as :func:`typed` returns them.
        stored: values of the file that all others come from, nested; None: there is none.
        home: folder that the file lies in, and ``code`` with it.
    """
    for key in KEYS:
        value, mine = _value(config, key), given.get(key)
        if stored is None:
            value = mine
        elif key in COPIES:
            value = allowed(key, _value(stored, key) if mine == STORED else value, mine, home)
        elif mine is not None:
            value = mine
        elif isinstance(value, list) and any(map(is_code, value)):
            raise ConfigError(_refusal(key, next(filter(is_code, value)), f"[{','.join(value)}]", home))
        config = _replaced(config, key, value)
    return config


def check_services(config: Any, stored: Mapping[str, Any], named: Collection[str]) -> None:
    """Raise ConfigError if only a file says which service to connect to.

    A Ray cluster can make whoever connects to it run code; for loggers see :func:`check_account`.
    """
    if "logger" not in named:
        check_account(stored.get("logger"))
    address = stored.get("address")
    if address is not None and "address" not in named and getattr(config, "executor", None) == "ray":
        raise ConfigError(
            f"The stored configuration names a Ray cluster, address={escaped(address)}. Who connects to a cluster can"
            f" be made to run code: name it yourself (address={escaped(address)}), or add address=null to start Ray on"
            " this machine, or executor=local."
        )


def check_account(logger: Any) -> None:
    """Raise ConfigError for a logger that only a file names: it would send figures to the user's own account."""
    if logger in SERVICES:
        raise ConfigError(
            f"The stored configuration sends figures to your account of {logger}: add logger={logger} if you want"
            " that, or logger=none."
        )


def allowed(key: str, text: Any, given: Any, home: Path) -> Any:
    """The value of ``text``, which a file in ``home`` has for ``key``: code only if the user has named it.

    Args:
        given: the user's own value: a :class:`Code`, ``stored`` for the copy, or anything else if there is none.
    """
    if given == STORED:
        if not is_code(text):
            raise ConfigError(f"{key}={STORED} names code in the folder of a run; {home} has none for {key}.")
        copy = _copy(home, key, text)
        if copy is None:
            raise RunError(f"{home} holds no copy of {escaped(text)}: name the code itself, {key}=FILE.py:NAME.")
        return copy
    if is_code(text) and not isinstance(given, Code):
        raise ConfigError(_refusal(key, text, STORED if _copy(home, key, text) else text, home))
    return given if is_code(text) else text


def as_stored(config: Any, stored: Mapping[str, Any]) -> Any:
    """``config`` with the places of code of the same name in the file of a run: what is written when it goes on."""
    for key in COPIES:
        text, mine = _value(stored, key), _value(config, key)
        if is_code(text) and is_code(mine) and text.rpartition(":")[2] == mine.rpartition(":")[2]:
            config = _replaced(config, key, text)
    return config


def again(config: Any) -> str:
    """The end of a command that uses a run of ``config`` again: the keys that name its code, each after a blank."""
    return "".join(f" {key}={STORED}" for key in COPIES if is_code(_value(config, key)))


def keep_code(config: Any, folder: Path, console: Console) -> None:
    """Copy the code that ``config`` names into the folder of a run; says which files have changed since it began."""
    for key, sub in COPIES.items():
        code, place = _value(config, key), folder / FOLDER / sub
        if not isinstance(code, Code):
            continue
        root, files = sources_of(code)
        for file in files if root != place.resolve() else []:
            copy, content = place / file.relative_to(root), file.read_bytes()
            if copy.is_file() and copy.read_bytes() != content:
                echo(console, f"not as it was when the run began, its copy is replaced: {file.relative_to(root)}")
            write_bytes(copy, content)
            if not code.rpartition(":")[0].endswith(".py"):  # the copy of a module is a package, too
                for above in list(copy.relative_to(place).parents)[:-1]:
                    if not (place / above / "__init__.py").exists():
                        write_bytes(place / above / "__init__.py", b"")


def _copy(home: Path, key: str, text: str) -> Code | None:
    """The copy of code in a run's folder; a design's is in the folder of its search."""
    place, _, name = text.rpartition(":")
    inner = Path(place if place.endswith(".py") else f"{place.replace('.', '/')}.py").parts
    home = home.resolve()
    for folder in (home, home.parent.parent):
        root = folder / FOLDER / COPIES[key]
        for length in range(1, len(inner) + 1):
            below = root.joinpath(*inner[-length:])
            for file in (below, below.with_suffix("") / "__init__.py"):
                if file.is_file() and file.resolve().is_relative_to(root):
                    return Code(f"{file}:{name}")
    return None


def _refusal(key: str, text: str, value: str, home: Path) -> str:
    """Why code is not imported, with the command that has it imported; ``latest`` by its name, as that may change."""
    words = [
        re.sub("^(run|resume)=latest$", lambda found: f"{found[1]}={home.absolute()}", w)
        for w in invocation.get()
        if not w.startswith(f"{key}=")
    ]
    word = f"{key}={value}"
    command = shlex.join(["warpvox", *words, word]) if words and escaped(value) == value else escaped(word)
    return (
        f"{escaped(home)} names code, {key}={escaped(text)}, which is imported only if you name it yourself. If you"
        f" trust it: {command}"
    )


def _as_code(value: Any) -> Any:
    if isinstance(value, list):
        return [_as_code(item) for item in value]
    return Code(value) if is_code(value) and not isinstance(value, Code) else value


def _value(values: Any, key: str) -> Any:
    """The value of a dotted key in mappings or dataclasses; None: there is none."""
    for name in key.split("."):
        values = values.get(name) if isinstance(values, Mapping) else getattr(values, name, None)
    return values


def _replaced(config: Any, key: str, value: Any) -> Any:
    if value is None or value is _value(config, key):
        return config
    first, _, rest = key.partition(".")
    return dataclasses.replace(config, **{first: _replaced(getattr(config, first), rest, value) if rest else value})
