"""Code that a stored configuration names is imported only if the user names it again, or says yes to a question.

A run keeps a copy of the code of its own task and search in the folder ``code``, so that it can be played from
anywhere. On the command line ``task=stored`` names that copy, ``task=FILE.py:NAME`` another place; the same holds for
``search.make``. A user who gets a run from somebody else thus decides whether its code is executed.
"""

from __future__ import annotations

import dataclasses
import re
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console

from warpvox.cli import invocation
from warpvox.cli.console import echo, escaped
from warpvox.envs.sources import Code, find_source, is_code, load_code, split
from warpvox.errors import ConfigError, RunError, listing
from warpvox.io.writing import write_bytes

__all__ = ["CODE_KEYS", "STORED", "again", "allow_code", "as_stored", "keep_code"]

STORED = "stored"
"""Value of a key that names the copy in the folder of the run."""
CODE_KEYS = {"task": "task", "search.make": "search", "policy": "policy", "screening.policy": "policy"}
"""Keys whose values may be code, and the folders of the copies in a run's folder ``code``."""
FOLDER = "code"
LARGEST_FILE, LARGEST_COPY = 16_000_000, 64_000_000
"""Bytes of a file of the user's that is copied, and of all together; a task that reads more is not copied whole."""


def allow_code(config: Any, stored: Mapping[str, Any], named: Mapping[str, Any], home: Path) -> Any:
    """A configuration that a file holds, with code only where the user has said so.

    Args:
        config: with the values of the command line over those of the file.
        stored: values of the file, nested.
        named: those of the command line, by dotted key; None: not given.
        home: folder that the file lies in, and ``code`` with it.

    Returns:
        ``config`` whose code is named by where it will be imported from.

    Raises:
        ConfigError: the user has not named the code, or refuses it. RunError: there is no copy.
    """
    for key in CODE_KEYS:
        text, given = _value(stored, key), named.get(key)
        if not is_code(text):
            if given == STORED:
                raise ConfigError(f"{key}={STORED} names code in the folder of a run; {home} has none for {key}.")
        elif given == STORED:
            copy = _copy(home, key, text)
            if copy is None:
                raise RunError(f"{home} holds no copy of {escaped(text)}: name the code itself, {key}=FILE.py:NAME.")
            config = _replaced(config, key, copy)
        elif is_code(given):
            config = _replaced(config, key, given)
        elif _value(config, key) == text:
            config = _replaced(config, key, _ask(key, text, home))
    _check_address(config, stored, named)
    return config


def as_stored(config: Any, stored: Mapping[str, Any]) -> Any:
    """``config`` with the names of code that the file of a run has: what is written when the run goes on."""
    for key in CODE_KEYS:
        text = _value(stored, key)
        if is_code(text) and is_code(_value(config, key)):
            config = _replaced(config, key, text)
    return config


def again(config: Any) -> str:
    """The end of a command that uses a run of ``config`` again: the keys that name its code, each after a blank."""
    return "".join(f" {key}={STORED}" for key in CODE_KEYS if is_code(_value(config, key)))


# ------------------------------------------------------------------------------------------------- copies


def keep_code(config: Any, folder: Path, console: Console) -> None:
    """Copy the code that ``config`` names into the folder of a run; says what is too large, and what has changed."""
    left_out: list[str] = []
    changed: list[str] = []
    for key, sub in CODE_KEYS.items():
        text = _value(config, key)
        if not is_code(text):
            continue
        code = load_code(split(text)[0])
        place = folder / FOLDER / sub
        if code.root is None or code.root == place.resolve():
            continue
        _copy_files(code, place, left_out, changed)
        if not split(text)[0].endswith(".py"):
            for above in code.source.relative_to(code.root).parents:
                if str(above) != "." and not (place / above / "__init__.py").is_file():
                    write_bytes(place / above / "__init__.py", b"")  # so that the copy is a package, too
    for file in left_out:
        echo(console, f"not copied into the run's folder, which needs it where it is: {file}")
    if changed:
        echo(console, f"not as it was when the run began: {listing(changed)}; the run's copy has been replaced")


def _copy_files(code: Code, place: Path, left_out: list[str], changed: list[str]) -> None:
    room = LARGEST_COPY
    for file in code.files:
        size = file.stat().st_size
        if size > min(room, LARGEST_FILE):
            left_out.append(f"{file} ({size:,} bytes)")
            continue
        room -= size
        copy, content = place / file.relative_to(code.root), file.read_bytes()
        if copy.is_file() and copy.read_bytes() != content:
            changed.append(str(file.relative_to(code.root)))
        write_bytes(copy, content)


def _copy(home: Path, key: str, text: str) -> str | None:
    """The copy of code in a run's folder, as ``FILE.py:NAME``; a design's is in the folder of its search."""
    place, name = split(text)
    inner = Path(place if place.endswith(".py") else f"{place.replace('.', '/')}.py").parts
    home = home.resolve()
    for folder in (home, home.parent.parent):
        root = folder / FOLDER / CODE_KEYS[key]
        for length in range(1, len(inner) + 1):
            below = root.joinpath(*inner[-length:])
            for file in (below, below.with_suffix("") / "__init__.py"):
                if file.is_file() and file.resolve().is_relative_to(root):
                    return f"{file}:{name}"
    return None


# ------------------------------------------------------------------------------------------------ the user


def _ask(key: str, text: str, home: Path) -> str:
    """Where the code is to be imported from, if the user agrees.

    Raises:
        ConfigError: there is no terminal to ask on, or the answer is no.
    """
    copy = _copy(home, key, text)
    name = copy or text
    value = STORED if copy else text
    source = find_source(split(name)[0])
    where = "which is not to be found from here" if source is None else f"the file {escaped(source)}"
    what = f"The configuration in {escaped(home)} names code: {key}={escaped(text)}, {where}"
    beside = _beside(source) if copy else []
    if beside:
        what += f", with {listing(beside, 20)} beside it"
    if _agreed(f"{what}.", "Import it?"):
        return name
    raise ConfigError(
        f"{what}. Code that a stored file names is imported only if you name it yourself. If you trust it:"
        f" {_command(home, key, value)}"
    )


def _beside(source: Path | None) -> list[str]:
    """The other files of a copy."""
    if source is None:
        return []
    root = next(above for above in source.parents if above.parent.name == FOLDER)
    return sorted(escaped(file.relative_to(root)) for file in root.rglob("*") if file.is_file() and file != source)


def _check_address(config: Any, stored: Mapping[str, Any], named: Mapping[str, Any]) -> None:
    """A cluster can run code in every process that connects to it: the same holds for its address."""
    address = _value(stored, "address")
    if address is None or "address" in named or getattr(config, "executor", None) != "ray":
        return
    what = f"The stored configuration names a Ray cluster, address={escaped(address)}."
    if not _agreed(what, "Connect to it?"):
        raise ConfigError(
            f"{what} Connecting to a cluster means to trust it; name it yourself (address={escaped(address)}), or add"
            " address=null to start Ray on this machine, or executor=local."
        )


def _agreed(what: str, question: str) -> bool:
    """Whether the user says yes; no if there is no terminal to ask on."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return False
    print(f"{what} It can do whatever you can do on this machine.", file=sys.stderr)
    print(f"{question} [y/N] ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def _command(home: Path, key: str, value: str) -> str:
    """The command line with the key that it lacks; ``latest`` by its name, as there may be a newer one by then."""
    given = [
        re.sub("^(run|resume)=latest$", lambda match: f"{match[1]}={home.absolute()}", word)
        for word in invocation.get()
    ]
    if not given or escaped(value) != value:
        return f"{key}={escaped(value)}"
    return shlex.join(["warpvox", *given, f"{key}={value}"])


def _value(values: Any, key: str) -> Any:
    """The value of a dotted key in mappings or dataclasses; None: there is none."""
    for name in key.split("."):
        values = values.get(name) if isinstance(values, Mapping) else getattr(values, name, None)
    return values


def _replaced(config: Any, key: str, value: str) -> Any:
    first, _, rest = key.partition(".")
    return dataclasses.replace(config, **{first: _replaced(getattr(config, first), rest, value) if rest else value})
