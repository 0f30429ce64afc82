"""Arguments from Python that cannot be meant: one sentence that names them, before anything is made."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from refusals import refused

import warpvox as wv
from warpvox.envs.vec_env import VoxelVecEnv

MANY = np.zeros(3)
ROBOT = "zoo:Walker-v0"


def env() -> VoxelVecEnv:
    return wv.make_vec("Walker-v0", "mini", 1, device="cpu")


CASES: dict[str, tuple[Callable[[], object], str]] = {
    # Of the wrong kind
    "folder list": (lambda: wv.train("Walker-v0", "mini", folder=["a"]), "folder"),
    "folder null": (lambda: wv.train("Walker-v0", "mini", folder="a\0b"), "a\\x00b"),
    "output_dir null": (lambda: wv.train("Walker-v0", "mini", output_dir="a\0b"), "a\\x00b"),
    "designs": (lambda: wv.train("Walker-v0", designs={1: 2}, folder=None), "designs"),
    "progress": (lambda: wv.train("Walker-v0", "mini", folder=None, progress=MANY), "progress"),
    "design": (lambda: wv.train("Walker-v0", object()), "design cannot be a object"),
    "ppo": (lambda: wv.train("Walker-v0", ppo=3), "got 3"),
    "sim": (lambda: wv.train("Walker-v0", sim={"device": "cpu"}), "SimOptions(device=..., ...)"),
    "arithmetic": (lambda: wv.evaluate(ROBOT, arithmetic=MANY), "arithmetic"),
    "evaluated policy": (lambda: wv.evaluate(len), "must be a run, or a function"),
    "evaluated number": (lambda: wv.evaluate(3), "must be a run"),
    "evaluated class": (lambda: wv.evaluate(wv.World), "must be a run"),
    "evaluated function": (lambda: wv.evaluate(wv.zoo), "task=... and design="),
    "episodes": (lambda: wv.evaluate(ROBOT, episodes=1.5), "episodes must be an integer, got 1.5"),
    "evaluated seed": (lambda: wv.evaluate(ROBOT, seed="a"), "seed must be an integer, got 'a'"),
    "stochastic": (lambda: wv.evaluate(ROBOT, stochastic="false"), "true or false, got 'false'"),
    "dtype": (lambda: wv.make_vec("Walker-v0", "mini", 2, dtype=MANY), "dtype"),
    "policy": (lambda: wv.record(env(), np.int64(2)), "must be a run"),
    "metadata": (lambda: wv.record(env(), metadata="@x"), "metadata"),
    "source list": (lambda: wv.load_policy(["a"]), "['a']"),
    "source null": (lambda: wv.load_policy("a\0b"), "a\\x00b"),
    "code": (lambda: wv.load_policy(ROBOT, policy=[1]), "policy"),
    "executor": (lambda: wv.codesign("Walker-v0", executor=1.5, folder=None), "1.5"),
    "search folder": (lambda: wv.codesign("Walker-v0", folder=["a"]), "folder"),
    "search null": (lambda: wv.codesign("Walker-v0", folder="a\0b"), "a\\x00b"),
    "search class": (lambda: wv.codesign(search=wv.GA), "asks and tells"),
    "search evaluation": (lambda: wv.codesign(fitness=3), "a method evaluate"),
    "listeners": (lambda: wv.codesign("Walker-v0", listeners=[1], folder=None), "listeners"),
    "iterations": (lambda: wv.codesign(training={"iterations": "many"}), "training.iterations must be an integer"),
    "robot": (lambda: wv.zoo(["a"]), "['a']"),
    # Names that do not exist
    "task": (lambda: wv.train("Waker-v0"), "'Walker-v0'"),
    "key of ppo": (lambda: wv.train(ppo={"step": 4}), "Did you mean 'steps'"),
    "set of ppo": (lambda: wv.train(ppo="evogim"), "Did you mean 'evogym'"),
    "key of evaluate": (lambda: wv.evaluate(ROBOT, episods=3), "Did you mean 'episodes'"),
    "no run": (lambda: wv.evaluate("nowhere"), "no run at nowhere"),
    "policy nowhere": (lambda: wv.load_policy("nowhere"), "no run at nowhere"),
    "robot of the zoo": (lambda: wv.evaluate("zoo:Waker-v0"), "Did you mean 'Walker-v0'"),
    "agent": (lambda: wv.record(env(), "sin"), "Did you mean 'sine'"),
    "recorded robot": (lambda: wv.record(env(), "zoo:Wlker-v0"), "'Walker-v0'"),
    "search": (lambda: wv.codesign(search="gaa"), "Did you mean 'ga'"),
    "evaluation": (lambda: wv.codesign(fitness="specialst"), "Did you mean 'specialist'"),
    "body": (lambda: wv.train("Walker-v0", body="wlker", folder=None), "Did you mean 'walker'"),
    "body twice": (lambda: wv.train("Walker-v0", "mini", body="mini"), "two names of one argument"),
    "body of settings": (lambda: wv.Training(body=object()), "design cannot be"),
    "design of environments": (lambda: wv.make_vec("Walker-v0", design="walkr"), "Did you mean 'walker'"),
    "population": (lambda: wv.codesign(population=3), ": search=wv.GA(population=...)"),
    "rounds": (lambda: wv.codesign(rounds=3), ": fitness=wv.Gaits(rounds=...)"),
    "generations": (lambda: wv.codesign(generations=3), ": search=wv.GA(max_designs=...)"),
    "learning rate": (lambda: wv.train(learning_rate=1e-3), ": ppo=wv.Ppo(learning_rate=...)"),
    "rate of a search": (lambda: wv.codesign(lr=1), ": training=wv.DesignTraining(ppo=wv.Ppo(learning_rate=...))"),
    "gravity": (lambda: wv.train(gravity=1), ": physics={'gravity': ...}"),
    "envs of an evaluation": (lambda: wv.Specialist(envs=16), "It is a setting of wv.DesignTraining"),
    "place of a setting": (lambda: wv.GA(25), "GA takes settings by name, GA(population=...)"),
    "search resumed": (lambda: wv.codesign(resume="mine"), "goes on when it is called again with folder="),
    "limit of designs": (lambda: wv.GA(max_evaluations=0), "search.max_designs must be at least 1"),
    "limit as mapping": (lambda: wv.codesign(search={"algorithm": "ga", "max_designs": 0}), "at least 1"),
    "steps": (lambda: wv.record(env(), "zero", steps=0), "num_steps"),
    "key of record": (lambda: wv.record(env(), agent="zero"), "It takes env, policy, num_steps, metadata"),
    "key of codesign": (lambda: wv.codesign(sead=3), "Did you mean 'seed'"),
    "key of gaits": (lambda: wv.codesign(fitness={"name": "gaits", "round": 3}), "Did you mean 'rounds'"),
    # Values that are out of range, or do not go together
    "latest": (lambda: wv.train("Walker-v0", folder="latest"), "'latest'"),
    "layout": (lambda: wv.train("Walker-v0", sim=wv.SimOptions(layout="group")), "sim.layout cannot be given"),
    "no policies": (lambda: wv.evaluate([]), "policies=[] names none"),
    "no episodes": (lambda: wv.evaluate(ROBOT, episodes=0), "episodes must be at least 1, got 0"),
    "level": (lambda: wv.evaluate(ROBOT, level=95), "level must be at most 0.9999, got 95"),
    "negative seed": (lambda: wv.evaluate(ROBOT, seed=-1), "seed must be at least 0, got -1"),
    "no chance": (lambda: wv.evaluate(ROBOT, stochastic=True), "stochastic=true goes with a run"),
    "task of a robot": (lambda: wv.evaluate([ROBOT], task="Climber-v0"), "task='Climber-v0'"),
    "body of a robot": (lambda: wv.evaluate(ROBOT, design="worm"), "Other bodies go with a run over many of them"),
    "seed of a search": (lambda: wv.codesign(seed=-1), "seed must be at least 0"),
    "inherited gaits": (
        lambda: wv.codesign(fitness=wv.Gaits(), training={"inherit": True}),
        "training.inherit does not go with",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_one_sentence_and_nothing_written(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    call, named = CASES[name]
    with refused(wv.WarpvoxError, named):
        call()
    assert not list(tmp_path.iterdir())
