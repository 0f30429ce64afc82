"""EvoGym's Python interface on warpvox: the names, arguments, shapes and orders of its release 2.0.0.

``import warpvox.evogym as evogym`` instead of ``import evogym``, or once ``warpvox.evogym.install()``, after which
``import evogym`` itself means this package. ``docs/evogym.md`` says what is the same and what differs.
"""

from warpvox.evogym import sim, simulator_cpp, utils, viewer, world
from warpvox.evogym.sim import EvoSim
from warpvox.evogym.switch import install as install
from warpvox.evogym.utils import *  # noqa: F403
from warpvox.evogym.viewer import EvoViewer
from warpvox.evogym.world import EvoWorld, WorldObject

__all__ = ["EvoSim", "EvoViewer", "EvoWorld", "WorldObject", "sim", "simulator_cpp", "utils", "viewer", "world"]
__all__ += utils.__all__
