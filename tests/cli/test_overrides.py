"""What is typed reaches the configuration: paths of any letters, single values where lists are expected."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from refusals import refused

from warpvox.cli.config import load
from warpvox.errors import ConfigError
from warpvox.io.writing import to_yaml

ODD = ["läufe (1)", "a=b", "~x", "it's", 'a"b,c', "[a]", "日本#;&!", "-a\\b", "$a", "007"]
"""Names of folders that the grammar of Hydra refuses, or reads as something else."""


@pytest.mark.parametrize("name", ODD)
def test_every_command_takes_odd_paths(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path(name).mkdir()
    (Path(name) / "body.json").touch()
    (Path(name) / "t.py").touch()
    assert load("play", [f"run={name}", f"output_dir={name}"]).run == name
    assert load("train", [f"design={name}/body.json", f"task={name}/t.py:T"]).design == f"{name}/body.json"
    (Path(name) / "x.png").touch()
    config = load("curves", [f"file={name}/x.png", f"runs={name}"])
    assert (config.file, config.runs) == (f"{name}/x.png", [name])


def test_words_of_ordinary_cases() -> None:
    config = load("train", ["task=Climber-v0", "design=path/to/body.json", "export=gif", "output_dir=a/b-c_1.x"])
    assert (config.task, config.design, config.export) == ("Climber-v0", "path/to/body.json", ["gif"])
    assert config.output_dir == "a/b-c_1.x"
    assert load("train", ["export=[gif,usd]"]).export == ["gif", "usd"]
    assert load("train", ["design=[[3,3],[4,4]]", "ppo.hidden=[32,16]"]).ppo.hidden == [32, 16]
    assert load("train", ["bodies=random:64", "bodies.refresh=new"]).designs.bodies == "random:64"
    assert load("codesign", ["finalists=2", "evaluation=gaits", "evaluation.gaits=5"]).fitness.finalists == 2
    assert load("play", ["output_dir=läufe"]).output_dir == "läufe"  # which the grammar of Hydra cannot read


def test_the_home_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    config = load("play", ["run=~/a", "output_dir=~"])
    assert (config.run, config.output_dir) == (f"{tmp_path}/a", str(tmp_path))


@pytest.mark.parametrize(
    ("command", "word", "name", "value"),
    [
        ("play", "export=gif", "export", ["gif"]),
        ("train", "ppo.hidden=64", "ppo.hidden", [64]),
        ("codesign", "training.rungs=0.5", "training.rungs", [0.5]),
        ("train", "name=007", "name", "007"),
        ("train", "name=1e3", "name", "1e3"),
        ("play", "checkpoint=50", "checkpoint", "50"),
    ],
)
def test_single_values_and_numbers_as_text(command: str, word: str, name: str, value: Any) -> None:
    config = load(command, [word])
    for part in name.split("."):
        config = getattr(config, part)
    assert config == value


def test_a_stored_configuration_runs_again(tmp_path: Path) -> None:
    words = "ppo=evogym seed=3 design=[[3,3],[4,4]] physics.gravity=80 name=x protocol=noise episodes=3".split()
    first, file = load("train", words), tmp_path / "config (1).yaml"
    file.write_text(to_yaml(first).replace("protocol: noise", "fitness: robust") + "...\n")  # as 0.1.0 wrote it
    assert load("train", [f"config={file}"]) == first
    again = load("train", ["seed=4", f"config={file}", "ppo.gamma=0.5"])
    assert (again.seed, again.ppo.gamma, again.num_envs, again.physics.gravity) == (4, 0.5, 4, 80.0)
    other = load("train", [f"config={file}", "ppo=parallel", "num_envs=16"])
    assert (other.ppo, other.num_envs, other.seed) == (load("train", []).ppo, 16, 3)
    assert load("train", [f"config={file}", "ppo=parallel"]).num_envs == 4  # of the file: it is not in the section
    search = load("codesign", ["search=map_elites", "search.bins=3", "fitness=gaits", "fitness.beam=3"])
    file.write_text(to_yaml(search))
    assert load("codesign", [f"config={file}"]) == search
    assert load("codesign", [f"config={file}", "fitness.gaits=3"]).fitness == replace(search.fitness, gaits=3)
    other = load("codesign", [f"config={file}", "fitness=specialist"])
    assert other == replace(search, fitness=load("codesign", ["fitness=specialist"]).fitness)
    file.write_text(to_yaml(search).replace("name: gaits", "name: gates"))
    with refused(ConfigError, "fitness must be one of", "got 'gates'"):
        load("codesign", [f"config={file}"])


@pytest.mark.parametrize(
    ("text", "words", "phrase"),
    [
        ("sede: 1\n", [], "Key 'sede' not in 'TrainConfig'. Did you mean 'seed'?"),
        ("- 1\n", [], "holds no KEY: VALUE"),
        ("task: !!python/name:os.system\n", [], "could not determine a constructor"),
        ("search: {algorithm: ga}\n", [], "Key 'search' not in 'TrainConfig'"),
        ("seed: 1\n", ["preset=paper"], "give one of them"),
        ("seed: -1\n", ["num_envs=4"], "c.yaml: seed must be at least 0"),
    ],
)
def test_files_that_do_not_fit(text: str, words: list[str], phrase: str, tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text(text)
    with refused(ConfigError, phrase):
        load("train", [f"config={tmp_path / 'c.yaml'}", *words])


@pytest.mark.parametrize("text", ["gamma: 0.5\n", "# @package _global_\nppo:\n  gamma: 0.5\nnum_envs: 8\n"])
def test_a_file_of_ones_own_needs_no_more_than_what_it_changes(text: str, tmp_path: Path, warpvox: Callable) -> None:
    folder = tmp_path / "my configs (ü)"
    (folder / "ppo").mkdir(parents=True)
    (folder / "ppo" / "mine.yaml").write_text(text)
    config, default = load("train", ["ppo=mine"], folder), load("train", [])
    assert (config.ppo.gamma, config.ppo.steps) == (0.5, default.ppo.steps)
    assert config.num_envs == (8 if "num_envs" in text else default.num_envs)
    outcome = warpvox("train", "--config-dir", str(folder), "ppo=mine", "--cfg", "job")
    assert yaml.safe_load(outcome.out)["ppo"]["gamma"] == 0.5
