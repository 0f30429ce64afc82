"""The table of a training's metrics, and its logger."""

from importlib.machinery import ModuleSpec
from pathlib import Path

import pytest

from warpvox.algos.training import metrics
from warpvox.algos.training.metrics import Metrics, check_logger, read_metrics
from warpvox.errors import ConfigError

ROW = {"iteration": 1, "steps": 8, "eval_return": 2.5, "elapsed": 0.1, "return_mean": float("nan")}


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
