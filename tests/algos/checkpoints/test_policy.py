"""Policies as modules and as files: the same actions as in training, and no file is trusted."""

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from refusals import refused

from warpvox.algos.checkpoints import export
from warpvox.algos.checkpoints.export import read_exported, write_onnx, write_script
from warpvox.algos.checkpoints.files import PolicySpec, build_actor
from warpvox.algos.checkpoints.policy import Policy, policy_bytes, read_policy
from warpvox.errors import ConfigError, RunError

pytestmark = pytest.mark.filterwarnings("ignore:.*torch.jit.* is deprecated:DeprecationWarning")

ACTIVATIONS = ("tanh", "elu", "relu", "selu", "gelu", "swish")


def make_actor(activation: str = "tanh", normalize: bool = True, hidden: tuple[int, ...] = (8, 6)) -> Any:
    """rsl-rl's network with random weights that has seen a thousand observations, and its description."""
    spec = PolicySpec(5, 3, list(hidden), activation, normalize, action_scale=0.5)
    with torch.random.fork_rng():
        torch.manual_seed(3)
        actor = build_actor(spec)
        actor.train()
        actor.update_normalization({"policy": 2 + 3 * torch.randn(1000, 5)})
    return actor.eval(), spec


def make_policy(activation: str = "tanh", **metadata: Any) -> Policy:
    actor, spec = make_actor(activation)
    return Policy(spec, actor.state_dict(), metadata)


def some_obs(rows: int = 7) -> torch.Tensor:
    return 2 + 3 * torch.randn((rows, 5), generator=torch.Generator().manual_seed(1), dtype=torch.float64)


@pytest.mark.parametrize("normalize", [True, False])
@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_it_is_the_policy_that_plays(activation: str, normalize: bool, tmp_path: Path) -> None:
    actor, spec = make_actor(activation, normalize)
    obs = some_obs()
    policy = Policy(spec, actor.state_dict())
    with torch.no_grad():
        expected = (1.1 + 0.5 * actor.double()({"policy": obs}).float()).clamp(0.6, 1.6)
    assert torch.equal(policy.in_float64()(obs), expected)
    torch.testing.assert_close(policy(obs), expected, rtol=0, atol=1e-6)
    assert torch.equal(torch.jit.script(policy)(obs), policy(obs))
    assert torch.equal(torch.jit.trace(policy, obs[:2])(obs), policy(obs))
    (tmp_path / "policy.pt").write_bytes(policy_bytes(policy))
    again = read_policy(tmp_path / "policy.pt")
    assert torch.equal(again(obs), policy(obs))
    assert torch.equal(again.in_float64()(obs), expected)
    assert again.spec == policy.spec


def test_actions_stay_in_the_range_and_shapes_are_free() -> None:
    policy = make_policy()
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
    policy, obs = make_policy("elu", task="Walker-v0"), some_obs()
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
    policy = make_policy()
    for wrong, words in ((lambda obs: policy(obs) + 1e-3, "differ from the policy's by 0.001"), (torch.sin, "gives")):
        monkeypatch.setattr(torch.jit, "load", lambda path, wrong=wrong: wrong)
        with refused(RunError, "policy.pt is not kept:", words):
            write_script(policy, tmp_path / "policy.pt")
    assert list(tmp_path.iterdir()) == []


def test_the_program_in_a_file_is_never_run(tmp_path: Path) -> None:
    """The card alone is read: an archive whose program is rubbish still gives the policy."""
    policy = make_policy(task="Walker-v0", design=[[3, 4]])
    assert write_script(policy, tmp_path / "policy.pt").startswith("within 0.0e+00")
    hollow = tmp_path / "hollow.pt"
    with zipfile.ZipFile(tmp_path / "policy.pt") as whole, zipfile.ZipFile(hollow, "w") as copy:
        for name in whole.namelist():
            copy.writestr(name, whole.read(name) if name.endswith("/extra/warpvox.pt") else b"rubbish")
    again = read_exported(hollow)
    assert torch.equal(again(some_obs()), policy(some_obs()))
    assert again.metadata == policy.metadata


SPEC = {"num_obs": 5, "num_actions": 3, "hidden": [8, 6], "activation": "tanh", "normalize_obs": True}
SPEC |= {"action_scale": 0.5}


@pytest.mark.parametrize(
    "changes",
    [
        {"policy": None},
        {"policy": SPEC | {"num_obs": 10**9}},
        {"policy": SPEC | {"activation": "os.system"}},
        {"policy": SPEC | {"action_center": "1"}},
        {"policy": SPEC | {"hidden": [8, 7]}},
        {"actor_state_dict": [1]},
        {"actor_state_dict": {"mlp.0.bias": torch.zeros(8)}},
        {"metadata": [1]},
    ],
)
def test_a_damaged_description_is_refused(changes: dict, tmp_path: Path) -> None:
    file = tmp_path / "policy.pt"
    whole = torch.load(io.BytesIO(policy_bytes(make_policy())), weights_only=True)
    torch.save(whole | changes, file)
    with pytest.raises(RunError, match=r"policy\.pt"):
        read_policy(file)


def test_files_of_the_first_version_say_how_to_replace_them(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "policy.pt", "w") as archive:
        archive.writestr("policy/extra/warpvox.json", "{}")
    with pytest.raises(RunError, match=r"0\.1\.0: export the policy again"):
        read_exported(tmp_path / "policy.pt")


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
