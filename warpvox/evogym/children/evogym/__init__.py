"""``import evogym`` of processes that a script has started; see :func:`warpvox.evogym.install`."""

import sys

import warpvox.evogym

sys.modules["evogym"] = warpvox.evogym
warpvox.evogym.install()
