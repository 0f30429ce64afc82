"""Damaged inputs, reproducible, and an object that fails at every use."""

import copy
import random
from collections.abc import Callable, Iterator
from typing import Any

from warpvox.errors import WarpvoxError

STRANGE = (None, True, -1, 10**400, 1e308, "x", "\ud800", [], {}, [[1]], {"a": [None]})
"""JSON values to put where others are expected."""


class Stranger:
    """An object that fails at every use."""

    def __array__(self, *_: object, **__: object) -> None:
        raise KeyError("no array")

    def __len__(self) -> int:
        raise OSError("no length")


def damaged_bytes(data: bytes, count: int) -> Iterator[bytes]:
    """Damage ``data`` by cutting, changing or inserting bytes."""
    rng = random.Random(0)
    for number in range(count):
        place = rng.randrange(len(data))
        yield (
            data[:place],
            data[:place] + bytes([rng.randrange(256)]) + data[place + 1 :],
            data[:place] + rng.randbytes(8) + data[place:],
        )[number % 3]


def damaged_tree(tree: Any, count: int) -> Iterator[Any]:
    """Damage a tree of lists and mappings by removing or replacing one part."""
    rng = random.Random(0)
    for _ in range(count):
        changed = part = copy.deepcopy(tree)
        while True:
            keys = list(part) if isinstance(part, dict) else list(range(len(part)))
            key = rng.choice(keys)
            if not isinstance(part[key], list | dict) or not part[key] or rng.random() < 0.3:
                break
            part = part[key]
        if rng.random() < 0.3:
            del part[key]
        else:
            part[key] = rng.choice(STRANGE)
        yield changed


def refusals(use: Callable[[Any], object], inputs: Iterator[Any]) -> int:
    """Pass all inputs to ``use``, and count the WarpvoxErrors; other errors are raised."""
    sentences = []
    for one in inputs:
        try:
            use(one)
        except WarpvoxError as error:
            sentences.append(str(error).strip())
    assert all(0 < len(sentence) < 50_000 for sentence in sentences)
    return len(sentences)
