"""A disk that is full, read-only or gone; folders that vanish; what killed processes leave; two writers of one run."""

from __future__ import annotations

import errno
import json
import os
import pathlib
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from fault_cases import CODESIGN, TRAIN, check_complaint, check_training, only, same

from warpvox import system
from warpvox.algos.checkpoints.files import load_checkpoint, save_checkpoint
from warpvox.algos.training.metrics import TAGS, Events
from warpvox.cli.runs import going_on
from warpvox.errors import RolloutError, RunError, StorageError
from warpvox.io import writing as files
from warpvox.io.writing import MARK, claimed, sweep, write_text

LARGE_ENOUGH = 50_000_000
OURS = {files.__file__, pathlib.__file__, system.__file__}
"""The modules whose code writes a file."""
PAGE = 4096
"""Of a file system in memory: what every file takes at least."""


# ------------------------------------------------------------------------------------------------- one file


def test_what_is_renamed_is_on_the_disk_and_so_is_the_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The order is what a power failure needs: content, then name, then the folder's list of names."""
    done: list[str] = []
    fsync, replace = os.fsync, os.replace

    def flush(handle: int) -> None:
        done.append(f"flush {Path(os.readlink(f'/proc/self/fd/{handle}')).name}")
        fsync(handle)

    def rename(one: Any, other: Any) -> None:
        assert Path(one).read_text() == "new"
        done.append("rename")
        replace(one, other)

    if not Path("/proc/self/fd").is_dir():
        pytest.skip("the system does not tell which file is flushed")
    monkeypatch.setattr(os, "fsync", flush)
    monkeypatch.setattr(os, "replace", rename)
    write_text(tmp_path / "a.txt", "new")
    assert done[0].startswith(f"flush {MARK}a-")
    assert done[1:] == ["rename", f"flush {tmp_path.name}"]


@pytest.mark.parametrize("call", ["fsync", "replace", "touch"])
@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO, errno.EROFS, errno.EDQUOT, errno.EACCES, errno.ENOENT])
def test_a_refused_write_leaves_the_old_file_and_says_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str, number: int
) -> None:
    target = tmp_path / "a.txt"
    write_text(target, "old")

    def refuse(*_: Any, **__: Any) -> None:
        raise OSError(number, os.strerror(number))

    with monkeypatch.context() as patch:
        patch.setattr("pathlib.Path.touch" if call == "touch" else f"os.{call}", refuse)
        with pytest.raises(StorageError, match=r"a\.txt cannot be written: .*(;|\?)") as caught:
            write_text(target, "new")
    assert caught.value.errno == number
    assert os.strerror(number) not in str(caught.value)
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("a.txt", "old")]


def test_an_interrupt_leaves_one_of_the_two_files_whenever_it_comes(tmp_path: Path) -> None:
    """Once before every line that Python runs for it; only what runs between two frames is left to the run's end."""
    target, lines = tmp_path / "a.txt", 0

    def write(interrupted: int | None) -> None:
        nonlocal lines
        lines = 0

        def trace(frame: Any, event: str, _: Any) -> Any:
            nonlocal lines
            if frame.f_code.co_filename not in OURS:
                return None
            lines += event == "line"
            if lines == interrupted and event == "line":
                sys.settrace(None)
                raise KeyboardInterrupt
            return trace

        sys.settrace(trace)
        try:
            write_text(target, "new")
        finally:
            sys.settrace(None)

    write(None)
    count = lines
    assert count > 15
    for number in range(1, count + 1):
        write_text(target, "old")
        with pytest.raises(KeyboardInterrupt):
            write(number)
        assert [file.name for file in tmp_path.iterdir()] == ["a.txt"], number
        assert target.read_text() in ("old", "new")


def test_what_an_interrupt_has_left_is_removed_when_the_run_ends(tmp_path: Path) -> None:
    (tmp_path / f"{MARK}before.pt").touch()
    with pytest.raises(KeyboardInterrupt), going_on(tmp_path, "task: Walker-v0\n"):
        assert not list(tmp_path.glob(f"{MARK}*"))
        (tmp_path / f"{MARK}state.pt").touch()
        raise KeyboardInterrupt
    assert not list(tmp_path.glob(f"{MARK}*"))


@contextmanager
def small_files(size: int) -> Iterator[None]:
    """No file may become larger: what libraries in other languages write is refused, too."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.fixture(scope="module")
def rollout() -> Any:
    from warpvox.design import example_design
    from warpvox.envs.vec_env import make_vec
    from warpvox.view.rollout import record

    env = make_vec("Walker-v0", example_design("mini"), 1, device="cpu", auto_reset=False, threads=1)
    return record(env, "sine", 10)


def _write(name: str, rollout: Any, path: Path) -> None:
    from warpvox.view import render, usd
    from warpvox.view.player import write_html

    if path.suffix == ".mp4":
        pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg is not installed")
    writers = {
        "rollout.npz": rollout.save,
        "usdc": lambda file: usd.write_usd(rollout, file),
        "usda": lambda file: usd.write_usd(rollout, file),
        "gif": lambda file: render.write_gif(rollout, file, size=(320, 180)),
        "mp4": lambda file: render.write_mp4(rollout, file, size=(320, 180)),
        "png": lambda file: render.write_png(rollout, file),
        "strip": lambda file: render.write_filmstrip(rollout, file),
        "html": lambda file: write_html(rollout, file),
    }
    writers[name](path)


FILES = {
    "rollout.npz": "a.npz",
    "usdc": "a.usdc",
    "usda": "a.usda",
    "gif": "a.gif",
    "mp4": "a.mp4",
    "png": "a.png",
    "strip": "a.png",
    "html": "a.html",
}


@pytest.mark.parametrize("name", FILES)
def test_every_writer_notices_that_it_was_cut_short(name: str, rollout: Any, tmp_path: Path) -> None:
    path = tmp_path / FILES[name]
    _write(name, rollout, path)
    whole = path.read_bytes()
    for share in (0.0, 0.9):
        with (
            small_files(int(share * len(whole))),
            pytest.raises((StorageError, RolloutError), match="cannot be written"),
        ):
            _write(name, rollout, path)
        assert path.read_bytes() == whole
        assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_a_checkpoint_that_was_cut_short_is_noticed(tmp_path: Path) -> None:
    import torch

    path = tmp_path / "a.pt"
    save_checkpoint(path, {"policy": 1, "actor_state_dict": {"w": torch.arange(5000)}})
    before = path.read_bytes()
    with small_files(len(before) // 2), pytest.raises(StorageError, match=r"a\.pt cannot be written"):
        save_checkpoint(path, {"policy": 2, "actor_state_dict": {"w": torch.arange(5000)}})
    assert path.read_bytes() == before
    assert len(list(tmp_path.iterdir())) == 1


def test_events_are_what_tensorboard_reads_and_a_full_disk_is_an_error_at_once(tmp_path: Path) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = Events(tmp_path, purge_step=1)
    for step in (1, 2, 3):
        events.write({TAGS["eval_return"]: step / 2, "Reward/x": 1.0}, step)
    events.close()
    again = Events(tmp_path, purge_step=3)  # the third is written anew
    again.write({TAGS["eval_return"]: 9.0}, 3)
    read = EventAccumulator(str(tmp_path)).Reload()
    assert [(point.step, point.value) for point in read.Scalars("Eval/return")] == [(1, 0.5), (2, 1.0), (3, 9.0)]
    assert read.Tags()["scalars"] == ["Eval/return", "Reward/x"]
    size = again.path.stat().st_size
    with small_files(size + 10), pytest.raises(StorageError, match="tfevents"):
        again.write({"a": 1.0}, 4)
    again.close()


# -------------------------------------------------------------------------------------------- whole commands


COMMANDS = {
    "train": TRAIN,
    "codesign": CODESIGN,
    "play": "play agent=zero steps=2 window=off".split(),
    "bench": "bench suite=tasks tasks=[Walker-v0] design=mini num_envs=8 steps=1 repeats=1".split(),
    "demo": ["demo", *TRAIN[1:]],
}


@pytest.mark.parametrize("how", ["read-only", "a file"])
@pytest.mark.parametrize("command", COMMANDS)
def test_a_folder_that_cannot_be_written_is_refused_before_anything_starts(
    command: str, how: str, warpvox: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def started(*_: Any, **__: Any) -> None:
        raise AssertionError("a simulation was made")

    monkeypatch.setattr("warpvox.simulation.Simulation.__init__", started)
    if how == "a file":
        (tmp_path / "place").write_text("mine")
        phrase = "place is a file, not a folder"
    else:
        # bits of permission do not stop the superuser, who may run these tests
        access = os.access
        monkeypatch.setattr(os, "access", lambda path, mode: not mode & os.W_OK and access(path, mode))
        phrase = "is read-only; choose another folder"
    check_complaint(warpvox(*COMMANDS[command], "output_dir=place/runs"), phrase)
    assert [file.name for file in tmp_path.iterdir()] == (["place"] if how == "a file" else [])


@pytest.mark.parametrize("command", ["train", "codesign"])
def test_a_folder_that_vanishes_is_told_of_and_not_made_anew(
    command: str, warpvox: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from warpvox.cli.codesign_progress import SearchProgress
    from warpvox.cli.progress import TrainingProgress

    def remove(*_: Any) -> None:
        shutil.rmtree(tmp_path / "outputs", ignore_errors=True)

    monkeypatch.setattr(TrainingProgress, "__call__", remove)
    monkeypatch.setattr(SearchProgress, "progress", remove)
    outcome = warpvox(*COMMANDS[command])
    check_complaint(outcome, "outputs")
    assert "vanished" in outcome.err or "folder is gone" in outcome.err
    assert list(tmp_path.iterdir()) == []
    assert "go on:" not in outcome.out


@pytest.mark.parametrize("name", ["designs", "archive.sqlite"])
def test_what_vanishes_from_a_search_is_told_of(
    name: str, warpvox: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from warpvox.cli.codesign_progress import SearchProgress

    def remove(self: SearchProgress, generation: int, fresh: bool) -> None:
        place = self.results.folder / name
        shutil.rmtree(place) if place.is_dir() else place.unlink()

    with monkeypatch.context() as patched:
        patched.setattr(SearchProgress, "told", remove)
        check_complaint(warpvox(*CODESIGN), name, "vanished")
    run = only(tmp_path, "codesign")
    if name == "designs":
        assert not (run / name).exists()
        outcome = warpvox("codesign", f"resume={run}")
        assert (outcome.code, "the policies of 3 designs are gone from" in outcome.out) == (0, True), outcome.err


@pytest.mark.parametrize("command", ["train", "codesign"])
def test_leftovers_of_killed_processes_are_swept_up_and_a_second_writer_is_refused(
    command: str, warpvox: Callable, tmp_path: Path
) -> None:
    words = [word for word in COMMANDS[command] if "max_iterations" not in word]
    assert warpvox(*words, *(["max_iterations=2"] if command == "train" else [])).code == 0
    run = only(tmp_path, command)
    (run / "designs").mkdir(exist_ok=True)
    litter = [run / f"{MARK}state-abc.pt", run / "designs" / f"{MARK}config-abc.yaml"]
    for file in litter:
        file.write_text("half")
    resume = [command, f"resume={run}", *(["max_iterations=3"] if command == "train" else [])]
    with claimed(run):
        check_complaint(warpvox(*resume), "Another process is writing to")
    assert all(file.is_file() for file in litter)  # they may be the other's
    outcome = warpvox(*resume)
    assert outcome.code == 0, outcome.err
    assert not any(file.exists() for file in litter)


def test_a_claim_is_of_one_process_and_ends_with_it(tmp_path: Path) -> None:
    code = "import sys; from pathlib import Path; from warpvox.io.writing import claimed\n"
    code += "with claimed(Path(sys.argv[1])): print('mine', flush=True); sys.stdin.read()"
    with subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        assert other.stdout.readline() == b"mine\n"
        with pytest.raises(RunError, match="one at a time"), claimed(tmp_path):
            pass
        other.kill()
        other.wait()
    with claimed(tmp_path):
        sweep(tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("words", [["tasks"], pytest.param(TRAIN, marks=pytest.mark.slow)], ids=["tasks", "train"])
def test_a_log_on_a_full_disk_is_one_clear_error(words: list[str], tmp_path: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("there is no /dev/full")
    line = [sys.executable, "-m", "warpvox", *words]
    with open("/dev/full", "w") as full:
        done = subprocess.run(line, stdout=full, stderr=subprocess.PIPE, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 2
    assert done.stderr == (
        "warpvox: The output cannot be written: no space is left on its disk; free some, or use a folder on another"
        " disk.\n"
    )


@pytest.fixture
def tiny_disk(tmp_path: Path) -> Iterator[Callable[[int], Path]]:
    """``tiny_disk(kilobytes)``: a file system of that size, or the same one with another size."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted: list[bool] = []

    def call(size: int) -> Path:
        how = f"{'remount,' if mounted else ''}size={size}k"
        done = subprocess.run(["mount", "-t", "tmpfs", "-o", how, "tmpfs", place], capture_output=True, check=False)
        if done.returncode:
            pytest.skip("this user may not mount a file system")
        mounted.append(True)
        return place

    if shutil.which("mount") is None:
        pytest.skip("there is no mount")
    yield call
    if mounted:
        subprocess.run(["umount", place], check=True)


def test_on_a_real_disk_that_fills_up_a_training_goes_on_once_there_is_room(
    warpvox: Callable, tmp_path: Path, tiny_disk: Callable
) -> None:
    assert warpvox(*TRAIN, f"output_dir={tmp_path / 'whole' / 'outputs'}").code == 0
    whole = only(tmp_path / "whole", "train")
    pages = sum(-(-file.stat().st_size // PAGE) for file in whole.iterdir())
    disk = tiny_disk(pages * PAGE // 1024)  # room for the files, not for the old and the new state at once
    outcome = warpvox(*TRAIN, f"output_dir={disk / 'outputs'}")
    check_complaint(outcome, "no space is left on its disk")
    assert "go on: warpvox train resume=" in outcome.out
    run = only(disk, "train")
    assert not list(run.glob(f"{MARK}*"))
    state = load_checkpoint(run / "state.pt")
    assert 1 <= state["iter"] < 3
    assert same(state["actor_state_dict"], load_checkpoint(whole / f"model_{state['iter']}.pt")["actor_state_dict"])
    tiny_disk(LARGE_ENOUGH // 1024)
    assert warpvox("train", f"resume={run}").code == 0
    check_training(run, whole)


def test_summaries_of_runs_that_were_killed_in_their_last_moment_are_made_up_for(warpvox: Callable) -> None:
    assert warpvox(*TRAIN).code == 0
    run = only(Path(), "train")
    summary = json.loads((run / "summary.json").read_text())
    (run / "summary.json").unlink()
    assert warpvox("train", f"resume={run}").code == 0
    again = json.loads((run / "summary.json").read_text())
    timing = {"steps_per_second", "elapsed_seconds"}
    assert {k: v for k, v in again.items() if k not in timing} == {k: v for k, v in summary.items() if k not in timing}
    assert "already" in warpvox("train", f"resume={run}").err
