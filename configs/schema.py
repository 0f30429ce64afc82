"""The keys of every command: type, meaning, range. Values that depend on a choice stand in the YAML files.

The command line composes these dataclasses with the YAML files beside them, checks types, choices and ranges
against the metadata below, and prints the same metadata as ``warpvox COMMAND --help``.
"""

# ruff: noqa: RUF009  (key() is dataclasses.field with a meaning)

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from warpvox.algos.codesign.evaluations import EVALUATIONS, Evaluation
from warpvox.algos.codesign.settings import Codesign
from warpvox.algos.physics import PhysicsConfig
from warpvox.algos.protocols import NOMINAL, PROTOCOLS
from warpvox.algos.search.settings import ALGORITHMS, SearchSettings
from warpvox.algos.training.settings import ARITHMETICS, DEVICES, MOST_THREADS, Training, arithmetic_key
from warpvox.configs.bench_keys import COLUMNS, SUITES, GradientsConfig, LearningConfig, PeerConfig, ScalingConfig
from warpvox.configs.suite_keys import SuiteConfig
from warpvox.keys import MISSING, key
from warpvox.types import Physics

__all__ = [
    "COMMANDS",
    "GROUPS",
    "NODES",
    "PRESET",
    "PRESET_OF",
    "BenchConfig",
    "CodesignConfig",
    "EvaluateConfig",
    "ExportConfig",
    "PhysicsConfig",
    "PlayConfig",
    "SuiteConfig",
    "TasksConfig",
    "TrainConfig",
    "ZooConfig",
]

EXPORTS = ("usd", "gif", "mp4", "html", "png", "strip")
POLICY_EXPORTS = ("onnx", "jit")
AGENTS = ("random", "sine", "zero")
SHOW = ("auto", "on", "off")
ARCHIVE_EXPORTS = ("csv", "parquet", "npz", "json")
AUTO = "auto"
OWN_TASK = "For a run of a task of your own: its code, file.py:NAME, or stored for the copy in the run"
"""Meaning of ``task`` beside ``run``."""
CONFIG_FILE = "file to take values from, such as a run's config.yaml (or its folder); keys that are given override them"


def _dtype_of_run() -> Any:
    """The key of commands that begin with what a run has left."""
    return key(None, "precision of the simulation; null: that of the run", choices=("float32", "float64"))


def _own_policy() -> Any:
    """The key of commands that begin with a run whose policy may be code of the user's."""
    return key(
        None,
        "for a run with a network of your own: its code, file.py:Class, or stored for the copy in the run",
        path="read",
    )


@dataclass
class PresetConfig:
    """The key of commands that have presets: whole sets of defaults, ``configs/preset/COMMAND/NAME.yaml``."""

    preset: str | None = key(
        None, "a named set of other defaults, which the keys that are given override; null: the defaults shown here"
    )


@dataclass
class TrainConfig(Training, PresetConfig):
    """Keys of ``warpvox train``."""

    export: list[str] = key(
        [],
        "formats in which an episode of the best policy is written into the run's folder at the end",
        choices=EXPORTS,
    )
    config: str | None = key(None, CONFIG_FILE, path="read")


@dataclass
class CodesignConfig(Codesign, PresetConfig):
    """Keys of ``warpvox codesign``."""

    search: SearchSettings = key(MISSING, "how designs are proposed")
    evaluation: Evaluation = key(MISSING, "how designs are compared")
    export: list[str] = key(
        [],
        "formats in which the archive is written at the end: csv, parquet, npz and json (designs)",
        choices=ARCHIVE_EXPORTS,
    )
    resume: str | None = key(None, "continue a search: latest or its folder", path="read")
    config: str | None = key(None, CONFIG_FILE, path="read")
    report: Any = key(
        None,
        "only make the report and the exports of a search again: latest or its folder; or one report that"
        " compares several searches: [FOLDER,...], a pattern such as 'outputs/codesign/*/*', or a folder that"
        " contains searches",
        path="read",
    )


@dataclass
class _RolloutConfig:
    """Keys that play and export share."""

    run: str = key("latest", "latest, the folder of a run, or a checkpoint file", path="read")
    zoo: str | None = key(
        None,
        "a stored robot instead of a run: a task id or a file (.npz); simulated as it was recorded, with"
        " arithmetic=exact",
        path="read",
    )
    checkpoint: str = key("best", "checkpoint of the run: best, last, or an iteration")
    size: list[int] | None = key(
        None,
        "width and height of pictures in pixels, [640,360] for instance; null: by format",
        low=16,
        form="[width,height]",
    )
    every: int = key(1, "show only every n-th control step; films run n times as fast", low=1)
    steps: int | None = key(None, "control steps to record; null: until the episode ends", low=1)
    device: str = key("auto", DEVICES)
    dtype: str | None = _dtype_of_run()
    arithmetic: str | None = arithmetic_key("that of the run, or chosen by dtype")
    stochastic: bool = key(False, "sample actions from the policy as in training, instead of taking their mean")
    seed: int | None = key(
        None,
        "seed of the episodes' random numbers and of sampled actions; null: the run's, which repeats its evaluations",
        low=0,
    )
    threads: int | None = key(None, "CPU threads of the simulation; null: all cores", low=1, high=MOST_THREADS)
    torch_threads: int = key(1, "PyTorch threads", low=1, high=MOST_THREADS)
    memory_check: bool = key(True, "refuse, before allocating, what does not fit into free memory")
    name: str | None = key(None, "appended to the name of the result's folder")
    output_dir: str = key("outputs", "folder that runs are written to and looked up in", path="written")


@dataclass
class PlayConfig(_RolloutConfig):
    """Keys of ``warpvox play``."""

    agent: str | None = key(
        None,
        "simple agent instead of a policy: random (uniform actions), sine (sine waves of random phases) or zero"
        " (rest lengths)",
        choices=AGENTS,
    )
    task: str | None = key(None, f"with agent: task id; null: Walker-v0. {OWN_TASK}", path="read")
    policy: str | None = _own_policy()
    design: Any = key(
        None,
        "with agent: body, as for train; null: walker. With a run over many bodies: the bodies to show",
        path="read",
    )
    rules: str | None = key(None, "with agent: evogym or paper; null: evogym", choices=("evogym", "paper"))
    num_envs: int = key(4, "number of environments, a multiple of the number of designs", low=1)
    protocol: str = key(NOMINAL, "disturbances of a policy, see `warpvox evaluate --help`", choices=tuple(PROTOCOLS))
    rollout: str | None = key(None, "only show this rollout file, such as a dump of nan_guard=dump", path="read")
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
class ExportConfig(_RolloutConfig):
    """Keys of ``warpvox export``."""

    rollout: str | None = key(None, "rollout file to export; null: record an episode of the run", path="read")
    task: str | None = key(None, OWN_TASK, path="read")
    policy: str | None = _own_policy()
    num_envs: int = key(1, "number of environments, a multiple of the run's number of designs", low=1)
    format: list[str] = key(
        ["usd"],
        "one or several formats, [usd,gif] for instance: of the episode usd, gif, mp4, html, png, strip; of the"
        " policy onnx, jit",
        choices=(*EXPORTS, *POLICY_EXPORTS),
    )


@dataclass
class BenchConfig:
    """Keys of ``warpvox bench``."""

    suite: str = key("peer", "; ".join(f"{name}: {text}" for name, text in SUITES.items()), choices=tuple(SUITES))
    task: str = key("Walker-v0", "task id", path="read")
    tasks: list[str] = key([], "tasks of suite=tasks and suite=gpu; []: all", path="read")
    design: Any = key("walker", "body, as for train", path="read")
    num_envs: int = key(512, "environments stepped in parallel", low=1)
    steps: int = key(40, "control steps of a timed repetition; fewer if they would take longer than limit", low=1)
    repeats: int = key(5, "number of repetitions, whose median is reported", low=1)
    limit: float = key(
        4.0, "time limit of a repetition, in seconds; what takes longer even at its shortest is left out", above=0
    )
    columns: list[str] = key(list(COLUMNS), "what is timed: step, inference, training", choices=COLUMNS)
    device: str | None = key(None, "auto, cpu, cuda, cuda:<index>; null: cuda for suite=gpu, cpu for the others")
    dtype: str = key("float32", "precision of the simulation", choices=("float32", "float64"))
    arithmetic: str | None = key(None, "arithmetic of the simulation; null: chosen by dtype", choices=ARITHMETICS)
    threads: int = key(1, "CPU threads of the simulation", low=1, high=MOST_THREADS)
    torch_threads: int = key(1, "PyTorch threads", low=1, high=MOST_THREADS)
    seed: int = key(0, "seed of the random actions", low=0)
    compile: bool = key(True, "suite=kernels: compile all kernels of a control step again and time that")
    peer: PeerConfig = key(PeerConfig, "the reference")
    scaling: ScalingConfig = key(ScalingConfig, "suite=scaling")
    learning: LearningConfig = key(LearningConfig, "suite=learning")
    gradients: GradientsConfig = key(GradientsConfig, "suite=gradients")
    seconds: float = key(400.0, "suite=gpu: no further part begins after so many seconds", above=0)
    document: str | None = key(
        None, "Markdown file whose tables of this suite are replaced (`<!-- bench SUITE -->`)", path="written"
    )
    name: str | None = key(None, "appended to the name of the result's folder")
    output_dir: str = key("outputs", "folder that results are written to", path="written")


@dataclass
class CurvesConfig:
    """Keys of ``warpvox curves``."""

    runs: list[str] = key(
        ["latest"],
        "runs of `warpvox train`: latest, folders, patterns such as 'outputs/train/*/*'; or design searches,"
        " by their folders or folders that contain them",
        path="read",
    )
    x: str = key(
        "steps",
        "x axis: steps, elapsed or iteration for trainings, steps or evaluations for searches",
        choices=("steps", "elapsed", "iteration", "evaluations"),
    )
    size: list[int] = key(
        [760, 340],
        "width and height in pixels; for searches those of each task's panel",
        low=64,
        high=8192,
        form="[width,height]",
    )
    file: str = key("curves.png", "picture to write: .png, .svg or .pdf", path="written")
    output_dir: str = key("outputs", "folder in which runs are looked up", path="written")


@dataclass
class EvaluateConfig:
    """Keys of ``warpvox evaluate``."""

    runs: list[str] = key(
        ["latest"], "trained runs: latest, folders, checkpoints, patterns such as 'outputs/train/*/*'", path="read"
    )
    zoo: list[str] = key(
        [], "stored robots to evaluate, instead of runs or beside them: task ids or files", path="read"
    )
    checkpoint: str = key("best", "checkpoint of each run: best, last, or an iteration")
    episodes: int = key(
        16, "episodes of each run (of each disturbance of protocol), a multiple of its number of designs", low=1
    )
    designs: Any = key(
        None,
        "for runs over many bodies: bodies to evaluate on, as for train (random:100); null: those held out",
        path="read",
    )
    stochastic: bool = key(False, "sample actions from the policy as in training, instead of taking their mean")
    protocol: str = key(
        NOMINAL,
        "episodes: undisturbed (nominal), with noise on the actions (noise), with repeated actions (sticky), with"
        " random actions at the beginning (start), with noise on the observations (sensors), or all of these (robust)",
        choices=tuple(PROTOCOLS),
    )
    seed: int = key(
        1000,
        "seed of the episodes' random numbers and of sampled actions; not that of training, by which checkpoints"
        " were chosen",
        low=0,
    )
    level: float = key(0.95, "confidence level of the intervals", above=0, high=0.9999)
    task: str | None = key(None, OWN_TASK, path="read")
    policy: str | None = _own_policy()
    device: str = key("auto", DEVICES)
    dtype: str | None = _dtype_of_run()
    arithmetic: str | None = arithmetic_key("that of the run, or chosen by dtype")
    threads: int | None = key(None, "CPU threads of the simulation; null: all cores", low=1)
    torch_threads: int = key(1, "PyTorch threads", low=1)
    name: str | None = key(None, "appended to the name of the result's folder")
    output_dir: str = key("outputs", "folder that runs are written to and looked up in", path="written")


@dataclass
class ZooConfig:
    """Keys of ``warpvox zoo``."""

    task: str | None = key(
        None,
        "show the robot of this task in detail; with add, for runs of a task of your own: its code, file.py:NAME, or"
        " stored for the copy in the run",
        path="read",
    )
    add: list[str] = key(
        [],
        "make entries from these: folders of design searches or runs, checkpoints, or patterns; an entry is"
        " replaced only by one with a higher return",
        path="read",
    )
    top: int = key(10, "number of best designs of a search that add evaluates", low=1)
    folder: str | None = key(None, "folder of the entries; null: that of the package", path="written")


@dataclass
class DesignConfig:
    """Keys of ``warpvox design``."""

    file: str | None = key(None, "file of the folder to open at the start", path="read")
    folder: str = key(
        "designs", "folder in which files are opened and saved; made when something is saved", path="written"
    )
    tasks: list[str] = key(
        [], "tasks of your own to try bodies in, beside the benchmark's: file.py:NAME, module:NAME", path="read"
    )
    port: int = key(0, "port of the server on 127.0.0.1; 0: any free port", low=0, high=65535)
    browser: str = key("auto", "open the page in a browser: on, off, or auto (if there is a display)", choices=SHOW)


@dataclass
class TasksConfig:
    """Keys of ``warpvox tasks``."""

    task: str | None = key(
        None,
        "task id, module:NAME or file.py:NAME to show in detail, with its world; its key may be omitted",
        path="read",
    )
    rules: str = key("evogym", "as released (evogym) or as printed (paper)", choices=("evogym", "paper"))
    design: Any = key(
        "walker", "body that worlds are shown with, and that the layout of the observation is for", path="read"
    )
    picture: str | None = key(None, "with a task: also write its world as a picture (.png)", path="written")
    gallery: str | None = key(None, "instead of the list write all worlds into one picture (.png)", path="written")


@dataclass
class InfoConfig:
    """``warpvox info`` has no keys."""


COMMANDS: dict[str, type] = {
    "train": TrainConfig,
    "play": PlayConfig,
    "export": ExportConfig,
    "codesign": CodesignConfig,
    "suite": SuiteConfig,
    "bench": BenchConfig,
    "curves": CurvesConfig,
    "evaluate": EvaluateConfig,
    "design": DesignConfig,
    "zoo": ZooConfig,
    "tasks": TasksConfig,
    "info": InfoConfig,
}
"""The dataclass of each command."""

PRESET = "preset"
"""The key that takes the name of a preset, a file of ``configs/preset/COMMAND``."""

PRESET_OF = {"suite": "suite"}
"""Name of that key in commands in which it is another."""


NODES: dict[str, dict[str, Any]] = {
    "physics": {name: PhysicsConfig(preset=name) for name in (AUTO, *Physics.presets())},
    "search": ALGORITHMS,
    "evaluation": EVALUATIONS,
}
"""Choices of a group that are dataclasses or instances of them, by name, beside the YAML files of its folder.

Where they are of different dataclasses, these have a common base, which is the type of the command's field, and a
first field, ``name`` or ``algorithm``, by which a stored configuration says which of them it has.
"""

GROUPS = ("physics", "ppo", "search", "evaluation", "training")
"""Keys that also take the name of a choice: one of :data:`NODES`, or a YAML file in the folder of the same name."""
