"""The drop-in's environments repeat what the reference's have recorded, of every task that has a recording."""

import gymnasium
import numpy as np
import pytest
from judge import verdict
from replay import Replay, Run, load_runs, make_env

import warpvox.evogym.envs as envs
from warpvox.envs.registry import released_id

pytestmark = pytest.mark.parity

ROUNDING = 1e-14  # of positions that were voxels to simulator units
RUNS = [run for run in load_runs() if run.index == 0 or run.unstable_at >= 0]


class Fixed:
    """Stands for a generator that draws given numbers."""

    def __init__(self, numbers: list[int]) -> None:
        self._numbers = list(numbers)

    def randint(self, low: int, high: int) -> int:
        number = self._numbers.pop(0)
        assert low <= number <= high
        return number


def begin(run: Run) -> tuple[envs.EvoGymBase, np.ndarray]:
    """The environment of a run after its reset, with what was random in the run, and the first observation."""
    env = gymnasium.make(released_id(run.task), body=run.arrays["body"]).unwrapped
    if isinstance(env, envs.CatchSmallRect):
        env._random = Fixed(run.info["offset"])
    obs, _ = env.reset()
    if isinstance(env, envs.BiWalk):
        env.init_reward_goals([envs.WalkToX(goal) for goal in run.info["goals"]])
        obs = env._observe(env._state())
    return env, obs


def moving(env: envs.EvoGymBase, run: Run) -> np.ndarray:
    points = [env.object_pos_at_time(env.get_time(), entry["name"]) for entry in run.info["objects"]]
    return np.concatenate(points, axis=1)[:, run.arrays["dyn"]]


def replay(run: Run) -> Replay:
    """Our side of a run up to its end."""
    env, obs = begin(run)
    positions, observations, reward, terminated = [moving(env, run)], [obs], [], []
    for action in run.actions:
        obs, gained, ended, truncated, info = env.step(action)
        assert not truncated
        assert info == {}
        positions.append(moving(env, run))
        observations.append(obs)
        reward.append(gained)
        terminated.append(ended)
        if ended:
            break
    columns = make_env(run).obs_columns[0].items()
    angles = [span.start for name, span in columns if name.startswith("orientation")]
    ended = np.array(terminated)
    return Replay(np.stack(positions), np.stack(observations), np.array(reward), ended, np.zeros_like(ended), angles)


@pytest.mark.parametrize("run", RUNS, ids=[f"{run.task}: {run.info['name']}" for run in RUNS])
def test_a_run_is_reproduced(run: Run) -> None:
    found = verdict(run, replay(run))
    assert found.passed, str(found)
    assert found.position < ROUNDING, str(found)


def test_the_runs_are_of_all_kinds() -> None:
    assert any(run.unstable_at >= 0 for run in RUNS)
    assert {"Catcher-v0", "BidirectionalWalker-v0", "Flipper-v0", "AreaMaximizer-v0"} <= {run.task for run in RUNS}
