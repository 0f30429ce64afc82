"""On CUDA, too, our float64 repeats the recorded reference bit for bit. Needs a GPU: ``pytest -m gpu``."""

import pytest
from judge import judge
from replay import load_runs

RUNS = [run for run in load_runs() if run.index == 0]


@pytest.mark.gpu
@pytest.mark.parametrize("run", RUNS, ids=[f"{run.task}: {run.info['name']}" for run in RUNS])
def test_a_run_is_reproduced_on_cuda(run):
    found = judge(run, "cuda")
    assert found.passed, str(found)
    assert found.exact, str(found)
