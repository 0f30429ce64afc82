"""``nan_guard="dump"``: the last states before bad numbers, as a rollout."""

from pathlib import Path

import numpy as np
import pytest
import torch

from warpvox.envs import dumps
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.types import Physics
from warpvox.view.rollout import Rollout, scenes_of

STIFF = np.array([[3, 2], [4, 3]])  # diverges within a few steps under `stiff`
SOUND = np.array([[3, 4], [4, 3], [3, 3]])


def make(folder: Path, designs: list[np.ndarray], envs: int = 4, **options: object) -> VoxelVecEnv:
    physics = Physics.preset("evogym", soft_main=1e12, soft_structural=1e12)
    env = make_vec("Walker-v0", designs, envs, **dict(device="cpu", threads=1, physics=physics) | options)
    env.dump = dumps.DivergenceDump(env, folder)
    return env


def throw(env: VoxelVecEnv, number: int, name: str = "vel", value: float = float("nan")) -> None:
    state = env.sim.state()
    state[name][number, 2] = value
    env.sim.set_state(state)


def actions_of(env: VoxelVecEnv, steps: int) -> torch.Tensor:
    return 0.5 + 1.2 * torch.rand((steps, env.num_envs, env.num_actions), generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize(("length", "shown"), [(5, 5), (90, dumps.STEPS)])
@pytest.mark.parametrize("auto_reset", [True, False])
def test_a_file_holds_what_led_to_it(tmp_path: Path, length: int, shown: int, auto_reset: bool) -> None:
    env = make(tmp_path / "made", [SOUND], auto_reset=auto_reset)
    env.reset()
    _, gather = scenes_of(env.sim)
    taken, states = actions_of(env, length), []
    for step, action in enumerate(taken):
        if step == length - 1:
            throw(env, 2)
        states.append(gather()[2].numpy())
        env.step(action)
        assert len(list(tmp_path.glob("made/*"))) == (step == length - 1)
    for action in taken[:20]:  # what follows has no part in it, and is no divergence
        env.step(action)
    (path,) = tmp_path.glob("made/*")
    assert path.name == "diverged_001_env2.npz"
    rollout = Rollout.load(path)
    assert rollout.num_steps == shown
    np.testing.assert_array_equal(rollout.positions[:-1, 0], states[-shown:])
    np.testing.assert_array_equal(rollout.positions[-1], rollout.positions[-2])
    np.testing.assert_array_equal(rollout.actions[:, 0], taken[-shown:, 2].clamp(0.6, 1.6))
    assert rollout.terminated[:, 0].tolist() == [False] * (shown - 1) + [True]
    assert rollout.rewards[-1, 0] == -3.0
    assert rollout.metadata["diverged"] is True
    assert (rollout.metadata["environment"], rollout.metadata["episode_step"]) == (2, length)


def test_every_environment_of_a_step_is_written_with_its_own_world(tmp_path: Path) -> None:
    env = make(tmp_path, [SOUND, STIFF], envs=4)
    env.reset()
    while not list(tmp_path.iterdir()):
        _, _, _, _, info = env.step(torch.ones((4, env.num_actions)))
    gone = info["diverged"].nonzero()[:, 0].tolist()
    files = sorted(tmp_path.iterdir())
    assert [int(path.stem.split("env")[1]) for path in files] == gone
    for path in files:
        robot = next(item for item in Rollout.load(path).scenes[0].objects if item.name == "robot")
        np.testing.assert_array_equal(robot.grid, STIFF)


def test_an_exchange_of_bodies_drops_the_steps_of_these_environments_alone(tmp_path: Path) -> None:
    env = make(tmp_path, [STIFF - STIFF + 3], grid=(3, 2), auto_reset=True)
    env.reset()
    for step, action in enumerate(actions_of(env, 9)):
        if step == 6:  # wider bodies than those before, in two of four environments
            env.set_designs([SOUND], np.array([False, True, False, True]))
            action = 0.5 + torch.rand(4, env.num_actions)
        if step == 8:
            throw(env, 0)
            throw(env, 1)
        env.step(action[:, : env.num_actions])
    kept, fresh = (Rollout.load(path) for path in sorted(tmp_path.iterdir()))
    assert (kept.num_steps, fresh.num_steps) == (9, 3)
    assert (kept.positions.shape[2], fresh.positions.shape[2]) == (9, 12)


def test_the_number_of_files_is_bounded_also_for_those_who_come_later(tmp_path: Path) -> None:
    for _ in range(2):
        env = make(tmp_path, [SOUND], envs=4)
        env.reset()
        for _ in range(10):
            throw(env, 1)
            throw(env, 3)
            env.step(torch.ones((4, env.num_actions)))
    names = sorted(path.name for path in tmp_path.iterdir())
    assert [int(name.split("_")[1]) for name in names] == list(range(1, 11))


def test_states_that_no_file_can_hold_are_those_before(tmp_path: Path) -> None:
    env = make(tmp_path, [SOUND])
    env.reset()
    env.step(torch.ones((4, env.num_actions)))
    throw(env, 0, "pos", float("inf"))
    throw(env, 1, "pos", 1e200)
    env.step(torch.ones((4, env.num_actions)))
    paths = sorted(tmp_path.iterdir())
    assert len(paths) == 2
    for path in paths:
        rollout = Rollout.load(path)
        assert np.ptp(rollout.positions, axis=0).max() == 0.0
        assert rollout.metadata["states_not_finite"] == 1


def test_a_disk_that_refuses_costs_the_file_and_is_said_once(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way of a folder")
    env = make(tmp_path / "file", [SOUND])
    env.reset()
    throw(env, 0)
    with pytest.warns(RuntimeWarning, match="No more divergences are written"):
        env.step(torch.ones((4, env.num_actions)))
    throw(env, 0)
    _, _, _, _, info = env.step(torch.ones((4, env.num_actions)))
    assert info["diverged"][0]


def test_on_cuda_it_looks_now_and_then(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dumps, "STEPS", 8)
    env = make(tmp_path, [SOUND])
    assert env.dump is not None
    env.dump.pause, env.dump._room = 8, 16  # as where looking would wait for the device
    env.reset()
    _, gather = scenes_of(env.sim)
    states = []
    for step, action in enumerate(actions_of(env, 16)):
        if step == 10:
            throw(env, 3)
        states.append(gather()[3].numpy())
        env.step(action)
        assert len(list(tmp_path.iterdir())) == (step == 15)
    (path,) = tmp_path.iterdir()
    np.testing.assert_array_equal(Rollout.load(path).positions[:-1, 0], states[3:11])
