"""Policies as modules and as files: the same actions as in training, and no file is trusted."""

import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from refusals import refused

from warpvox.algos.checkpoints import export
from warpvox.algos.checkpoints.export import read_exported, write_onnx, write_script
from warpvox.algos.checkpoints.files import Controller, PolicySpec, build_actor
from warpvox.algos.checkpoints.policy import parse_policy, policy_of, policy_text
from warpvox.errors import ConfigError, RunError

pytestmark = pytest.mark.filterwarnings("ignore:.*torch.jit.* is deprecated:DeprecationWarning")

ACTIVATIONS = ("tanh", "elu", "relu", "selu", "gelu", "swish")


def make_controller(activation: str = "tanh", normalize: bool = True, hidden: tuple[int, ...] = (8, 6)) -> Controller:
    """A network with random weights that has seen a thousand observations."""
    spec = PolicySpec(5, 3, list(hidden), activation, normalize, action_scale=0.5)
    with torch.random.fork_rng():
        torch.manual_seed(3)
        actor = build_actor(spec)
        actor.train()
        actor.update_normalization({"policy": 2 + 3 * torch.randn(1000, 5)})
    return Controller(actor.eval(), spec)


def some_obs(rows: int = 7) -> torch.Tensor:
    return 2 + 3 * torch.randn((rows, 5), generator=torch.Generator().manual_seed(1), dtype=torch.float64)


@pytest.mark.parametrize("normalize", [True, False])
@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_it_is_the_policy_that_plays(activation: str, normalize: bool) -> None:
    controller, obs = make_controller(activation, normalize), some_obs()
    policy = policy_of(controller)
    torch.testing.assert_close(policy(obs).float(), controller(obs), rtol=0, atol=1e-6)  # which is in float64
    assert torch.equal(torch.jit.script(policy)(obs), policy(obs))
    assert torch.equal(torch.jit.trace(policy, obs[:2])(obs), policy(obs))
    again = parse_policy(policy_text(policy), "here")
    assert torch.equal(again(obs), policy(obs))
    assert torch.equal(again.in_float64()(obs), controller(obs))  # bit for bit what a run of the checkpoint does
    assert again.spec == policy.spec


def test_actions_stay_in_the_range_and_shapes_are_free() -> None:
    policy = policy_of(make_controller())
    far = policy(1e6 * some_obs())
    assert float(far.min()) >= np.float32(0.6)
    assert float(far.max()) <= np.float32(1.6)
    obs = some_obs(6)
    torch.testing.assert_close(policy(obs.view(2, 3, 5)), policy(obs).view(2, 3, 3))
    torch.testing.assert_close(policy(obs[0]), policy(obs)[0])
    acted = policy.act(obs.numpy())
    assert acted.dtype == np.float32
    assert np.array_equal(acted, policy(obs).numpy())
    assert np.array_equal(acted, policy(obs.numpy()))
    for wrong in (obs[:, :4], obs.numpy()[:, :4]):
        with refused(ConfigError, "takes observations [..., 5], got shape [6, 4]"):
            policy(wrong)
    assert not policy(obs).requires_grad
    assert policy.requires_grad_()(obs).requires_grad


@pytest.mark.parametrize("runtime", ["ONNX Runtime", "onnx's reference evaluator"])
def test_onnx_is_checked_and_read_again(tmp_path: Path, runtime: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if runtime == "ONNX Runtime":
        pytest.importorskip("onnxruntime")
    else:
        found = export.find_spec
        monkeypatch.setattr(export, "find_spec", lambda name: None if name == "onnxruntime" else found(name))
    policy, obs = policy_of(make_controller("elu"), {"task": "Walker-v0"}), some_obs()
    assert runtime in write_onnx(policy, tmp_path / "policy.onnx")
    again = read_exported(tmp_path / "policy.onnx")
    assert torch.equal(again(obs), policy(obs))
    assert again.metadata == policy.metadata
    assert [file.name for file in tmp_path.iterdir()] == ["policy.onnx"]  # its weights are in it

    from onnx.reference import ReferenceEvaluator

    evaluator = ReferenceEvaluator(str(tmp_path / "policy.onnx"))
    for rows in (1, 4):
        (actions,) = evaluator.run(["actions"], {"obs": obs[:rows].float().numpy()})
        np.testing.assert_allclose(actions, policy(obs[:rows]).numpy(), atol=export.TOLERANCE, rtol=0)


def test_a_file_that_does_something_else_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    policy = policy_of(make_controller())
    for wrong, words in ((lambda obs: policy(obs) + 1e-3, "differ from the policy's by 0.001"), (torch.sin, "gives")):
        monkeypatch.setattr(torch.jit, "load", lambda path, wrong=wrong: wrong)
        with refused(RunError, "policy.pt is not kept:", words):
            write_script(policy, tmp_path / "policy.pt")
    assert list(tmp_path.iterdir()) == []


def test_the_program_in_a_file_is_never_run(tmp_path: Path) -> None:
    """The card alone is read: an archive whose program is rubbish still gives the policy."""
    policy = policy_of(make_controller(), {"task": "Walker-v0", "design": [[3, 4]]})
    assert write_script(policy, tmp_path / "policy.pt").startswith("within 0.0e+00")
    hollow = tmp_path / "hollow.pt"
    with zipfile.ZipFile(tmp_path / "policy.pt") as whole, zipfile.ZipFile(hollow, "w") as copy:
        for name in whole.namelist():
            copy.writestr(name, whole.read(name) if name.endswith("/extra/warpvox.json") else b"rubbish")
    again = read_exported(hollow)
    assert torch.equal(again(some_obs()), policy(some_obs()))
    assert again.metadata == policy.metadata


def card(**changes: object) -> str:
    return json.dumps(json.loads(policy_text(policy_of(make_controller()))) | changes)


def weights(**changes: object) -> dict:
    return json.loads(card())["weights"] | changes


SPEC = {"num_obs": 5, "num_actions": 3, "hidden": [8, 6], "activation": "tanh", "normalize_obs": True}
SPEC |= {"action_scale": 0.5}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "not valid JSON"),
        (card(version=1), "version 2"),
        (card(version=3), "version 2"),
        (card(policy=None), "no description of the network"),
        (card(weights=[1]), "no weights"),
        (card(weights=weights(mean="AAAA")), "'mean'"),
        (card(weights={"mean": weights()["mean"]}), "of another network"),
        (card(policy=SPEC | {"num_obs": 10**9}), ""),
        (card(policy=SPEC | {"activation": "os.system"}), "holds no policy"),
    ],
)
def test_a_damaged_description_is_refused_in_words(text: str, words: str) -> None:
    with refused(RunError, words):
        parse_policy(text, "file.pt")


def test_other_files_are_not_taken_for_a_policy(tmp_path: Path) -> None:
    whole = io.BytesIO()
    torch.save({"a": torch.zeros(1)}, whole)
    (tmp_path / "model.pt").write_bytes(whole.getvalue())
    assert read_exported(tmp_path / "model.pt") is None
    (tmp_path / "text.pt").write_text("no archive")
    assert read_exported(tmp_path / "text.pt") is None
    (tmp_path / "policy.onnx").write_bytes(b"\xff\xff\xff")
    with pytest.raises(RunError):
        read_exported(tmp_path / "policy.onnx")
    (tmp_path / "policy.onnx").write_bytes(b"")
    with pytest.raises(RunError):
        read_exported(tmp_path / "policy.onnx")
