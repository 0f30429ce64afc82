"""Robots that a design search begins with (``start``), and those that searches and trainings leave."""

import dataclasses
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warpvox.algos.codesign.archive import FILE as ARCHIVE, Archive, Record
from warpvox.algos.codesign.settings import Codesign
from warpvox.algos.training.bodies import has_designs, read_bodies
from warpvox.design import check_design, full_connections
from warpvox.errors import ConfigError, RunError
from warpvox.robots.entry import Robot, check_facts, read_robot, save_robot, zoo
from warpvox.robots.network import Network
from warpvox.robots.replay import policy_of_checkpoint
from warpvox.runs import ZOO, Run, find_codesign, find_run, read_summary

WEIGHT_BITS = 8
"""Last bits of a weight's 23 that entries leave out, so that those of all tasks fit into a megabyte."""
COPIES = Path("training") / "start"
"""In a search's folder: a search that is resumed does not depend on a zoo or on other files."""


def read_start(settings: Codesign, folder: Path | None = None) -> list[Robot]:
    """The robots that the first generation contains.

    Args:
        folder: of the search, which has copies; None: there are none yet.
    """
    if folder is not None:
        return _copies(folder)
    found = [(text, robot) for text in settings.start for robot in _robots(text, settings)]
    for text, robot in found:
        if not robot.fully_connected:
            raise ConfigError(f"start={text}: this robot lacks connections, which designs of a search have.")
    return [robot for _, robot in found]


def _robots(text: str, settings: Codesign) -> list[Robot]:
    if text.startswith(ZOO):
        return [zoo(text.removeprefix(ZOO))]
    folder = Path(text).expanduser()
    if folder.suffix == ".pt" or (folder.is_dir() and not has_designs(folder)):
        robot = next(robots_of(folder, 1), None)
        if robot is None:
            raise ConfigError(f"start={text}: this search has no design with a policy yet.")
        return [robot]
    bodies = read_bodies(text, settings.seed, "start")
    return [Robot(settings.task, body, full_connections(body).T, None) for body in bodies]


def keep_start(robots: Sequence[Robot], folder: Path) -> None:
    """Copy the robots into the folder of a new search, in place of those of one that could not begin there."""
    shutil.rmtree(folder / COPIES, ignore_errors=True)
    for number, robot in enumerate(robots):
        save_robot(folder / COPIES / f"{number}.npz", robot)


def _copies(folder: Path) -> list[Robot]:
    """The robots that the search in ``folder`` began with; files of another kind of name are not its own."""
    own = [path for path in (folder / COPIES).glob("*.npz") if path.stem.isdecimal()]
    return [read_robot(path) for path in sorted(own, key=lambda path: int(path.stem))]


def robots_of(source: Path, top: int) -> Iterator[Robot]:
    """The robots that a search or training has left, with what its files say of them.

    Args:
        source: folder of a design search, of a design in one (``designs/17``) or of a training, or a checkpoint in the
            latter.
    """
    if (source / ARCHIVE).is_file():
        return _of_search(source, lambda archive: trained(archive)[:top])
    search = source.absolute().parent.parent
    if source.name.isdecimal() and (search / ARCHIVE).is_file():
        return _of_search(search, lambda archive: [archive.record(int(source.name))])
    return _of_run(source)


def _of_search(folder: Path, choose: Callable[[Archive], list[Record]]) -> Iterator[Robot]:
    run = find_codesign(str(folder), "")
    with Archive.read(folder / ARCHIVE) as archive:
        records = choose(archive)
        steps = sum(row["steps"] or 0 for row in archive.generations())
    about = _about(run) | {"control_steps": steps}
    start: list[dict[str, Any]] = []
    for robot in _copies(folder):  # what a robot has cost includes those that it was made from
        names = ["return", "control_steps", "wall_s", "processor", "commit"]
        names += ["command" if "command" in robot.about else "config"]  # of the zoo, or of a search as it is
        known = {name: robot.about[name] for name in names if name in robot.about}
        start += [*robot.about.get("start", ()), {"task": robot.task, "sha256": robot.sha256} | known]
        for name in "control_steps", "wall_s":
            about[name] = (about[name] or 0) + (known.get(name) or 0)
    if start:
        about["start"] = start
    for record in records:
        if record.policy is None:
            raise RunError(f"Design {record.id} of {folder} has no policy of its own.")
        known = about | {"design": record.id, "design_steps": record.steps, "fitness": record.fitness}
        yield _robot(run.config["task"], record.candidate.body, folder / record.policy, known)


def trained(archive: Archive) -> list[Record]:
    """The designs with a policy of their own, the best first; finalists alone, where others were only compared."""
    return [record for record in archive.winners(max(1, archive.count())) if record.policy is not None]


def _of_run(path: Path) -> Iterator[Robot]:
    run = find_run(str(path), "")
    if run.is_many or run.config.get("obs", "task") != "task" or isinstance(run.config["design"], dict):
        raise RunError(
            f"{path}: the zoo has single robots with their own body that observe what the task has (obs=task)."
        )
    yield _robot(run.config["task"], check_design(run.config["design"]), run.find_checkpoint("best"), _of_training(run))


def _of_training(run: Run) -> dict[str, Any]:
    """Facts from the files of a training; what it has cost includes the one whose policy it began with."""
    about: dict[str, Any] = _about(run) | {"control_steps": read_summary(run.folder).get("steps")}
    if source := run.config.get("pretrained"):
        about["config"]["pretrained"] = _place(source)
        try:
            known = _of_training(find_run(source, ""))
        except RunError:  # a file by itself, or of a run that is gone: nobody knows what it has cost
            return about | {"control_steps": None, "wall_s": None}
        for name in "control_steps", "wall_s":
            spent = about[name], known[name]
            about[name] = None if None in spent else sum(spent)
        names = ("control_steps", "wall_s", "processor", "commit", "config")
        about["start"] = [*known.get("start", ()), {name: known[name] for name in names}]
    return about


def _robot(task: str, body: np.ndarray, checkpoint: Path, about: dict[str, Any]) -> Robot:
    policy = policy_of_checkpoint(checkpoint)
    if isinstance(policy, Network):
        arrays = {name: tuple(map(_shorter, getattr(policy, name))) for name in ("weights", "biases")}
        policy = dataclasses.replace(policy, **arrays)
    return Robot(task, body, full_connections(body).T, policy, about)


def _shorter(values: np.ndarray) -> np.ndarray:
    """float32 numbers whose last bits are zero."""
    bits = np.ascontiguousarray(values, np.float32).view(np.uint32).astype(np.uint64) + (1 << (WEIGHT_BITS - 1))
    return (bits & ~np.uint64((1 << WEIGHT_BITS) - 1)).astype(np.uint32).view(np.float32)


def _place(path: str) -> str:
    """The end of a path, which says as much elsewhere as the whole."""
    return "/".join(Path(path).parts[-3:])


def _about(run: Run) -> dict[str, Any]:
    """Facts from the files of a search or training."""
    summary = read_summary(run.folder)
    known = {name: summary.get(name) for name in ("version", "commit", "processor")}
    config = {name: value for name, value in run.config.items() if name not in ("output_dir", "name")}
    if "start" in config:
        config["start"] = [text if ":" in text else _place(text) for text in config["start"]]
    about = {"wall_s": summary.get("elapsed_seconds"), **known, "config": config}
    try:
        check_facts(about)  # before hours of evaluations
    except RunError as error:
        raise RunError(f"{run.folder}: {error}") from None
    return about
