"""Runs that the test records itself, of bodies and actions nothing was made for: ``pytest -m slow tests/parity``."""

import subprocess
from pathlib import Path

import numpy as np
import pytest
import reference
from judge import REWARD, compare, judge
from replay import load_runs, replay

from warpvox.envs.registry import task_ids

SEED = 20
STRICT = 0.97  # share of the runs that must be reproduced
RANKS = 0.97

pytestmark = [pytest.mark.slow, pytest.mark.parity, reference.NEEDED]


def record(folder, *options):
    script = Path(__file__).with_name("record.py")
    subprocess.run([reference.PYTHON, script, "--seed", str(SEED), "--out", folder, *options], check=True)
    runs = load_runs(folder)
    assert {run.task for run in runs} == set(task_ids())
    return runs


def test_runs_kept_aside_are_reproduced(tmp_path):
    verdicts = {str(run): judge(run) for run in record(tmp_path)}
    failed = {name: str(verdict) for name, verdict in verdicts.items() if not verdict.passed}
    assert len(failed) <= (1 - STRICT) * len(verdicts), failed


def test_whole_episodes_return_the_same(tmp_path):
    runs = record(tmp_path, "--whole")
    assert len(runs) == 100
    theirs = np.array([run.arrays["reward"].sum() for run in runs])
    result = compare(theirs, np.array([replay(run).reward.sum() for run in runs]))
    assert abs(result.mean) <= max(2 * result.error, REWARD)
    assert result.rank >= RANKS
