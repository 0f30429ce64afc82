"""Arguments of the wrong kind, size or sense: functions and command lines refuse them with errors of ours."""

import inspect
from pathlib import Path

import numpy as np
import pytest
from damage import Stranger
from refusals import refused
from sample_files import world_tree

import warpvox
from warpvox import errors
from warpvox.cli.config import load
from warpvox.errors import ConfigError, DesignError, DeviceError, SimulationError, WorldError
from warpvox.evogym.simulator_cpp import Sim
from warpvox.simulation import Simulation
from warpvox.world import World

SMALL = {"device": "cpu", "threads": 1}


@pytest.mark.parametrize(
    ("words", "error"),
    [
        ({"physics": []}, ConfigError), ({"rules": np.zeros((2, 2))}, ConfigError), ({"dtype": []}, SimulationError),
        ({"obs": np.zeros((2, 2))}, ConfigError), ({"connections": 5}, ConfigError), ({"seed": -1}, ConfigError),
        ({"seed": 1.5}, ConfigError), ({"lanes": []}, SimulationError), ({"lanes": 7}, SimulationError),
        ({"dtype": "float16"}, SimulationError), ({"threads": 0}, SimulationError),
        ({"threads": True}, SimulationError), ({"device": "cuda:²"}, DeviceError),
        ({"designs": Stranger()}, DesignError), ({"designs": np.array(False)}, DesignError),
        ({"num_envs": float("nan")}, ConfigError),
    ],
)  # fmt: skip
def test_make_vec_refuses(words: dict, error: type[Exception]) -> None:
    with pytest.raises(error):
        warpvox.make_vec(**{"task": "Walker-v0", "designs": "mini", **SMALL, **words})


@pytest.mark.parametrize(
    "words", [{"worlds": 1}, {"loose": 5}, {"loose": "robot"}, {"action_range": 3}, {"action_range": (2, 1)}]
)
def test_simulation_refuses(words: dict) -> None:
    with pytest.raises(SimulationError):
        Simulation(**{"worlds": [World.from_json(world_tree())], **SMALL, **words})


@pytest.mark.parametrize("data", [b"\x80", b"2 1 3 99999999999999999999999", b"-1 -1 3", b"2"])
def test_objects_of_the_drop_in(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "object.txt").write_bytes(data)
    with pytest.raises(WorldError):
        Sim().read_object_from_file(str(tmp_path / "object.txt"), "thing", 0, 0)


@pytest.mark.parametrize("value", ["1" * 5000, "[" * 3000, "'", "{a:"])
def test_values_on_the_command_line(value: str) -> None:
    with pytest.raises(ConfigError):
        load("play", [f"record={value}"])


def test_numbers_that_no_float_can_hold() -> None:
    with pytest.raises(ConfigError):
        load("train", [f"ppo.entropy_coef={'9' * 400}"])


def test_every_error_is_a_warpvox_error_and_of_the_builtin_kind_that_callers_expect() -> None:
    bad_input = "DesignError WorldError TaskError ActionError ConfigError RunError RolloutError".split()
    for name in bad_input:
        assert issubclass(getattr(errors, name), errors.WarpvoxError)
        assert issubclass(getattr(errors, name), ValueError)
    for name in ("DeviceError", "SearchError", "SimulationError"):
        assert issubclass(getattr(errors, name), errors.WarpvoxError)
        assert issubclass(getattr(errors, name), RuntimeError)


def test_settings_are_checked_when_they_are_made() -> None:
    for make in (
        lambda: warpvox.Ppo(step=4),
        lambda: warpvox.GA(popultion=3),
        lambda: warpvox.Ppo(steps=-4),
        lambda: warpvox.Ppo(hidden="64"),
        lambda: warpvox.Ppo(hidden={"a": 64}),
        lambda: warpvox.Ppo(clip=1e300),
        lambda: warpvox.Ppo(hidden=[65537]),
        lambda: warpvox.Ppo(action_scale=1e6),
    ):
        with pytest.raises(ConfigError):
            make()
    assert "steps" in inspect.signature(warpvox.Ppo).parameters
    with refused(AttributeError, "Did you mean 'make_vec'"):
        warpvox.makevec  # noqa: B018


def test_every_error_has_a_public_name() -> None:
    ours = [
        name
        for name, value in vars(errors).items()
        if getattr(value, "__module__", "") == errors.__name__ and isinstance(value, type)
    ]
    assert {"StorageError", "DivergenceError"} <= set(ours) <= set(warpvox.__all__)
    assert all(getattr(warpvox, name) is getattr(errors, name) for name in ours)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ("Walker-v1", " Did you mean 'Walker-v0'?"),
        ("walker-V0", " Did you mean 'Walker-v0'?"),
        ("climber", " Did you mean 'Climber-v0'?"),
        ("Dual-v0", ""),
        ("zzz", ""),
        (17, ""),
    ],
)
def test_did_you_mean(given: object, sentence: str) -> None:
    assert errors.did_you_mean(given, ["Walker-v0", "Climber-v0", "Carrier-v0"]) == sentence
