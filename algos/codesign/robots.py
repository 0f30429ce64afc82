"""Robots that searches and trainings leave, and those that a design search begins with (``start``)."""

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from warpvox.algos.archive import FILE as ARCHIVE, Archive, Record
from warpvox.algos.checkpoints.policy import read_policy
from warpvox.algos.codesign.settings import Codesign
from warpvox.algos.find import find_codesign, find_run
from warpvox.algos.robots.entry import Robot, read_robot, save_robot, zoo
from warpvox.algos.training.bodies import has_designs, read_bodies
from warpvox.design import check_design, full_connections
from warpvox.errors import ConfigError, RunError
from warpvox.runs import ZOO

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
        robots = robots_of(folder)
        if not robots:
            raise ConfigError(f"start={text}: this search has no design with a policy yet.")
        return robots
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


def robots_of(source: str | Path, top: int = 1) -> list[Robot]:
    """The robots that a design search or a training has left, the best first; nothing is known of them but this.

    Args:
        source: folder of a design search, of a design in one (``designs/17``) or of a training, or a checkpoint in the
            latter.
        top: most designs of a search; those that were only compared have no policy of their own.

    Raises:
        RunError: no such run, or its policies are of another kind than a stored robot has.
    """
    source = Path(source)
    search = source.absolute().parent.parent
    if (source / ARCHIVE).is_file():
        return _of_search(source, lambda archive: _trained(archive)[:top])
    if source.name.isdecimal() and (search / ARCHIVE).is_file():
        return _of_search(search, lambda archive: [archive.record(int(source.name))])
    return [_of_run(source)]


def _of_search(folder: Path, choose: Callable[[Archive], list[Record]]) -> list[Robot]:
    run = find_codesign(str(folder), "")
    with Archive.read(folder / ARCHIVE) as archive:
        records = choose(archive)
    robots = []
    for record in records:
        if record.policy is None:
            raise RunError(f"Design {record.id} of {folder} has no policy of its own.")
        robots.append(_robot(run.config["task"], record.candidate.body, folder / record.policy))
    return robots


def _trained(archive: Archive) -> list[Record]:
    """The designs with a policy, the best first."""
    return [record for record in archive.best(max(1, archive.count())) if record.policy is not None]


def _of_run(path: Path) -> Robot:
    run = find_run(str(path), "")
    if run.is_many or run.config.get("obs", "task") != "task" or isinstance(run.config["design"], dict):
        raise RunError(
            f"{path}: stored robots are single ones with their own body that observe what the task has (obs=task)."
        )
    return _robot(run.config["task"], check_design(run.config["design"]), run.find_checkpoint("best"))


def _robot(task: str, body: np.ndarray, checkpoint: Path) -> Robot:
    return Robot(task, body, full_connections(body).T, read_policy(checkpoint))
