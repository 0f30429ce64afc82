"""``warpvox design`` as a process: it says where it is, answers there, and ends when it is interrupted."""

import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

PATIENCE = 60  # seconds; a shared machine may stall


@pytest.mark.skipif(sys.platform == "win32", reason="signals are POSIX's")
def test_it_serves_until_it_is_interrupted(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "warpvox", "design", "browser=off", "folder=mine"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            line = process.stdout.readline()
            address = re.search(r"http://127\.0\.0\.1:\d+/[\w-]{32}/", line)[0]
            with urllib.request.urlopen(address, timeout=PATIENCE) as answer:
                assert "warpvox design" in answer.read().decode()
            assert str(tmp_path / "mine") in process.stdout.readline()
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=PATIENCE)
        finally:
            process.kill()
    assert (process.returncode, out, err) == (0, "stopped\n", "")
    assert not list(tmp_path.iterdir())  # the folder is made when something is saved
