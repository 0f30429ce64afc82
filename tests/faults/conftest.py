"""A command line whose disk fails, or which is killed, at a moment of the test's choice."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from fault_cases import CODESIGN, TRAIN, Victim


@pytest.fixture(scope="session")
def victim(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Victim]:
    """The process, with ``injector.c`` between it and the system."""
    compiler = shutil.which("cc")
    if compiler is None or not sys.platform.startswith("linux"):
        pytest.skip("faults are injected on Linux with a C compiler (cc)")
    place = Path(__file__).parent
    library = tmp_path_factory.mktemp("injector") / "injector.so"
    source = str(place / "injector.c")
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-Wall", source, "-o", library, "-ldl"], check=True)
    environment = os.environ | {"LD_PRELOAD": str(library), "OMP_NUM_THREADS": "1", "COLUMNS": "100"}
    line = [sys.executable, str(place / "victim.py")]
    with subprocess.Popen(line, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment) as process:
        found = Victim(process)
        assert found.ask([TRAIN, CODESIGN]) == "ready\n"
        yield found
        process.stdin.close()
