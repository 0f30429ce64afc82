"""Hypothesis strategies for inputs that are not what they should be: damaged bytes, JSON trees, arrays and archives."""

from __future__ import annotations

import copy
import io
import json
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from hypothesis.strategies import SearchStrategy

NUMBERS = [0, 1, -1, 255, 65536, 2**31, -(2**31), 2**63, 10**30, 0.5, 1e-300, 1e308, np.nan, np.inf, -np.inf]
TEXTS = ["", "\0", "../x", "robot", "ä€𝄞", "\ud800", "9" * 5000, "a" * 5000, "%s%n{0}", "</script>", "NaN", "true"]
SCALARS = st.sampled_from([None, True, False, *NUMBERS, *TEXTS]) | st.integers(-10, 10) | st.text(max_size=5)
VALUES = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner, max_size=3)
)
"""What JSON can hold, and hardly any place expects."""
PATCHES = st.binary(max_size=4) | st.sampled_from(
    [b"-1", b"1e999", b"9" * 5000, b"NaN", b"[" * 3000, b'"', b"{", b",", b"\xff\xfe", b"\xff" * 8, b"\0" * 8]
    + [struct.pack(form, number) for form in ("<I", "<Q", ">I") for number in (2**31 - 1, 2**31, 2**32 - 1)]
)


class Stranger:
    """An object that fails whatever it is asked for."""

    def __array__(self, *_: object, **__: object) -> np.ndarray:
        raise KeyError("no array")

    def __len__(self) -> int:
        raise OSError("no length")


ARRAYS = hnp.arrays(
    hnp.scalar_dtypes() | st.just(np.dtype("U3")), hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=3)
)
STRANGE = [Stranger(), object, range(3), {1, 2}, np.float32("nan"), np.bool_(True), 3 + 4j, b"x", slice(3), Path("x")]
ARGUMENTS = VALUES | ARRAYS | st.sampled_from(STRANGE)
"""What a function is given by mistake, and now and then what it expects."""


@st.composite
def damaged_bytes(draw: Callable, content: bytes | SearchStrategy[bytes]) -> bytes:
    """``content`` with some bytes changed, removed, inserted, repeated or cut off."""
    data = bytearray(draw(content) if isinstance(content, SearchStrategy) else content)
    for _ in range(draw(st.sampled_from([1, 1, 1, 2, 4]))):
        start = draw(st.integers(0, len(data)))
        count = draw(st.sampled_from([0, 1, 1, 2, 4, 8, 100, len(data)]))
        data[start : start + count] = draw(PATCHES | st.just(bytes(data[:start][-40:])))
    return bytes(data)


@st.composite
def damaged_tree(draw: Callable, tree: Any) -> Any:
    """``tree``, of lists and mappings, with some of its parts removed, replaced, wrapped or doubled."""
    root = [copy.deepcopy(tree)]
    for _ in range(draw(st.sampled_from([1, 1, 2]))):
        holder, key = root, 0
        while isinstance(holder[key], (dict, list)) and holder[key] and draw(st.integers(0, 5)):
            holder = holder[key]
            key = draw(st.sampled_from(list(holder) if isinstance(holder, dict) else range(len(holder))))
        change = draw(st.sampled_from(["number", "number", "replace", "remove", "wrap", "double", "rename"]))
        if change == "number" and type(holder[key]) in (int, float):
            holder[key] = draw(st.integers(0, 6))
        elif change == "remove" and holder is not root:
            del holder[key]
        elif change == "wrap":
            holder[key] = [holder[key]]
        elif change == "double" and isinstance(holder, list) and holder is not root:
            holder.insert(key, copy.deepcopy(holder[key]))
        elif change == "rename" and isinstance(holder, dict):
            holder[draw(st.sampled_from(TEXTS))] = holder.pop(key)
        else:
            holder[key] = draw(VALUES)
    return root[0]


def as_json(tree: Any) -> bytes:
    """A tree as JSON; halves of characters stay what they are."""
    return json.dumps(tree, ensure_ascii=False).encode("utf-8", "surrogatepass")


def damaged_json(tree: Any) -> SearchStrategy[bytes]:
    """A JSON file whose content is wrong, or whose text is."""
    return damaged_tree(tree).map(as_json) | damaged_bytes(as_json(tree))


# ------------------------------------------------------------------------------------------------------ arrays


def npy(array: np.ndarray) -> bytes:
    """An array as an .npy file; objects are pickled."""
    target = io.BytesIO()
    np.save(target, array, allow_pickle=True)
    return target.getvalue()


def claiming(shape: str, data: bytes = b"", descr: str = "'<f8'") -> bytes:
    """An .npy file whose header says what it likes."""
    head = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head + data


CLAIMS = [
    claiming("(1000000000000,)"),
    claiming("(1000000, 1000000)", b"\0" * 80),
    claiming("(200000000,)", b"\0" * 8),
    claiming("(100,)", b"\0" * 8, "'|V1000000000'"),
    claiming("(3,)", b"\0" * 24, "'|O'"),
    claiming("(2,)", b"\0" * 24, "[('a', '<i4'), ('b', '|O')]"),
    claiming("()", b"", "('<f4', (100000, 100000))"),
    claiming("(-1, -1)", b"\0" * 8),
    claiming("(" + "9" * 3000 + ",)"),
    claiming("(" * 3000),
    claiming("__import__('os').system('touch pwned')"),
]
"""Files whose headers claim what they do not hold."""


@st.composite
def altered(draw: Callable, array: np.ndarray) -> np.ndarray:
    """``array`` with one other value, or as another type or shape."""
    array = np.array(array)
    if array.size and array.dtype.kind in "iuf" and draw(st.booleans()):
        extreme = st.sampled_from([np.nan, np.inf, 1e9] if array.dtype.kind == "f" else [100])
        array.flat[draw(st.integers(0, array.size - 1))] = draw(st.integers(0, 7) | extreme)
        return array
    changes = [lambda a: a.astype("f8"), lambda a: a.astype(">i4"), lambda a: a.T, lambda a: a[None], lambda a: a[:1]]
    with np.errstate(invalid="ignore"):
        return draw(st.sampled_from(changes[: 5 if array.ndim else 4]))(array)


def damaged_npy(array: np.ndarray) -> SearchStrategy[bytes]:
    """An .npy file with other content, a false header or damaged bytes."""
    arrays = (altered(array) | ARRAYS).map(npy)
    return arrays | st.sampled_from(CLAIMS) | damaged_bytes(npy(array))


def zipped(parts: dict[str, bytes], compression: int = zipfile.ZIP_DEFLATED) -> bytes:
    """Files in an archive."""
    target = io.BytesIO()
    with zipfile.ZipFile(target, "w", compression) as archive:
        for name, data in parts.items():
            archive.writestr(name, data)
    return target.getvalue()


def unzipped(data: bytes) -> dict[str, bytes]:
    """Files of an archive."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


@st.composite
def damaged_zip(draw: Callable, parts: dict[str, bytes], damage: Callable[[bytes], SearchStrategy[bytes]]) -> bytes:
    """An archive: one of its files damaged (its checksum is right again), lost or renamed, or its own bytes damaged."""
    parts, name = dict(parts), draw(st.sampled_from(list(parts)))
    change = draw(st.sampled_from(["inside", "inside", "lost", "renamed", "outside"]))
    if change == "inside":
        parts[name] = draw(damage(parts[name]))
    elif change == "lost":
        del parts[name]
    elif change == "renamed":
        parts[draw(st.sampled_from(["x", "../../x.npy", "arr_2.npy", *parts]))] = parts.pop(name)
    data = zipped(parts, draw(st.sampled_from([zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED])))
    return draw(damaged_bytes(data)) if change == "outside" else data


def damaged_npz(parts: dict[str, bytes]) -> SearchStrategy[bytes]:
    """An .npz archive, damaged at one of its levels."""
    return damaged_zip(parts, lambda part: damaged_npy(np.load(io.BytesIO(part))))
