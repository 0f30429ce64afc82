"""What a checkpoint file claims, looked at before torch believes it.

``torch.load(weights_only=True)`` runs no code of the file's, but among what it allows are calls that take as much
memory as the file asks for, and older releases read a tensor as long as the file says from a record that is shorter.
Here the pickle is only read, opcode by opcode, never executed: it may name what :func:`torch.save` writes for tensors
and containers, and the storages it claims must be as long as the records of the archive.
"""

from __future__ import annotations

import pickletools
import zipfile
from collections.abc import Iterator
from pathlib import Path

__all__ = ["LARGEST", "check_claims"]

LARGEST = 1 << 33
"""Bytes that a checkpoint may have (8 GiB)."""
LARGEST_PICKLE = 1 << 26
"""Bytes of the part that describes the tensors (64 MiB)."""

ITEM_SIZES = {
    "FloatStorage": 4,
    "DoubleStorage": 8,
    "HalfStorage": 2,
    "BFloat16Storage": 2,
    "LongStorage": 8,
    "IntStorage": 4,
    "ShortStorage": 2,
    "CharStorage": 1,
    "ByteStorage": 1,
    "BoolStorage": 1,
}
"""Bytes of a number in the storages that torch.save names."""
ALLOWED = {
    "collections OrderedDict",
    "torch._utils _rebuild_tensor_v2",
    "torch._utils _rebuild_parameter",
    *(f"torch {name}" for name in ITEM_SIZES),
}
"""What a checkpoint may name; the tensors of all states of ours need no more."""
OPCODES = set(
    "PROTO STOP MARK TUPLE TUPLE1 TUPLE2 TUPLE3 EMPTY_TUPLE EMPTY_DICT EMPTY_LIST APPEND APPENDS SETITEM SETITEMS"
    " NONE NEWTRUE NEWFALSE BININT BININT1 BININT2 LONG1 BINFLOAT BINUNICODE BINPUT LONG_BINPUT BINGET LONG_BINGET"
    " GLOBAL REDUCE BUILD BINPERSID".split()
)
"""Those of torch.save for numbers, texts, containers and tensors."""
MOST_DIGITS = 32
"""Bytes of a whole number."""


def check_claims(path: Path) -> None:
    """Look at a file of :func:`torch.save` without executing anything of it.

    Raises:
        ValueError, zipfile.BadZipFile, OSError: it is no such file, or claims what is not there; the text says what.
    """
    size = path.stat().st_size
    if size > LARGEST:
        raise ValueError(f"it has {size:,} bytes, and {LARGEST:,} are the limit")
    try:
        with zipfile.ZipFile(path) as archive:
            records = _records(archive, size)
            (name,) = (name for name in records if name.endswith("/data.pkl"))
            if records[name] > LARGEST_PICKLE:
                raise ValueError("its description of the tensors is too long")
            content = archive.read(name)
    except (NotImplementedError, RuntimeError, KeyError, EOFError, zipfile.LargeZipFile) as error:
        raise ValueError(f"it is damaged: {error}") from None
    for kind, key, count in _storages(content):
        there = records.get(f"{name.removesuffix('data.pkl')}data/{key}")
        if there != count * ITEM_SIZES[kind]:
            raise ValueError(
                f"a tensor claims {count * ITEM_SIZES[kind]:,} bytes, and the file has {there or 0:,} of it"
            )


def _records(archive: zipfile.ZipFile, size: int) -> dict[str, int]:
    """Bytes of every record by name; torch packs none of them."""
    infos = archive.infolist()
    records = {info.filename: info.file_size for info in infos}
    if len(records) < len(infos):
        raise ValueError("two of its records have one name")
    if any(info.compress_type != zipfile.ZIP_STORED or info.file_size != info.compress_size for info in infos):
        raise ValueError("its records are packed, which torch does not do")
    if sum(records.values()) > size:
        raise ValueError("its records claim more bytes than the file has")
    return records


def _storages(content: bytes) -> Iterator[tuple[str, str, int]]:
    """Kind, key and number of entries of every storage that a pickle refers to.

    Follows the values since the last mark, which is all that torch's references consist of: ``("storage", kind, key,
    device, count)``.
    """
    since_mark: list[object] = []
    reference: list[object] = []
    memo: dict[int, object] = {}
    before = ("", "")
    for opcode, argument, _ in pickletools.genops(content):
        name = opcode.name
        if name not in OPCODES:
            raise ValueError(
                f"its description of the tensors has the instruction {name}, which torch.save does not use"
            )
        if name == "GLOBAL" and argument not in ALLOWED:
            raise ValueError(f"it names {argument!r:.100}, which no checkpoint of warpvox needs; nothing of it was run")
        if name == "LONG1" and argument.bit_length() > 8 * MOST_DIGITS:
            raise ValueError("it holds a number of too many digits")
        if name == "MARK":
            since_mark = []
        elif name in ("BINPUT", "LONG_BINPUT"):
            memo[argument] = since_mark[-1] if since_mark else None
        elif name in ("BINGET", "LONG_BINGET"):
            since_mark.append(memo.get(argument))
        elif name == "TUPLE":
            reference, since_mark = since_mark, [None]
        elif name == "BINPERSID":
            # the reference must be the tuple that was just made, not one that was put aside earlier
            fresh = "TUPLE" in (before[1], before[0] if before[1].endswith("BINPUT") else "")
            yield _storage(reference if fresh else [])
            since_mark = [None]
        else:
            since_mark.append(argument)
        before = (before[1], name)


def _storage(reference: list[object]) -> tuple[str, str, int]:
    if len(reference) == 5:
        word, kind, key, _, count = reference
        kind = str(kind).removeprefix("torch ")
        if word == "storage" and kind in ITEM_SIZES and isinstance(key, str) and type(count) is int and count >= 0:
            return kind, key, count
    raise ValueError(f"it refers to {reference!r:.100}, which is no storage")
