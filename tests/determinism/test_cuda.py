"""On CUDA, too, results are the same bits in every run, batch, order and process. Needs a GPU: ``pytest -m gpu``."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from rollouts import LIMIT, PRECISIONS, SMALL, digest, digests, fixed_actions, walk

from warpvox.design import example_design
from warpvox.envs.registry import task_ids
from warpvox.envs.vec_env import make_vec

pytestmark = pytest.mark.gpu

PROGRAM = Path(__file__).with_name("rollouts.py")
OPTIONS = {"device": "cuda", "lanes": None}
TASKS = ["Walker-v0", "Carrier-v0", "Climber-v0", "Catcher-v0"]
BODIES, SEEDS = [example_design("walker"), SMALL], [3, 1]
FIRST, SECOND = list(range(40)), list(range(40, 80))


def test_another_process_gives_the_same_bits() -> None:
    done = subprocess.run([sys.executable, str(PROGRAM), json.dumps(OPTIONS)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == digests(task_ids(), **OPTIONS)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("task", TASKS)
def test_the_graph_of_a_control_step_changes_nothing(task: str, precision: str) -> None:
    assert digest(task, precision, cuda_graph=True, **OPTIONS) == digest(task, precision, **OPTIONS)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("task", TASKS)
def test_neither_order_nor_batch_matters(task: str, precision: str) -> None:
    options = dict(device="cuda", dtype=precision, max_episode_steps=LIMIT)
    whole = make_vec(task, BODIES, 80, seed=SEEDS, **options)
    actions = fixed_actions(whole)
    seen = walk(whole, actions)
    turned = make_vec(task, BODIES[::-1], 80, seed=SEEDS[::-1], **options)
    few = make_vec(task, BODIES, 10, seed=SEEDS, **options)
    for env, rows in ((turned, SECOND + FIRST), (few, FIRST[:5] + SECOND[:5])):
        for step, (a, b) in enumerate(zip(seen, walk(env, actions[:, rows]), strict=True)):
            for name in a:
                assert torch.equal(a[name][rows], b[name]), (step, name)
