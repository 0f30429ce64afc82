"""Ways to spoil an input: its bytes, its structure, its arrays. All draw from a ``random.Random`` alone."""

from __future__ import annotations

import copy
import io
import json
import random
import re
import struct
import zipfile
from collections.abc import Callable
from typing import Any

import numpy as np

Draw = random.Random

NUMBERS = (0, 1, -1, 2, 7, 255, 256, 65536, 2**31 - 1, 2**31, -(2**31), 2**63, 10**12, 10**30, 0.5, -0.0, 1e-300, 1e308)
ODD_NUMBERS = (float("nan"), float("inf"), float("-inf"))
TEXTS = ("", "x", "\0", "../x", "robot", "ä€𝄞", "\ud800", "9" * 50, "a" * 5000, "%s%n{0}", "</script>", "NaN", "true")
PLAIN = (None, True, False, [], {}, [[]], [0], {"": 0}, [None], *NUMBERS, *ODD_NUMBERS, *TEXTS)


def value(draw: Draw) -> Any:
    """Something that hardly any place expects."""
    kind = draw.randrange(8)
    if kind == 0:
        return nested(draw.choice((3, 20)))
    if kind == 1:
        return [draw.choice(NUMBERS) for _ in range(draw.randrange(20))]
    if kind == 2:
        return draw.randint(-10, 10)
    return copy.deepcopy(draw.choice(PLAIN))


def nested(depth: int) -> list:
    """Lists in lists."""
    inner: list = []
    for _ in range(depth):
        inner = [inner]
    return inner


# ------------------------------------------------------------------------------------------------------- bytes


def spoil_bytes(draw: Draw, data: bytes, other: bytes = b"") -> bytes:
    """A few changes that know nothing of the format."""
    content = bytearray(data)
    for _ in range(draw.choice((1, 1, 1, 2, 3, 8))):
        content = draw.choice(BYTE_CHANGES)(draw, content, other)
    return bytes(content)


def _place(draw: Draw, content: bytearray) -> int:
    return draw.randrange(len(content) + 1)


def _flip(draw: Draw, content: bytearray, other: bytes) -> bytearray:
    if content:
        content[draw.randrange(len(content))] ^= 1 << draw.randrange(8)
    return content


def _set(draw: Draw, content: bytearray, other: bytes) -> bytearray:
    if content:
        content[draw.randrange(len(content))] = draw.choice((0, 1, 0x7F, 0x80, 0xFF, *b'"[]{},:0-9.eE\n'))
    return content


def _cut(draw: Draw, content: bytearray, other: bytes) -> bytearray:
    return content[: _place(draw, content)]


def _drop(draw: Draw, content: bytearray, other: bytes) -> bytearray:
    start = _place(draw, content)
    del content[start : start + draw.choice((1, 2, 8, 100))]
    return content


def _double(draw: Draw, content: bytearray, other: bytes) -> bytearray:
    start = _place(draw, content)
    part = content[start : start + draw.choice((1, 4, 40, 400))]
    content[start:start] = part * draw.choice((1, 1, 3))
    return content


def _insert(draw: Draw, content: bytearray, other: bytes) -> bytearray:
    start = _place(draw, content)
    content[start:start] = draw.randbytes(draw.choice((1, 4, 16)))
    return content


def _splice(draw: Draw, content: bytearray, other: bytes) -> bytearray:
    return content[: _place(draw, content)] + other[draw.randrange(len(other) + 1) :]


def _number(draw: Draw, content: bytearray, other: bytes) -> bytearray:
    """Another number for one that stands there in digits."""
    found = list(re.finditer(rb"-?\d+", content))
    if not found:
        return _flip(draw, content, other)
    spot = draw.choice(found)
    word = draw.choice(
        (b"-1", b"0", b"1.5", b"1e999", b"99999999999999999999", b"1" * 5000, b"NaN", b"-Infinity", b"01")
    )
    content[spot.start() : spot.end()] = word
    return content


def _integer(draw: Draw, content: bytearray, other: bytes) -> bytearray:
    """An extreme whole number over four or eight bytes: lengths, counts and offsets of binary formats."""
    if len(content) < 8:
        return _insert(draw, content, other)
    form = draw.choice(("<I", "<Q", ">I", "<H"))
    top = 2 ** (8 * struct.calcsize(form))
    start = draw.randrange(len(content) - 7)
    struct.pack_into(form, content, start, draw.choice((0, 1, top - 1, top // 2, top // 2 - 1, draw.randrange(top))))
    return content


def _mark(draw: Draw, content: bytearray, other: bytes) -> bytearray:
    """Other encodings, at the beginning."""
    return bytearray(draw.choice((b"\xef\xbb\xbf", b"\xff\xfe", b"\xfe\xff", b"\x00", b"\x80"))) + content


BYTE_CHANGES = (_flip, _flip, _set, _cut, _drop, _double, _insert, _splice, _number, _number, _integer, _mark)


# --------------------------------------------------------------------------------------------------- structure


def spoil_tree(draw: Draw, tree: Any) -> Any:
    """Lists and mappings with a few of their parts removed, replaced, doubled or exchanged."""
    tree = copy.deepcopy(tree)
    for _ in range(draw.choice((1, 1, 1, 2, 4))):
        tree = _change_one(draw, tree)
    return tree


def _change_one(draw: Draw, tree: Any) -> Any:
    holders: list[Any] = []

    def collect(node: Any, depth: int = 0) -> None:
        if isinstance(node, (dict, list)) and node and depth < 20:
            holders.append(node)
            for item in node.values() if isinstance(node, dict) else node:
                collect(item, depth + 1)

    collect(tree)
    if not holders or draw.random() < 0.02:
        return value(draw)
    # Levels alike: else nearly all changes would be to the numbers at the bottom.
    small = [node for node in holders if isinstance(node, dict) or not isinstance(node[0], (int, float))]
    node = draw.choice(small if small and draw.random() < 0.6 else holders)
    key = draw.choice(list(node)) if isinstance(node, dict) else draw.randrange(len(node))
    kind = draw.randrange(8)
    if kind == 0:
        del node[key]
    elif kind == 1 and isinstance(node[key], (int, float)) and not isinstance(node[key], bool):
        node[key] = node[key] + draw.choice((1, -1, 0.5, 2**31, 1000))
    elif kind == 2:
        node[key] = [node[key]]
    elif kind == 3 and isinstance(node, dict):
        node[draw.choice((*TEXTS, *node))] = node.pop(key) if draw.random() < 0.5 else node[key]
    elif kind == 3:
        node.insert(key, copy.deepcopy(node[key]))
    elif kind == 4:
        other = draw.choice(holders)
        node[key] = copy.deepcopy(draw.choice(list(other.values()) if isinstance(other, dict) else other))
    elif kind == 5 and isinstance(node[key], list):
        node[key] = node[key][:: draw.choice((-1, 2))]
    else:
        node[key] = value(draw)
    return tree


def as_json(draw: Draw, tree: Any) -> bytes:
    """A tree as JSON, now and then with what JSON does not have: names twice, odd encodings, NaN."""
    text = json.dumps(tree, ensure_ascii=draw.random() < 0.8)
    if draw.random() < 0.02:
        text = text.replace("[", draw.choice(("[", '{"a":')) * draw.choice((60, 1500, 100_000)), 1)
    if draw.random() < 0.05 and '": ' in text:
        spot = draw.choice([found.start() for found in re.finditer('"[^"]*": ', text)])
        text = text[:spot] + re.match('"[^"]*": ', text[spot:])[0] + "0, " + text[spot:]
    coding = draw.choice(("utf-8",) * 30 + ("utf-16", "utf-8-sig", "latin-1"))
    return text.encode(coding, "surrogatepass" if coding.startswith("utf-8") else "replace")


# ------------------------------------------------------------------------------------------------------ arrays

TYPES = (
    "int8",
    "uint8",
    "int64",
    "float32",
    "float64",
    ">i4",
    "bool",
    "complex64",
    "U3",
    "S2",
    "M8[s]",
    "object",
    "f2",
)


def spoil_array(draw: Draw, array: np.ndarray) -> np.ndarray:
    """An array with another shape, type or content."""
    array = np.array(array)
    kind = draw.randrange(9)
    with np.errstate(all="ignore"):
        if kind == 0:
            return array.reshape(-1)
        if kind == 1:
            return array[None]
        if kind == 2:
            return array[: draw.randrange(3)] if array.ndim else array
        if kind == 3:
            return np.concatenate([array, array]) if array.ndim else array[None]
        if kind == 4:
            try:
                return array.astype(draw.choice(TYPES))
            except (TypeError, ValueError):
                return np.array(["x", None], object)
        if kind == 5:
            return np.asfortranarray(array.T)
        if kind == 6 and array.size:
            return np.full_like(array, draw.choice((0, 1, 2, 5, 6, 127)))
        if array.size and array.dtype.kind in "iuf":
            array = array.astype(draw.choice(("float64", array.dtype.str)))
            extreme = draw.choice((-1, 6, 1e9, 2**40, np.nan, np.inf, 0.5, 3))
            fits = array.dtype.kind == "f" or (extreme == extreme and abs(extreme) < 2**6 and extreme == int(extreme))
            array.flat[draw.randrange(array.size)] = extreme if fits else 0
            return array
        return np.zeros(draw.choice(((), (0,), (0, 5), (5, 0), (1, 1), (3, 3, 3))), array.dtype)


def npy_bytes(array: np.ndarray) -> bytes:
    """An array as an .npy file; objects are pickled."""
    target = io.BytesIO()
    np.save(target, array, allow_pickle=True)
    return target.getvalue()


def false_header(draw: Draw, data: bytes) -> bytes:
    """An .npy file whose header claims something else."""
    if len(data) < 10:
        return data
    end = 10 + struct.unpack_from("<H", data, 8)[0]
    description = draw.choice(
        (
            "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }",
            "{'descr': '|i1', 'fortran_order': True, 'shape': (1000000, 1000000), }",
            "{'descr': '|V1000000000', 'fortran_order': False, 'shape': (1000,), }",
            "{'descr': '|O', 'fortran_order': False, 'shape': (3,), }",
            "{'descr': '<i8', 'fortran_order': False, 'shape': (-1,), }",
            "{'descr': '<i8', 'fortran_order': False, 'shape': (True, 0), }",
            "{'descr': [('a', '<i4'), ('b', '|O')], 'fortran_order': False, 'shape': (2,), }",
            "{'descr': ('<f4', (100000, 100000)), 'fortran_order': False, 'shape': (), }",
            "{'descr': '<i1', 'fortran_order': False, 'shape': (" + "9" * draw.choice((20, 2000)) + ",), }",
            "(" * draw.choice((50, 1500)),
            "-" * 3000 + "1",
            "__import__('os').system('touch pwned')",
        )
    ).encode()
    magic = b"\x93NUMPY" + bytes(draw.choice(((1, 0), (1, 0), (1, 0), (2, 0), (3, 0), (9, 9))))
    form = "<H" if magic[6] == 1 else "<I"
    return magic + struct.pack(form, len(description)) + description + data[end:]


def zip_bytes(parts: dict[str, bytes], packed: bool = True) -> bytes:
    """Files in an archive."""
    target = io.BytesIO()
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED if packed else zipfile.ZIP_STORED) as archive:
        for name, data in parts.items():
            archive.writestr(name, data)
    return target.getvalue()


def unzip(data: bytes) -> dict[str, bytes]:
    """Files of an archive."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def spoil_zip(draw: Draw, data: bytes, spoil: Callable[[Draw, str, bytes], bytes]) -> bytes:
    """An archive with some of its files spoilt, lost or renamed; the sums of the archive are right again."""
    parts = unzip(data)
    for _ in range(draw.choice((1, 1, 2))):
        name = draw.choice(list(parts))
        kind = draw.randrange(10)
        if kind == 0 and len(parts) > 1:
            del parts[name]
        elif kind == 1:
            parts[draw.choice((*TEXTS[1:2], "../../x.npy", "arr_2.npy", *parts))] = parts[name]
        else:
            parts[name] = spoil(draw, name, parts[name])
    return zip_bytes(parts, packed=draw.random() < 0.5)


def spoil_directory(draw: Draw, data: bytes) -> bytes:
    """An archive whose directory lies about sizes, places or kinds of packing."""
    content = bytearray(data)
    heads = [found.start() for found in re.finditer(rb"PK\x01\x02", data)]
    if not heads:
        return data
    start = draw.choice(heads)
    offset, form = draw.choice(((10, "<H"), (8, "<H"), (20, "<I"), (24, "<I"), (42, "<I"), (28, "<H"), (16, "<I")))
    top = 2 ** (8 * struct.calcsize(form))
    struct.pack_into(form, content, start + offset, draw.choice((0, 1, 12, 14, top - 1, top // 2, draw.randrange(top))))
    return bytes(content)
