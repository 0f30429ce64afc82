"""``warpvox train pretrained=``: trainings that begin with the policy of another one."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
import yaml

from warpvox.algos.checkpoints.files import load_checkpoint
from warpvox.cli.commands.train import make_job
from warpvox.cli.config import load

pytestmark = pytest.mark.usefixtures("narrow_packs")
VOXELS = "designs=random:4:3x3", "designs.held_out=random:2:3x3", "policy=grid", "network={width:8}", "lanes=8"
STILL = "ppo.learning_rate=1e-12", "ppo.schedule=fixed", "max_iterations=1", "eval_interval=1"
BODY = "design=[[3,3],[4,0]]"


def weights(run: Path, name: str = "model_best.pt") -> dict[str, torch.Tensor]:
    content = load_checkpoint(run / name)
    found = {
        f"{part}.{key}": value for part in ("actor", "critic") for key, value in content[f"{part}_state_dict"].items()
    }
    # moments of observations go on
    return {key: value for key, value in found.items() if "obs_normalizer" not in key}


def config_of(run: Path) -> dict:
    return yaml.safe_load((run / "config.yaml").read_text(encoding="utf-8"))


RECURRENT = ("ppo.rnn={rnn_type:gru,rnn_hidden_dim:8}",)


ONE = BODY, "policy=grid", "network={width:8}"


@pytest.mark.parametrize("words", [(), RECURRENT, VOXELS, ONE], ids=["mlp", "rnn", "grid", "grid of one body"])
def test_a_training_begins_with_the_networks_of_another(train: Callable, words: tuple[str, ...]) -> None:
    first = train(*words, "max_iterations=2", "ppo.action_scale=0.4")
    given = [word for word in words if word.startswith(("design", "lanes"))]
    second = train("pretrained=latest", *given, *STILL)
    before, after, fresh = weights(first), weights(second), weights(train(*words, *STILL, "seed=5"))
    assert before.keys() == after.keys()
    assert all(torch.allclose(value, after[name], atol=1e-6) for name, value in before.items())
    assert not all(torch.allclose(value, fresh[name], atol=1e-3) for name, value in before.items())
    config = config_of(second)
    assert Path(config["pretrained"]) == (first / "model_best.pt").absolute()
    same = {"policy", "network", "obs"}
    assert {key: config[key] for key in same} == {key: config_of(first)[key] for key in same}
    assert config["ppo"]["action_scale"] == 0.4


def test_a_policy_for_many_bodies_is_tuned_for_one(warpvox: Callable, train: Callable) -> None:
    first = train(*VOXELS, "max_iterations=2")
    second = train("pretrained=latest", BODY, "max_iterations=2", "lanes=8")
    config = config_of(second)
    assert config["designs"]["bodies"] == [[[3, 3], [4, 0]]]
    assert (second / "bodies.csv").is_file()  # it is what the policy is judged on
    assert config["designs"]["grid"] == [3, 3]  # that of the policy
    # nothing depends on the first run any more
    (first / "model_best.pt").unlink()
    (second / "summary.json").unlink()
    warpvox("train", f"resume={second}", "max_iterations=4")
    warpvox("play", f"run={second}", "num_envs=1", "steps=3", "export=[]", "device=cpu")


def test_settings_of_a_network_may_be_written_out(train: Callable) -> None:
    """The default settings by name, some of them, or none, are those of a network that was made without any."""
    train(*(word for word in VOXELS if not word.startswith("network")), "max_iterations=1")
    for words in ("network={}", "network=null", "network={width:16}", "network={heads:16,summary:64,width:16}"):
        config = config_of(train("pretrained=latest", BODY, words, *STILL, "lanes=8"))
        assert config["network"] is None


def test_a_body_takes_the_place_of_those_of_a_preset() -> None:
    assert make_job(load("train", ["preset=universal"]), ["preset"]).settings.designs.bodies == "random:512:5x5"
    job = make_job(load("train", ["preset=universal", "design=worm"]), ["preset", "design"])
    assert (job.settings.designs.bodies, job.settings.design) == (None, "worm")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("policy=mlp", "policy=mlp is not that of the policy in .*: policy=grid"),
        ("ppo.action_scale=0.1", "ppo.action_scale=0.1 is not that of the policy in .*: ppo.action_scale=0.5"),
        ("designs.grid=[4,4]", r"designs.grid=\[4, 4\]: the grid of the pretrained policy is \[3, 3\]"),
        ("network={width:9}", "network={'width': 9, .* is not that of the policy in .*: network={'width': 8, "),
        (
            "task=Thrower-v0 design=mini",
            r"another layout \(rest\): \d+, here it is \d+\. Take the task and bodies that it was trained for",
        ),
        ("design=worm designs=random:3", "design is one body, designs are many for one policy"),
        ("pretrained=zoo:Walker-v0", "robots of the zoo are stored without what it takes to learn on"),
        ("pretrained=nowhere", "There is no run at nowhere"),
    ],
)
def test_what_does_not_go_with_the_policy_is_refused(warpvox, train: Callable, words: str, message: str) -> None:
    run = train(*VOXELS, "max_iterations=1")
    words = words.split() if "pretrained" in words else ["pretrained=latest", *words.split()]
    outcome = warpvox("train", *words, "num_envs=4", "max_iterations=1", "device=cpu", fails="")
    assert re.search(message, " ".join(outcome.err.split()))
    assert list(Path("outputs/train/Walker-v0").iterdir()) == [run]  # nothing was written
