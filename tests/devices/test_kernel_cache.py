"""Compiled kernels that a full disk or a power cut has damaged: they are removed and compiled once more."""

from __future__ import annotations

import itertools
import logging
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import warp as wp

from warpvox.devices.startup import start_warp
from warpvox.errors import DeviceError

DAMAGES = {
    "empty": lambda data: b"",
    "cut": lambda data: data[: len(data) // 2],
    "zeros": lambda data: bytes(len(data)),
    "half zeros": lambda data: data[: len(data) // 2] + bytes(len(data) - len(data) // 2),
}

FACTORS = itertools.count(2)


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A kernel cache of the test's own."""
    start_warp()
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path / "cache"))
    (tmp_path / "cache").mkdir()
    return tmp_path / "cache"


def counting(module: str = "warpvox.probe") -> tuple[Any, Callable[[], list[float]]]:
    """A fresh kernel that compiles in a moment, and a function that launches it, from a module of that name."""

    factor = wp.constant(float(next(FACTORS)))  # equal kernels would share what is loaded

    @wp.kernel(enable_backward=False, module="unique")
    def count(values: wp.array(dtype=float)):
        i = wp.tid()
        values[i] = (float(i) + 1.0) * factor

    names = {"__name__": module, "wp": wp}
    exec("def call(*words, **options): wp.launch(*words, **options)", names)

    def launch() -> list[float]:
        values = wp.zeros(3, dtype=float, device="cpu")
        names["call"](count, 3, [values], device="cpu")
        return (values.numpy() / factor).tolist()

    return count, launch


def forget(kernel: Any) -> None:
    """As in a process that begins anew: nothing is loaded."""
    kernel.module.unload()


@pytest.mark.parametrize("suffix", [".o", ".meta"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_removed_and_compiled_again(
    damage: str, suffix: str, cache: Path, caplog: pytest.LogCaptureFixture
) -> None:
    kernel, launch = counting()
    assert launch() == [1, 2, 3]
    (file,) = cache.rglob(f"*{suffix}")
    whole = file.read_bytes()
    file.write_bytes(DAMAGES[damage](whole))
    forget(kernel)
    with caplog.at_level(logging.WARNING):
        assert launch() == [1, 2, 3]
    assert str(file.parent) in caplog.text
    forget(kernel)
    caplog.clear()
    assert launch() == [1, 2, 3]
    assert not caplog.text
    assert len(file.read_bytes()) == len(whole)


def test_what_fails_again_is_a_clear_error(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk that is full still: what is compiled anew is cut short as well."""
    compile_whole = wp._src.context.Module._compile

    def compile_half(*words: Any, **options: Any) -> Any:
        done = compile_whole(*words, **options)
        for file in cache.rglob("*.o"):
            file.write_bytes(file.read_bytes()[:100])
        return done

    monkeypatch.setattr(wp._src.context.Module, "_compile", compile_half)
    _, launch = counting()
    with pytest.raises(DeviceError, match="WARP_CACHE_PATH") as caught:
        launch()
    assert str(cache) in str(caught.value)
    assert "once more has failed as well" in str(caught.value)


def test_what_cannot_be_removed_is_a_clear_error(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kernel, launch = counting()
    launch()
    (file,) = cache.rglob("*.o")
    file.write_bytes(b"")
    forget(kernel)

    def refuse(folder: Path) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(shutil, "rmtree", refuse)
    with pytest.raises(DeviceError, match=r"cannot be removed \(permission is denied"):
        launch()


def test_kernels_of_others_are_left_alone(cache: Path) -> None:
    kernel, launch = counting("somebody.else")
    launch()
    (file,) = cache.rglob("*.o")
    file.write_bytes(b"")
    forget(kernel)
    with pytest.raises(Exception, match="Failed to load"):
        launch()
    assert file.is_file()
