"""Memory that runs out, on a GPU or in the machine: advice instead of a traceback, and nothing of the run is lost."""

import itertools
import pkgutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from fault_cases import CODESIGN, TRAIN, check_search, check_training, only

from warpvox.devices.out_of_memory import enough_memory, shortage
from warpvox.errors import DeviceError

TORCH = (
    "CUDA out of memory. Tried to allocate 2.00 GiB. GPU 0 has a total capacity of 15.77 GiB of which 1.19 GiB is free."
    " Including non-PyTorch memory, this process has 14.58 GiB memory in use. If reserved but unallocated memory is"
    " large try setting PYTORCH_ALLOC_CONF."
)
ERRORS = {
    "torch on CUDA": torch.OutOfMemoryError(TORCH),
    "Warp on CUDA": RuntimeError("Failed to allocate 8589934592 bytes on device 'cuda:0'"),
    "Warp on the CPU": RuntimeError("Failed to allocate 8589934592 bytes on device 'cpu'"),
    "torch on the CPU": RuntimeError(
        "[enforce fail at alloc_cpu.cpp:127] err == 0. DefaultCPUAllocator: can't allocate memory: you tried to"
        " allocate 8589934592 bytes. Error code 12 (Cannot allocate memory)"
    ),
    "numpy": np._core._exceptions._ArrayMemoryError((2**30,), np.dtype(np.float64))
    if hasattr(np, "_core")
    else MemoryError("Unable to allocate 8.00 GiB for an array with shape (1073741824,) and data type float64"),
    "Python": MemoryError(),
}
WORDS = {
    "torch on CUDA": "CUDA out of memory. Tried to allocate 2.00 GiB",
    "Warp on CUDA": "8 GiB more could not be had on cuda:0",
    "Warp on the CPU": "8 GiB more could not be had on cpu",
    "torch on the CPU": "8 GiB more could not be had",
    "numpy": "Unable to allocate 8.00 GiB for an array",
    "Python": "memory is used up",
}
EVERY = pytest.mark.parametrize("name", ERRORS)


@EVERY
def test_what_libraries_say_of_memory_is_understood(name: str) -> None:
    assert shortage(ERRORS[name]).startswith(WORDS[name])
    with pytest.raises(DeviceError), enough_memory("Take less."):
        raise ERRORS[name]


@pytest.mark.parametrize("error", [RuntimeError("shapes do not match"), ValueError("out of memory"), KeyError("x")])
def test_other_errors_stay_what_they_are(error: Exception) -> None:
    assert shortage(error) is None
    with pytest.raises(type(error)) as caught, enough_memory("Take less."):
        raise error
    assert caught.value is error


@contextmanager
def raised_at(monkeypatch: pytest.MonkeyPatch, place: str, call: int, error: Exception) -> Iterator[None]:
    """The ``call``-th call of a function runs out of memory."""
    before, calls = pkgutil.resolve_name(place), itertools.count(1)

    def failing(*words: Any, **more: Any) -> Any:
        if next(calls) == call:
            raise error
        return before(*words, **more)

    with monkeypatch.context() as patch:
        patch.setattr(place, failing)
        yield


def test_a_training_says_how_many_fewer_environments_and_goes_on(warpvox: Callable, tmp_path, monkeypatch) -> None:
    warpvox(*TRAIN, f"output_dir={tmp_path / 'whole' / 'outputs'}")
    with raised_at(monkeypatch, "warpvox.algos.ppo.stock.PPO.update", 3, ERRORS["torch on CUDA"]):
        outcome = warpvox(*TRAIN, fails=("Memory has run out", "num_envs=4 instead of 8", "2.00 GiB"))
    assert "failed after" in outcome.out
    run = only(tmp_path, "train")
    warpvox("train", f"resume={run}")
    check_training(run, only(tmp_path / "whole", "train"))


def test_environments_that_do_not_fit_leave_nothing_behind(warpvox: Callable, tmp_path: Path, monkeypatch) -> None:
    with raised_at(monkeypatch, "warpvox.simulation.Simulation.__init__", 1, ERRORS["Warp on CUDA"]):
        warpvox(
            *TRAIN, fails=("Memory has run out", "num_envs=4 instead of 8", "8 GiB more could not be had on cuda:0")
        )
    with raised_at(monkeypatch, "warpvox.simulation.Simulation.__init__", 1, ERRORS["numpy"]):
        warpvox("play", "agent=sine", "window=off", fails=("Memory has run out", "num_envs"))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_search_says_what_to_take_less_of_and_goes_on(warpvox: Callable, tmp_path, monkeypatch) -> None:
    warpvox(*CODESIGN, f"output_dir={tmp_path / 'whole' / 'outputs'}")
    place = "warpvox.algos.ppo.population.PopulationPPO.update"
    with raised_at(monkeypatch, place, 2, ERRORS["torch on CUDA"]):
        outcome = warpvox(*CODESIGN, fails=("Memory has run out", "training.envs is 8", "batch=1 trains 1"))
    assert "go on: warpvox codesign resume=" in outcome.out
    run = only(tmp_path, "codesign")
    warpvox("codesign", f"resume={run}")
    check_search(run, only(tmp_path / "whole", "codesign"))
