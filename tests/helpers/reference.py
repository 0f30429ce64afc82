"""The Python that has the reference: the one that ``WARPVOX_REFERENCE`` names, or ``make reference`` has made."""

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PYTHON = Path(os.environ.get("WARPVOX_REFERENCE") or ROOT / "build/reference/bin/python")
NEEDED = pytest.mark.skipif(not PYTHON.is_file(), reason="WARPVOX_REFERENCE names no interpreter with the reference")
