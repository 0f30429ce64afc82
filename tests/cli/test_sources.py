"""Policies and bodies by all their names: every form of it means the same wherever one is taken."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from episodes import short_episodes

import warpvox as wv
from warpvox.algos.codesign.robots import read_start
from warpvox.algos.robots import Robot, save_robot

KEYS = {"design": "mini", "num_envs": 8, "threads": 1, "device": "cpu", "max_iterations": 2, "eval_interval": 1}
PPO = {"steps": 4, "hidden": [8], "epochs": 1}
SMALL = {"device": "cpu", "threads": 1}
EXACT = SMALL | {"dtype": "float64"}  # in which returns do not depend on what is in a batch
TRAINING = {"envs": 8, "iterations": 1, "eval_interval": 1, "ppo": {"steps": 4, "hidden": [8], "epochs": 1}}


@pytest.fixture(scope="module", autouse=True)
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """An empty folder to work in, and episodes of a few steps."""
    folder = tmp_path_factory.mktemp("sources")
    with pytest.MonkeyPatch.context() as patch, short_episodes("Walker-v0", "Catcher-v0", "Thrower-v0", steps=30):
        patch.chdir(folder)
        yield folder


@pytest.fixture(scope="module")
def made(place: Path) -> SimpleNamespace:
    """A training and a search with finalists."""
    run = wv.train("Walker-v0", **(KEYS | {"dtype": "float64"}), ppo=PPO, folder="run", progress=False)
    unwritten = wv.train("Walker-v0", **(KEYS | {"dtype": "float64"}), ppo=PPO, folder=None, progress=False)
    found = wv.codesign(
        "Walker-v0", (3, 3), search=wv.GA(population=3, max_designs=3), dtype="float64", training=TRAINING,
        fitness=wv.Gaits(gaits=2, rounds=1, finalists=1, final_rounds=1, final_gaits=2, final_passes=0),
        folder="search", progress=False, **SMALL,
    )  # fmt: skip
    return SimpleNamespace(run=run, unwritten=unwritten, found=found)


def forms(made: SimpleNamespace, kind: str) -> dict[str, Any]:
    """All forms of the policy of a training, of the best design of a search, or of a robot of the zoo."""
    if kind == "training":
        return {
            "object": made.run,
            "without a folder": made.unwritten,
            "folder": made.run.folder,
            "text": str(made.run.folder),
            "checkpoint": made.run.folder / "model_best.pt",
            "policy": made.run.policy,
            "loaded": wv.load_policy(made.run),
        }
    if kind == "search":
        best = made.found.best
        return {
            "object": made.found,
            "record": best,
            "folder": made.found.folder,
            "folder of the design": made.found.folder / "designs" / str(best.id),
            "policy": made.found.policy,
            "loaded": wv.load_policy(best),
        }
    name = f"zoo:{kind}"
    return {"text": name, "object": wv.zoo(kind), "loaded": wv.load_policy(name), "twice": wv.load_policy(wv.zoo(kind))}


def functions(policy: Any) -> dict[str, Any]:
    """Functions of a user's own that act as ``policy`` does."""
    exact = policy.in_float64()

    class Acting:
        def act(self, obs: Any) -> Any:
            return exact(obs)

    class ActingModule(torch.nn.Module):
        def act(self, obs: Any) -> Any:
            return exact(obs)

    return {"function": lambda obs: exact(obs), "object with act": Acting(), "module with act": ActingModule()}


@pytest.mark.parametrize("kind", ["training", "search", "Walker-v0", "Catcher-v0", "Thrower-v0"])
def test_every_form_of_a_policy_has_the_same_returns_everywhere(made: SimpleNamespace, kind: str) -> None:
    several = forms(made, kind)
    own = functions(wv.load_policy(several["object"]))
    about = wv.load_policy(several["object"]).metadata
    task, obs = about["task"], about["obs"]
    returns = {}
    for name, policy in (several | own).items():
        how: dict[str, Any] = {"episodes": 1, **SMALL}
        if name in own:
            how |= {"task": task, "design": several["object"], "obs": obs, "dtype": "float64"}
        for step, one in (("given", policy), ("loaded", wv.load_policy(policy))):
            (row,) = wv.evaluate(one, **how)
            returns[name, step, "evaluate"] = row.mean
            env = wv.make_vec(task, several["object"], 1, obs=obs, seed=1000, auto_reset=False, **EXACT)
            returns[name, step, "record"] = float(wv.record(env, one).rewards.sum())
    assert returns == dict.fromkeys(returns, pytest.approx(returns["object", "given", "evaluate"], abs=1e-12))
    table = wv.evaluate(list(several.values()), episodes=1, **SMALL)
    assert len(table) == len(several)


def test_a_policy_that_was_loaded_is_computed_as_its_run(place: Path) -> None:
    """In float32, where rounding depends on how many environments a thread advances at once."""
    run = wv.train("Walker-v0", **(KEYS | {"num_envs": 16}), ppo=PPO, folder="fast", progress=False)
    (one,) = wv.evaluate(run.folder, episodes=1, **SMALL)
    (other,) = wv.evaluate(run.policy, episodes=1, **SMALL)
    assert one.returns == other.returns


def test_episodes_of_a_stored_robot_are_those_of_its_name() -> None:
    """In a task that draws at random, in disturbed episodes too."""
    for protocol in ("nominal", "noise"):
        how = {"episodes": 2, "protocol": protocol, **SMALL}
        rows = [wv.evaluate(one, **how)[0].returns for one in forms(SimpleNamespace(), "Catcher-v0").values()]
        assert all(row == rows[0] for row in rows)
        assert len(set(rows[0])) == 2


def test_a_trained_robot_that_was_changed_acts_as_it_is_now() -> None:
    policy = wv.load_policy("zoo:Walker-v0")
    with torch.no_grad():
        policy.network.mlp[-1].weight.mul_(0)
    env = wv.make_vec("Walker-v0", policy, 1, **EXACT)
    assert wv.record(env, policy).rewards.sum() != wv.record(env, "zoo:Walker-v0").rewards.sum()


def test_a_policy_that_observes_the_time_needs_environments_that_tell_it(made: SimpleNamespace) -> None:
    env = wv.make_vec("Walker-v0", made.run, 1, **EXACT)
    with pytest.raises(wv.ConfigError):
        wv.record(env, wv.zoo("Thrower-v0"))


# ---- bodies


def bodies(made: SimpleNamespace) -> dict[str, tuple[Any, np.ndarray]]:
    """Forms of bodies, with the body that each stands for."""
    several: dict[str, tuple[Any, np.ndarray]] = {}
    best = made.found.best.candidate.body
    known = {"training": wv.example_design("mini"), "search": best, "Walker-v0": wv.zoo("Walker-v0").body}
    for kind, body in known.items():
        several |= {f"{name} of {kind}": (form, body) for name, form in forms(made, kind).items()}
    return several


def in_gymnasium(form: Any) -> Any:
    return gymnasium.make("warpvox/Walker-v0", body=form).unwrapped.body


def in_training(form: Any) -> Any:
    return np.array(wv.train(**KEYS | {"design": form}, ppo=PPO, folder=None, progress=False).policy.metadata["design"])


def in_new_bodies(form: Any) -> Any:
    env = wv.make_vec("Walker-v0", "mini", 1, grid=(5, 5), **SMALL)
    env.set_designs(form, np.ones(1, bool))
    return env.designs[0]


def in_file(form: Any) -> Any:
    return wv.load_design(wv.save_design("saved.json", wv.load_design(form)))


DOORS: dict[str, Callable[[Any], Any]] = {
    "load_design": wv.load_design,
    "save_design": in_file,
    "designs=": lambda form: wv.make_vec("Walker-v0", form, 1, **SMALL).designs[0],
    "designs=[]": lambda form: wv.make_vec("Walker-v0", [form, "mini"], 2, **SMALL).designs[0],
    "body=": lambda form: wv.make_vec("Walker-v0", body=form, **SMALL).designs[0],
    "set_designs": in_new_bodies,
    "gymnasium": in_gymnasium,
    "start": lambda form: read_start(wv.Codesign(start=[form]))[0].body,
    "one start": lambda form: read_start(wv.Codesign(start=form))[0].body,
}


@pytest.mark.parametrize("door", DOORS)
def test_every_form_of_a_body_is_that_body_everywhere(made: SimpleNamespace, door: str) -> None:
    for name, (form, body) in bodies(made).items():
        assert np.array_equal(DOORS[door](form), body), name


def test_a_training_takes_every_form_of_a_body(made: SimpleNamespace) -> None:
    several = bodies(made)
    assert np.array_equal(in_training(made.found), several["object of search"][1])
    assert np.array_equal(in_training(str(made.run.folder)), several["object of training"][1])
    for name, (form, body) in several.items():
        plain = wv.Training(design=form, designs=[form, "walker"])
        assert np.array_equal(wv.load_design(plain.design), body), name
        assert np.array_equal(wv.load_design(plain.designs.bodies[0]), body), name


def test_a_search_begins_with_a_robot_as_with_its_name(place: Path, made: SimpleNamespace) -> None:
    """With its gait, too, which ``fitness=gaits`` goes on from."""
    for robot, name in ((wv.zoo("Thrower-v0"), "zoo:Thrower-v0"), (made.found, "search"), (made.found.best, "search")):
        one, other = (read_start(wv.Codesign(start=[form]))[0] for form in (robot, name))
        assert one.sha256 == other.sha256
        assert one.policy is not None
    changed = replace(wv.zoo("Thrower-v0"), policy=None)
    with pytest.raises(wv.ConfigError):
        wv.Codesign(start=[changed])
    path = save_robot("own.npz", changed)
    assert read_start(wv.Codesign(start=[wv.zoo(path)]))[0].policy is None


def test_a_body_that_a_design_cannot_say_is_refused(place: Path) -> None:
    whole = wv.zoo("Thrower-v0")  # whose policy observes the time alone
    cut = Robot(whole.task, whole.body, whole.connections[:, 1:], whole.policy)
    for door in ("load_design", "designs=", "body=", "gymnasium", "start"):
        with pytest.raises((wv.DesignError, wv.ConfigError)):
            DOORS[door](cut)
    with pytest.raises(wv.DesignError):
        wv.Training(design=cut)
    rows = [wv.evaluate(one, episodes=1, **SMALL)[0].returns for one in (cut, wv.load_policy(cut))]
    assert rows[0] == rows[1]


def test_runs_without_a_body_of_their_own_are_named(place: Path) -> None:
    many = KEYS | {"design": None, "designs": ["mini", "walker"], "policy": "grid", "network": {"width": 8}}
    run = wv.train(**many, ppo=PPO, folder="many", progress=False)
    for form in (run.folder, str(run.folder)):
        with pytest.raises(wv.DesignError):
            wv.load_design(form)
    with pytest.raises(wv.DesignError):
        wv.load_design(run)
    Path("broken").mkdir()
    Path("broken/config.yaml").write_text("design: [[3")
    with pytest.raises(wv.DesignError):
        wv.load_design("broken")
    with pytest.raises(wv.DesignError):
        wv.load_design("x" * 5000)
