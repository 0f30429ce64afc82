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
from warpvox.configs.suite_keys import suite_config
from warpvox.keys import MISSING, key
from warpvox.types import Physics

__all__ = [
    "COMMANDS",
    "GROUPS",
    "GROUPS_OF",
    "PRESET",
    "PRESET_OF",
    "BenchConfig",
    "CodesignConfig",
    "DemoConfig",
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
OBSERVATIONS = ("task", "timed", "voxel")
ARCHIVE_EXPORTS = ("csv", "parquet", "npz", "json")
AUTO = "auto"
MOST_THREADS = 1024
"""More than any machine has cores; a stored file may not make a process start a million."""
ARITHMETICS = ("fast", "exact")
PPO = ("parallel", "evogym")
DEVICES = "auto (CUDA where there is one, from 1,000 environments on), cpu, cuda, cuda:<index>"
CONFIG_FILE = "start from the values of a file, such as a run's config.yaml (or its folder); other keys go before them"


def _dtype_of_run() -> Any:
    """The key of commands that begin with what a run has left."""
    return key(None, "precision of the simulation; null: that of the run", choices=("float32", "float64"))


def _own_policy() -> Any:
    """The key of commands that begin with a run whose policy may be code of the user's."""
    return key(None, "of a run with a network of your own: where its code is, file.py:Class, or stored", path="read")


def _arithmetic(default: str) -> Any:
    return key(None, f"fast, or exact: bit for bit as released (float64); null: {default}", choices=ARITHMETICS)


CONSTANTS = {
    "dt": "inner time of a sub-step, 1e-8 to 0.01; the default constants are stable up to about 1.3e-4",
    "substeps": "sub-steps of a control step, 1 to 10000",
    "point_mass": "mass of every point, 0.001 to 1e6",
    "gravity": "acceleration downward, in simulator units",
    "drag": "force against a point's velocity, per velocity",
    "contact_stiffness": "force per depth of penetration",
    "contact_depth": "length added to the depth of penetration",
    "contact_damping": "force per velocity of approach",
    "friction": "coefficient of friction between voxels",
    "friction_multiplier": "force per sliding velocity, up to friction's limit",
    "floor_stiffness": "force per depth below y = 0",
    "floor_friction": "friction of the floor at y = 0",
    "actuation_rate": "share of the way to its goal that a length goes in a sub-step",
    "strain_limit": "strain of any spring from which its ends are moved, 0.001 to 0.99",
    "strain_share": "share of half the excess by which each end moves, 0 (no limit) to 1",
    "rigid_strain_limit": "the same limit for the sides of rigid voxels",
    "rigid_strain_share": "the same share for the sides of rigid voxels",
    "rigid_main": "stiffness of the sides of rigid voxels",
    "rigid_structural": "stiffness of the diagonals of rigid voxels",
    "soft_main": "stiffness of the sides of soft voxels",
    "soft_structural": "stiffness of the diagonals of soft voxels",
    "actuator_main": "stiffness of the sides of actuators",
    "actuator_structural": "stiffness of the diagonals of actuators",
    "shared_edge": "which voxel sets a shared side: last or stiffest",
}
"""Meanings of the constants of the physics."""


def _physics_fields() -> list[tuple[str, Any, Any]]:
    """One optional key per constant of :class:`warpvox.types.Physics`; null keeps the preset's value."""
    presets = (AUTO, *Physics.presets())
    fields = [("preset", str, key(AUTO, "preset to start from; auto: that of the rules", choices=presets))]
    for constant in dataclasses.fields(Physics):
        if constant.name == "name":
            continue
        meaning = CONSTANTS.get(constant.name, constant.name.replace("_", " ")) + "; null: the preset's"
        fields.append((constant.name, type(constant.default) | None, key(None, meaning)))
    return fields


PhysicsConfig = make_dataclass("PhysicsConfig", _physics_fields(), namespace={"__module__": __name__})
"""Keys ``physics.*``: a preset, and constants that differ from it (paper section A, Table 1)."""


@dataclass
class PresetConfig:
    """The key of commands that have presets: whole sets of defaults, ``configs/preset/NAME/COMMAND.yaml``."""

    preset: str | None = key(
        None, "a set of other defaults, over which keys that are given win; null: those shown here"
    )


@dataclass
class DesignsConfig:
    """Keys ``designs.*``: many bodies for one policy. ``designs=...`` is short for ``designs.bodies=...``."""

    bodies: Any = key(
        None,
        "bodies to train one policy over, instead of design: random:64, random:64:5x7, a folder of designs or of a"
        " design search, or a list as for design",
        path="read",
    )
    refresh: str = key(
        "none",
        "bodies that take the place of those whose episode has ended: none, new random ones, any of the bodies"
        " (random), or rather those on which the policy does worse (performance)",
        choices=REFRESH,
    )
    held_out: Any = key(
        None,
        "bodies to evaluate on and never to train on, as designs; null: 32 random ones of the same size",
        path="read",
    )


@dataclass
class _TrainingRunConfig:
    """What train and demo share."""

    task: str = key(
        "Walker-v0", "task id; `warpvox tasks` lists them; module:NAME or file.py:NAME of your own", path="read"
    )
    design: Any = key(
        "walker",
        "body: name of an example, random, random:5x7, zoo:TASK, a .json/.npz/.npy file, or rows of cells;"
        " for a task with several robots {name:body}",
        path="read",
    )
    rules: str = key("evogym", "the benchmark as released (evogym) or as printed (paper)", choices=("evogym", "paper"))
    policy: str = key(
        "mlp",
        "mlp (ppo.hidden), grid or transformer (both see voxels, whatever obs says), module:Class, file.py:Class",
        path="read",
    )
    network: Any = key(None, "settings of another policy than mlp: {width:32}; null: its own")
    obs: str = key("task", "task (what the task has), timed (and the time) or voxel (by cell)", choices=OBSERVATIONS)
    num_envs: int = key(MISSING, "environments stepped together", low=1)
    max_iterations: int = key(MISSING, "iterations in all, those before a resume included", low=1)
    eval_interval: int = key(MISSING, "iterations between deterministic evaluations", low=1)
    eval_envs: int = key(1, "environments of an evaluation, for each design", low=1)
    stop_return: float | None = key(None, "stop as soon as an evaluation reaches this return")
    save_interval: int = key(50, "iterations between checkpoints", low=1)
    seed: int = key(0, "governs everything random", low=0)
    device: str = key("auto", DEVICES)
    dtype: str = key("float32", "precision of the simulation", choices=("float32", "float64"))
    arithmetic: str | None = _arithmetic("by dtype")
    threads: int | None = key(None, "threads of the simulation on the CPU; null: all cores", low=1, high=MOST_THREADS)
    lanes: int | None = key(None, "environments that a thread advances at once; null: chosen by size")
    cuda_graph: bool = key(False, "on CUDA launch each control step, rewards and resets included, as one graph")
    logger: str = key(
        "tensorboard",
        "where metrics go besides metrics.csv: tensorboard; wandb or neptune, by rsl-rl's writers; or none",
        choices=LOGGERS,
    )
    nan_guard: str = key(
        "on",
        "divergence ends an environment (on), and its last 64 steps are written to the run's folder dumps (dump)",
        choices=("on", "dump"),
    )
    torch_threads: int = key(
        1, "threads of PyTorch; more than 1 slows small networks and changes rounding", low=1, high=MOST_THREADS
    )
    memory_check: bool = key(True, "refuse what does not fit into the memory that is free, before it is allocated")
    resume: str | None = key(None, "go on with a run: latest, its folder, or a checkpoint file in it", path="read")
    config: str | None = key(None, CONFIG_FILE, path="read")
    name: str | None = key(None, "appended to the name of the run's folder")
    output_dir: str = key("outputs", "folder that runs are written to", path="written")
    physics: PhysicsConfig = key(PhysicsConfig, "preset and constants of the dynamics")
    ppo: PpoConfig = key(PpoConfig, "training method")


@dataclass
class TrainConfig(_TrainingRunConfig, PresetConfig):
    """Keys of ``warpvox train``."""

    designs: DesignsConfig = key(DesignsConfig, "many bodies for one policy")


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

    task: str = key("Walker-v0", "task id; `warpvox tasks` lists them", path="read")
    shape: list[int] = key(
        [5, 5], "rows and columns of the bodies; the paper: [5,5], for Lifter-v0 [5,7]", low=1, form="[rows,columns]"
    )
    rules: str = key("evogym", "the benchmark as released (evogym) or as printed (paper)", choices=("evogym", "paper"))
    evaluation: str = key(
        "specialist",
        "what a design's fitness is: of a policy of its own (specialist); of one policy that learns on all designs of"
        " each generation (shared); of a pretrained one, tuned for each generation (few_shot); the best that open-loop"
        " gaits get, which evolve with the designs (gaits)",
        choices=("specialist", "shared", "few_shot", "gaits"),
    )
    policy: str = key(
        "mlp",
        "of a design's own training: mlp (training.ppo.hidden); with training.method=sequential also grid,"
        " transformer, module:Class, file.py:Class",
        path="read",
    )
    network: Any = key(None, "settings of another policy than mlp: {width:32}; null: its own")
    pretrained: str | None = key(
        None,
        "evaluation=few_shot: the policy to begin with, latest, the folder of a run of `warpvox train designs=...` or a"
        " checkpoint in it",
        path="read",
    )
    finalists: int = key(
        4, "evaluation=shared, few_shot, gaits: best designs that get a training of their own in the end", low=1
    )
    reuse: bool = key(True, "a body that was evaluated before is not trained again")
    batch: int | None = key(
        None, "designs trained together; null: a whole generation (executor=ray: a worker's share of it)", low=1
    )
    seed: int = key(0, "governs everything random", low=0)
    device: str = key("auto", DEVICES)
    dtype: str = key("float32", "precision of the simulation", choices=("float32", "float64"))
    arithmetic: str | None = _arithmetic("by dtype")
    threads: int | None = key(
        None, "threads of the simulation on the CPU; null: all cores (executor=ray: one)", low=1, high=MOST_THREADS
    )
    torch_threads: int = key(
        1, "threads of PyTorch; more than 1 slows small networks and changes rounding", low=1, high=MOST_THREADS
    )
    executor: str = key("local", "where designs are trained: in this process, or on workers", choices=("local", "ray"))
    address: str | None = key(None, "of a running Ray cluster: auto or host:port; null: Ray is started on this machine")
    workers: int | None = key(None, "workers of executor=ray; null: one for each GPU, or what the CPUs allow", low=1)
    top: int = key(5, "best designs that are shown and drawn for every generation", low=1)
    export: list[str] = key(
        [], "what to write of the archive at the end: csv, parquet, npz and json (designs)", choices=ARCHIVE_EXPORTS
    )
    memory_check: bool = key(True, "refuse what does not fit into the memory that is free, before it is allocated")
    resume: str | None = key(None, "go on with a search: latest or its folder", path="read")
    config: str | None = key(None, CONFIG_FILE, path="read")
    report: Any = key(
        None,
        "only make report and exports of a search again: latest or its folder; of several one report that compares"
        " them: [FOLDER,...], a pattern such as 'outputs/codesign/*/*', or a folder that searches lie in",
        path="read",
    )
    name: str | None = key(None, "appended to the name of the run's folder")
    output_dir: str = key("outputs", "folder that runs are written to", path="written")
    physics: PhysicsConfig = key(PhysicsConfig, "preset and constants of the dynamics")
    search: SearchConfig = key(SearchConfig, "search algorithm")
    training: TrainingConfig = key(TrainingConfig, "how a design is trained and judged")
    screening: ScreeningConfig = key(ScreeningConfig, "how evaluation=shared, few_shot and gaits compare designs")


SuiteConfig = suite_config(CodesignConfig, SearchConfig)
"""Keys of ``warpvox suite``: what its members are, and what they share."""


@dataclass
class DemoConfig(_TrainingRunConfig):
    """Keys of ``warpvox demo``: training, then the exports."""

    export: list[str] = key(["usd", "gif", "html"], "what to write of the rollout", choices=EXPORTS)


OWN_TASK = "With a run of a task of your own: where its code is, file.py:NAME, or stored for the copy in the run"
"""What ``task`` means beside ``run``."""


@dataclass
class _RolloutConfig:
    """What play and export share."""

    run: str = key("latest", "latest, the folder of a run, or a checkpoint file", path="read")
    zoo: str | None = key(
        None,
        "instead of a run a stored robot: a task's id, a file, or one of a data set, robots.parquet:TASK:RANK; as"
        " recorded, arithmetic=exact",
        path="read",
    )
    checkpoint: str = key("best", "of that run: best, last, or an iteration")
    size: list[int] | None = key(
        None,
        "width and height of pictures in pixels, [640,360] for instance; null: what suits the format",
        low=16,
        form="[width,height]",
    )
    every: int = key(1, "show every n-th control step only; films run n times as fast", low=1)
    steps: int | None = key(None, "control steps to record; null: until the episode ends", low=1)
    device: str = key("auto", DEVICES)
    dtype: str | None = _dtype_of_run()
    arithmetic: str | None = _arithmetic("the run's, or by dtype")
    stochastic: bool = key(False, "sample the policy's actions as in training, instead of taking their mean")
    seed: int | None = key(
        None,
        "of what episodes draw and of sampled actions; null: that of the run, whose evaluations are repeated",
        low=0,
    )
    threads: int | None = key(None, "threads of the simulation on the CPU; null: all cores", low=1, high=MOST_THREADS)
    torch_threads: int = key(1, "threads of PyTorch", low=1, high=MOST_THREADS)
    memory_check: bool = key(True, "refuse what does not fit into the memory that is free, before it is allocated")
    name: str | None = key(None, "appended to the name of the result's folder")
    output_dir: str = key("outputs", "folder that runs are written to and looked up in", path="written")


@dataclass
class PlayConfig(_RolloutConfig):
    """Keys of ``warpvox play``."""

    agent: str | None = key(
        None, "instead of a run's policy: uniformly random actions, a sine wave, or zero effort", choices=AGENTS
    )
    task: str | None = key(None, f"with agent: task id; null: Walker-v0. {OWN_TASK}", path="read")
    policy: str | None = _own_policy()
    design: Any = key(
        None,
        "with agent: body, as for train; null: walker. With a run over many bodies: the bodies to show",
        path="read",
    )
    rules: str | None = key(None, "with agent: evogym or paper; null: evogym", choices=("evogym", "paper"))
    num_envs: int = key(4, "environments; a multiple of the number of designs", low=1)
    rollout: str | None = key(
        None, "a rollout file to show as it is (a dump of nan_guard=dump, say), and nothing else", path="read"
    )
    window: str = key("auto", "show the episode in a window: on, off, or auto, where there is a display", choices=SHOW)
    record: bool = key(True, "write the rollout, of which `warpvox export rollout=FILE` makes pictures later")
    export: list[str] | None = key(
        None,
        "what to make of the rollout, some of [usd,gif,mp4,html,png,strip]; null: html where no window is shown",
        choices=EXPORTS,
    )


@dataclass
class ExportConfig(_RolloutConfig):
    """Keys of ``warpvox export``."""

    rollout: str | None = key(None, "a rollout.npz to export as it is; null: record an episode of the run", path="read")
    task: str | None = key(None, OWN_TASK, path="read")
    policy: str | None = _own_policy()
    num_envs: int = key(1, "environments; a multiple of the run's number of designs", low=1)
    format: list[str] = key(
        ["usd"],
        "of the episode usd, gif, mp4, html, png, strip; of the policy itself onnx, jit; or several: [usd,gif]",
        choices=(*EXPORTS, *POLICY_EXPORTS),
    )


SUITES = {
    "peer": "beside the reference",
    "tasks": "each task by itself, beside the reference if there is one",
    "mixed": "a different body in every environment, beside one in all",
    "scaling": "bodies of n x n voxels, numbers of environments, threads",
    "learning": "time to a return",
    "kernels": "times of the stages, memory, compilation",
    "cuda": "the CUDA kernel without a GPU: limits, instructions by stage, predicted speed",
    "gpu": "checks and figures of a CUDA device in one go",
}
"""What ``warpvox bench`` measures."""
COLUMNS = ("step", "inference", "training")
"""Columns of a table of speeds: random actions, actions of a policy, whole iterations of PPO."""


@dataclass
class PeerConfig:
    """Keys ``peer.*``: the reference implementation to compare with."""

    python: str | None = key(
        None, "interpreter with evogym 2.0.0; null: that which peer.make has made, if it has", path="read"
    )
    make: bool = key(False, "make an environment for the reference first (needs a Python 3.10 and a package index)")


@dataclass
class ScalingConfig:
    """Keys ``scaling.*``: what the suite of that name varies."""

    sizes: list[int] = key(list(range(5, 36)), "sides n of the bodies of n x n voxels", low=2, high=60)
    bodies: int = key(10, "robots of each size", low=1)
    seconds: float = key(10.0, "simulated seconds of each robot, of 50 control steps each", above=0)
    quick: bool = key(False, "every fifth size only, 3 robots at most of each, for 2 simulated seconds at most")
    envs: list[int] = key([1, 8, 64, 512, 4096, 16384, 65536], "numbers of environments", low=1)


@dataclass
class LearningConfig:
    """Keys ``learning.*``: who learns, until when."""

    ppo: list[str] = key(["parallel", "evogym"], "settings to compare: names of configs/ppo", choices=PPO)
    seeds: int = key(3, "runs of each", low=1)
    stop_return: float = key(10.0, "the return to reach, in a deterministic evaluation")
    seconds: float = key(150.0, "a run gives up after so long", above=0)


@dataclass
class BenchConfig:
    """Keys of ``warpvox bench``."""

    suite: str = key("peer", "; ".join(f"{name}: {text}" for name, text in SUITES.items()), choices=tuple(SUITES))
    task: str = key("Walker-v0", "task id", path="read")
    tasks: list[str] = key([], "tasks of suite=tasks and suite=gpu; []: all", path="read")
    design: Any = key("walker", "body, as for train", path="read")
    num_envs: int = key(512, "environments stepped together", low=1)
    steps: int = key(40, "control steps of a timed repetition, fewer where they would take longer than limit", low=1)
    repeats: int = key(5, "repetitions, of which the median counts", low=1)
    limit: float = key(4.0, "seconds that a repetition may take; what cannot be shorter is left out", above=0)
    columns: list[str] = key(list(COLUMNS), "what is timed: step, inference, training", choices=COLUMNS)
    device: str | None = key(None, "auto, cpu, cuda, cuda:<index>; null: cuda for suite=gpu, cpu for the others")
    dtype: str = key("float32", "precision that is timed", choices=("float32", "float64"))
    arithmetic: str | None = key(None, "arithmetic that is timed; null: by dtype", choices=ARITHMETICS)
    threads: int = key(1, "threads of the simulation on the CPU", low=1, high=MOST_THREADS)
    torch_threads: int = key(1, "threads of PyTorch", low=1, high=MOST_THREADS)
    seed: int = key(0, "of the random actions", low=0)
    compile: bool = key(True, "suite=kernels compiles all kernels of a control step once more and times that")
    peer: PeerConfig = key(PeerConfig, "the reference")
    scaling: ScalingConfig = key(ScalingConfig, "suite=scaling")
    learning: LearningConfig = key(LearningConfig, "suite=learning")
    seconds: float = key(400.0, "suite=gpu begins no part after so many", above=0)
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
        "runs of `warpvox train`: latest, folders, patterns such as 'outputs/train/*/*'; or design searches: these, or"
        " folders that searches lie in",
        path="read",
    )
    x: str = key(
        "steps",
        "what is to the right; of trainings steps, elapsed or iteration, of searches steps or evaluations",
        choices=("steps", "elapsed", "iteration", "evaluations"),
    )
    size: list[int] = key(
        [760, 340],
        "width and height in pixels; of searches of each task",
        low=64,
        high=8192,
        form="[width,height]",
    )
    file: str = key("curves.png", "picture to write: .png, .svg or .pdf", path="written")
    output_dir: str = key("outputs", "folder that runs are looked up in", path="written")


@dataclass
class EvaluateConfig:
    """Keys of ``warpvox evaluate``."""

    runs: list[str] = key(
        ["latest"], "trained runs: latest, folders, checkpoints, patterns such as 'outputs/train/*/*'", path="read"
    )
    zoo: list[str] = key([], "stored robots, instead of runs or beside them: tasks' ids, or files", path="read")
    checkpoint: str = key("best", "of each run: best, last, or an iteration")
    episodes: int = key(16, "of each run; a multiple of its number of designs", low=1)
    designs: Any = key(
        None,
        "of runs over many bodies: bodies to evaluate on, as for train (random:100); null: those held out",
        path="read",
    )
    stochastic: bool = key(False, "sample the policy's actions as in training, instead of taking their mean")
    seed: int = key(
        1000,
        "of what episodes draw and of sampled actions; another than that of training, by which it was judged",
        low=0,
    )
    level: float = key(0.95, "confidence of the intervals", above=0, high=0.9999)
    task: str | None = key(None, f"of runs of tasks of your own. {OWN_TASK}", path="read")
    policy: str | None = _own_policy()
    device: str = key("auto", DEVICES)
    dtype: str | None = _dtype_of_run()
    arithmetic: str | None = _arithmetic("the run's, or by dtype")
    threads: int | None = key(None, "threads of the simulation on the CPU; null: all cores", low=1)
    torch_threads: int = key(1, "threads of PyTorch", low=1)
    name: str | None = key(None, "appended to the name of the result's folder")
    output_dir: str = key("outputs", "folder that runs are written to and looked up in", path="written")


@dataclass
class ZooConfig:
    """Keys of ``warpvox zoo``."""

    task: str | None = key(None, "show the robot of this task in detail; with file: the best of this task")
    file: str | None = key(
        None,
        "list a released data set of robots instead (EvoGym/robots, EvoGym/robots-with-policies): a Parquet or JSON"
        " file, or a folder of Parquet files",
        path="read",
    )
    evaluate: bool = key(False, "with file and task: evaluate the policies of the robots that are listed")
    add: list[str] = key(
        [],
        "make entries of these: folders of design searches or runs, checkpoints, or patterns; an entry is replaced only"
        " by one of a higher return",
        path="read",
    )
    top: int = key(
        10, "best robots of a task of file that are listed; best designs of a search that add evaluates", low=1
    )
    folder: str | None = key(None, "folder of entries; null: the one of the package", path="written")


@dataclass
class DesignConfig:
    """Keys of ``warpvox design``."""

    file: str | None = key(None, "file in the folder to begin with", path="read")
    folder: str = key(
        "designs", "folder that files are opened and saved in; made when something is saved", path="written"
    )
    tasks: list[str] = key(
        [], "tasks of your own to try bodies in, beside the benchmark's: file.py:NAME, module:NAME", path="read"
    )
    port: int = key(0, "of the server on 127.0.0.1; 0: a free one", low=0, high=65535)
    browser: str = key("auto", "open the page in a browser: on, off, or auto, where there is a display", choices=SHOW)


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
}
"""Commands that take keys, and the dataclass of each."""

PRESET = "preset"
"""The key that takes the name of a folder of ``configs/preset``; each has a YAML file for every command it is for."""

PRESET_OF = {"suite": ("suite", "quick")}
"""Of commands in which that key has another name: the name, and its default."""

GROUPS = ("physics", "ppo", "search", "training")
"""Keys that also take the name of a YAML file in the folder of the same name."""

GROUPS_OF = {"suite": ("physics", "training")}
"""Of commands in which a name of :data:`GROUPS` has another meaning."""
