"""Which program has made a result, and on which processor."""

from __future__ import annotations

import functools
import subprocess
from pathlib import Path

from warpvox import __version__
from warpvox.system import processor_name

__all__ = ["provenance"]

PATIENCE = 20.0
"""Seconds that git may take, on the disk of a network for instance."""


def provenance() -> dict[str, str | None]:
    """For ``summary.json``: version, processor and, in a checkout, the commit (``-dirty`` where files were changed)."""
    return {"version": __version__, "commit": _commit(), "processor": processor_name()}


@functools.cache
def _commit() -> str | None:
    """None: an installed package, or no git."""
    root = Path(__file__).resolve().parents[1]
    if not (root / ".git").exists():
        return None
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, stdin=subprocess.DEVNULL)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip() or None if done.returncode == 0 else None
