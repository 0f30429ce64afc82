"""warpvox: soft-robot co-design on Warp.

The public names are listed in ``__init__.pyi`` and load on first use, so that ``import warpvox`` stays instant and free
of torch, Warp, Hydra and rsl-rl. ``import warpvox.envs`` registers the tasks with gymnasium as ``warpvox/<Task>``.
"""

import lazy_loader as _lazy

__version__ = "0.1.0"

_load, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    if name not in __all__:
        from warpvox.errors import did_you_mean

        raise AttributeError(f"warpvox has no {name!r}.{did_you_mean(name, __all__)}")
    return _load(name)
