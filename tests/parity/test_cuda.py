"""On CUDA, too, our float64 follows the recorded reference. Needs a GPU: ``pytest -m gpu``."""

import pytest
from judge import verdict
from replay import load_runs, replay

RUNS = [run for run in load_runs() if run.index == 0]


@pytest.mark.gpu
@pytest.mark.parametrize("run", RUNS, ids=[f"{run.task}: {run.info['name']}" for run in RUNS])
def test_a_run_is_reproduced_on_cuda(run):
    found = verdict(run, replay(run, device="cuda"))
    assert found.near, str(found)
    assert found.ends, str(found)
