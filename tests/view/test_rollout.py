"""Rollouts: what is recorded, what a file holds, and files that are none."""

import functools
import json
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st

from warpvox.envs.adapters.gym import VoxelEnv
from warpvox.envs.adapters.gym_vector import VoxelGymVectorEnv
from warpvox.envs.vec_env import make_vec
from warpvox.errors import ActionError, ConfigError, RolloutError
from warpvox.types import Physics
from warpvox.view.rollout import AGENTS, Rollout, record

ARRAYS = "positions design_index actions rewards terminated truncated".split()


def assert_equal(one: Rollout, other: Rollout) -> None:
    for name in ARRAYS:
        a, b = getattr(one, name), getattr(other, name)
        assert a.dtype == b.dtype, name
        np.testing.assert_array_equal(a, b, err_msg=name)
    assert one.metadata == other.metadata
    assert len(one.scenes) == len(other.scenes)
    for a, b in zip(one.scenes, other.scenes, strict=True):
        assert (a.width, a.height) == (b.width, b.height)
        for x, y in zip(a.objects, b.objects, strict=True):
            assert (x.name, x.x, x.y, x.first_point, x.num_points) == (
                y.name, y.x, y.y, y.first_point, y.num_points,
            )  # fmt: skip
            np.testing.assert_array_equal(x.grid, y.grid)
            np.testing.assert_array_equal(x.corners, y.corners)


@given(frames=st.integers(1, 9), envs=st.integers(1, 5), designs=st.integers(1, 3), seed=st.integers(0, 99))
def test_what_is_saved_is_loaded(rollouts, tmp_path_factory, frames, envs, designs, seed) -> None:
    rollout = rollouts(frames, envs, designs, seed)
    path = tmp_path_factory.mktemp("saved") / "deep" / "rollout.npz"
    assert rollout.save(path) == path
    assert_equal(rollout, Rollout.load(path))
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]


def test_the_best_come_first_under_their_names(rollouts: Callable[..., Rollout]) -> None:
    rollout = rollouts(6, 5, 2)
    assert rollout.names == ["0", "1", "2", "3", "4"]
    best = rollout.best_first()
    assert (np.diff(best.returns[-1]) <= 0).all()
    for env, name in enumerate(best.names):
        old = int(name)
        assert best.scene(env) is rollout.scene(old)
        np.testing.assert_array_equal(best.positions[:, env], rollout.positions[:, old])
        np.testing.assert_array_equal(best.done[:, env], rollout.done[:, old])
    assert best.best_first().names == best.names
    rollout.metadata["names"] = ["one"]  # of another number of environments
    assert rollout.names[0] == "0"


def test_equal_rollouts_give_equal_files(rollouts: Callable[..., Rollout], tmp_path: Path) -> None:
    for name in ("a.npz", "b.npz"):
        rollouts(5, 2).save(tmp_path / name)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


@pytest.mark.parametrize(("limit", "what"), [("LARGEST", "arrays"), ("LARGEST_HEADER", "header")])
def test_what_could_not_be_loaded_is_not_saved(rollouts, tmp_path: Path, monkeypatch, limit: str, what: str) -> None:
    monkeypatch.setattr(f"warpvox.view.rollout.{limit}", 1 << 12)
    with pytest.raises(RolloutError):
        rollouts(5, 2).save(tmp_path / "rollout.npz")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "wrong",
    [
        {"run": "\udcff"},  # as Python has a file's name that is not UTF-8
        {1: "one", "1": "another"},
        {"deep": functools.reduce(lambda inner, _: [inner], range(10**5), [])},
    ],
)
def test_metadata_that_a_file_cannot_hold_is_not_saved(rollouts, tmp_path: Path, wrong: dict) -> None:
    rollout = rollouts(2, 1)
    rollout.metadata |= wrong
    with pytest.raises(RolloutError):
        rollout.save(tmp_path / "rollout.npz")
    assert not list(tmp_path.iterdir())


def test_numpy_alone_can_read_it(rollouts: Callable[..., Rollout], tmp_path: Path) -> None:
    rollout = rollouts(5, 2)
    rollout.save(tmp_path / "rollout.npz")
    with np.load(tmp_path / "rollout.npz", allow_pickle=False) as file:
        header = json.loads(file["header"].tobytes())
        assert set(file.files) == {"header", *ARRAYS}
    assert header["format"] == "warpvox-rollout"
    assert header["version"] == 1
    assert header["units"] == {"voxel": 0.1, "dt": 0.02}
    assert header["metadata"]["task"] == "Walker-v0"
    assert [obj["name"] for obj in header["scenes"][0]["objects"]] == ["robot", "box_1", "ground"]


@pytest.mark.parametrize("header", [None, b'{"format": "something else"}', b"[1, 2", "bare zip", "text"])
def test_a_foreign_file_is_refused(tmp_path: Path, header: object) -> None:
    path = tmp_path / "file.npz"
    np.savez(path, header=np.frombuffer(header, np.uint8)) if isinstance(header, bytes) else np.savez(path, a=[1.0])
    if header == "bare zip":
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("header.npy", b"no array")
    elif header == "text":
        path.write_text("positions, rewards\n")
    with pytest.raises(RolloutError):
        Rollout.load(path)


def rewrite(path: Path, change: Callable[[dict, dict], None]) -> None:
    """Change the header and arrays of a file."""
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    header = json.loads(arrays.pop("header").tobytes())
    change(header, arrays)
    np.savez(path, header=np.frombuffer(json.dumps(header).encode(), np.uint8), **arrays)


@pytest.mark.parametrize(
    "change",
    [
        lambda h, a: h.update(version=2),
        lambda h, a: h.pop("scenes"),
        lambda h, a: h["scenes"][0]["objects"][0].update(grid=[[9]]),
        lambda h, a: h["scenes"][0]["objects"][0].update(num_points=900),
        lambda h, a: h["scenes"][0]["objects"][0].update(x=500),
        lambda h, a: h["scenes"][0]["objects"][1].update(first_point=0, num_points=3),
        lambda h, a: h["scenes"][0]["objects"][0].update(x=1.7),
        lambda h, a: h["scenes"][0].update(objects=[]),
        lambda h, a: a.update(rewards=a["rewards"][:-1]),
        lambda h, a: a.update(rewards=a["rewards"] * np.nan),
        lambda h, a: a.update(positions=a["positions"].astype(float)),
    ],
)
def test_contradictions_are_named(rollouts, tmp_path: Path, change) -> None:
    path = tmp_path / "rollout.npz"
    rollouts(4, 1).save(path)
    rewrite(path, change)
    with pytest.raises(RolloutError):
        Rollout.load(path)


def test_lengths_and_returns(rollouts: Callable[..., Rollout]) -> None:
    rollout = rollouts(20, 3, ends=(5, 19))
    assert rollout.lengths.tolist() == [5, 19, 19]
    assert rollout.returns.shape == (20, 3)
    np.testing.assert_array_equal(rollout.returns[0], 0)
    np.testing.assert_allclose(rollout.returns[-1], rollout.rewards.sum(axis=0))
    assert rollouts(1, 2).lengths.tolist() == [0, 0]


def test_stretch_follows_the_axis_of_actuation(rollouts: Callable[..., Rollout]) -> None:
    rollout = rollouts(2, 1)
    scene = rollout.scene(0)
    np.testing.assert_allclose(rollout.stretch(0, 0), 1, atol=1e-5)
    rollout.positions[1, 0] = rollout.positions[0, 0] * (1.5, 0.8)
    wide = rollout.stretch(slice(None), 0)[1]
    expected = np.select([scene.cells == 3, scene.cells == 4], [1.5, 0.8], 1.15)
    np.testing.assert_allclose(wide, expected, atol=1e-5)


SMALL = [np.array([[3, 4], [1, 2]]), np.array([[4, 3, 4], [2, 0, 2]])]


@pytest.mark.parametrize("auto_reset", [True, False])
def test_record_holds_what_the_simulation_did(auto_reset: bool) -> None:
    env = make_vec("Carrier-v0", SMALL, num_envs=4, device="cpu", lanes=1, auto_reset=auto_reset, max_episode_steps=6)
    seen = []

    def policy(obs: torch.Tensor) -> torch.Tensor:
        seen.append({name: env.sim.object_positions(name).clone() for name in ("robot", "package")})
        return torch.full((4, env.num_actions), 9.0)

    rollout = record(env, policy, metadata={"note": "kept"})
    assert rollout.num_steps == 6
    assert rollout.truncated[-1].all()
    assert rollout.design_index.tolist() == [0, 0, 1, 1]
    assert rollout.actions.max() == np.float32(1.6)  # as applied
    assert rollout.metadata["task"] == "Carrier-v0"
    assert rollout.metadata["note"] == "kept"
    assert env.auto_reset is auto_reset
    for env_number in range(4):
        scene = rollout.scene(env_number)
        assert [obj.name for obj in scene.moving] == ["robot", "package"]
        np.testing.assert_array_equal(scene.moving[0].grid, SMALL[env_number // 2])
        assert scene.terrain.any()
        for obj in scene.moving:
            mine = slice(obj.first_point, obj.first_point + obj.num_points)
            for frame, points in enumerate(seen):
                expected = points[obj.name][env_number, : obj.num_points].numpy()
                np.testing.assert_array_equal(rollout.positions[frame, env_number, mine], expected)
        assert not rollout.positions[:, env_number, scene.num_points :].any()
    np.testing.assert_allclose(rollout.stretch(0, 0), 1, atol=1e-5)  # corners and points belong together


@pytest.mark.parametrize("agent", AGENTS)
def test_agents_repeat_and_stay_in_bounds(agent: str) -> None:
    runs = []
    for _ in range(2):
        env = make_vec("Walker-v0", SMALL, num_envs=2, device="cpu", lanes=1, seed=3)
        runs.append(record(env, agent, num_steps=4))
    assert_equal(*runs)
    assert runs[0].num_steps == 4
    assert runs[0].metadata["agent"] == agent
    assert runs[0].actions.min() >= np.float32(0.6)
    assert runs[0].actions.max() <= np.float32(1.6)


def test_a_rollout_names_the_constants_that_were_changed() -> None:
    physics = Physics.preset("paper", gravity=80.0)
    env = make_vec("Walker-v0", ["mini"], device="cpu", physics=physics, threads=1)
    assert record(env, "zero", num_steps=1).metadata["physics"] == "paper, gravity=80.0"


def test_record_refuses_what_makes_no_sense() -> None:
    env = make_vec("Walker-v0", SMALL, num_envs=2, device="cpu", lanes=1)
    with pytest.raises(ConfigError):
        record(env, "randum")
    with pytest.raises(ConfigError):
        record(env, "zero", num_steps=0)
    with pytest.raises(ActionError):
        record(env, lambda obs: torch.ones(1, 1))
    with pytest.raises(ActionError):
        record(env, lambda obs: None)
    with pytest.raises(ConfigError):
        record(VoxelGymVectorEnv("Walker-v0", 1, body="mini", threads=1))
    with pytest.raises(ConfigError):
        record(VoxelEnv("Walker-v0", "mini"))
    assert env.auto_reset is True


def test_terrain_that_an_episode_moves_is_recorded_where_it_was() -> None:
    env = make_vec("Catcher-v0", SMALL[:1], num_envs=2, device="cpu", lanes=1, max_episode_steps=3)
    rollout = record(env, lambda obs: torch.ones(2, env.num_actions))
    home = next(obj for obj in env.spec.objects if obj.name == "peg1")
    for number in range(2):
        peg = next(obj for obj in rollout.scene(number).objects if obj.name == "peg1")
        points = rollout.positions[-1, number, peg.first_point : peg.first_point + peg.num_points]
        assert peg.num_points == 12
        cells = (points.min(0) / 0.1).round() - [home.x, home.y]
        assert ((cells >= [-6, 0]) & (cells <= [4, 5])).all()
        np.testing.assert_allclose(points, rollout.positions[0, number, peg.first_point : peg.first_point + 12])


@pytest.mark.parametrize("agent", ["random", "sine"])
def test_blocks_with_seeds_of_their_own_act_as_if_they_were_alone(agent: str, tmp_path: Path) -> None:
    designs, seeds = ["mini", "worm"], [np.int64(3), 2**70]

    def made(designs: list[str], num_envs: int, seed: object) -> Rollout:
        env = make_vec("Walker-v0", designs, num_envs, device="cpu", threads=1, seed=seed)
        return record(env, agent, 4)

    both = made(designs, 4, seeds)
    for number, (design, seed) in enumerate(zip(designs, seeds, strict=True)):
        alone = made([design], 2, seed)
        count = alone.actions.shape[2]
        np.testing.assert_array_equal(both.actions[:, 2 * number : 2 * number + 2, :count], alone.actions)
        assert alone.metadata["seed"] == int(seed)
    assert Rollout.load(both.save(tmp_path / "a.npz")).metadata["seed"] == [3, 2**70]
    each = made(["mini"], 2, [np.int32(5), 6])  # a seed for each environment
    assert not np.array_equal(each.actions[:, 0], each.actions[:, 1])
    np.testing.assert_array_equal(each.actions[:, :1], made(["mini"], 1, 5).actions)


def test_a_larger_body_that_is_put_into_a_block_with_a_seed_moves_as_a_whole() -> None:
    env = make_vec("Walker-v0", [[[3, 4]], [[4, 3]]], 4, device="cpu", threads=1, seed=[1, 2], grid=(2, 2))
    env.set_designs([[[3, 3], [4, 4]]], np.array([False, True, False, False]))
    assert (record(env, "random", 1).actions[0, 1] > 0.6).all()
