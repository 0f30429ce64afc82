"""Ctrl-C, SIGTERM and SIGHUP where they are not expected: a second one, and one while results are written."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from fault_cases import TRAIN, check_training, only

from warpvox.algos.checkpoints.files import load_checkpoint

NUMBERS = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}
SIGNALS = pytest.mark.parametrize(("number", "code"), NUMBERS.items(), ids=lambda value: getattr(value, "name", None))


@pytest.fixture(autouse=True)
def usual_handlers() -> Iterator[None]:
    """Those of a process that a shell has started; under nohup, or in a script's background, some are ignored."""
    usual = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL, signal.SIGHUP: signal.SIG_DFL}
    before = {number: signal.signal(number, handler) for number, handler in usual.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def test_a_second_one_ends_at_once_and_says_which_state_is_kept(
    warpvox: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from warpvox.cli.progress import TrainingProgress

    assert warpvox(*TRAIN, f"output_dir={tmp_path / 'whole' / 'outputs'}").code == 0

    def twice(self: TrainingProgress, row: dict) -> None:
        if row["iteration"] == 2:
            signal.raise_signal(signal.SIGTERM)
            signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr(TrainingProgress, "__call__", twice)
        outcome = warpvox(*TRAIN)
    assert outcome.code == 130
    assert "interrupted, the state of iteration 1 is kept, after 64 control steps" in outcome.out
    assert outcome.err == "warpvox: interrupted\n"
    run = only(tmp_path, "train")
    assert not (run / "model_2.pt").exists()
    assert warpvox("train", f"resume={run}").code == 0
    check_training(run, only(tmp_path / "whole", "train"))


@SIGNALS
@pytest.mark.parametrize("moment", ["print_returns", "write_exports"])
def test_results_that_were_being_written_are_gone_or_whole(
    moment: str, number: int, code: int, warpvox: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(*_: Any) -> None:
        signal.raise_signal(number)

    monkeypatch.setattr(f"warpvox.cli.commands.play.{moment}", stop)
    outcome = warpvox(*"play agent=zero steps=2 num_envs=1 window=off".split())
    assert outcome.code == code
    assert outcome.err.count("\n") == 1
    assert "Traceback" not in outcome.out + outcome.err
    left = {file.name for file in tmp_path.rglob("*") if file.is_file()}
    assert left == (set() if moment == "print_returns" else {"config.yaml", "rollout.npz"})
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def at_iteration(monkeypatch: pytest.MonkeyPatch, iteration: int, *numbers: int) -> None:
    """Have signals arrive when an iteration of a training is over."""
    from warpvox.cli.progress import TrainingProgress

    def send(self: TrainingProgress, row: dict) -> None:
        for number in numbers if row["iteration"] == iteration else ():
            signal.raise_signal(number)

    monkeypatch.setattr(TrainingProgress, "__call__", send)


@pytest.mark.parametrize(
    ("numbers", "code"),
    [
        ([signal.SIGHUP, signal.SIGHUP], 129),  # from the shell and from the kernel
        ([signal.SIGTERM, signal.SIGHUP], 143),  # as systemd ends a session
        ([signal.SIGHUP, signal.SIGTERM], 143),
    ],
)
def test_a_closed_terminal_never_hurries(
    numbers: list[int], code: int, warpvox: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The iteration is finished and saved, and the run goes on from it."""
    with monkeypatch.context() as patch:
        at_iteration(patch, 2, *numbers)
        outcome = warpvox(*TRAIN)
    assert outcome.code == code
    assert outcome.err == f"warpvox: asked to end ({signal.Signals(numbers[0] if code == 129 else 15).name})\n"
    run = only(tmp_path, "train")
    assert "interrupted, state saved after 64 control steps" in outcome.out
    assert (run / "model_2.pt").is_file()


def test_under_nohup_a_closed_terminal_is_ignored(
    warpvox: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with monkeypatch.context() as patch:
        at_iteration(patch, 2, signal.SIGHUP)
        assert warpvox(*TRAIN).code == 0
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    assert (only(tmp_path, "train") / "model_3.pt").is_file()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="terminals are those of Linux")
def test_a_terminal_that_is_closed_loses_nothing(tmp_path: Path) -> None:
    """A whole process whose terminal goes away while it trains: it saves, although it can print nothing any more."""
    import fcntl
    import pty
    import termios

    def take_terminal() -> None:
        for number in NUMBERS:
            signal.signal(number, signal.SIG_DFL)
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)

    words = [word for word in TRAIN if not word.startswith(("save_interval", "max_iterations"))]
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "warpvox", *words, "max_iterations=100000"],
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        cwd=tmp_path,
        start_new_session=True,
        preexec_fn=take_terminal,
    )
    os.close(theirs)
    try:
        said = b""
        while b"steps/s" not in said:  # it trains
            said += os.read(ours, 10_000)
        os.close(ours)
        assert process.wait(60) == 129, said
    finally:
        process.kill()
        process.wait()
    run = only(tmp_path, "train")
    (model,) = run.glob("model_[0-9]*.pt")
    assert load_checkpoint(run / "state.pt")["iter"] == load_checkpoint(model)["iter"] > 0


def test_what_ends_before_its_first_checkpoint_can_be_resumed(
    warpvox: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The state from before the first iteration is there, and the resumed run draws what the first one drew."""
    from warpvox.cli.progress import TrainingProgress

    words = [word for word in TRAIN if not word.startswith("save_interval")]
    assert warpvox(*words, f"output_dir={tmp_path / 'whole' / 'outputs'}").code == 0

    class Killed(BaseException):
        pass

    def kill(*_: Any) -> None:
        raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(TrainingProgress, "__call__", kill)
        patch.setattr("warpvox.cli.commands.train.write_summary", lambda *_: None)
        patch.setattr("warpvox.cli.runs._has_result", lambda folder: True)  # who is killed cleans nothing up
        with pytest.raises(Killed):
            warpvox(*words)
    run = only(tmp_path, "train")
    assert not list(run.glob("model_*.pt"))
    assert warpvox("train", "resume=latest").code == 0
    check_training(run, only(tmp_path / "whole", "train"))
