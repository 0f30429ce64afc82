"""Every mistake gets one clear line and exit code 2, and leaves nothing behind."""

import errno
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

MISTAKES = {
    # The command and its options
    "trian": "Did you mean 'train'",
    "train --foo": "Unknown option",
    "train --num_envs 4": "Keys have no dashes: num_envs=VALUE",
    "train --cfg=jub": "-c/--cfg: invalid choice: 'jub' (choose from",
    "train --config-dir nowhere": "existing folder",
    "-sc install=csh": "bash fish zsh",
    # Words
    "train seed": "not KEY=VALUE",
    "train Walker-v0": "Write task=Walker-v0.",
    "codesign warpvox/Walker-v0": "Write task=warpvox/Walker-v0.",
    "play zoo:Walker-v0": "Write zoo=Walker-v0.",
    "train +extra=1": "cannot be added",
    "train seed=1 seed=2": "more than once",
    "train seed=1,2": "add --multirun",
    # Keys
    "train sede=1": "Did you mean 'seed'",
    "train lr=1": "Did you mean 'ppo.learning_rate'",
    "train total_timesteps=1000": "Did you mean 'max_iterations'",
    "codesign num_envs=8": "Did you mean 'training.envs'",
    "codesign search=random search.mutation_rate=0.2": "It is a setting of search=ga and search=map_elites",
    "train hydra.run.dir=x": "Unknown key",
    "codesign generations=3": "Did you mean 'search.max_designs'",
    "train design=mini body=worm": "more than once",
    # Values
    "train body=walkr": "Did you mean 'walker'",
    "train bodies=[walkr]": "Did you mean 'walker'",
    "play agent=zero body=walkr": "Did you mean 'walker'",
    "codesign search.max_evaluations=0": "search.max_designs must be at least 1",
    "codesign training.eval_envs=0": "training.episodes must be at least 1",
    "train task=warpvox/Walkr-v0": "Did you mean 'Walker-v0'",
    "train task=Walkr-v0": "Did you mean 'Walker-v0'",
    "train task=my_tasks.py": "my_tasks.py:NAME",
    "tasks nowhere:MINE": "There is no module 'nowhere'",
    "train design=walkr": "Did you mean 'walker'",
    "train design=[[3": "is not a nested list of cell types",
    "train num_envs=abc": "num_envs=abc: Value 'abc' of type 'str' could not be converted to Integer.",
    "train num_envs=0": "num_envs must be at least 1",
    "train ppo.gamma=1.5": "ppo.gamma must be at most 1",
    "codesign training.ppo.steps=0": "training.ppo.steps must be at least 1",
    "train ppo.schedule=lin": "Did you mean 'linear'",
    "play export=[usd,gf]": "Did you mean 'gif'",
    "play agent=zero size=[300]": "size must be [width,height]",
    "train name=a/b": "letters, digits",
    "evaluate level=1": "at most 0.9999",
    "evaluate episodes=0": "at least 1",
    "train device=gpu": "valid are 'auto', 'cpu'",
    "codesign search=gaa": "Did you mean 'ga'",
    "train preset=papr": "Did you mean 'paper'",
    "train ppo=paralel": "Did you mean 'parallel'",
    # What does not go together
    "train num_envs=3 design=[mini,worm]": "multiple of the number of designs",
    "train num_envs=3 design=mini lanes=8 threads=1 ppo.minibatches=100": "environments make 48 in 16 steps",
    "train task=Climber-v0 design=random:12x12": "does not fit",
    "codesign executor=local address=auto": "executor=ray",
    "codesign report=latest seed=4 search=bo": "seed, search cannot change a report",
    "play zoo=Walker-v0 run=mine": "run and zoo both say what is shown",
    "play task=Walker-v0": "task goes with agent=",
    "play agent=zero stochastic=true window=off": "stochastic goes with a run, not with agent",
    "evaluate zoo=[Walker-v0] checkpoint=2": "checkpoint goes with a run; a stored robot has one policy",
    "tasks rules=paper": "rules goes with a task",
    "evaluate task=Walker-v0": "a run knows its task",
    "codesign start=[zoo:Walker-v0] shape=[3,4]": "expected [3, 4]",
    "codesign start=[zoo:Walker-v0] search=cppn_neat": "makes all bodies itself",
    "codesign start=[random:4] search.population=3": "start has 4 robots, the first generation 3 designs",
    "codesign fitness=gaits fitness.rounds=0": "fitness.passes and fitness.rounds are both 0",
    "codesign fitness=gaits fitness.final_rounds=0 fitness.final_passes=0": "are both 0",
    "codesign fitness=gaits training.inherit=true": "training.inherit does not go with fitness=gaits",
    "codesign training.ppo.rnn={rnn_type:gru}": "are for one policy",
    "codesign training.ppo.extra={gama:1}": "are for one policy",
    "design -m port=1,2": "one editor at a time",
    # Files and runs
    "train resume=nowhere": "no run at nowhere",
    "demo resume=nowhere": "no run at nowhere",
    "train config=nowhere": "there is no such file",
    "codesign report=.": "not a run",
    "play run=/dev/null": "a file in a folder that is no run",
    f"play run={'x' * 300}": "x" * 80,  # too long for a name, by which Python 3.14 finds nothing
    "curves": "no run",
    "evaluate": "no run",
    "evaluate runs=[]": "runs=[] names none",
    "evaluate runs='nothing*'": "matches nothing",
    "evaluate runs=latest zoo=Walker-v0": "no run",
    "curves file=curves.gif": "file must end in .png, .svg, .pdf",
    "export rollout=nothing.npz": "no such file",
    "train output_dir=/proc/nowhere num_envs=1 design=mini lanes=8 threads=1": "it cannot be created there",
    # Sweeps, all of whose values are checked before the first run
    "train -m seed=1,2 task=Walker-v0,Wolker-v0": "Did you mean 'Walker-v0'",
    "train -m ppo.gamma=0.9,1.5": "ppo.gamma must be at most 1",
    "train -m seed=interval(0,1)": "INTERVAL",
    "train -m seed=range(0,3,0)": "'seed=range(0,3,0)' makes no runs",
    "train -m seed=1,2 hydra/launcher=nowhere": "hydra/launcher must be one of basic, got 'nowhere'",
}


@pytest.mark.parametrize("words", MISTAKES)
def test_one_clear_line_and_nothing_written(words: str, warpvox: Callable, tmp_path: Path) -> None:
    warpvox(*words.split(), fails=MISTAKES[words])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has a GPU")
def test_a_missing_gpu(warpvox: Callable, tmp_path: Path) -> None:
    warpvox("train", "device=cuda", fails="no CUDA device")
    assert list(tmp_path.iterdir()) == []


def test_no_command_shows_the_help(warpvox: Callable) -> None:
    usage = warpvox(code=2).err.strip()
    assert "usage: warpvox COMMAND" in usage
    assert warpvox("--help").out.strip() == usage
    assert warpvox("--version").out == warpvox("version").out


@pytest.mark.parametrize("words", ["play run=locked/run", "codesign resume=locked/run", "curves runs=locked/run"])
def test_a_folder_that_may_not_be_entered(words: str, warpvox: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    exists = Path.exists

    def enter(path: Path) -> bool:
        if path.parent.name == "locked":  # which root may enter
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return exists(path)

    monkeypatch.setattr(Path, "exists", enter)
    warpvox(*words.split(), fails="Permission is denied: locked/run.")


def test_a_folder_with_another_config_is_not_a_run(warpvox: Callable, tmp_path: Path) -> None:
    unread = "config.yaml cannot be read as YAML"
    short, other = "cut short", "that of another run"
    texts = {
        "": short,
        "a: 1\n": short,
        "a: 1...\n": short,
        "a: 1\r\n...\r\n": other,
        "- 1\n": other,
        "{": unread,
        "\0": unread,
    }
    texts["task: Walker-v0\ndesign: walker\ndesigns: 3\nppo: {}\n...\n"] = "no checkpoint yet"
    for text, says in texts.items():
        (tmp_path / "config.yaml").write_bytes(text.encode())
        warpvox("play", "run=.", fails=says)


def test_of_several_runs_the_one_that_was_changed_is_named(warpvox: Callable, tmp_path: Path) -> None:
    for name, seed in {"a": "0", "b": "x"}.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "model_1.pt").touch()
        text = f"task: Walker-v0\ndesign: walker\nppo: {{}}\nseed: {seed}\n...\n"
        (tmp_path / name / "config.yaml").write_text(text)
    warpvox("evaluate", "runs=[b,a]", fails="b/config.yaml is not valid: seed must be an integer, got 'x'")


def test_a_run_that_fails_before_any_result_leaves_nothing(warpvox: Callable, tmp_path: Path, monkeypatch) -> None:
    from warpvox.algos.training.runner import Runner
    from warpvox.errors import RunError

    def fail(self: Runner) -> None:
        raise RunError("it broke")

    monkeypatch.setattr(Runner, "run", fail)
    warpvox("train", "design=mini", "num_envs=8", "threads=1", fails="it broke")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("key", ["threads", "torch_threads"])
def test_a_million_threads_are_refused_also_where_a_file_asks_for_them(key: str, train: Callable, warpvox) -> None:
    run = train("max_iterations=1")
    for command in ("train", "evaluate"):
        warpvox(command, f"{key}=1000000", fails=f"{key} must be at most 1024")
    config = run / "config.yaml"
    lines = [f"{key}: 1000000\n" if line.startswith(f"{key}:") else line for line in config.open()]
    config.write_text("".join(lines))
    warpvox("play", f"run={run}", "window=off", fails=f"{key} must be at most 1024")


@pytest.mark.parametrize("command", ["train", "codesign"])
def test_values_that_no_run_can_begin_with(command: str, warpvox: Callable) -> None:
    warpvox(command, "config={a:1}", fails="config must be a YAML file or the folder of a run; {a:1}")
    warpvox(command, f"seed={1 << 63}", fails="must be an integer of at most 63 bits")
