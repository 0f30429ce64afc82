"""On CUDA, too, our float64 follows the recorded reference. Needs a GPU: ``pytest -m gpu``."""

from pathlib import Path

import numpy as np
import pytest
from replay import load_runs, obs_error, position_error, replay

RUNS = [run for path in sorted(Path(__file__).parent.glob("recordings/*.npz")) for run in load_runs(path)[:1]]

POSITION = OBSERVATION = 1e-9  # as on the CPU, over the recorded 60 control steps
ANGLE = 5e-3


@pytest.mark.gpu
@pytest.mark.parametrize("run", RUNS, ids=[f"{run.task}: {run.info['name']}" for run in RUNS])
def test_a_run_is_reproduced_on_cuda(run):
    ours = replay(run, device="cuda")
    plain, angle = obs_error(run, ours)
    assert position_error(run, ours).max() < POSITION
    assert plain.max() < OBSERVATION
    assert angle.max() < ANGLE
    assert np.array_equal(ours.terminated, run.arrays["terminated"])
