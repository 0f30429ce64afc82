"""The co-design loop: evaluation of designs, executors, the archive of what was tried."""
