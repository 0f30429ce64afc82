"""The benchmark's tasks as data, a module per family; each lists its specifications in ``TASKS``."""
