"""The co-design loop: evaluation of designs, executors and the archive."""
