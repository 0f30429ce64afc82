"""From words to configurations."""

import dataclasses
import signal
from pathlib import Path
from typing import Any

import pytest
import yaml
from omegaconf.errors import OmegaConfBaseException
from refusals import refused

from warpvox.algos import settings
from warpvox.algos.settings import physics_of
from warpvox.cli import COMMANDS, main
from warpvox.cli.config import load
from warpvox.cli.help import flat_values, keys_of, options_of
from warpvox.configs import schema
from warpvox.design import load_design
from warpvox.errors import ConfigError
from warpvox.io.writing import to_yaml
from warpvox.types import Physics

TABLE_1 = {
    "point_mass": 1.0, "drag": 0.1, "gravity": 110.0, "contact_stiffness": 2.1e7, "contact_depth": 5e-3,
    "friction": 0.1, "friction_multiplier": 2.4e3, "rigid_main": 3e8 / 3.5,
    "rigid_structural": 3e8 / 7, "soft_main": 3e8 / 5,
    "soft_structural": 3e8 / 10, "actuator_main": 3e8 / 6, "actuator_structural": 3e8 / 24,
}  # fmt: skip # paper section A, but for the frictional penalty, which the release does not use
TABLE_6 = {
    "learning_rate": 2.5e-4, "schedule": "linear", "clip": 0.1, "value_coef": 0.5, "entropy_coef": 0.01, "steps": 128,
}  # fmt: skip # paper section D.3


def test_the_papers_constants_and_settings() -> None:
    literal = Physics.preset("paper_literal")
    assert {name: getattr(literal, name) for name in TABLE_1} == TABLE_1
    assert Physics.preset("paper") == dataclasses.replace(literal, name="paper", contact_stiffness=2.1e6)
    train, search = load("train", ["ppo=evogym"]), load("codesign", ["training=paper"]).training
    assert {name: getattr(train.ppo, name) for name in TABLE_6} == TABLE_6
    assert (train.num_envs, train.eval_interval, train.max_iterations) == (4, 50, 1000)
    assert search.ppo == train.ppo
    assert (search.envs, search.eval_interval, search.iterations) == (4, 50, 1000)


@pytest.mark.parametrize(("task", "shape"), [("Walker-v0", (5, 5)), ("Lifter-v0", (5, 7))])
def test_the_papers_preset(task: str, shape: tuple[int, int]) -> None:
    train, search = (load(command, ["preset=paper", f"task={task}"]) for command in ("train", "codesign"))
    for config in (train, search):
        assert (config.preset, config.rules, physics_of(config)) == ("paper", "paper", Physics.preset("paper"))
    tables = load("train", ["ppo=evogym", "rules=paper", f"task={task}"])
    assert train == dataclasses.replace(tables, preset="paper", design=train.design)
    assert load_design(train.design).shape == tuple(search.shape) == shape
    assert search.search == load("codesign", ["search=paper"]).search
    assert search.training == load("codesign", ["training=paper"]).training


@pytest.mark.parametrize(
    ("command", "words", "path", "value"),
    [
        ("codesign", ["shape=[3,4]", "task=Lifter-v0"], "shape", [3, 4]),
        ("codesign", ["search.algorithm=bo"], "search.algorithm", "bo"),
        ("codesign", ["fitness.name=gaits"], "fitness.name", "gaits"),
        ("codesign", ["search=bo"], "search.acquisition", "pathwise"),
        ("train", ["ppo=parallel"], "num_envs", 512),
        ("train", ["physics=evogym"], "physics.preset", "evogym"),
        ("train", ["rules=evogym"], "rules", "evogym"),
    ],
)
def test_what_is_typed_goes_before_a_preset(command: str, words: list[str], path: str, value: Any) -> None:
    """Wherever the preset stands."""
    config = load(command, [*words, "preset=paper"][:: 1 if len(path) % 2 else -1])
    assert flat_values(command, dataclasses.asdict(config))[path] == value
    assert config.rules == ("evogym" if words == ["rules=evogym"] else "paper")


@pytest.mark.parametrize(("command", "words"), [("train", ["seed=7"]), ("codesign", ["top=7"])])
def test_null_is_none(command: str, words: list[str]) -> None:
    assert load(command, ["resume=null", "config=null", "preset=null", *words]) == load(command, words)


def test_a_preset_of_ones_own(tmp_path: Path) -> None:
    (tmp_path / "preset" / "train").mkdir(parents=True)
    file = tmp_path / "preset" / "train" / "mine.yaml"
    file.write_text("preset: mine\nseed: 9\nppo:\n  gamma: 0.5\n")
    config, default = load("train", ["preset=mine"], tmp_path), load("train", [])
    expected = dataclasses.replace(default.ppo, gamma=0.5)
    assert config == dataclasses.replace(default, preset="mine", seed=9, ppo=expected)
    with pytest.raises(ConfigError):
        load("codesign", ["preset=mine"], tmp_path)
    for text, named in (("sed: 9\n", "sed"), ("- 9\n", "preset/train/mine"), ("a: [\n", "mine.yaml")):
        file.write_text(text)
        with refused(ConfigError, named):
            load("train", ["preset=mine"], tmp_path)


@pytest.mark.parametrize("words", [[], ["rules=paper"], ["physics=paper_literal"], ["rules=paper", "physics=evogym"]])
def test_physics_goes_with_the_rules_unless_named(words: list[str]) -> None:
    config = load("train", words)
    named = config.physics.preset
    assert physics_of(config) == Physics.preset(config.rules if named == "auto" else named)


def test_a_constant_changes_alone_whatever_the_order() -> None:
    expected = dataclasses.replace(Physics.preset("paper"), gravity=80.0)
    for words in (["physics=paper", "physics.gravity=80"], ["physics.gravity=80", "physics=paper"]):
        assert physics_of(load("train", words)) == expected


def test_every_constant_of_the_physics_is_a_key_with_a_meaning() -> None:
    constants = {field.name for field in dataclasses.fields(Physics)} - {"name"}
    assert {field.name for field in dataclasses.fields(settings.PhysicsConfig)} == constants | {"preset"}
    assert all(field.metadata["help"] for field in dataclasses.fields(settings.PhysicsConfig))


@pytest.mark.parametrize("command", schema.COMMANDS)
def test_no_default_is_missing_and_none_is_out_of_range(command: str) -> None:
    values = yaml.safe_load(to_yaml(load(command, [])))
    assert "???" not in str(values)


@pytest.mark.parametrize(
    ("command", "group"),
    [("train", "physics"), ("train", "ppo"), *(("codesign", name) for name in ("search", "fitness", "training"))],
)
def test_every_choice_of_a_group_composes(command: str, group: str) -> None:
    names = options_of(command, group)
    assert len(names) >= 2
    for name in names:
        load(command, [f"{group}={name}"])


@pytest.mark.parametrize("command", COMMANDS)
def test_help_names_every_key_with_its_meaning(command: str, capsys: pytest.CaptureFixture) -> None:
    assert main([command, "--help"]) == 0
    text = capsys.readouterr().out
    assert f"warpvox {command.replace('demo', 'train')}" in text  # of which the demo is a preset
    if command in schema.COMMANDS:
        for name, key in keys_of(command).items():
            assert key.help
            if not dataclasses.is_dataclass(key.default) and len(key.choices) != 1:
                assert f"  {name}=" in text, name
        assert "=?" not in text


def test_the_settings_are_printed_as_config_takes_them(capsys: pytest.CaptureFixture, tmp_path: Path) -> None:
    for words in (["demo"], ["train", "ppo=evogym", "seed=3"], ["codesign", "search=quick"], ["zoo", "Walker-v0"]):
        assert main([*words, "--cfg", "job"]) == 0
        (tmp_path / "c.yaml").write_text(capsys.readouterr().out)
        command, *given = words
        if command in ("train", "codesign"):
            assert load(command, [f"config={tmp_path / 'c.yaml'}"]) == load(command, given)


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("warpvox tr", {"train"}),
        ("warpvox train ppo.ga", {"ppo.gamma="}),
        ("warpvox codesign search=map", {"search=map_elites"}),
        ("warpvox demo num_e", {"num_envs="}),
        ("warpvox train seed=1 preset=univ", {"preset=universal"}),
        ("warpvox tasks Wal", set()),
    ],
)
def test_a_shell_is_told_how_a_line_goes_on(line: str, expected: set[str], capsys, monkeypatch) -> None:
    monkeypatch.setenv("COMP_LINE", line)
    assert main(["-sc", "query=bash"]) == 0
    assert set(capsys.readouterr().out.split()) == expected


def test_a_request_to_end_while_hydra_composes(monkeypatch, capsys: pytest.CaptureFixture, tmp_path: Path) -> None:
    def compose(*arguments: object) -> None:
        """As OmegaConf does where an interrupt leaves a configuration half built."""
        try:
            signal.raise_signal(signal.SIGTERM)
        finally:
            raise OmegaConfBaseException("half built")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("warpvox.cli.config.composed", compose)
    assert main(["train", "task=Walker-v0"]) == 128 + signal.SIGTERM
    assert capsys.readouterr().err == "warpvox: asked to end (SIGTERM)\n"
