"""Every mistake gets one clear line and exit code 2, and leaves nothing behind."""

from collections.abc import Callable
from pathlib import Path

import pytest
import torch

MISTAKES = {
    "trian": "Did you mean 'train'",
    "train task=Walkr-v0": "Did you mean 'Walker-v0'",
    "train task=null": "task must be text, got None",
    "train design=walkr": "Did you mean 'walker'",
    "train design=[[0,0],[0,0]]": "empty",
    "train design=nothing.json": "nothing.json",
    "train design=5": "design must be",
    "train task=Climber-v0 design=random:12x12": "does not fit",
    "train device=gpu": "valid are 'auto', 'cpu'",
    "train device=cuda:63": "not available",
    "train sede=1": "Did you mean 'seed'",
    "train gravity=1": "Did you mean 'physics.gravity'",
    "train ppo.gama=1": "Did you mean 'ppo.gamma'",
    "train lr=1": "Did you mean 'ppo.learning_rate'",
    "train ppo.lr=1": "Did you mean 'ppo.learning_rate'",
    "train env=Walker-v0": "Did you mean 'task'",
    "train total_timesteps=1000": "Did you mean 'max_iterations'",
    "train n_envs=4": "Did you mean 'num_envs'",
    "train batch_size=64": "Did you mean 'ppo.minibatches'",
    "curves out=a.png": "Did you mean 'file'",
    "codesign lr=1": "Did you mean 'training.ppo.learning_rate'",
    "train num_envs=3 design=mini lanes=8 threads=1 ppo.minibatches=100": "environments make 48 in 16 steps",
    "train -m hydra.launcher._target_=os.system": "chosen by name, such as hydra/launcher=joblib",
    "train +extra=1": "cannot be added",
    "train ~seed": "cannot be added or removed",
    "train hydra.run.dir=x": "Unknown key",
    "train seed": "not KEY=VALUE",
    "train design=[[1,2": "not KEY=VALUE",
    "train seed=1 seed=2": "more than once",
    "train seed=1,2": "add --multirun",
    "train -m seed=interval(0,1)": "range",
    "train -m seed=1,2 task=Walker-v0,Wolker-v0": "Did you mean 'Walker-v0'",
    "train num_envs=abc": "num_envs must be an integer, got 'abc'",
    "train num_envs=0": "at least 1",
    "train num_envs=3 design=[mini,worm]": "multiple of the number of designs",
    "train physics=papr": "Did you mean 'paper'",
    "train physics.gravity=-1": ">= 0",
    "train rules=papers": "Did you mean 'paper'",
    "train ppo=evogm": "Did you mean 'evogym'",
    "train ppo.schedule=lin": "fixed, linear, adaptive",
    "train ppo.hidden=[0]": "at least 1",
    "train ppo.gamma=1.5": "at most 1",
    "train name=a/b": "letters, digits",
    "train --foo": "Unknown option",
    "train --cfg hydra sede=1": "Did you mean 'seed'",
    "train --info all preset=papr": "Did you mean 'paper'",
    "train --cfg all config=run": "which config=FILE is no part of",
    "train -m seed=1,2 hydra/launcher=basic task=Walkr-v0": "Did you mean 'Walker-v0'",
    "train --cfg=jub": "-c/--cfg: invalid choice: 'jub' (choose from",
    "train --cfg seed=1": "-c/--cfg: invalid choice: 'seed=1' (choose from",
    "train seed=1 hydra/launcher=joblib": "about sweeps: add --multirun",
    "train -m seed=1,2 hydra/launcher=nowhere": "hydra/launcher must be one of basic, got 'nowhere'",
    "-sc install=csh": "bash fish zsh",
    "train --config-dir nowhere": "existing folder",
    "train output_dir=/proc/nowhere num_envs=1 design=mini lanes=8 threads=1": "it cannot be created there",
    "train resume=latest": "no run",
    "train resume=nowhere": "no run at nowhere",
    "train resume=.": "not a run",
    "play run=nowhere": "no run at nowhere",
    "play run=/dev/null": "a file in a folder that is no run",
    "play zoo=Walker-v0 run=mine": "run and zoo both say what is shown",
    "play agent=sine run=mine": "run and agent both say what is shown",
    "export rollout=mine.npz run=mine": "run and rollout both say what is shown",
    "codesign resume=/dev/null": "a file in a folder that is no run",
    "tasks gallery=/proc/gallery.png": "or its disk detached.\n",
    "play export=[usd,gf]": "Did you mean 'gif'",
    "play agent=sin": "Did you mean 'sine'",
    "play task=Walker-v0": "task goes with agent=",
    "play agent=zero task=Walkr-v0 window=off": "Did you mean 'Walker-v0'",
    "play agent=zero size=[300]": "size must be [width,height]",
    "play window=maybe": "auto, on, off",
    "design file=nothing": "There is no file 'nothing.json'",
    "design file=../secret": "name may hold",
    "design port=70000": "at most 65535",
    "design -m port=1,2": "one editor at a time",
    "export rollout=nothing.npz": "no such file",
    "export format=pdf": "usd, gif, mp4, html",
    "export format=[]": "usd, gif, mp4, html",
    "demo resume=latest": "There is no run in",
    "bench suite=per": "Did you mean 'peer'",
    "bench num_envs=1 design=mini": "evogym==2.0.0",
    "bench num_envs=1 design=mini peer=nowhere": "no file",
    "codesign task=Walkr-v0": "Did you mean 'Walker-v0'",
    "codesign search=gaa": "search must be one of",
    "codesign search.population=1": "at least 2",
    "codesign search=random search.mutation_rate=0.2": "It is a setting of search=ga and search=map_elites",
    "codesign search.algorithm=go": "search must be one of",
    "codesign training=papr": "Did you mean 'paper'",
    "codesign training.iterations=0": "at least 1",
    "codesign training.method=sequential training.rungs=[0.5]": "training.method=population",
    "codesign population=3": "Did you mean 'search.population'",
    "codesign shape=[5]": "shape must be [rows,columns]",
    "codesign shape=[1,2]": "valid bodies of 1x2",
    "codesign shape=[12,12] task=Climber-v0": "does not fit",
    "codesign export=[cvs]": "Did you mean 'csv'",
    "codesign executor=local address=auto": "executor=ray",
    "codesign workers=2": "executor=ray",
    "codesign resume=nowhere": "no design search at nowhere",
    "codesign report=.": "not a run",
    "suite tasks=[Walkr-v0]": "Did you mean 'Walker-v0'",
    "suite search=ga": "Did you mean 'searches'",
    "suite suite=papr": "Did you mean 'paper'",
    "suite evaluations=9 control_steps=100000": "both a budget",
    "suite retry=true": "resume=latest",
    "suite resume=latest": "no suite",
    "suite resume=.": "not a run",
    "tasks Walkr": "Did you mean 'Walker-v0'",
    "tasks a b": "'task' is given more than once",
    "tasks rules=paper": "rules goes with a task",
    "tasks Walker-v0 gallery=x.png": "gallery goes without a task",
    "tasks gallery=x.gif": "ending in .png",
    "curves": "no run",
    "curves x=step": "Did you mean 'steps'",
    "tasks Walker-v0 desing=walker": "Did you mean 'design'",
    "tasks Walker-v0 rules=papr": "Did you mean 'paper'",
    "tasks Walker-v0 design=wlker": "Did you mean 'walker'",
    "tasks Walker-v0 picture=world.jpg": "picture must be a file ending in .png",
    "tasks Walker-v0 picture=/proc/world.png": "cannot be written",
    "tasks Climber-v0 design=random:3x6": "does not fit the world of Climber-v0",
    "tasks nowhere:MINE": "There is no module 'nowhere'",
    "info x": "not KEY=VALUE",
}


@pytest.mark.parametrize("words", MISTAKES)
def test_one_clear_line_and_nothing_written(words: str, warpvox: Callable, tmp_path: Path) -> None:
    outcome = warpvox(*words.split())
    assert outcome.code == 2
    assert outcome.err.startswith("warpvox: ")
    assert outcome.err.count("\n") == 1
    assert MISTAKES[words] in outcome.err
    assert "Traceback" not in outcome.out + outcome.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has a GPU")
def test_a_missing_gpu(warpvox: Callable, tmp_path: Path) -> None:
    outcome = warpvox("train", "device=cuda")
    assert outcome.code == 2
    assert "no CUDA device" in outcome.err
    assert list(tmp_path.iterdir()) == []


def test_no_command_shows_the_help(warpvox: Callable) -> None:
    outcome = warpvox()
    assert outcome.code == 2
    assert "usage: warpvox COMMAND" in outcome.err
    assert warpvox("--help").out.strip() == outcome.err.strip()
    assert warpvox("--version").out.startswith("warpvox ")


def test_a_folder_with_another_config_is_not_a_run(warpvox: Callable, tmp_path: Path) -> None:
    for text in ("a: 1\n", "- 1\n", "{", "\0"):
        (tmp_path / "config.yaml").write_text(text)
        outcome = warpvox("play", "run=.")
        assert outcome.code == 2
        assert outcome.err.count("\n") == 1


def test_a_run_that_fails_before_any_result_leaves_nothing(warpvox: Callable, tmp_path: Path, monkeypatch) -> None:
    from warpvox.algos.training.runner import Runner
    from warpvox.errors import RunError

    def fail(self: Runner) -> None:
        raise RunError("it broke")

    monkeypatch.setattr(Runner, "run", fail)
    outcome = warpvox("train", "design=mini", "num_envs=8", "threads=1")
    assert (outcome.code, outcome.err) == (2, "warpvox: it broke\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("key", ["threads", "torch_threads"])
def test_a_million_threads_are_refused_also_where_a_file_asks_for_them(key: str, train: Callable, warpvox) -> None:
    run = train("max_iterations=1")
    assert f"{key} must be at most 1024" in warpvox("train", f"{key}=1000000").err
    config = run / "config.yaml"
    lines = [f"{key}: 1000000\n" if line.startswith(f"{key}:") else line for line in config.open()]
    config.write_text("".join(lines))
    outcome = warpvox("play", f"run={run}", "window=off")
    assert outcome.code == 2
    assert f"{key} must be at most 1024" in outcome.err
