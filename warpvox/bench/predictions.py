"""What a GPU was predicted to do, to be shown beside what it does; the arithmetic is in docs/performance.md."""

from __future__ import annotations

from warpvox.bench.report import number

__all__ = ["KERNEL", "PREDICTED", "predicted"]

KERNEL = "16 threads an environment"
"""The kernel whose predictions stand beside measurements."""
PREDICTED: dict[str, dict[int, tuple[float, float]]] = {
    KERNEL: {4096: (3.2e6, 6.4e6), 16384: (3.6e6, 7.3e6), 65536: (4.1e6, 8.2e6)},
    "one thread an environment": {4096: (0.15e6, 0.25e6), 16384: (0.6e6, 0.9e6), 65536: (1.1e6, 1.9e6)},
}
"""Control steps per second of the physics, Walker-v0 in float32 on an H100 or H200: least and most, by kernel and count
of environments."""


def predicted(task: str, dtype: str, num_envs: int, kernel: str = KERNEL) -> str:
    """``0.600 to 0.900 M``, or ``-`` for what was not predicted."""
    found = PREDICTED.get(kernel, {}).get(num_envs)
    if found is None or (task, dtype) != ("Walker-v0", "float32"):
        return "-"
    return f"{number(found[0] / 1e6)} to {number(found[1] / 1e6)} M"
