"""warpvox: soft-robot co-design on Warp.

The public names below load on first use, so that ``import warpvox`` stays instant and free of torch, Warp,
Hydra and rsl-rl. ``dir(warpvox)`` lists them. Gymnasium, once it is imported, knows the tasks as ``warpvox/<Task>``.
"""

from __future__ import annotations

from importlib import import_module as _import_module
from pathlib import Path as _Path
from typing import TYPE_CHECKING

from warpvox.discovery import announce as _announce

if TYPE_CHECKING:
    from warpvox.api import TrainedRun, load_policy, train
    from warpvox.design import (
        check_design,
        example_design,
        example_designs,
        load_design,
        sample_design,
        save_design,
    )
    from warpvox.envs.registry import task_ids
    from warpvox.envs.vec_env import make_vec
    from warpvox.errors import (
        ActionError,
        ConfigError,
        DesignError,
        DeviceError,
        DisplayError,
        DivergenceError,
        MemoryLimitError,
        RolloutError,
        RunError,
        SearchError,
        SimulationError,
        StorageError,
        TaskError,
        WarpvoxError,
        WorldError,
    )
    from warpvox.rollout import record
    from warpvox.sim import Simulation
    from warpvox.types import Cell, Physics
    from warpvox.world import World, WorldObject

__version__ = "0.1.0"

# module -> public names that live there; one canonical place per name
_PLACES = {
    "warpvox.api": ("TrainedRun", "load_policy", "train"),
    "warpvox.design": (
        "check_design",
        "example_design",
        "example_designs",
        "load_design",
        "sample_design",
        "save_design",
    ),
    "warpvox.world": ("World", "WorldObject"),
    "warpvox.types": ("Cell", "Physics"),
    "warpvox.sim": ("Simulation",),
    "warpvox.rollout": ("record",),
    "warpvox.envs.registry": ("task_ids",),
    "warpvox.envs.vec_env": ("make_vec",),
    "warpvox.errors": (
        "ActionError",
        "ConfigError",
        "DesignError",
        "DeviceError",
        "DisplayError",
        "DivergenceError",
        "MemoryLimitError",
        "RolloutError",
        "RunError",
        "SearchError",
        "SimulationError",
        "StorageError",
        "TaskError",
        "WarpvoxError",
        "WorldError",
    ),
}
_HOME = {name: module for module, names in _PLACES.items() for name in names}

__all__ = [
    "ActionError",
    "Cell",
    "ConfigError",
    "DesignError",
    "DeviceError",
    "DisplayError",
    "DivergenceError",
    "MemoryLimitError",
    "Physics",
    "RolloutError",
    "RunError",
    "SearchError",
    "Simulation",
    "SimulationError",
    "StorageError",
    "TaskError",
    "TrainedRun",
    "WarpvoxError",
    "World",
    "WorldError",
    "WorldObject",
    "__version__",
    "check_design",
    "example_design",
    "example_designs",
    "load_design",
    "load_policy",
    "make_vec",
    "record",
    "sample_design",
    "save_design",
    "task_ids",
    "train",
]

# In a checkout the folders kernels/, envs/, algos/ and configs/ lie beside this one. Installed packages map
# them, but when Python runs in the repository root, this folder shadows an installed copy: look beside it as
# well.
_root = _Path(__file__).resolve().parent.parent
if (_root / "pyproject.toml").is_file() and (_root / "kernels" / "__init__.py").is_file():
    __path__.append(str(_root))

_announce()


def __getattr__(name: str) -> object:
    module = _HOME.get(name)
    if module is None:
        raise AttributeError(f"module 'warpvox' has no attribute '{name}'")
    value = getattr(_import_module(module), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
