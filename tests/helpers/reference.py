"""Python with EvoGym: named by ``WARPVOX_REFERENCE``, or installed by ``make reference``."""

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PYTHON = Path(os.environ.get("WARPVOX_REFERENCE") or ROOT / "build/reference/bin/python")
NEEDED = pytest.mark.skipif(not PYTHON.is_file(), reason="WARPVOX_REFERENCE names no interpreter with the reference")
