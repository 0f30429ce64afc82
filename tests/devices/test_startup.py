"""Warp starts without its banner, and says in time that it compiles."""

import os
import subprocess
import sys
from pathlib import Path

PROBE = """
import sys
import warp as wp
from warpvox.devices.startup import start_warp

@wp.kernel
def first(x: wp.array(dtype=float)):
    x[wp.tid()] = 1.0

@wp.kernel
def second(x: wp.array(dtype=float)):
    x[wp.tid()] = 2.0

@wp.kernel
def third(x: wp.array(dtype=float)):
    x[wp.tid()] = 3.0

exec(sys.argv[1])
start_warp()
array = wp.zeros(1, dtype=float, device="cpu")
ours = {"__name__": "warpvox.probe", "wp": wp}
exec("def launch(kernel, array): wp.launch(kernel, 1, inputs=[array], device='cpu')", ours)
wp.launch(first, 1, inputs=[array], device="cpu")
print("somebody else's", file=sys.stderr)
"""
OURS = """
ours["launch"](second, array)
print("ours", file=sys.stderr)
ours["launch"](third, array)
"""


def probe(folder: Path, before: str = "", code: str = PROBE + OURS) -> subprocess.CompletedProcess:
    # every kernel a module of its own, as those of the package are
    (folder / "probe.py").write_text(code.replace("@wp.kernel", "@wp.kernel(module='unique')"))
    environment = {**os.environ, "WARP_CACHE_PATH": str(folder / "cache")}
    words = [sys.executable, str(folder / "probe.py"), before]
    done = subprocess.run(words, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    return done


def test_compilation_is_announced_once_and_only_where_there_is_any(tmp_path: Path) -> None:
    cold = probe(tmp_path)
    lines = cold.stderr.splitlines()
    assert lines[0] == "somebody else's"
    assert lines[1].startswith("Compiling kernels for the CPU (once per version and machine;")
    assert lines[2:] == ["ours"]
    assert cold.stdout == ""  # neither the banner nor a line for every module
    assert "Compiling" not in probe(tmp_path).stderr  # they are in the cache


def test_a_folder_for_kernels_that_cannot_be_made_can_be_changed_for_another(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    words = [sys.executable, "-m", "warpvox", "info"]
    environment = {**os.environ, "WARP_CACHE_PATH": str(tmp_path / "file" / "kernels")}
    done = subprocess.run(words, capture_output=True, text=True, env=environment)
    assert done.returncode == 2
    assert done.stderr.startswith(f"warpvox: {tmp_path / 'file'}")
    assert "WARP_CACHE_PATH=FOLDER" in done.stderr
