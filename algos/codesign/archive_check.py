"""Checks that an SQLite file is an archive of warpvox, before any query on it.

A foreign view, trigger, index or check is a program that SQLite runs during a query, possibly for ever. Therefore the
whole schema of the file must be the one that we write.
"""

from __future__ import annotations

import math
import re
import sqlite3
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from functools import cache
from pathlib import Path

__all__ = ["LARGEST_VALUE", "check_numbers", "check_row", "check_schema", "restrict"]

NoneType = type(None)

LARGEST_VALUE = 16_000_000
"""Bytes that one value of the archive may have: settings and bodies are texts of some hundred to some thousand."""
_COMMENT = re.compile(r"--[^\n]*")
_SCHEMA = "SELECT type, name, tbl_name, sql FROM sqlite_master"


def restrict(db: sqlite3.Connection) -> None:
    """Let SQLite trust no part of the file's schema."""
    db.execute("PRAGMA trusted_schema = OFF")
    db.execute("PRAGMA cell_size_check = ON")
    if hasattr(db, "setlimit"):  # Python 3.11
        db.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_VALUE)


def check_schema(db: sqlite3.Connection, tables: str) -> str | None:
    """What is wrong with the schema of a file, or None.

    Args:
        tables: the statements that make ours; comments and blanks do not matter.
    """
    have, want = _schema(db), _schema_of(tables)
    missing = sorted(name for _, name, *_ in want - have if name not in {other for _, other, *_ in have})
    if missing:
        return f"is damaged: it lacks the table {missing[0]}"
    if have != want:
        kind, name, *_ = sorted(have ^ want, key=str)[0]
        return f"is damaged, or not made by warpvox: its {kind} {name!r:.80} is not that of an archive"
    return None


def _schema(db: sqlite3.Connection) -> frozenset[tuple[str, str, str, str]]:
    return frozenset(
        (kind, name, table, "".join(_COMMENT.sub("", sql or "").split()))
        for kind, name, table, sql in db.execute(_SCHEMA)
    )


@cache
def _schema_of(tables: str) -> frozenset[tuple[str, str, str, str]]:
    with closing(sqlite3.connect(":memory:")) as db:
        db.executescript(tables)
        return _schema(db)


def check_numbers(rows: Iterable[Mapping[str, object]]) -> None:
    """Raise ValueError unless all values of a table are finite numbers or missing."""
    for row in rows:
        for name, value in row.items():
            if not isinstance(value, (int, float, NoneType)) or not math.isfinite(value or 0):
                raise ValueError(f"the {name} of generation {row.get('generation')!r:.40} is {value!r:.40}")


def check_row(row: Sequence[object], parents: Sequence[object], curve: Sequence[tuple[object, object]]) -> None:
    """Raise ValueError unless the values of a candidate are of the kinds that the archive writes.

    SQLite's columns take values of any kind, whatever their declaration says.

    Args:
        row: id, generation, body, origin, seed, fitness, steps, stopped, reused, policy, policy_sha256, seconds.
    """
    for name, kind, value in zip(_ROW, _ROW.values(), row, strict=True):
        if not isinstance(value, kind) or (isinstance(value, float) and not math.isfinite(value)):
            raise ValueError(f"the {name} of candidate {row[0]!r:.40} is {value!r:.40}")
    if not all(isinstance(parent, int) and 0 <= parent < row[0] for parent in parents):
        raise ValueError(f"candidate {row[0]} descends from {list(parents)!r:.80}")
    for steps, value in curve:
        if not isinstance(steps, int) or not isinstance(value, float) or not math.isfinite(value):
            raise ValueError(f"the curve of candidate {row[0]} has the point {(steps, value)!r:.80}")
    policy = row[9]
    if policy is not None and (Path(policy).is_absolute() or ".." in Path(policy).parts or "\0" in policy):
        raise ValueError(f"the policy of candidate {row[0]} lies outside of the experiment: {policy!r:.80}")


_ROW: dict[str, tuple[type, ...]] = {
    "id": (int,),
    "generation": (int,),
    "body": (str,),
    "origin": (str,),
    "seed": (int,),
    "fitness": (float, NoneType),
    "steps": (int, NoneType),
    "stopped": (int, NoneType),
    "reused": (int, NoneType),
    "policy": (str, NoneType),
    "policy_sha256": (str, NoneType),
    "seconds": (float, NoneType),
}
