"""Metrics go to rsl-rl's writers where they are asked for."""

from importlib.machinery import ModuleSpec
from pathlib import Path
from types import SimpleNamespace

import pytest
from rsl_rl.utils import wandb_log_writer

from warpvox.algos.training import metrics
from warpvox.algos.training.metrics import Metrics, check_logger, read_metrics
from warpvox.errors import ConfigError

ROW = {"iteration": 1, "steps": 8, "eval_return": 2.5, "elapsed": 0.1, "return_mean": float("nan")}


def test_weights_and_biases_gets_every_known_value(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """rsl-rl's own writer, with a stand-in for the package."""
    seen: list[tuple] = []
    stand_in = SimpleNamespace(
        init=lambda **options: seen.append(("init", options["project"], options["name"])),
        log=lambda values, step: seen.append((values, step)),
        finish=lambda: seen.append(("finish",)),
    )
    monkeypatch.setattr(wandb_log_writer, "wandb", stand_in)
    written = Metrics(tmp_path, 0, "wandb")
    written.write(ROW, {"Reward/x": 1.0})
    written.close()
    assert seen[0] == ("init", "warpvox", tmp_path.name)
    assert seen[1:-1] == [({"Eval/return": 2.5}, 1), ({"Reward/x": 1.0}, 1)]
    assert seen[-1] == ("finish",)
    assert [row["steps"] for row in read_metrics(tmp_path)] == [8]


def test_without_a_logger_there_is_the_table_alone(tmp_path: Path) -> None:
    written = Metrics(tmp_path, 0, "none")
    written.write(ROW)
    written.close()
    assert [file.name for file in tmp_path.iterdir()] == ["metrics.csv"]


def test_a_table_that_was_moved_away_begins_again_with_its_heading(tmp_path: Path) -> None:
    written = Metrics(tmp_path, 0, "none")
    written.write(ROW)
    (tmp_path / "metrics.csv").unlink()
    for iteration in (2, 3):
        written.write(ROW | {"iteration": iteration})
    assert [row["iteration"] for row in read_metrics(tmp_path)] == [2, 3]


def test_a_logger_that_is_not_installed_is_one_clear_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(metrics, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match="logger=wandb needs the package wandb"):
        check_logger("wandb")
    check_logger("tensorboard")
    monkeypatch.setattr(metrics, "find_spec", lambda name: ModuleSpec(name, None))
    check_logger("neptune")
