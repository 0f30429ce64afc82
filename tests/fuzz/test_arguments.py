"""Arguments of the wrong kind, size or sense: functions and command lines refuse them with errors of ours."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from bounds import fuzz
from damage import ARGUMENTS, VALUES, Stranger, altered, damaged_bytes, damaged_tree
from hypothesis import strategies as st
from sample_files import world_tree

import warpvox
from warpvox.cli.config import load, load_values
from warpvox.cli.help import flat_keys
from warpvox.configs.schema import COMMANDS
from warpvox.design import check_design, load_design, sample_design
from warpvox.envs.adapters.gym import VoxelEnv
from warpvox.envs.registry import get_task
from warpvox.errors import ConfigError, DesignError, DeviceError, SimulationError, TaskError, WorldError
from warpvox.evogym.simulator_cpp import Sim
from warpvox.simulation import Simulation
from warpvox.world import World

BODY = [[3, 3], [4, 0]]
SMALL = {"device": "cpu", "threads": 1}


def some_of(valid: dict[str, Any], names: str) -> st.SearchStrategy[dict[str, Any]]:
    """``valid`` with one or two of the named arguments replaced."""
    wrong = st.dictionaries(st.sampled_from(names.split()), ARGUMENTS, min_size=1, max_size=2)
    return wrong.map(lambda given: valid | given)


def without_large(given: dict[str, Any]) -> dict[str, Any]:
    """How many environments or threads fit the machine is a matter of memory, not of reading: large counts become 0."""
    counts = {name for name in ("num_envs", "threads", "lanes") if isinstance(given.get(name), int)}
    return given | {name: 0 for name in counts if given[name] > 64}


def test_designs() -> None:
    names = st.sampled_from(
        ["walker", "random:5x7", "random:0x0", "random:9999999x9", "~.json", "/dev/zero", "a\0b.npz"]
    )
    fuzz(
        names | damaged_bytes(b"random:3x4").map(lambda data: data.decode("utf-8", "replace")) | ARGUMENTS, load_design
    )
    fuzz(damaged_tree(BODY), check_design)
    shape = st.tuples(st.sampled_from([1, 2, 10**9]), st.just(3))
    weights = damaged_tree([0.2, 0.2, 0.2, 0.2, 0.2])
    seed = st.sampled_from([None, 0]) | ARGUMENTS
    fuzz(st.tuples(shape | ARGUMENTS, seed, weights | ARGUMENTS), lambda given: sample_design(*given), 0.4)


def test_worlds() -> None:
    names = st.sampled_from(["robot", "stone", "\ud800"]) | ARGUMENTS
    places = st.tuples(*[st.sampled_from([0, 1, -1, 10**9, 1.5]) | ARGUMENTS] * 2)
    added = st.tuples(st.just("add_from_array"), names, st.just(BODY) | ARGUMENTS, places)
    trees = damaged_tree(world_tree()) | ARGUMENTS
    calls = st.one_of(
        added,
        st.tuples(st.just("move_object"), names, places),
        st.tuples(st.just("remove_object"), names),
        st.tuples(st.just("add_from_json"), trees),
    )

    def use(given: list[tuple]) -> None:
        """A world that refuses a call stays as it was."""
        world = World(5, 5)
        world.add_from_array("robot", BODY, 1, 1)
        for name, *arguments in given:
            before = world.key()
            try:
                getattr(world, name)(*[part for a in arguments for part in (a if isinstance(a, tuple) else [a])])
            except BaseException:
                assert world.key() == before
                raise
        if world.objects:
            assert World.from_json(world.to_json()) == world

    fuzz(st.lists(calls, min_size=1, max_size=3), use)


def test_make_vec() -> None:
    def use(given: dict[str, Any]) -> None:
        env = warpvox.make_vec(**without_large(given))
        env.reset()
        env.step(np.ones((env.num_envs, env.num_actions)))

    names = "task designs num_envs device rules dtype seed lanes threads connections max_episode_steps obs physics"
    fuzz(some_of({"task": "Walker-v0", "designs": "mini", "num_envs": 1, **SMALL}, names), use, 0.3)


def test_simulations() -> None:
    def use(given: dict[str, Any]) -> None:
        sim = Simulation(**without_large(given))
        sim.step(np.ones((sim.num_envs, sim.num_actions)))

    names = "worlds device physics dtype lanes threads loose action_range"
    fuzz(some_of({"worlds": [World.from_json(world_tree())], **SMALL}, names), use, 0.3)


@pytest.mark.parametrize("kind", ["sim", "vec", "gym"])
def test_actions(kind: str) -> None:
    if kind == "gym":
        env = VoxelEnv("Walker-v0", "mini", dtype="float32")
        good = np.ones(env.action_space.shape)
    else:
        worlds = [World.from_json(world_tree())] * 2
        env = Simulation(worlds, **SMALL) if kind == "sim" else warpvox.make_vec("Walker-v0", "mini", 2, **SMALL)
        good = np.ones((2, env.num_actions))
    sim = env if kind == "sim" else env.sim
    changes = [torch.Tensor.to_sparse, torch.Tensor.bool, lambda t: t.to("meta"), lambda t: t.to(torch.complex64)]
    tensors = st.sampled_from([change(torch.from_numpy(good)) for change in changes])

    def use(actions: Any) -> None:
        """A step leaves finite states, whatever was given."""
        if kind == "gym":
            env.reset(seed=0)
        env.step(actions)
        assert bool(torch.isfinite(sim.state()["pos"]).all())

    fuzz(altered(good) | damaged_tree(good.tolist()) | tensors | ARGUMENTS, use, 0.5)


WORDS = [
    "null",
    "nan",
    "1e400",
    "[1,2]",
    "{a:1}",
    "${seed}",
    "${oc.env:HOME}",
    "???",
    "'",
    "1,2",
    "range(1,3)",
    "[" * 50,
]


@pytest.mark.parametrize("command", ["train", "codesign", "play"])
def test_command_lines(command: str) -> None:
    keys = st.sampled_from([name for name, _ in flat_keys(COMMANDS[command])])
    values = st.sampled_from(WORDS) | VALUES.map(lambda value: str(value)[:3000])
    words = st.tuples(st.sampled_from(["", "", "", "~", "+", "++", "--"]), keys, values).map(
        lambda parts: "{}{}={}".format(*parts)
    )
    fuzz(st.lists(words, min_size=1, max_size=2), lambda given: load(command, given), 0.1)


# --------------------------------------------------------------- inputs that once gave another error, or an answer


@pytest.mark.parametrize(
    ("words", "error"),
    [
        ({"physics": []}, ConfigError),
        ({"rules": np.array(BODY)}, ConfigError),
        ({"dtype": []}, SimulationError),
        ({"obs": np.array(BODY)}, ConfigError),
        ({"connections": 5}, ConfigError),
        ({"seed": -1}, ConfigError),
        ({"seed": 1.5}, ConfigError),
        ({"lanes": []}, SimulationError),
        ({"threads": True}, SimulationError),
        ({"device": "cuda:²"}, DeviceError),
        ({"designs": Stranger()}, DesignError),
        ({"designs": np.array(False)}, DesignError),
        ({"num_envs": float("nan")}, ConfigError),
    ],
)
def test_make_vec_refuses(words: dict, error: type[Exception]) -> None:
    with pytest.raises(error):
        warpvox.make_vec(**{"task": "Walker-v0", "designs": "mini", **SMALL, **words})


@pytest.mark.parametrize(
    "words", [{"worlds": 1}, {"loose": 5}, {"loose": "robot"}, {"action_range": 3}, {"action_range": (2, 1)}]
)
def test_simulation_refuses(words: dict) -> None:
    with pytest.raises(SimulationError):
        Simulation(**{"worlds": [World.from_json(world_tree())], **SMALL, **words})


@pytest.mark.parametrize(
    "data", [b"\x80", b"2 1 3 99999999999999999999999", b"-1 -1 3", b"99999999999999999999 1 3", b"2"]
)
def test_objects_of_the_drop_in(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "object.txt").write_bytes(data)
    with pytest.raises(WorldError):
        Sim().read_object_from_file(str(tmp_path / "object.txt"), "thing", 0, 0)
    with pytest.raises(FileNotFoundError):
        Sim().read_object_from_file(str(tmp_path / "nowhere.txt"), "thing", 0, 0)


TASK = """
from dataclasses import replace
from warpvox.envs.registry import get_task
MINE = replace(get_task("Walker-v0"), id="Mine-v0")
"""


@pytest.mark.parametrize(
    "line",
    ["raise SystemExit(3)", "MINE = replace(MINE, objects=3)", "MINE = replace(MINE, objects=(3,))", "1/0", "\0"],
)
def test_files_of_tasks(tmp_path: Path, line: str) -> None:
    (tmp_path / "task.py").write_text(TASK + line + "\n")
    with pytest.raises(TaskError, match=r"cannot be imported|must be"):
        get_task(f"{tmp_path}/task.py:MINE")


@pytest.mark.parametrize("value", ["1" * 5000, "[" * 3000, "'", "{a:"])
def test_values_on_the_command_line(value: str) -> None:
    with pytest.raises(ConfigError, match="is not KEY=VALUE"):
        load("play", [f"record={value}"])


def test_numbers_that_no_float_can_hold() -> None:
    with pytest.raises(ConfigError, match="a number"):
        load("train", [f"ppo.entropy_coef={'9' * 400}"])
    with pytest.raises(ConfigError, match="stored configuration is not valid"):
        load_values("train", {"ppo": {"entropy_coef": 10**400}})
