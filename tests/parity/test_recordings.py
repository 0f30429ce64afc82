"""Our float64 follows the recorded reference on every run of every task that has a recording."""

from pathlib import Path

import numpy as np
import pytest
from replay import load_runs, obs_error, position_error, replay, reward_error

from warpvox.envs.registry import task_ids

pytestmark = pytest.mark.parity

RUNS = [run for path in sorted(Path(__file__).parent.glob("recordings/*.npz")) for run in load_runs(path)]

POSITION = 1e-9  # simulator units, over 60 control steps: what is larger is another model, not rounding
REWARD = 1e-6  # over 200 control steps
OBSERVATION = 1e-9
ANGLE = 5e-3  # the arc cosine of the orientation is guarded at 0.99999, which makes noise of this size


def before_the_floor(ours):
    """Steps until something slides on the implicit floor at y = 0, where no two computations stay together.

    Its friction, tanh(v N mu) with N up to thousands, is far too stiff for the sub-step: a difference of 1e-15 grows
    to 1e-6 in five control steps of ours.
    """
    below = (ours.positions[1:, 1].min(axis=1) < 0.0).nonzero()[0]
    return below[0] if len(below) else None


@pytest.mark.parametrize("run", RUNS, ids=[f"{run.task}: {run.info['name']}" for run in RUNS])
def test_a_run_is_reproduced(run):
    ours = replay(run)
    plain, angle = obs_error(run, ours)
    assert position_error(run, ours).max() < POSITION
    assert plain.max() < OBSERVATION
    assert angle.max() < ANGLE
    assert reward_error(run, ours)[: before_the_floor(ours)].max() < REWARD
    assert np.array_equal(ours.terminated, run.arrays["terminated"])
    assert np.array_equal(ours.truncated, run.arrays["truncated"])


def test_the_recordings_hold_what_they_should():
    tasks = {run.task for run in RUNS}
    shapes = {run.arrays["body"].shape for run in RUNS}
    assert tasks == set(task_ids()) - {"Traverser-v0"}  # record.py says why
    assert {(3, 3), (5, 5), (5, 7), (10, 10)} <= shapes
    assert any(run.unstable_at >= 0 for run in RUNS)
    assert sum(before_the_floor(replay(run, 200)) is None for run in RUNS if "walker" in run.info["name"]) == 4
