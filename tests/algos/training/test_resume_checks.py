"""States of trainings are compared with what takes them over: damaged states give one sentence, and never a crash."""

import copy
import random
import zipfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import torch
from learning import ppo_settings, small_env
from sample_files import checkpoint_content

from warpvox.algos.checkpoints.files import save_checkpoint
from warpvox.algos.checkpoints.policy import read_policy
from warpvox.algos.settings import Ppo
from warpvox.algos.training.runner import Runner, Schedule, adapt
from warpvox.errors import RunError, WarpvoxError
from warpvox.runs import STATE

RND = {"rnd_cfg": {"num_outputs": 2, "reward_normalization": True, "weight": 0.1}}
SIZES = {"predictor_hidden_dims": [4], "target_hidden_dims": [4]}
KINDS = {
    "mlp": {"normalize_reward": True},
    "recurrent": {"minibatches": 1, "rnn": {"rnn_hidden_dim": 4}, "extra": {"rnd_cfg": RND["rnd_cfg"] | SIZES}},
}
MUTATIONS = 15

pytestmark = pytest.mark.usefixtures("one_thread")


def make_runner(kind: str) -> Runner:
    ppo: Ppo = ppo_settings(**copy.deepcopy(KINDS[kind]))
    return Runner(adapt(small_env(max_episode_steps=14), ppo), ppo, Schedule(9, 100, 100))


@pytest.fixture(scope="module", params=list(KINDS))
def state(request: pytest.FixtureRequest) -> tuple[str, dict[str, Any]]:
    runner = make_runner(request.param)
    runner.learn(1)
    return request.param, runner.state()


def places(content: Any, place: tuple = ()) -> Iterator[tuple]:
    """Where there is anything in dictionaries and lists."""
    if place:
        yield place
    inside = content.items() if isinstance(content, Mapping) else ()
    inside = enumerate(content) if isinstance(content, list | tuple) else inside
    for key, value in inside:
        yield from places(value, (*place, key))


def changed(content: Any, place: tuple, change: Callable[[Any], Any]) -> Any:
    """A copy with something else at a place."""
    if not place:
        return change(content)
    if isinstance(content, Mapping):
        return {**content, place[0]: changed(content[place[0]], place[1:], change)}
    several = list(content)
    several[place[0]] = changed(several[place[0]], place[1:], change)
    return type(content)(several)


def another(value: Any, chance: random.Random) -> Any:
    """Something else in the place of a value."""
    others: list[Any] = [None, -1, 10**30, 1.5, float("nan"), "x", [], {}, [[]], True, torch.zeros(3), torch.zeros(0)]
    if isinstance(value, torch.Tensor):
        flat = value.flatten()
        others += [flat[:0], flat[:1], value.long(), value.double(), value.unsqueeze(0), torch.full_like(value, 99)]
        others += [flat[:1].expand(value.numel()).view(value.shape)] if value.numel() else []
        others += [value.to_sparse()] if value.ndim else []
        others += [torch.full_like(value, float("nan"))] if value.is_floating_point() else []
    elif isinstance(value, Mapping):
        others += [{**value, "more": 1}, {str(key): one for key, one in value.items()}, list(value)]
    elif isinstance(value, list | tuple):
        others += [list(value) * 2, value[:-1], [*value, value]]
    return chance.choice(others)


def resumed(kind: str, path: Path) -> None:
    """Go on for an iteration."""
    runner = make_runner(kind)
    runner.resume(path)
    runner.learn(1)


def test_a_damaged_state_gives_a_sentence(state: tuple[str, dict[str, Any]], tmp_path: Path) -> None:
    kind, content = state
    chance, by_part = random.Random(kind), {}
    for place in places(content):
        by_part.setdefault(place[:2], []).append(place)
    said = []
    for _ in range(MUTATIONS):
        place = chance.choice(by_part[chance.choice(list(by_part))])
        save_checkpoint(tmp_path / STATE, changed(content, place, lambda value: another(value, chance)))
        try:
            resumed(kind, tmp_path / STATE)
        except WarpvoxError as error:
            said.append(str(error))
    assert len(said) > MUTATIONS // 2
    assert not [text for text in said if "\n" in text]


@pytest.mark.parametrize("name", ["exp_avg", "exp_avg_sq", "step"])
@pytest.mark.parametrize("change", ["short", "missing", "long", "of another type", "infinite"])
def test_moments_are_those_of_the_parameters(
    state: tuple[str, dict[str, Any]], tmp_path: Path, name: str, change: str
) -> None:
    kind, content = state
    content = copy.deepcopy(content)
    entry = content["optimizer_state_dict"]["state"][1]
    changes = {
        "short": torch.zeros(3),
        "long": torch.zeros(10_000),
        "of another type": entry[name].half(),
        "infinite": entry[name] + float("inf"),
    }
    entry |= {name: changes.get(change)}
    if change == "missing":
        del entry[name]
    save_checkpoint(tmp_path / STATE, content)
    with pytest.raises(RunError, match=rf"optimizer_state_dict.state.1.{name}"):
        resumed(kind, tmp_path / STATE)
    with pytest.raises(RunError, match=rf"optimizer_state_dict.state.1.{name}"):
        make_runner(kind).begin_with(content, optimizer=True)


@pytest.mark.parametrize("layout", ["one number", "transposed"])
def test_moments_may_be_views(state: tuple[str, dict[str, Any]], tmp_path: Path, layout: str) -> None:
    """torch's Adam takes a tensor's numbers to lie in order, from its first one on."""
    kind, content = state
    weights = []
    for is_view in (True, False):
        content = copy.deepcopy(content)
        for entry in content["optimizer_state_dict"]["state"].values():
            for name in ("exp_avg", "exp_avg_sq"):
                value = entry[name]
                view = value.mT.contiguous().mT if value.ndim == 2 else value
                if layout == "one number":
                    view = torch.zeros(value.numel()).as_strided(value.shape, [0] * value.ndim, value.numel() - 1)
                entry[name] = view if is_view else view.clone(memory_format=torch.contiguous_format)
        save_checkpoint(tmp_path / STATE, content)
        runner = make_runner(kind)
        runner.resume(tmp_path / STATE)
        runner.learn(1)
        weights.append(runner.alg.actor.state_dict())
    for name, value in weights[0].items():
        assert torch.equal(value, weights[1][name]), name


def test_settings_of_an_optimiser_are_those_of_the_training(state: tuple[str, dict[str, Any]], tmp_path: Path) -> None:
    kind, content = state
    content = copy.deepcopy(content)
    group = content["optimizer_state_dict"]["param_groups"][0]
    group |= {"betas": (0.5,), "weight_decay": 9.0, "amsgrad": True, "params": [7]}
    save_checkpoint(tmp_path / STATE, content)
    runner = make_runner(kind)
    wanted = {key: value for key, value in runner.alg.optimizer.param_groups[0].items() if key not in ("lr", "params")}
    runner.resume(tmp_path / STATE)
    assert {key: runner.alg.optimizer.param_groups[0][key] for key in wanted} == wanted
    assert runner.alg.learning_rate == group["lr"]


def test_files_do_not_unpack_to_more_than_they_are(tmp_path: Path) -> None:
    good = tmp_path / "good.pt"
    save_checkpoint(good, checkpoint_content())
    read_policy(good)
    with zipfile.ZipFile(good) as file:
        entries = {name: file.read(name) for name in file.namelist()}

    def write(name: str, method: int = zipfile.ZIP_STORED, more: int = 0) -> Path:
        with zipfile.ZipFile(tmp_path / name, "w", method) as file:
            for entry, value in entries.items():
                file.writestr(entry, value)
            for number in range(more):
                file.writestr(f"archive/more/{number}", b"")
        return tmp_path / name

    claims = bytearray(write("claims.pt").read_bytes())
    place = claims.find(b"PK\x01\x02")
    claims[place + 24 : place + 28] = (2**31).to_bytes(4, "little")  # the length of the first entry, unpacked
    (tmp_path / "claims.pt").write_bytes(claims)
    read_policy(write("again.pt"))
    refused = {"packed.pt": "packed", "many.pt": "entries", "claims.pt": "unpacks"}
    write("packed.pt", zipfile.ZIP_DEFLATED)
    write("many.pt", more=(1 << 16) + 1)
    for name, words in refused.items():
        with pytest.raises(RunError, match=words):
            read_policy(tmp_path / name)


@pytest.mark.parametrize("kind", ["hidden", "rnn", "transformer"])
def test_a_network_has_some_hundred_layers_at_most(tmp_path: Path, kind: str) -> None:
    content = copy.deepcopy(checkpoint_content())
    policy = content["policy"]
    if kind == "hidden":
        policy["hidden"] = [1] * 300_000
    elif kind == "rnn":
        policy["rnn"] = {"rnn_type": "gru", "rnn_hidden_dim": 4, "rnn_num_layers": 60_000}
    else:
        layout = {"rows": 2, "columns": 2, "rest": 6, "actions": 4}
        policy["voxels"] = {"network": kind, "settings": {"layers": 10**6}, "layout": layout}
    save_checkpoint(tmp_path / "deep.pt", content)
    with pytest.raises(RunError):
        read_policy(tmp_path / "deep.pt")
