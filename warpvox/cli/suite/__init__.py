"""Many design searches as one job: which they are, what has come of them, and the processes that make them."""
