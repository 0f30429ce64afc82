"""Checks of the values in an archive: SQLite's columns take values of any kind, whatever their declaration says."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path, PurePath

__all__ = ["BACKUP", "check_row", "repair_hint"]

BACKUP = "archive.backup.sqlite"
"""The archive as it was after the last whole generation."""

KINDS: dict[str, type | tuple[type, ...]] = {
    **dict.fromkeys(("id", "generation"), int),
    **dict.fromkeys(("body", "origin"), str),
    "seed": int,
    "fitness": float,
    **dict.fromkeys(("steps", "stopped", "reused"), int),
    **dict.fromkeys(("policy", "policy_sha256"), str),
    "seconds": float,
}
"""Columns of a candidate; those from ``fitness`` on may be missing."""


def check_row(row: Sequence[object], parents: Sequence[object], curve: Sequence[tuple[object, object]]) -> None:
    """Raise ValueError unless the values of a candidate are of the kinds that the archive writes.

    Args:
        row: in the order of :data:`KINDS`.
    """
    for place, ((name, kind), value) in enumerate(zip(KINDS.items(), row, strict=True)):
        missing = value is None and place > 4
        if not missing and (not isinstance(value, kind) or (kind is float and not math.isfinite(value))):
            raise ValueError(f"the {name} of candidate {row[0]!r:.40} is {value!r:.40}")
    if not all(isinstance(parent, int) and 0 <= parent < row[0] for parent in parents):
        raise ValueError(f"candidate {row[0]} descends from {list(parents)!r:.80}")
    if not all(isinstance(steps, int) and isinstance(value, float) and math.isfinite(value) for steps, value in curve):
        raise ValueError(f"the curve of candidate {row[0]} is {curve!r:.80}")
    policy = PurePath(row[9] or "")
    if policy.is_absolute() or ".." in policy.parts:
        raise ValueError(f"the policy of candidate {row[0]} lies outside of the experiment: {row[9]!r:.80}")


def repair_hint(path: Path) -> str:
    """How to restore an archive that is damaged or gone from its backup, as a sentence; empty if there is none."""
    backup = path.with_name(BACKUP)
    if path == backup or not backup.is_file():
        return ""
    return (
        f" {backup.name} beside it holds all generations that were whole: copy it over {path.name} (and remove"
        f" {path.name}-journal, if there is one), then resume; the result is the same."
    )
