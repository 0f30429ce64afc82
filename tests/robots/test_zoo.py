"""Every robot of the zoo gets the return that its entry states, and an entry is what it should be."""

import numpy as np
import pytest
import torch

from warpvox.algos.robots.entry import Robot, zoo, zoo_tasks
from warpvox.algos.robots.episodes import SEEDS, judge, robot_env
from warpvox.algos.training.loading import load_policy
from warpvox.design import ZOO_FOLDER, load_design
from warpvox.envs.registry import get_task, task_ids
from warpvox.errors import DesignError, RunError

LARGEST = 1_200_000  # bytes of the whole zoo, which is in the wheel
TASKS = zoo_tasks()


@pytest.mark.parametrize(
    "task", [t if k % 4 == 0 else pytest.param(t, marks=pytest.mark.slow) for k, t in enumerate(TASKS)]
)
def test_a_robot_gets_the_recorded_return(task: str) -> None:
    about, found = zoo(task).about, judge(zoo(task))
    assert (found.returns, found.lengths) == (about["returns"], about["lengths"])
    assert found.mean_return == about["return"]


def test_the_zoo_is_small_and_of_known_tasks() -> None:
    assert TASKS
    assert set(TASKS) <= set(task_ids())
    assert sum(path.stat().st_size for path in ZOO_FOLDER.iterdir()) < LARGEST


@pytest.mark.parametrize("task", TASKS)
def test_an_entry_says_where_it_comes_from(task: str) -> None:
    robot = zoo(task)
    about = robot.about
    assert robot.task == task
    assert robot.fully_connected
    assert np.isfinite(robot.mean_return)
    assert len(about["returns"]) == len(about["lengths"]) == len(about["seeds"])
    assert max(about["lengths"]) <= get_task(task).max_episode_steps
    assert about["control_steps"] > 0
    assert about["command"].startswith("warpvox ")
    assert f"task={task}" in about["command"] or task == "Walker-v0"
    assert about["config"]["task"] == task
    assert (tuple(about["seeds"]) == SEEDS) == get_task(task).is_random


def test_a_stored_robot_is_a_design_and_a_policy() -> None:
    robot = zoo(TASKS[0])
    np.testing.assert_array_equal(load_design(f"zoo:{TASKS[0]}"), robot.body)
    policy = load_policy(f"zoo:{TASKS[0]}")
    obs = policy.network.random_obs(16, torch.Generator().manual_seed(0)).numpy()
    np.testing.assert_allclose(policy.act(obs), robot.policy(obs), atol=5e-5)  # the step of actions is 1.5e-5


def test_a_robot_that_is_not_there_is_named_with_the_nearest() -> None:
    with pytest.raises(RunError, match=f"Did you mean '{TASKS[0]}'"):
        zoo(TASKS[0].lower())
    with pytest.raises(DesignError, match="The zoo has no robot for 'x'"):
        load_design("zoo:x")


def test_a_policy_for_another_body_is_refused() -> None:
    first = zoo(TASKS[0])
    with pytest.raises(RunError, match="gait is none of this body"):
        robot_env(Robot(first.task, load_design("mini"), np.zeros((2, 0), np.int32), first.policy))
