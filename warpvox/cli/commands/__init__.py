"""The commands of ``warpvox``: a module each, with a function ``run``."""
