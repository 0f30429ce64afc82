"""Results belong to an environment: its place, its neighbours, the size of the batch and threads change no bit."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings, strategies as st
from rollouts import LANES, LIMIT, PRECISIONS, SMALL, fixed_actions, walk

from warpvox.design import example_design
from warpvox.envs.vec_env import VoxelVecEnv, make_vec

BODIES = [example_design("walker"), SMALL, example_design("mini")]
SEEDS = [3, 1, 2]
EACH = 2  # environments of a design
STEPS = 22  # past the first reset
PLACES = st.permutations(range(len(BODIES)))

STILL = ["UpStepper-v0", "Carrier-v0", "Climber-v0"]  # nothing is drawn
DRAWN = ["Catcher-v0", "BidirectionalWalker-v0"]
EACH_TASK = pytest.mark.parametrize(
    ("task", "precision"),
    [
        pytest.param(task, precision, marks=() if (number + which) % 2 else pytest.mark.slow)
        for number, task in enumerate(STILL + DRAWN)
        for which, precision in enumerate(PRECISIONS)
    ],
)


def make(task: str, precision: str, bodies: list[np.ndarray], count: int, seeds: object, **options) -> VoxelVecEnv:
    defaults = dict(device="cpu", lanes=LANES, max_episode_steps=LIMIT, threads=1)
    return make_vec(task, bodies, count, dtype=precision, seed=seeds, **(defaults | options))


def assert_rows(one: list[dict], other: list[dict], rows: list[int]) -> None:
    """Row k of ``other`` is row ``rows[k]`` of ``one``, in every bit."""
    for step, (a, b) in enumerate(zip(one, other, strict=True)):
        for name in a:
            assert torch.equal(a[name][rows], b[name]), (step, name)


@EACH_TASK
@settings(max_examples=2)
@given(places=PLACES, swapped=st.lists(st.booleans(), min_size=len(BODIES), max_size=len(BODIES)))
def test_results_move_with_their_design_and_seed(task, precision: str, places: list[int], swapped: list[bool]) -> None:
    count = EACH * len(BODIES)
    env = make(task, precision, BODIES, count, SEEDS)
    moved = make(task, precision, [BODIES[d] for d in places], count, [SEEDS[d] for d in places])
    # what an environment draws depends on its number among its seed's, so only environments that draw nothing swap
    inner = [[1, 0] if swap and task in STILL else [0, 1] for swap in swapped]
    rows = [EACH * d + k for n, d in enumerate(places) for k in inner[n]]
    actions = fixed_actions(env, STEPS)
    assert_rows(walk(env, actions), walk(moved, actions[:, rows]), rows)


@EACH_TASK
def test_the_size_of_a_batch_does_not_matter(task: str, precision: str) -> None:
    many = 5 * LANES - 3  # five packs, the last of which is not full
    whole = make(task, precision, [BODIES[0]], many, 5)
    actions = fixed_actions(whole, STEPS)
    seen = walk(whole, actions)
    for few in (1, 2 * LANES + 1):
        part = make(task, precision, [BODIES[0]], few, 5)
        assert_rows(seen, walk(part, actions[:, :few]), list(range(few)))


@EACH_TASK
def test_the_number_of_threads_does_not_matter(task: str, precision: str) -> None:
    found = []
    for threads in (1, 2, 3):
        env = make(task, precision, BODIES, 3 * LANES, SEEDS, threads=threads)
        found.append(walk(env, fixed_actions(env, STEPS)))
        assert len(env.sim._launches) == threads
    rows = list(range(3 * LANES))
    assert_rows(found[0], found[1], rows)
    assert_rows(found[0], found[2], rows)
