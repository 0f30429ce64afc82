"""Many design searches as one job: which they are, their states and results, and the processes that run them."""
