"""The Python that has the reference: the one that ``WARPVOX_REFERENCE`` names, or that ``warpvox bench`` has made."""

import os
from pathlib import Path

import pytest

from warpvox.bench.reference import reference_folder
from warpvox.system import python_of

PYTHON = Path(os.environ.get("WARPVOX_REFERENCE") or python_of(reference_folder()))
NEEDED = pytest.mark.skipif(not PYTHON.is_file(), reason="WARPVOX_REFERENCE names no interpreter with the reference")
