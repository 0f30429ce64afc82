"""The tasks as gymnasium has them."""

import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box
from gymnasium.utils.env_checker import check_env
from refusals import refused

from warpvox.design import example_design
from warpvox.envs.adapters.gym import VoxelEnv, register_task
from warpvox.envs.registry import get_task, task_ids
from warpvox.errors import ActionError, ConfigError, DesignError, DisplayError, WorldError


def stand_in(monkeypatch: pytest.MonkeyPatch) -> list[np.ndarray]:
    """A window that needs no display; returns the list of pictures that it will be shown."""
    shown: list[np.ndarray] = []

    class Window:
        def __init__(self, size: tuple[int, int], title: str) -> None:
            self.size, self.closed = size, False

        def show(self, frame: np.ndarray) -> None:
            assert not self.closed
            assert frame.shape == (self.size[1], self.size[0], 3)
            shown.append(frame)

        def close(self) -> None:
            self.closed = True

    monkeypatch.setattr("warpvox.view.window.Window", Window, raising=False)
    monkeypatch.setattr("warpvox.view.window.why_no_window", lambda: None)
    return shown


# Gymnasium dislikes bounds that are honest (0.6 to 1.6, none for velocities) and takes versions for succession.
pytestmark = [
    pytest.mark.filterwarnings("ignore:.*For Box action spaces, we recommend:UserWarning"),
    pytest.mark.filterwarnings("ignore:.*A Box observation space (min|max)imum value is:UserWarning"),
    pytest.mark.filterwarnings("ignore:.*is out of date:DeprecationWarning"),
]


@pytest.mark.parametrize(
    ("task", "obs"),
    [
        *((task, "task") for task in task_ids()[::4]),
        *(("Walker-v0", "voxel"), ("Catcher-v0", "voxel"), ("Walker-v0", "timed")),
        *(pytest.param(task, "task", marks=pytest.mark.slow) for k, task in enumerate(task_ids()) if k % 4),
    ],
)
def test_gymnasium_accepts_the_environment(task: str, obs: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pictures = stand_in(monkeypatch)
    env = gymnasium.make(f"warpvox/{task}", body=example_design("walker"), render_mode="rgb_array", obs=obs)
    assert env.spec.max_episode_steps == get_task(task).max_episode_steps
    assert env.metadata["render_modes"] == ["human", "rgb_array"]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(env.unwrapped)
    expected = ("recommend using a symmetric", "minimum value is -inf", "maximum value is inf")
    told = [str(w.message) for w in caught if w.category is UserWarning]  # by gymnasium, not by what is collected
    assert [text for text in told if not any(words in text for words in expected)] == []
    assert pictures  # the checker has looked at the window, too


def test_spaces_are_honest() -> None:
    env = gymnasium.make("warpvox/UpStepper-v0", body=example_design("walker"))
    actuators = int((example_design("walker") >= 3).sum())
    assert env.action_space == Box(0.6, 1.6, (actuators,), np.float64)
    points = env.unwrapped.sim.num_points("robot")
    low = [-np.inf] * 2 + [0.0] + [-np.inf] * 2 * points + [0.0] * 11
    high = [np.inf] * 2 + [2 * np.pi] + [np.inf] * 2 * points + [0.5] * 11
    assert env.observation_space == Box(np.array(low), np.array(high), dtype=np.float64)
    single = gymnasium.make("warpvox/Walker-v0", body="walker", dtype="float32")
    assert single.observation_space.dtype == single.action_space.dtype == single.reset()[0].dtype == np.float32


def test_importing_the_environments_registers_them(tmp_path: Path) -> None:
    code = "import gymnasium; gymnasium.make('warpvox.envs:warpvox/Walker-v0', body='walker')"
    run = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr


def test_a_window_shows_every_step(monkeypatch: pytest.MonkeyPatch) -> None:
    pictures = stand_in(monkeypatch)
    env = gymnasium.make("warpvox/Walker-v0", body="walker", render_mode="human", render_size=(160, 90))
    env.reset()
    for _ in range(3):
        env.step(env.action_space.sample())
    assert len(pictures) == 4
    assert env.render() is None
    assert not np.array_equal(pictures[0], pictures[3])
    assert np.array_equal(pictures[3], pictures[4])
    env.close()
    env.close()
    env.step(env.action_space.sample())  # whoever closes the window may go on without it
    assert len(pictures) == 5


def test_no_display_is_said_and_the_mode_is_not_offered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("warpvox.view.window.why_no_window", lambda: "there is no display")
    with pytest.raises(DisplayError):
        gymnasium.make("warpvox/Walker-v0", body="walker", render_mode="human")
    env = gymnasium.make("warpvox/Walker-v0", body="walker", render_mode="rgb_array")
    assert env.metadata["render_modes"] == ["rgb_array"]
    assert VoxelEnv.metadata["render_modes"] == ["human", "rgb_array"]
    check_env(env.unwrapped)


def test_a_task_of_ones_own_can_be_registered() -> None:
    name = register_task(replace(get_task("Walker-v0"), id="Mine-v0", max_episode_steps=7), "mine")
    assert name == "mine/Mine-v0"
    assert gymnasium.make(name, design="walker").spec.max_episode_steps == 7
    assert gymnasium.make_vec(name, num_envs=2, bodies=["walker"]).vec.max_episode_steps == 7
    with pytest.raises(ConfigError):
        register_task("Walker-v0", "warpvox")


def test_first_episodes_have_the_seed_that_is_given() -> None:
    goals = [VoxelEnv("BidirectionalWalker-v0", body="mini", seed=seed).vec.memory for seed in (0, 1)]
    default = VoxelEnv("BidirectionalWalker-v0", body="mini").vec.memory
    same = [all((value == default[name]).all() for name, value in goal.items()) for goal in goals]
    assert same == [True, False]


def test_mistakes_are_named() -> None:
    with pytest.raises(DesignError):
        gymnasium.make("warpvox/Walker-v0", body=np.ones((5, 5)))
    with pytest.raises(ConfigError):
        VoxelEnv("Walker-v0", render_mode="ascii")
    with refused(TypeError, "unexpected keyword argument 'frameskip'"):  # TorchRL looks for this
        gymnasium.make("warpvox/Walker-v0", frameskip=1)
    with pytest.raises(ConfigError):
        VoxelEnv("Walker-v0", obs="voxels")
    with pytest.raises(WorldError):
        gymnasium.make("warpvox/Climber-v0", body=np.full((2, 6), 3))
    env = gymnasium.make("warpvox/Walker-v0", body=[[3, 3], [4, 4]]).unwrapped
    env.reset()
    with pytest.raises(ActionError):
        env.step(np.ones(3))
    with pytest.raises(ActionError):
        env.step(np.full(4, np.nan))
