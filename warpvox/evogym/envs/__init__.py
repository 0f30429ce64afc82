"""The benchmark's environments under the names of EvoGym's package ``evogym.envs``.

Importing it makes the tasks known to gymnasium under the ids of the release: ``gymnasium.make("Walker-v0", body=...)``.
"""

# pyright: reportUnsupportedDunderAll=false
# The names of ten modules: a type checker reads no list that is computed.

from gymnasium.envs.registration import register

from warpvox.envs.registry import get_task, released_id
from warpvox.evogym.envs import balance, change_shape, climb, flip, jump, manipulate, multi_goal, traverse, walk
from warpvox.evogym.envs.balance import *  # noqa: F403
from warpvox.evogym.envs.base import *  # noqa: F403
from warpvox.evogym.envs.base import __all__ as _of_base
from warpvox.evogym.envs.change_shape import *  # noqa: F403
from warpvox.evogym.envs.climb import *  # noqa: F403
from warpvox.evogym.envs.flip import *  # noqa: F403
from warpvox.evogym.envs.jump import *  # noqa: F403
from warpvox.evogym.envs.manipulate import *  # noqa: F403
from warpvox.evogym.envs.multi_goal import *  # noqa: F403
from warpvox.evogym.envs.task import TimeLimit
from warpvox.evogym.envs.traverse import *  # noqa: F403
from warpvox.evogym.envs.walk import *  # noqa: F403

_MODULES = (balance, change_shape, climb, flip, jump, manipulate, multi_goal, traverse, walk)

__all__ = [*_of_base, "register", *(name for module in _MODULES for name in module.__all__)]  # noqa: PLE0604, RUF100


def _register() -> None:
    """Register all of the release's environments with gymnasium."""
    for module in _MODULES:
        for name in module.__all__:
            task = getattr(getattr(module, name), "task", None)
            if task is not None:
                register(
                    released_id(task),
                    entry_point=f"{module.__name__}:{name}",
                    max_episode_steps=get_task(task).max_episode_steps,
                    additional_wrappers=(TimeLimit.wrapper_spec(),),
                )


_register()
