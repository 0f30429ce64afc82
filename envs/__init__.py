"""Tasks: specifications, terrains, terms, the registry and the vector environment.

Importing this package makes the tasks known to gymnasium as ``warpvox/<id>``.
"""

if __name__ != "warpvox.envs":
    # The folder is also importable as `envs` when the repository root is on sys.path: two copies of one
    # module.
    raise ImportError("import this package as warpvox.envs")

from warpvox.envs.adapters.gym import register as _register

_register()
