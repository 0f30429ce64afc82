"""The keys of every command: type, meaning, range. Values that depend on a choice stand in the YAML files.

The command line composes these dataclasses with the YAML files beside them, checks types, choices and ranges
against the metadata below, and prints the same metadata as ``warpvox COMMAND --help``.
"""

# ruff: noqa: RUF009  (key() is dataclasses.field with a meaning)

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field, make_dataclass
from typing import Any, get_origin, get_type_hints

from warpvox.algos.search.settings import ALGORITHMS, SearchSettings
from warpvox.algos.settings import LOGGERS, REFRESH, PpoConfig, ScreeningConfig, TrainingConfig
from warpvox.configs.bench_keys import COLUMNS, SUITES, GradientsConfig, LearningConfig, PeerConfig, ScalingConfig
from warpvox.configs.listing_keys import InfoConfig, TasksConfig
from warpvox.configs.physics_keys import PhysicsConfig
from warpvox.configs.suite_keys import suite_config
from warpvox.keys import MISSING, key
from warpvox.types import Physics

__all__ = [
    "COMMANDS",
    "GROUPS",
    "GROUPS_OF",
    "NODES",
    "PRESET",
    "PRESET_OF",
    "BenchConfig",
    "CodesignConfig",
    "DemoConfig",
    "DesignsConfig",
    "EvaluateConfig",
    "ExportConfig",
    "PhysicsConfig",
    "PlayConfig",
    "SearchConfig",
    "SuiteConfig",
    "TrainConfig",
    "ZooConfig",
]

EXPORTS = ("usd", "gif", "mp4", "html", "png", "strip")
POLICY_EXPORTS = ("onnx", "jit")
AGENTS = ("random", "sine", "zero")
SHOW = ("auto", "on", "off")
OBSERVATIONS = ("task", "timed", "voxel", "timed_voxel")
ARCHIVE_EXPORTS = ("csv", "parquet", "npz", "json")
AUTO = "auto"
MOST_THREADS = 1024
"""More than any machine has cores; a stored file may not make a process start a million."""
ARITHMETICS = ("fast", "exact")
DEVICES = "auto (CUDA where there is a device, from 100 environments per CPU core on), cpu, cuda, cuda:<index>"
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


def _arithmetic(default: str) -> Any:
    return key(None, f"fast, or exact (float64, bit for bit as released); null: {default}", choices=ARITHMETICS)


@dataclass
class PresetConfig:
    """The key of commands that have presets: whole sets of defaults, ``configs/preset/COMMAND/NAME.yaml``."""

    preset: str | None = key(
        None, "a named set of other defaults, which the keys that are given override; null: the defaults shown here"
    )


@dataclass
class DesignsConfig:
    """Keys ``designs.*``: many bodies for one policy. ``designs=...`` is short for ``designs.bodies=...``."""

    bodies: Any = key(
        None,
        "bodies to train one policy on, instead of design: random:64, random:64:5x7, a folder of designs or of a"
        " design search, or a list of designs",
        path="read",
    )
    refresh: str = key(
        "none",
        "what replaces a body at the end of its episode: nothing (none), a new random body (new), any of the"
        " bodies (random), or any of them, more often those on which the policy does worse (performance)",
        choices=REFRESH,
    )
    held_out: Any = key(
        None,
        "bodies for evaluation only, never trained on, given as designs; null: 32 random ones of the same size, or the"
        " bodies themselves where these are named",
        path="read",
    )
    grid: list[int] | None = key(
        None, "rows and columns that bodies have room for; null: those of the largest", low=1, form="[rows,columns]"
    )


@dataclass
class _TrainingRunConfig:
    """What train and demo share."""

    task: str = key(
        "Walker-v0",
        "task id (`warpvox tasks` lists them), or a task of your own: module:NAME or file.py:NAME",
        path="read",
    )
    design: Any = key(
        "walker",
        "body: the name of an example, random, random:5x7, zoo:TASK, a .json/.npz/.npy file, or rows of cells;"
        " for a task with several robots {name:body}",
        path="read",
    )
    rules: str = key(
        "evogym",
        "rules and constants of the benchmark as released (evogym) or as printed in the paper (paper)",
        choices=("evogym", "paper"),
    )
    policy: str = key(
        "mlp",
        "network of the policy: mlp (layers: ppo.hidden), grid, transformer or cpg (all observe voxels: obs=task"
        " becomes voxel, timed becomes timed_voxel), or your own: module:Class, file.py:Class",
        path="read",
    )
    network: Any = key(None, "settings of a network other than mlp, {width:32} for instance; null: its defaults")
    obs: str = key(
        "task",
        "observations: as the task has (task), by cell (voxel), with the time (timed, timed_voxel)",
        choices=OBSERVATIONS,
    )
    num_envs: int = key(MISSING, "environments stepped in parallel", low=1)
    max_iterations: int = key(MISSING, "training iterations in total, including those before a resume", low=1)
    eval_interval: int = key(MISSING, "iterations between deterministic evaluations", low=1)
    eval_envs: int = key(1, "evaluation environments for each design", low=1)
    stop_return: float | None = key(None, "stop as soon as an evaluation reaches this return; null: never")
    save_interval: int = key(50, "iterations between checkpoints", low=1)
    seed: int = key(0, "seed of all random numbers", low=0)
    device: str = key("auto", DEVICES)
    dtype: str = key("float32", "precision of the simulation", choices=("float32", "float64"))
    arithmetic: str | None = _arithmetic("chosen by dtype")
    threads: int | None = key(None, "CPU threads of the simulation; null: all cores", low=1, high=MOST_THREADS)
    lanes: int | None = key(
        None, "environments that a thread advances at once, in SIMD lanes; null: chosen by their number"
    )
    cuda_graph: bool = key(False, "on CUDA: launch each control step, with rewards and resets, as one CUDA graph")
    logger: str = key(
        "tensorboard",
        "where metrics are logged besides metrics.csv: tensorboard; wandb or neptune, by rsl-rl's writers; or none",
        choices=LOGGERS,
    )
    nan_guard: str = key(
        "on",
        "what happens when an environment diverges: its episode ends (on), and its last 64 steps are also written"
        " to the folder dumps of the run (dump)",
        choices=("on", "dump"),
    )
    torch_threads: int = key(
        1, "PyTorch threads; more than 1 slow down small networks and change rounding", low=1, high=MOST_THREADS
    )
    memory_check: bool = key(True, "refuse, before allocating, what does not fit into free memory")
    resume: str | None = key(None, "continue a run: latest, its folder, or a checkpoint file in it", path="read")
    config: str | None = key(None, CONFIG_FILE, path="read")
    name: str | None = key(None, "appended to the name of the run's folder")
    output_dir: str = key("outputs", "folder that runs are written to", path="written")
    physics: PhysicsConfig = key(PhysicsConfig, "preset and constants of the physics")
    ppo: PpoConfig = key(PpoConfig, "settings of PPO")


@dataclass
class TrainConfig(_TrainingRunConfig, PresetConfig):
    """Keys of ``warpvox train``."""

    designs: DesignsConfig = key(DesignsConfig, "many bodies for one policy")
    pretrained: str | None = key(
        None,
        "policy to begin with instead of a new one: universal (comes with warpvox: bodies up to 5x5, Walker-v0),"
        " latest, the folder of a run of `warpvox train` or a checkpoint in it; network, observations and method are"
        " its own",
        path="read",
    )
    method: str = key(
        "ppo",
        "how the policy learns: ppo, or gradients through the physics (policy=cpg; of ppo.* only steps, epochs,"
        " minibatches, learning_rate, schedule, max_grad_norm, adam_eps and action_scale count)",
        choices=("ppo", "gradients"),
    )


def _search_fields() -> list[tuple[str, Any, Any]]:
    """One optional key per setting of any search; null where the algorithm has none of this name."""
    common = {item.name for item in dataclasses.fields(SearchSettings)}
    fields = {"algorithm": ("algorithm", str, key(MISSING, "which search", choices=tuple(ALGORITHMS)))}
    for settings in ALGORITHMS.values():
        hints = get_type_hints(settings)
        for item in dataclasses.fields(settings):
            kind = list[str] if get_origin(hints[item.name]) is tuple else hints[item.name]
            if item.name in common:
                fields[item.name] = (item.name, kind, field(default=MISSING, metadata=item.metadata))
                continue
            owners = [name for name, other in ALGORITHMS.items() if item.name in other.__dataclass_fields__]
            metadata = {**item.metadata, "help": f"{', '.join(owners)}: {item.metadata['help']}"}
            fields.setdefault(item.name, (item.name, kind | None, field(default=None, metadata=metadata)))
    return list(fields.values())


SearchConfig = make_dataclass("SearchConfig", _search_fields(), namespace={"__module__": __name__})
"""Keys ``search.*``: the algorithm and its settings; ``warpvox.algos.search.settings_from`` sorts them out."""


@dataclass
class CodesignConfig(PresetConfig):
    """Keys of ``warpvox codesign``."""

    task: str = key(
        "Walker-v0",
        "task id (`warpvox tasks` lists them), or a task of your own: module:NAME or file.py:NAME",
        path="read",
    )
    shape: list[int] = key(
        [5, 5], "rows and columns of the bodies; in the paper [5,5], for Lifter-v0 [5,7]", low=1, form="[rows,columns]"
    )
    rules: str = key(
        "evogym",
        "rules and constants of the benchmark as released (evogym) or as printed in the paper (paper)",
        choices=("evogym", "paper"),
    )
    evaluation: str = key(
        "specialist",
        "how designs are compared: each by a policy of its own (specialist); by one policy that learns on all"
        " designs of each generation (shared); by a pretrained policy that is fine-tuned for each generation"
        " (few_shot); by the best of some open-loop gaits, which evolve with the designs (gaits)",
        choices=("specialist", "shared", "few_shot", "gaits"),
    )
    policy: str = key(
        "mlp",
        "network of a design's own policy: mlp (layers: training.ppo.hidden); with training.method=sequential"
        " also grid, transformer, module:Class, file.py:Class",
        path="read",
    )
    network: Any = key(None, "settings of a network other than mlp, {width:32} for instance; null: its defaults")
    pretrained: str | None = key(
        None,
        "evaluation=few_shot: the policy to start from: universal (comes with warpvox: bodies up to 5x5, Walker-v0),"
        " latest, the folder of a run of `warpvox train designs=...` or a checkpoint in it",
        path="read",
    )
    finalists: int = key(
        4,
        "evaluation=shared, few_shot, gaits: number of best designs that get a training of their own at the end",
        low=1,
    )
    reuse: bool = key(True, "take the result of a body that was evaluated before instead of training it again")
    batch: int | None = key(
        None, "designs trained in one batch; null: a whole generation (executor=ray: a worker's share of it)", low=1
    )
    seed: int = key(0, "seed of all random numbers", low=0)
    device: str = key("auto", DEVICES)
    dtype: str = key("float32", "precision of the simulation", choices=("float32", "float64"))
    arithmetic: str | None = _arithmetic("chosen by dtype")
    threads: int | None = key(
        None, "CPU threads of the simulation; null: all cores (executor=ray: one)", low=1, high=MOST_THREADS
    )
    torch_threads: int = key(
        1, "PyTorch threads; more than 1 slow down small networks and change rounding", low=1, high=MOST_THREADS
    )
    executor: str = key(
        "local",
        "where designs are trained: in this process (local) or on workers of Ray (ray)",
        choices=("local", "ray"),
    )
    address: str | None = key(
        None, "address of a running Ray cluster: auto or host:port; null: start Ray on this machine"
    )
    workers: int | None = key(
        None, "number of workers of executor=ray; null: one for each GPU, or as many as the CPUs allow", low=1
    )
    top: int = key(5, "number of best designs that are shown and drawn for each generation", low=1)
    export: list[str] = key(
        [],
        "formats in which the archive is written at the end: csv, parquet, npz and json (designs)",
        choices=ARCHIVE_EXPORTS,
    )
    memory_check: bool = key(True, "refuse, before allocating, what does not fit into free memory")
    resume: str | None = key(None, "continue a search: latest or its folder", path="read")
    config: str | None = key(None, CONFIG_FILE, path="read")
    report: Any = key(
        None,
        "only make the report and the exports of a search again: latest or its folder; or one report that"
        " compares several searches: [FOLDER,...], a pattern such as 'outputs/codesign/*/*', or a folder that"
        " contains searches",
        path="read",
    )
    name: str | None = key(None, "appended to the name of the run's folder")
    output_dir: str = key("outputs", "folder that runs are written to", path="written")
    physics: PhysicsConfig = key(PhysicsConfig, "preset and constants of the physics")
    start: list[str] = key(
        [],
        "robots whose bodies the first generation contains, with evaluation=gaits also their gaits: zoo:TASK, zoo:FILE,"
        " the folder of a search (its best design), of one of its designs or of a run, or bodies: random:100:5x5 (drawn"
        " with seed as train's designs are), a folder of design files, or what design takes",
        path="read",
    )
    search: SearchConfig = key(SearchConfig, "search algorithm")
    training: TrainingConfig = key(TrainingConfig, "how a design is trained and evaluated")
    screening: ScreeningConfig = key(ScreeningConfig, "how evaluation=shared, few_shot and gaits compare designs")


SuiteConfig = suite_config(CodesignConfig, SearchConfig)
"""Keys of ``warpvox suite``: what its members are, and what they share."""


@dataclass
class DemoConfig(_TrainingRunConfig):
    """Keys of ``warpvox demo``: training, then the exports."""

    export: list[str] = key(["usd", "gif", "html"], "formats to export the rollout to", choices=EXPORTS)


OWN_TASK = "For a run of a task of your own: its code, file.py:NAME, or stored for the copy in the run"
"""What ``task`` means beside ``run``."""


@dataclass
class _RolloutConfig:
    """What play and export share."""

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
    arithmetic: str | None = _arithmetic("that of the run, or chosen by dtype")
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
    episodes: int = key(16, "episodes of each run, a multiple of its number of designs", low=1)
    designs: Any = key(
        None,
        "for runs over many bodies: bodies to evaluate on, as for train (random:100); null: those held out",
        path="read",
    )
    stochastic: bool = key(False, "sample actions from the policy as in training, instead of taking their mean")
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
    arithmetic: str | None = _arithmetic("that of the run, or chosen by dtype")
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


COMMANDS: dict[str, type] = {
    "train": TrainConfig,
    "demo": DemoConfig,
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
"""Of commands in which that key has another name: the name."""


def _search(name: str, **changes: Any) -> Any:
    """The node ``search=<name>``: an algorithm with the defaults of its settings, but for ``changes``."""
    defaults = {item.name: item.default for item in dataclasses.fields(ALGORITHMS[name])} | changes
    return SearchConfig(
        name, **{key: list(value) if isinstance(value, tuple) else value for key, value in defaults.items()}
    )


NODES: dict[str, dict[str, Any]] = {
    "search": {name: _search(name) for name in ALGORITHMS} | {"bo": _search("bo", acquisition="pathwise")},
    "physics": {name: PhysicsConfig(preset=name) for name in (AUTO, *Physics.presets())},
}
"""Choices of a group that are dataclasses or instances of them, by name, beside the YAML files of its folder.

Where they are of different dataclasses, these have a common base, which is the type of the command's field, and a
field ``name``, by which a stored configuration says which of them it has.
"""

GROUPS = ("physics", "ppo", "search", "training")
"""Keys that also take the name of a choice: one of :data:`NODES`, or a YAML file in the folder of the same name."""

GROUPS_OF = {"suite": ("physics", "training")}
"""Of commands in which a name of :data:`GROUPS` has another meaning."""
