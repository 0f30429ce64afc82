"""Control steps under NVIDIA's compute-sanitizer, where it is installed. Needs a GPU: ``pytest -m gpu``."""

import os
import shutil
import subprocess
import sys

import pytest

TOOL = shutil.which("compute-sanitizer") or shutil.which("compute-sanitizer", path="/usr/local/cuda/bin")
SECONDS = 90
STEPS = """
import sys
import numpy as np
import warpvox as wv

task, bodies, side = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
designs = [wv.sample_design((5, 5), seed=k) for k in range(bodies)] or None
if side:
    designs = [np.random.default_rng(0).choice(np.array([1, 2, 3, 4], np.int8), (side, side))]
env = wv.make_vec(task, designs, num_envs=64, device="cuda")
env.reset()
random = np.random.default_rng(0)
for _ in range(2):
    obs, *_ = env.step(random.uniform(0.6, 1.6, (env.num_envs, env.num_actions)))
env.sim.reset()
assert obs.isfinite().all()
"""


@pytest.mark.gpu
@pytest.mark.skipif(TOOL is None, reason="compute-sanitizer is not installed")
@pytest.mark.parametrize("tool", ["memcheck", "racecheck", "synccheck", "initcheck"])
@pytest.mark.parametrize(
    ("task", "bodies", "side"),
    [("Walker-v0", 8, 0), ("Climber-v1", 0, 0), ("Traverser-v0", 0, 0), ("Walker-v0", 0, 25), ("Walker-v0", 0, 35)],
)
def test_the_sanitizer_finds_nothing(task: str, bodies: int, side: int, tool: str) -> None:
    """16 threads take a world, 64, 128, 256 and 512."""
    numbers = [str(bodies), str(side)]
    command = [TOOL, "--tool", tool, "--error-exitcode", "9", sys.executable, "-c", STEPS, task, *numbers]
    # With torch's cache of memory nothing that is written beyond an array would show.
    surroundings = os.environ | {"PYTORCH_NO_CUDA_MEMORY_CACHING": "1"}
    done = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS, env=surroundings)
    assert done.returncode == 0, done.stdout + done.stderr
