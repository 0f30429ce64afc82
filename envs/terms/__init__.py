"""Terms: the small functions on states that tasks are put together from."""
