"""Killed, interrupted, on a full disk, with damaged files: nothing is lost, and one line says what to do."""

import errno
import itertools
import json
import os
import pathlib
import pkgutil
import shutil
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import yaml
from codesign_toys import Judge, ToySearch
from fault_cases import (
    CODESIGN,
    TRAIN,
    WHEN_DONE,
    WHEN_LEFT,
    check_search,
    check_training,
    has_begun,
    only,
)
from refusals import refused

import warpvox as wv
from warpvox import system
from warpvox.algos.archive import BACKUP, FILE, Archive
from warpvox.algos.checkpoints.files import load_checkpoint
from warpvox.algos.robots.entry import read_robot
from warpvox.errors import ResumeError, RolloutError, RunError, StorageError
from warpvox.io import writing
from warpvox.io.writing import MARK, atomic_path, claimed, write_text
from warpvox.runs import run_folder

resource = pytest.importorskip("resource", reason="signals and limits are those of POSIX")

COMMANDS = {"train": TRAIN, "codesign": CODESIGN}
OURS = {writing.__file__, pathlib.__file__, system.__file__}  # the modules whose code writes a file
FEW = [("killed", 0.6), ("full", 0.5)]
MANY = [(how, k / 20) for how in ("killed", "full") for k in range(20)]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="copies of a process are made by fork")
@pytest.mark.parametrize("moments", [FEW, pytest.param(MANY, marks=pytest.mark.slow)], ids=["few", "many"])
def test_a_run_goes_on_from_any_moment_to_the_undisturbed_end(moments: list, warpvox: Callable, tmp_path: Path) -> None:
    place = tmp_path / "victims"
    line = [sys.executable, Path(__file__).with_name("victim.py"), place, json.dumps(COMMANDS), json.dumps(moments)]
    # where there is no git, which a training can do without
    environment = os.environ | {"OMP_NUM_THREADS": "1", "PATH": ""}
    environment.pop("GIT_PYTHON_REFRESH", None)
    subprocess.run(line, check=True, stdout=subprocess.DEVNULL, env=environment)
    for command in COMMANDS:
        home = place / command
        codes = json.loads((home / "codes").read_text())
        assert codes == [0] + [-signal.SIGKILL if how == "killed" else 2 for how, _ in moments]
        assert "Traceback" not in (home / "output").read_text()
        assert "space is left" in (home / "output").read_text()
        whole, checked = only(home / "whole", command), 0
        for number in range(len(moments)):
            run = only(home / str(number), command)
            if run is None or not has_begun(run):
                continue  # nothing to lose yet
            WHEN_LEFT[command](run, whole)
            resumed = warpvox(command, f"resume={run}", code=None)
            assert resumed.code == 0 or "has already made" in resumed.err, resumed  # it was stopped when all was done
            WHEN_DONE[command](run, whole)
            checked += 1
        assert checked, command


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A training and a search; not to be changed."""
    from warpvox.cli import main

    place = tmp_path_factory.mktemp("runs")
    for words in COMMANDS.values():
        assert main([*words, f"output_dir={place / 'outputs'}"]) == 0
    return {command: only(place, command) for command in COMMANDS}


@pytest.fixture
def copied(runs: dict[str, Path], warpvox: Callable, tmp_path: Path) -> Callable[[str], Path]:
    """A copy of a run that may be damaged, in the folder where commands are run."""

    def call(command: str) -> Path:
        return Path(shutil.copytree(runs[command], tmp_path / "outputs" / command / "Walker-v0" / runs[command].name))

    return call


def cut(path: Path, share: float) -> None:
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])


@pytest.mark.parametrize("call", ["os.fsync", "os.replace", "pathlib.Path.touch"])
@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EROFS, errno.ENOENT])
def test_a_refused_write_leaves_the_old_file_and_says_what_to_do(tmp_path, monkeypatch, call: str, number: int) -> None:
    target = tmp_path / "a.txt"
    write_text(target, "old")

    def refuse(*_: Any, **__: Any) -> None:
        raise OSError(number, os.strerror(number))

    with monkeypatch.context() as patch:
        patch.setattr(call, refuse)
        with refused(StorageError, "a.txt cannot be written:"):
            write_text(target, "new")
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("a.txt", "old")]


def test_an_interrupt_leaves_one_of_the_two_files_whenever_it_comes(tmp_path: Path) -> None:
    """Once before every line that Python runs for it."""
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

        before = sys.gettrace()  # what measures coverage goes on
        sys.settrace(trace)
        try:
            write_text(target, "new")
        finally:
            sys.settrace(before)

    write_text(target, "old")  # the path keeps its text from here on: each write runs as many lines
    write(None)
    for number in range(1, lines + 1):
        write_text(target, "old")
        with pytest.raises(KeyboardInterrupt):
            write(number)
        assert [file.name for file in tmp_path.iterdir()] == ["a.txt"], number
        assert target.read_text() in ("old", "new")


@contextmanager
def small_files(size: int) -> Iterator[None]:
    """No file may become larger: what libraries in other languages write is refused, too."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_every_writer_notices_that_it_was_cut_short(tmp_path: Path) -> None:
    from warpvox.design import example_design
    from warpvox.envs.vec_env import make_vec
    from warpvox.view import render, usd
    from warpvox.view.player import write_html
    from warpvox.view.rollout import record

    env = make_vec("Walker-v0", example_design("mini"), 1, device="cpu", auto_reset=False, threads=1)
    rollout = record(env, "sine", 4)
    writers = {"a.npz": type(rollout).save, "a.usda": usd.write_usd, "a.png": render.write_png, "a.html": write_html}
    writers |= {"a.gif": lambda *words: render.write_gif(*words, size=(320, 180))}
    for name, write in writers.items():
        path = tmp_path / name
        write(rollout, path)
        whole = path.read_bytes()
        with small_files(len(whole) // 2), pytest.raises((StorageError, RolloutError)):
            write(rollout, path)
        assert path.read_bytes() == whole
        assert not list(tmp_path.glob(f"{MARK}*"))


@pytest.mark.parametrize("how", ["read-only", "a file"])
def test_a_folder_that_cannot_be_written_is_refused_before_anything_starts(how, warpvox, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("warpvox.simulation.Simulation.__init__", None)
    if how == "a file":
        (tmp_path / "place").write_text("mine")
    else:  # bits of permission do not stop the superuser, who may run these tests
        access = os.access
        monkeypatch.setattr(os, "access", lambda path, mode: not mode & os.W_OK and access(path, mode))
    phrase = {"a file": "place is a file, not a folder", "read-only": "is read-only; choose another folder"}[how]
    for words in (TRAIN, CODESIGN, "play agent=zero steps=2 window=off".split(), ["demo", *TRAIN[1:]]):
        warpvox(*words, "output_dir=place/runs", fails=phrase)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_folder_that_vanishes_is_told_of_and_not_made_again(command: str, warpvox, tmp_path, monkeypatch) -> None:
    def remove(*_: Any) -> None:
        shutil.rmtree(tmp_path / "outputs", ignore_errors=True)

    monkeypatch.setattr("warpvox.progress.training.Terminal.iterated", remove)
    monkeypatch.setattr("warpvox.progress.search.SearchProgress.progress", remove)
    warpvox(*COMMANDS[command], fails="outputs")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["designs", "archive.sqlite"])
def test_what_vanishes_from_a_search_is_told_of(name: str, warpvox: Callable, tmp_path: Path, monkeypatch) -> None:
    from warpvox.progress.search import SearchProgress

    def remove(self: SearchProgress, generation: int, fresh: bool) -> None:
        place = self.run.folder / name
        shutil.rmtree(place) if place.is_dir() else place.unlink()

    with monkeypatch.context() as patched:
        patched.setattr(SearchProgress, "told", remove)
        warpvox(*CODESIGN, fails=(name, "vanished"))
    run = only(tmp_path, "codesign")
    if name == "designs":
        assert not (run / name).exists()
        assert "the policies of 3 designs are gone from" in warpvox("codesign", f"resume={run}").out


@pytest.mark.parametrize(("command", "more"), [("train", ["max_iterations=4"]), ("codesign", [])])
def test_leftovers_of_killed_processes_are_swept_up_and_a_second_writer_is_refused(
    command: str, more: list[str], copied: Callable, warpvox
) -> None:
    run = copied(command)
    leftover = run / f"{MARK}state-abc.pt"
    leftover.write_text("half")
    with claimed(run):
        warpvox(command, f"resume={run}", *more, fails="Another process is writing to")
    assert leftover.is_file()  # it may be the other's
    warpvox(command, f"resume={run}", *more)
    assert not leftover.exists()


def test_a_run_whose_films_were_interrupted_is_done(copied: Callable, warpvox, monkeypatch) -> None:
    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    run = copied("train")
    monkeypatch.setattr("warpvox.cli.exports.write_exports", interrupt)
    warpvox("train", f"resume={run}", "max_iterations=4", "export=[png]", code=130)
    about = json.loads((run / "summary.json").read_text())
    assert (about["status"], about["iterations"]) == ("done", 4)
    warpvox("train", f"resume={run}", fails="already made 4 iterations")


def test_what_another_process_is_writing_is_no_leftover(copied: Callable, warpvox: Callable) -> None:
    run = copied("codesign")
    with atomic_path(run / "report.html") as temporary:  # as `report=` does without a claim, also of a running search
        temporary.write_text("of another process")
        warpvox("codesign", f"resume={run}")
    assert (run / "report.html").read_text() == "of another process"


@pytest.mark.parametrize(
    ("command", "more", "writer"),
    [
        ("train", ["max_iterations=4", "export=[gif]"], "warpvox.cli.exports.write_exports"),
        ("codesign", [], "warpvox.algos.codesign.results.Results.film"),
    ],
)
def test_nobody_else_goes_on_with_a_run_while_its_films_are_written(
    command: str, more: list[str], writer: str, copied: Callable, warpvox: Callable, monkeypatch
) -> None:
    run = copied(command)
    held = []
    tried = []

    @contextmanager
    def lock(path: Path, *words: Any) -> Iterator[None]:
        with system.path_lock(path, *words):
            held.append(path)
            yield

    def write(*_: Any) -> None:
        with refused(RunError, "Another process is writing to"), claimed(run):
            pass
        tried.append(True)

    monkeypatch.setattr(writing, "path_lock", lock)
    monkeypatch.setattr(writer, write)
    warpvox(command, f"resume={run}", *more)
    assert tried
    assert held.count(run) == 1  # not let go between the last iteration and the films


@pytest.mark.parametrize("asked", [6, 4])
def test_a_run_that_another_process_continued_meanwhile_goes_on_from_there(
    asked, copied: Callable, monkeypatch
) -> None:
    run, told = copied("train"), []

    def hear(row: dict) -> None:
        told.append(row["iteration"])

    def late(*words: Any, **more: Any) -> Any:
        with monkeypatch.context() as patch:
            patch.setattr("warpvox.algos.training.job.run_folder", run_folder)
            wv.train(resume=run, max_iterations=5, progress=False, listeners=[hear])
        return run_folder(*words, **more)

    monkeypatch.setattr("warpvox.algos.training.job.run_folder", late)
    refused = pytest.raises(ResumeError)
    with refused if asked == 4 else nullcontext():
        wv.train(resume=run, max_iterations=asked, progress=False, listeners=[hear])
    assert told == ([4, 5] if asked == 4 else [4, 5, 6])  # 4 and 5 by the other
    assert yaml.safe_load((run / "config.yaml").read_text().partition("...")[0])["max_iterations"] == max(asked, 5)


UPDATE, REPORT = "warpvox.algos.ppo.stock.PPO.update", "warpvox.progress.training.Terminal.iterated"


@pytest.mark.parametrize(
    ("place", "numbers", "code", "words"),
    [
        (UPDATE, [signal.SIGTERM], 143, "interrupted, state saved after 64 control steps"),
        (UPDATE, [signal.SIGHUP, signal.SIGHUP], 129, "interrupted, state saved after 64 control steps"),
        (
            REPORT,
            [signal.SIGTERM, signal.SIGINT],
            130,
            "interrupted, the state of iteration 1 is kept, after 64 control",
        ),
    ],
)
def test_a_signal_waits_for_the_iteration_and_a_second_one_does_not(
    place: str, numbers: list, code: int, words: str, warpvox: Callable, tmp_path: Path, monkeypatch, runs: dict
) -> None:
    """It comes in the second iteration, or when this one is reported."""
    usual = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL, signal.SIGHUP: signal.SIG_DFL}
    before = {number: signal.signal(number, handler) for number, handler in usual.items()}
    function, calls = pkgutil.resolve_name(place), itertools.count(1)

    def interrupted(*words: Any) -> Any:
        for number in numbers if next(calls) == 2 else ():
            signal.raise_signal(number)
        return function(*words)

    with monkeypatch.context() as patch:
        patch.setattr(place, interrupted)
        outcome = warpvox(*TRAIN, code=code)
    for number, handler in before.items():
        signal.signal(number, handler)
    assert words in outcome.out
    assert outcome.err.count("\n") == 1
    warpvox("train", f"resume={only(tmp_path, 'train')}")
    check_training(only(tmp_path, "train"), runs["train"])


def test_a_log_on_a_full_disk_is_one_clear_error(tmp_path: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("there is no /dev/full")
    with open("/dev/full", "w") as full:
        line = [sys.executable, "-m", "warpvox", "tasks"]
        done = subprocess.run(line, stdout=full, stderr=subprocess.PIPE, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("warpvox: The output cannot be written: no space is left on its disk")


def test_a_damaged_state_names_the_newest_checkpoint_that_is_whole(copied: Callable, warpvox: Callable) -> None:
    run = copied("train")
    cut(run / "state.pt", 0.99)
    garbled = bytearray((run / "model_3.pt").read_bytes())
    garbled[len(garbled) // 2] ^= 4  # within a tensor: its checksum tells
    (run / "model_3.pt").write_bytes(garbled)
    phrases = "state.pt is not a readable checkpoint", "that of iteration 2", "model_2.pt"
    advised = warpvox("train", "resume=latest", "max_iterations=4", fails=phrases).err.split("resume=")[-1].strip()
    warpvox("train", f"resume={advised}", "max_iterations=3")
    assert load_checkpoint(run / "model_3.pt")["iter"] == 3
    for file in run.glob("*.pt"):
        cut(file, 0.5)
    warpvox("train", f"resume={run}", "max_iterations=4", fails="start the run again")


@pytest.mark.parametrize("command", COMMANDS)
def test_a_configuration_that_was_cut_short_makes_no_other_run(command: str, copied: Callable, warpvox) -> None:
    run = copied(command)
    lines = (run / "config.yaml").read_text().splitlines(keepends=True)
    short = ("has been cut short", "...")
    for count in (0, len(lines) // 2, len(lines) - 4):
        (run / "config.yaml").write_text("".join(lines[:count]))
        warpvox(command, f"resume={run}", fails=short)


def test_damaged_curves_say_what_to_do(copied: Callable, warpvox: Callable) -> None:
    metrics = copied("train") / "metrics.csv"
    metrics.write_text(metrics.read_text().replace("\n2,", "\n2x,"))
    warpvox("train", "resume=latest", "max_iterations=4", fails=("metrics.csv is damaged", "move it away"))


def test_a_search_that_could_not_make_its_archive_is_made_when_it_is_repeated(tmp_path: Path, monkeypatch) -> None:
    def refuse(path: Path, _: Any) -> None:
        shutil.copy(path, tmp_path / "run" / f"{MARK}archive-1.sqlite")  # as of a process that was killed here
        raise sqlite3.OperationalError("database or disk is full")

    def search() -> dict[str, Any]:
        options = dict(folder=tmp_path / "run", progress=False, shape=(3, 3), device="cpu", threads=1)
        return wv.codesign(search=ToySearch(), fitness=Judge(), **options).summary

    with monkeypatch.context() as patch:
        patch.setattr(Archive, "_create_tables", refuse)
        with pytest.raises(StorageError):
            search()
    assert search()["status"] == "done"
    assert not list(tmp_path.rglob(f"{MARK}*"))


def test_a_search_that_could_not_begin_leaves_the_next_one_nothing_to_begin_with(tmp_path: Path, monkeypatch) -> None:
    def search(*start: str) -> dict[str, Any]:
        options = dict(progress=False, shape=(3, 3), device="cpu", threads=1, start=start)
        options |= dict(search=wv.GA(population=3, max_designs=3), fitness=Judge())
        return wv.codesign(folder=tmp_path / "run", **options).summary

    for name, corner in {"a": 1, "b": 2, "c": 4}.items():
        wv.save_design(tmp_path / f"{name}.json", np.array([[corner, 3, 3], [3, 0, 3], [3, 0, 3]]))
    with monkeypatch.context() as patch:
        patch.setattr(Archive, "_create_tables", Mock(side_effect=sqlite3.OperationalError("database or disk is full")))
        with pytest.raises(StorageError):
            search(f"{tmp_path}/a.json", f"{tmp_path}/b.json")
    assert search(f"{tmp_path}/c.json")["status"] == "done"
    (kept,) = (tmp_path / "run" / "training" / "start").iterdir()
    assert read_robot(kept).body[0, 0] == 4
    assert search(f"{tmp_path}/c.json")["status"] == "done"


def test_a_damaged_archive_names_its_copy_and_the_search_goes_on_from_it(copied, warpvox, runs) -> None:
    run = copied("codesign")
    cut(run / FILE, 0.5)
    (run / f"{FILE}-journal").write_bytes(b"nonsense" * 500)
    for words in (("codesign", "resume=latest"), ("codesign", "report=latest"), ("play", "window=off")):
        warpvox(*words, fails=("damaged", f"{BACKUP} beside it", "copy it over"))
    (run / FILE).unlink()
    warpvox("codesign", "resume=latest", fails=(f"has no {FILE}", f"{BACKUP} beside it", "copy it over"))
    with refused(RunError, f"{FILE} is gone", "copy it over"):  # rather than begin another one
        Archive.create(run / FILE, {})
    shutil.copy(run / BACKUP, run / FILE)
    warpvox("codesign", f"resume={run}")
    check_search(run, runs["codesign"])
