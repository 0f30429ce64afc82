"""Design search: its loop, evaluations of designs, executors and results."""

from warpvox.algos.codesign import evaluations  # noqa: F401  (they register themselves)
