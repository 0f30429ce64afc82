"""Stand-in that makes ``import evogym`` work in child processes; see :func:`warpvox.evogym.install`."""

import sys

import warpvox.evogym

sys.modules["evogym"] = warpvox.evogym
warpvox.evogym.install()
