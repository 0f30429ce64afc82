"""Repeats of a robot's training run the commands of its entry with another seed, each from the one before."""

from pathlib import Path
from types import SimpleNamespace

import repeats

from warpvox.robots import zoo


def test_a_chain_of_trainings_is_run_with_one_seed(tmp_path: Path, monkeypatch) -> None:
    robot, ran = zoo("ObstacleTraverser-v0"), []

    def run(words: list[str], **_: object) -> None:
        ran.append(words[4:])
        task, number = (one[len(name) :] for name in ("task=", "name=") for one in words if one.startswith(name))
        (tmp_path / f"train/{task}/2026-01-31_12-00-00_{number}").mkdir(parents=True)

    monkeypatch.setattr(repeats.subprocess, "run", run)
    monkeypatch.setattr(repeats, "robots_of", lambda place, top: iter([SimpleNamespace(about=place)]))
    monkeypatch.setattr(repeats, "recorded", lambda robot, about: about)
    last = repeats.repeat(robot, 7, tmp_path)
    commands = [one["command"].split() for one in [*robot.about["start"], robot.about]]
    assert len(ran) == len(commands) == 3
    for number, (words, command) in enumerate(zip(ran, commands, strict=True)):
        given = [word for word in command[2:] if not word.startswith(("seed=", "pretrained="))]
        assert words[: len(given)] == given
        assert words[len(given) :][:3] == ["seed=7", f"output_dir={tmp_path}", f"name={number}"]
    folders = [tmp_path / f"train/{task}/2026-01-31_12-00-00_{k}" for k, task in enumerate(["UpStepper-v0"] * 2)]
    assert [words[-1] for words in ran[1:]] == [f"pretrained={folder / 'model_best.pt'}" for folder in folders]
    assert last == tmp_path / "train/ObstacleTraverser-v0/2026-01-31_12-00-00_2"
