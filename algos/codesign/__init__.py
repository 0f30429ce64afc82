"""The co-design loop: evaluation of designs, executors and the archive."""

from warpvox.algos.codesign import evaluations  # noqa: F401  (they register themselves)
