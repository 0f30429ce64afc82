"""What is typed reaches the configuration: paths of any letters, single values where lists are expected."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import example, given, strategies as st

from warpvox.cli.config import Arguments, expand, load, to_yaml
from warpvox.cli.help import flat_keys
from warpvox.cli.quoting import parse, readable
from warpvox.configs.schema import COMMANDS
from warpvox.errors import ConfigError

ODD = ["läufe (1)", "a=b", "~x", "it's", 'a"b,c', "[a]", "{a", "日本#;&!", "-a\\b", "$a", "007"]
"""Names of folders that the grammar of Hydra refuses, or reads as something else."""
KEYS = {command: dict(flat_keys(schema)) for command, schema in COMMANDS.items()}


def value_of(command: str, name: str, word: str) -> Any:
    override = parse(readable(word, KEYS[command][name], multirun=False))
    assert override is not None
    return override.value()


@given(st.text(st.characters(exclude_categories=("Cs",), exclude_characters="\0"), min_size=1, max_size=40))
@example("a\\")
@example("'a' b")
@example("choice(a,b)")
def test_a_path_is_taken_as_it_is_typed(path: str) -> None:
    if path == "null" or (path[0] == path[-1] and path[0] in "'\""):
        return  # these have a meaning
    assert value_of("play", "output_dir", f"output_dir={path}") == os.path.expanduser(path)
    if "," not in path:
        assert value_of("play", "run", f"run={path}") == os.path.expanduser(path)


@pytest.mark.parametrize("name", ODD)
def test_every_command_takes_odd_paths(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path(name).mkdir()
    (Path(name) / "body.json").touch()
    (Path(name) / "t.py").touch()
    assert load("play", [f"run={name}", f"output_dir={name}"]).run == name
    assert load("train", [f"design={name}/body.json", f"task={name}/t.py:T"]).design == f"{name}/body.json"
    if name[0] != "[":  # of a list
        several = "," not in name
        config = load("curves", [f"file={name}/x.png", f"runs=[{name},latest]" if several else f"runs={name}"])
        assert (config.file, config.runs) == (f"{name}/x.png", [name, "latest"] if several else [name])


def test_the_home_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    config = load("play", ["run=~/a", "output_dir=~"])
    assert (config.run, config.output_dir) == (f"{tmp_path}/a", str(tmp_path))
    assert load("curves", ["runs=[~/a,b]"]).runs == [f"{tmp_path}/a", "b"]


def test_sweeps_of_paths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    runs = expand(Arguments(["run=a(1),ü", "num_envs=1"], multirun=True), "play")
    assert [load("play", words).run for words in runs] == ["a(1)", "ü"]
    assert [load("play", words).run for words in expand(Arguments(["run=choice(a,b)"], multirun=True), "play")] == [
        "a",
        "b",
    ]
    (tmp_path / "a,b").mkdir()
    assert len(expand(Arguments(["run=a,b"], multirun=True), "play")) == 1  # there is such a folder
    with pytest.raises(ConfigError, match="add --multirun"):
        expand(Arguments(["task=Walker-v0,Climber-v0"]), "train")


@pytest.mark.parametrize(
    ("command", "word", "name", "value"),
    [
        ("play", "export=gif", "export", ["gif"]),
        ("curves", "runs=latest", "runs", ["latest"]),
        ("codesign", "export=csv", "export", ["csv"]),
        ("train", "ppo.hidden=64", "ppo.hidden", [64]),
        ("codesign", "training.rungs=0.5", "training.rungs", [0.5]),
        ("bench", "tasks=Walker-v0", "tasks", ["Walker-v0"]),
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


def test_a_sweep_of_single_values_where_lists_are_expected() -> None:
    runs = expand(Arguments(["export=gif,usd"], multirun=True), "play")
    assert [load("play", words).export for words in runs] == [["gif"], ["usd"]]


def test_texts_of_other_scripts_are_judged_by_their_content() -> None:
    with pytest.raises(ConfigError, match="rules must be one of evogym, paper"):
        load("train", ["rules=pàper"])


# ------------------------------------------------------------------------------------------------ config=FILE


def test_a_stored_configuration_runs_again(tmp_path: Path) -> None:
    first = load("train", ["ppo=evogym", "seed=3", "design=[[3,3],[4,4]]", "physics.gravity=80", "name=x"])
    file = tmp_path / "config (1).yaml"
    file.write_text(to_yaml(first) + "...\n")
    assert load("train", [f"config={file}"]) == first
    again = load("train", ["seed=4", f"config={file}", "ppo.gamma=0.5"])
    assert (again.seed, again.ppo.gamma, again.num_envs, again.physics.gravity) == (4, 0.5, 4, 80.0)
    other = load("train", [f"config={file}", "ppo=parallel", "num_envs=16"])
    assert (other.ppo, other.num_envs, other.seed) == (load("train", []).ppo, 16, 3)
    assert load("train", [f"config={file}", "ppo=parallel"]).num_envs == 4  # of the file: the group has its default
    mappings = ["network={width:8}", "evaluation.network={width:16}", "evaluation.ppo={epochs:2}"]
    search = load("codesign", ["search=map_elites", "search.bins=3", *mappings])
    file.write_text(to_yaml(search))
    assert load("codesign", [f"config={file}"]) == search


def test_a_few_keys_in_a_file(tmp_path: Path) -> None:
    (tmp_path / "few.yaml").write_text("seed: 9\nppo:\n  gamma: 0.5\n")
    config = load("train", [f"config={tmp_path / 'few.yaml'}"])
    assert (config.seed, config.ppo.gamma, config.ppo.steps) == (9, 0.5, load("train", []).ppo.steps)


@pytest.mark.parametrize(
    ("text", "phrase"),
    [
        ("sede: 1\n", "the key 'sede', unknown to this version of warpvox. Did you mean 'seed'?"),
        ("ppo:\n  gama: 1\n", "'ppo.gama'"),
        ("seed: abc\n", "seed"),
        ("num_envs: 0\n", "at least 1"),
        ("- 1\n", "holds no KEY: VALUE"),
        ("task: !!python/name:os.system\n", "cannot be read as YAML"),
        ("search: {algorithm: ga}\n", "It is a configuration of `warpvox codesign`"),
    ],
)
def test_files_that_do_not_fit(text: str, phrase: str, tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text(text)
    with pytest.raises(ConfigError) as caught:
        load("train", [f"config={tmp_path / 'c.yaml'}"])
    assert phrase in str(caught.value)


def test_a_file_and_a_preset_are_two_beginnings(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text("seed: 1\n")
    with pytest.raises(ConfigError, match="give one of them"):
        load("train", [f"config={tmp_path / 'c.yaml'}", "preset=paper"])


def test_no_such_file() -> None:
    with pytest.raises(ConfigError, match="There is no file"):
        load("train", ["config=nowhere.yaml"])


# ----------------------------------------------------------------------------------------------- --config-dir


@pytest.mark.parametrize("text", ["gamma: 0.5\n", "# @package _global_\nppo:\n  gamma: 0.5\nnum_envs: 8\n"])
def test_a_file_of_ones_own_needs_no_more_than_what_it_changes(text: str, tmp_path: Path, warpvox: Callable) -> None:
    folder = tmp_path / "my configs (ü)"
    (folder / "ppo").mkdir(parents=True)
    (folder / "ppo" / "mine.yaml").write_text(text)
    outcome = warpvox("train", "--config-dir", str(folder), "ppo=mine", "--cfg")
    assert outcome.code == 0, outcome.err
    values, defaults = yaml.safe_load(outcome.out), yaml.safe_load(to_yaml(load("train", [])))
    expected = {**defaults, "num_envs": 8 if "num_envs" in text else defaults["num_envs"]}
    assert values == {**expected, "ppo": {**defaults["ppo"], "gamma": 0.5}}
