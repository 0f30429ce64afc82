"""Design search: its loop, fitness of designs, executors and results."""

from warpvox.algos.codesign import fitness  # noqa: F401  (they register themselves)
