"""The pinned digests: of which platforms there are some, and what a digest found here says.

A rollout is made of IEEE sums, products, quotients and roots, which are the same everywhere, and of a few functions of
the C library (the hyperbolic tangent of friction, the arc cosine of orientations), which are not. A platform is
therefore known by the machine, by Warp's version, whose compiler makes the kernels, and by a fingerprint of that
library. The CPU's vectors do not matter, nor did numpy (2.2 and 2.4 were tried); other versions of torch were not.
"""

import hashlib
import json
import math
import platform
import struct
from collections.abc import Sequence
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

FILE = Path(__file__).with_name("digests.json")
FUNCTIONS = (math.tanh, math.sin, math.cos, math.atan, math.exp, lambda x: math.acos(x / 8), lambda x: math.atan2(x, 3))
POINTS = 4000
HOW = "python tests/determinism/record.py"


def fingerprint() -> str:
    """Of the C library's functions at numbers in [-8, 8]."""
    numbers = [16 * (k * 0.6180339887498949 % 1.0) - 8 for k in range(1, POINTS)]
    found = hashlib.sha256()
    for function in FUNCTIONS:
        found.update(struct.pack(f"<{len(numbers)}d", *map(function, numbers)))
    return found.hexdigest()[:8]


@cache
def known_libm() -> bool:
    """True where the C library rounds as on a platform whose digests are recorded."""
    return fingerprint() in {record["platform"]["libm"] for record in load()}


def this_platform() -> dict[str, str]:
    """What the bits of a rollout can depend on."""
    return {"machine": platform.machine(), "libm": fingerprint(), "warp-lang": version("warp-lang")}


def load() -> list[dict[str, Any]]:
    """The records: ``{"platform": ..., "digests": {precision: {task: digest}}}``."""
    return json.loads(FILE.read_text(encoding="utf-8"))


def verdict(
    found: str, precision: str, task: str, records: Sequence[dict[str, Any]], here: dict[str, str]
) -> Literal["same", "changed", "unknown"]:
    """Whether a digest is pinned; one that is not is a change only where this very platform has been recorded."""
    if any(record["digests"][precision].get(task) == found for record in records):
        return "same"
    return "changed" if any(record["platform"] == here for record in records) else "unknown"
