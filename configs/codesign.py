"""The keys of ``warpvox codesign`` and ``warpvox suite``."""

# ruff: noqa: RUF009  (key() is dataclasses.field with a meaning)

from dataclasses import dataclass
from typing import Any

from warpvox.algos.codesign.archive_export import FORMATS
from warpvox.algos.codesign.evaluations import EVALUATIONS, Evaluation
from warpvox.algos.codesign.settings import Codesign
from warpvox.algos.search.settings import ALGORITHMS, SearchSettings
from warpvox.algos.training.settings import DEVICES, MOST_THREADS, RAY
from warpvox.configs.schema import CONFIG_FILE, PresetConfig
from warpvox.keys import MISSING, key


@dataclass
class CodesignConfig(Codesign, PresetConfig):
    search: SearchSettings = key(MISSING, "how designs are proposed", nodes=ALGORITHMS)
    evaluation: Evaluation = key(MISSING, "how designs are compared", nodes=EVALUATIONS)
    export: list[str] = key(
        [],
        "formats in which the archive is written at the end: csv, parquet, npz and json (designs)",
        choices=tuple(FORMATS),
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
class SuiteConfig:
    """Keys of ``warpvox suite``; those of ``warpvox codesign`` that are given as well hold for all of its searches."""

    suite: str = key(
        "quick", "a named set of tasks, searches, seeds and budgets, which the keys that are given override"
    )
    tasks: list[str] = key(
        [], "task ids, all (the 32) or benchmark10 (the ten of the paper's main comparison)", path="read"
    )
    searches: list[str] = key([], "searches to compare, named as for search of codesign")
    seeds: Any = key(3, "seeds of each task and search: [0,1,2], or their number, counted from 0")
    evaluations: Any = key(
        250, "designs that a search may train: a number, or by task, difficulty and default: {easy:250,Lifter-v0:750}"
    )
    control_steps: Any = key(
        None,
        "instead of evaluations: about how many control steps of training a search may spend; a number, or by task",
    )
    shape: Any = key(
        None, "rows and columns of the bodies, or by task; null: the paper's, [5,5] and [5,7] for Lifter-v0"
    )
    codesign: list[str] = key(
        [], "keys of `warpvox codesign` for all searches that have them, given by themselves (training.envs=16) or here"
    )
    executor: str = key(
        "local",
        "where searches run: in processes of this machine (local) or in tasks of Ray (ray)",
        choices=("local", "ray"),
    )
    address: str | None = key(None, RAY)
    workers: int | None = key(
        None,
        "searches that run at the same time; null: one per core as far as memory allows (device=cuda: one;"
        " executor=ray: as many as there is room for)",
        low=1,
    )
    device: str = key("auto", DEVICES)
    threads: int | None = key(
        None, "threads of a search's simulation; null: cores / workers (executor=ray: one)", low=1, high=MOST_THREADS
    )
    resume: str | None = key(
        None, "continue a suite: latest or its folder; tasks, searches and seeds may be added", path="read"
    )
    retry: bool = key(False, "with resume: run failed searches again")
    report: str | None = key(
        None, "only make curves.csv and the report of a suite again: latest or its folder", path="read"
    )
    name: str | None = key(None, "name of the suite's folder; null: date and time")
    output_dir: str = key("outputs", "folder that runs are written to", path="written")
    config: str | None = key(
        None, "file to take values from, such as a suite's config.yaml; keys that are given override them", path="read"
    )
