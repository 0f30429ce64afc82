"""Which device is taken, and what is said when its memory runs out."""

from typing import Any

import pytest
import torch
import warp as wp

from warpvox.algos.env_factory import EnvFactory
from warpvox.algos.training.job import resolved
from warpvox.batch.options import SimOptions
from warpvox.cli.config import load
from warpvox.devices import names
from warpvox.devices.names import resolve_device
from warpvox.envs.vec_env import make_vec
from warpvox.errors import DeviceError
from warpvox.simulation import Simulation


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine that says it has a GPU."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    monkeypatch.setattr(wp, "is_cuda_available", lambda: True)


@pytest.mark.usefixtures("gpu")
def test_auto_takes_a_gpu_where_there_are_environments_enough() -> None:
    assert [resolve_device("auto", count) for count in (1, 255, 256)] == ["cpu", "cpu", "cuda:0"]
    assert resolve_device("auto") == "cuda:0"
    assert resolve_device("cuda", 1) == "cuda:0"


def test_auto_is_the_cpu_where_there_is_no_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert resolve_device("auto", 10 * names.ENOUGH) == "cpu"


@pytest.mark.usefixtures("gpu")
def test_environments_and_commands_choose_by_their_number() -> None:
    assert make_vec("Walker-v0", num_envs=2, threads=1, lanes=8).device == "cpu"
    for count, device in ((names.ENOUGH - 1, "cpu"), (names.ENOUGH, "cuda:0")):
        assert resolved(load("train", [f"num_envs={count}"])).device == device


@pytest.mark.usefixtures("gpu")
def test_a_factory_has_one_device_for_batches_of_all_sizes() -> None:
    assert EnvFactory("Walker-v0", sim=SimOptions()).sim.device == "cuda:0"


@pytest.mark.parametrize(
    ("torch_has", "built", "driver", "said"),
    [
        (True, "13.0", (12, 8), "torch has a device, Warp refuses the driver, which is of CUDA 12.8: 13.0 is needed"),
        (False, None, (13, 0), "torch 2.13.0+cpu is built without CUDA, Warp has a device"),
        (False, "12.6", None, "torch finds no device (it is built for CUDA 12.6), Warp finds no driver (NVIDIA driver"),
    ],
)
def test_the_half_of_cuda_that_is_missing_is_named(torch_has, built, driver, said: str, monkeypatch, warpvox) -> None:
    monkeypatch.setattr(torch, "__version__", "2.13.0+cpu")
    monkeypatch.setattr(torch.version, "cuda", built)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: torch_has)
    monkeypatch.setattr(wp, "is_cuda_available", lambda: driver is not None and driver >= (13, 0))
    monkeypatch.setattr(wp, "get_cuda_driver_version", lambda: driver)
    monkeypatch.setattr(wp, "get_cuda_toolkit_version", lambda: (13, 4))
    assert said in " ".join(warpvox("info").out.split())
    with pytest.raises(DeviceError):
        resolve_device("cuda")


def exhausted(*args: Any, **options: Any) -> None:
    raise torch.cuda.OutOfMemoryError(
        "CUDA out of memory. Tried to allocate 2.00 GiB. GPU 0 has a total capacity of 4 GiB"
    )


def test_a_step_that_does_not_fit_says_what_to_lower(monkeypatch: pytest.MonkeyPatch) -> None:
    env = make_vec("Walker-v0", num_envs=2, device="cpu", threads=1, lanes=8)
    env.reset()
    monkeypatch.setattr(Simulation, "com", exhausted)
    with pytest.raises(DeviceError):
        env.step(torch.ones((2, env.num_actions)))
