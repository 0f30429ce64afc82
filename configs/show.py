"""Keys of the commands that show results of runs: play, export, evaluate, curves."""

# ruff: noqa: RUF009  (key() is dataclasses.field with a meaning)

from dataclasses import dataclass
from typing import Any

from warpvox.algos.protocols import NOMINAL, PROTOCOLS
from warpvox.algos.training.settings import DEVICES, MOST_THREADS, arithmetic_key
from warpvox.configs.schema import EXPORTS, SHOW
from warpvox.keys import Settings, key
from warpvox.types import RULES
from warpvox.view.rollout import AGENTS

POLICY_EXPORTS = ("onnx", "jit")
_OWN_TASK = "For a run of a task of your own: its code, file.py:NAME"
"""Help text of the key ``task`` for a run with the user's own task."""


@dataclass
class _PolicyConfig(Settings):
    """Keys shared by play, export and evaluate, listed after each command's own."""

    stochastic: bool = key(False, "sample actions from the policy as in training, instead of taking their mean")
    policy: str | None = key(
        None,
        "for a run with a network of your own: its code, file.py:Class",
    )
    device: str = key("auto", DEVICES)
    dtype: str | None = key(None, "precision of the simulation; null: that of the run", choices=("float32", "float64"))
    arithmetic: str | None = arithmetic_key("that of the run, or chosen by dtype")
    threads: int | None = key(None, "CPU threads of the simulation; null: all cores", low=1, high=MOST_THREADS)
    torch_threads: int = key(1, "PyTorch threads", low=1, high=MOST_THREADS)
    name: str | None = key(None, "appended to the name of the result's folder")
    output_dir: str = key("outputs", "folder that runs are written to and looked up in")


@dataclass
class _RolloutConfig(Settings):
    """Keys shared by play and export."""

    run: str = key("latest", "latest, the folder of a run, or a checkpoint file")
    zoo: str | None = key(
        None,
        "a stored robot instead of a run: a task id or a file (.npz); simulated as it was recorded, with"
        " arithmetic=exact",
    )
    checkpoint: str = key("best", "checkpoint of the run: best, last, or an iteration")
    size: list[int] | None = key(
        None,
        "width and height of pictures in pixels, [640,360] for instance; null: by format",
        low=16,
        high=8192,
        form="[width,height]",
    )
    every: int = key(1, "show only every n-th control step; films run n times as fast", low=1)
    steps: int | None = key(None, "control steps to record; null: until the episode ends", low=1)
    seed: int | None = key(
        None,
        "seed of the episodes' random numbers and of sampled actions; null: the run's, which repeats its evaluations",
        low=0,
    )
    memory_check: bool = key(True, "refuse, before allocating, what does not fit into free memory")


@dataclass
class PlayConfig(_PolicyConfig, _RolloutConfig):
    """Keys of ``warpvox play``."""

    agent: str | None = key(
        None,
        "simple agent instead of a policy: random (uniform actions), sine (sine waves of random phases) or zero"
        " (rest lengths)",
        choices=AGENTS,
    )
    task: str | None = key(None, f"with agent: task id; null: Walker-v0. {_OWN_TASK}")
    design: Any = key(
        None,
        "with agent: body, as for train; null: walker. With a run over many bodies: the bodies to show",
    )
    rules: str | None = key(None, "with agent: evogym or paper; null: evogym", choices=RULES)
    num_envs: int | None = key(None, "environments; null: one for each design, four where episodes differ", low=1)
    protocol: str = key(NOMINAL, "disturbances of a policy, see `warpvox evaluate --help`", choices=tuple(PROTOCOLS))
    rollout: str | None = key(None, "only show this rollout file, such as a dump of nan_guard=dump")
    window: str = key("auto", "show the episode in a window: on, off, or auto (if there is a display)", choices=SHOW)
    record: bool = key(
        True, "write the rollout to a file, from which `warpvox export rollout=FILE` makes pictures later"
    )
    export: list[str] | None = key(
        None,
        "formats to export the rollout to, some of [usd,gif,mp4,html,png,strip]; null: html if no window is shown",
        choices=EXPORTS,
    )


@dataclass
class ExportConfig(_PolicyConfig, _RolloutConfig):
    """Keys of ``warpvox export``."""

    rollout: str | None = key(None, "rollout file to export; null: record an episode of the run")
    task: str | None = key(None, _OWN_TASK)
    num_envs: int = key(1, "number of environments, a multiple of the run's number of designs", low=1)
    format: list[str] = key(
        ["usd"],
        "one or several formats, [usd,gif] for instance: of the episode usd, gif, mp4, html, png, strip; of the"
        " policy onnx, jit",
        choices=(*EXPORTS, *POLICY_EXPORTS),
    )


@dataclass
class _EvaluationConfig(Settings):
    """Keys of evaluate only."""

    runs: list[str] | None = key(
        None,
        "trained runs: latest, folders, checkpoints, patterns such as 'outputs/train/*/*_NAME*';"
        " null: latest, unless zoo names robots",
    )
    zoo: list[str] = key(
        [],
        "stored robots to evaluate, instead of runs or beside them: task ids or files; all: the whole zoo",
    )
    checkpoint: str = key("best", "checkpoint of each run: best, last, or an iteration")
    episodes: int = key(
        32, "episodes of each run (of each disturbance of protocol), a multiple of its number of designs", low=1
    )
    designs: Any = key(
        None,
        "for runs over many bodies: bodies to evaluate on, as for train (random:100); null: those held out",
    )
    protocol: str = key(
        NOMINAL,
        "disturbance of the episodes: nominal (none), noise (on the actions), sticky (repeated actions), start (random"
        " actions at the beginning), sensors (noise on the observations), robust (all of these)",
        choices=tuple(PROTOCOLS),
    )
    seed: int = key(
        1000,
        "seed of the episodes' random numbers and of sampled actions; not that of training, by which checkpoints"
        " were chosen",
        low=0,
    )
    level: float = key(0.95, "confidence level of the intervals", above=0, high=0.9999)
    task: str | None = key(None, _OWN_TASK)


@dataclass
class EvaluateConfig(_PolicyConfig, _EvaluationConfig):
    """Keys of ``warpvox evaluate``."""


@dataclass
class CurvesConfig(Settings):
    """Keys of ``warpvox curves``."""

    runs: list[str] = key(
        ["latest"],
        "runs of `warpvox train`: latest, folders, patterns such as 'outputs/train/*/*_NAME*'; or design searches, by"
        " their folders or folders that contain them",
    )
    x: str = key(
        "steps",
        "x axis: steps, elapsed or iteration for trainings, steps or evaluations for searches",
        choices=("steps", "elapsed", "iteration", "evaluations"),
    )
    size: list[int] = key(
        [760, 340],
        "width and height in pixels, of each task's panel",
        low=64,
        high=8192,
        form="[width,height]",
    )
    file: str = key("curves.png", "picture to write: .png, .svg or .pdf")
    output_dir: str = key("outputs", "folder in which runs are looked up")
