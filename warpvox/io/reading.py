"""Reading of files from others, with a size limit and without pickle.

A reader has a limit in bytes, which files must fit as they lie on disk, and the arrays of an ``.npz`` as they unpack.
Arrays consist of plain numbers and are read without pickle.

All that is wrong with a file is an :class:`Unreadable` with the reason, which the readers of designs, worlds and
rollouts turn into errors of their own.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
import re
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
import yaml

from warpvox.errors import RunError, did_you_mean, listing

CONFIG, SUMMARY = "config.yaml", "summary.json"
"""Names of a run's settings file and summary file."""
LARGEST_CONFIG = 100_000
"""Maximum size of a configuration in bytes; larger YAML takes seconds to parse."""
END = "...\n"
"""Last line of a run's configuration, YAML's end marker; a file without it was cut short."""
DEEPEST = 32
"""Maximum nesting depth of a YAML text."""


class Unreadable(ValueError):
    """Raised for an invalid file or text; the message is the reason, without a full stop."""


class Missing(Unreadable):
    """Raised for a file that does not exist."""


def read_bytes(path: str | os.PathLike[str], limit: int) -> bytes:
    """Read a file of at most ``limit`` bytes.

    Unreadable: no such file, none that can be read, or a longer one.
    """
    with _opened(path, limit) as file:
        return file.read(limit)


def read_text(path: str | os.PathLike[str], limit: int) -> str:
    """Read a UTF-8 text file of at most ``limit`` bytes; Unreadable: as :func:`read_bytes`, or not UTF-8."""
    try:
        return read_bytes(path, limit).decode("utf-8-sig")  # some editors begin a file with a byte order mark
    except UnicodeDecodeError as error:
        raise Unreadable(f"it is not text in UTF-8 (byte {error.start})") from None


def read_table(path: str | os.PathLike[str], limit: int = 1 << 24) -> list[dict[str, str]]:
    """Read the rows of a CSV file as dictionaries by column; empty if the file does not exist."""
    try:
        return list(csv.DictReader(io.StringIO(read_text(path, limit), newline="")))
    except Missing:
        return []


def parse_json(text: str, allow_nan: bool = False) -> Any:
    """Parse a JSON text.

    Stricter than :func:`json.loads`: NaN and Infinity are refused (JSON has none), and so are names that occur twice
    in one object (the first would be dropped without a word) and halves of characters (no file or page can hold them).

    Args:
        allow_nan: read NaN and Infinity as Python writes them, for files whose other entries belong to somebody else.

    Raises:
        Unreadable: it is not JSON, or too deeply nested.
    """
    try:
        value = json.loads(text, object_pairs_hook=_unique, parse_constant=None if allow_nan else _no_number)
        # Where halves of characters are written as escapes, only writing the value shows whether they pair up.
        if re.search(r"\\u[dD][89a-fA-F]", text):
            json.dumps(value, ensure_ascii=False).encode()
    except RecursionError:
        raise Unreadable("it is nested too deeply") from None
    except UnicodeEncodeError:
        raise Unreadable("it holds half of a character (a lone surrogate)") from None
    except Unreadable:
        raise
    except ValueError as error:
        raise Unreadable(f"it is not valid JSON: {error}") from None
    return value


def parse_yaml(text: str) -> Any:
    """Parse a YAML text of mappings, lists, strings, true, false, null and numbers.

    No tag makes an object. Aliases are refused (ten of them can stand for a billion entries once the value is copied),
    and so is ``${...}``, which OmegaConf would look up elsewhere.

    Raises:
        Unreadable: anything else; the text is the reason.
    """
    depth = 0
    try:
        for event in yaml.parse(text, Loader=yaml.SafeLoader):
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if isinstance(event, yaml.AliasEvent):
                raise Unreadable("there is an alias")
            if isinstance(event, yaml.ScalarEvent) and "${" in event.value:
                raise Unreadable("there is a reference ${...}")
            if depth > DEEPEST:
                raise Unreadable("it is nested too deeply")
        return yaml.safe_load(text)
    except Unreadable:
        raise
    except yaml.YAMLError as error:
        raise Unreadable(" ".join(str(error).split())[:200]) from None
    except (ValueError, TypeError, LookupError, AttributeError) as error:  # odd dates and numbers
        raise Unreadable(str(error)[:200] or type(error).__name__) from None


def read_facts(path: str | os.PathLike[str], limit: int = 1 << 24) -> dict[str, Any]:
    """Read the object in a JSON file; empty if the file is missing or unreadable.

    Its numbers are finite: None stands in the place of others.
    """
    try:
        # Infinity and NaN, which JSON lacks and earlier versions wrote, are None.
        content = json.loads(read_text(path, limit), parse_constant=lambda word: None, parse_float=_finite)
    except (Unreadable, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


def read_config(folder: Path) -> dict[str, Any]:
    """Read the settings in a run's ``config.yaml``; empty if it is no mapping. RunError: the file is damaged."""
    config = folder / CONFIG
    try:
        text = read_text(config, LARGEST_CONFIG)
        content = parse_yaml(text)
    except Unreadable as error:
        raise RunError(f"{config} cannot be read as YAML ({error}): is {folder} a run?") from None
    if not isinstance(content, dict | None):
        return {}
    # missing keys would be taken for the defaults, and the run for another one
    if text.splitlines()[-1:] != [END.strip()]:
        raise RunError(f"{config} has been cut short: it lacks its last line, {END.strip()}. Restore it from a copy.")
    return content or {}


def read_npy(path: str | os.PathLike[str], limit: int) -> np.ndarray:
    """Read an ``.npy`` file of plain numbers.

    Unreadable: no such file, no such array, or a file of more than ``limit`` bytes.
    """
    with _opened(path, limit) as file, _as_unreadable("no .npy file that can be read"):
        return _plain(np.lib.format.read_array(file, allow_pickle=False))


class ArrayFile:
    """An ``.npz`` archive of plain arrays; a context manager that closes the file.

    Args:
        limit: bytes of the file, and of all arrays together.

    Raises:
        Unreadable: no such file, no such archive, or a larger one.
    """

    def __init__(self, path: str | os.PathLike[str], limit: int) -> None:
        self._file = _opened(path, limit)
        try:
            with _as_unreadable("no .npz archive that can be read"):
                self._zip = zipfile.ZipFile(self._file)
                self._members = {info.filename.removesuffix(".npy"): info for info in self._zip.infolist()}
                total = sum(info.file_size for info in self._zip.infolist())
                if total > limit:
                    raise Unreadable(f"its arrays have {total:,} bytes, and {limit:,} are the limit")
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> ArrayFile:
        return self

    def __exit__(self, *_: object) -> None:
        self._zip.close()
        self._file.close()

    @property
    def names(self) -> list[str]:
        """Names of the arrays."""
        return list(self._members)

    def read(self, name: str, limit: int | None = None) -> np.ndarray:
        """Read the array ``name``, of at most ``limit`` bytes (None: the limit of the archive).

        Unreadable: there is none, or it is damaged.
        """
        if name not in self._members:
            raise Unreadable(
                f"it has no array '{name}'; it holds {listing(self.names)}.{did_you_mean(name, self.names)}"
            )
        member = self._members[name]
        if limit is not None and member.file_size > limit:
            raise Unreadable(f"its array '{name}' has {member.file_size:,} bytes, and {limit:,} are the limit")
        with _as_unreadable(f"its array '{name}' is damaged"), self._zip.open(member) as file:
            array = _plain(np.lib.format.read_array(file, allow_pickle=False))
            file.read()  # to the end, where the checksum is compared
            return array


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Build a dictionary from pairs; Unreadable if a name occurs twice."""
    result = dict(pairs)
    if len(result) < len(pairs):
        seen: set[str] = set()
        twice = next(name for name, _ in pairs if name in seen or seen.add(name))
        raise Unreadable(f"the name '{twice}' occurs twice")
    return result


def _finite(text: str) -> float | None:
    value = float(text)
    return value if math.isfinite(value) else None


def _no_number(word: str) -> None:
    raise Unreadable(f"{word} is no number of JSON")


def _opened(path: str | os.PathLike[str], limit: int) -> IO[bytes]:
    """Open a regular file of at most ``limit`` bytes for reading."""
    try:
        if not Path(path).is_file():  # before it is opened: opening a pipe would wait for its writer
            raise Missing("there is no such file")
        file = open(path, "rb")  # noqa: SIM115 (the caller closes it)
    except (OSError, ValueError) as error:
        if isinstance(error, Unreadable):
            raise
        raise Unreadable(getattr(error, "strerror", None) or str(error)) from None
    size = os.fstat(file.fileno()).st_size
    if size > limit:
        file.close()
        raise Unreadable(f"it has {size:,} bytes, and {limit:,} are the limit")
    return file


@contextmanager
def _as_unreadable(reason: str) -> Iterator[None]:
    """Convert any error in the block to Unreadable, because zipfile and numpy raise many kinds for a bad file."""
    try:
        yield
    except Unreadable:
        raise
    except MemoryError:
        raise Unreadable("it does not fit into memory") from None
    except Exception as error:
        raise Unreadable(f"{reason} ({str(error).strip() or type(error).__name__:.200})") from None


def _plain(array: np.ndarray) -> np.ndarray:
    if array.dtype.kind not in "biuf":
        raise Unreadable(f"an array of {array.dtype} is not made of plain numbers")
    return array
