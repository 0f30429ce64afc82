"""Ctrl-C and SIGTERM where they are not expected: a second one, and one while results are written."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fault_cases import TRAIN, check_training, only

SIGNALS = pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])


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

    monkeypatch.setattr(f"warpvox.cli.play.{moment}", stop)
    outcome = warpvox(*"play agent=zero steps=2 num_envs=1 window=off".split())
    assert outcome.code == code
    assert outcome.err.count("\n") == 1
    assert "Traceback" not in outcome.out + outcome.err
    left = {file.name for file in tmp_path.rglob("*") if file.is_file()}
    assert left == (set() if moment == "print_returns" else {"config.yaml", "rollout.npz"})
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


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
        patch.setattr("warpvox.cli.train.write_summary", lambda *_: None)
        patch.setattr("warpvox.cli.runs._has_result", lambda folder: True)  # who is killed cleans nothing up
        with pytest.raises(Killed):
            warpvox(*words)
    run = only(tmp_path, "train")
    assert not list(run.glob("model_*.pt"))
    assert warpvox("train", "resume=latest").code == 0
    check_training(run, only(tmp_path / "whole", "train"))
