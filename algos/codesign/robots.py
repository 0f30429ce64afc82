"""Stored robots made from searches and trainings, and the robots that start a search."""

import shutil
from collections.abc import Sequence
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

_COPIES = Path("training") / "start"
"""Subfolder with copies of the robots that a search started from, so that resuming needs no other files."""


def read_start(settings: Codesign, folder: Path | None = None) -> list[Robot]:
    """Load the robots of the first generation from ``settings.start``, or their copies in ``folder``.

    Args:
        folder: of the search, which has copies; None: there are none yet.
    """
    if folder is not None:
        # The search names its copies by numbers.
        copies = [path for path in (folder / _COPIES).glob("*.npz") if path.stem.isdecimal()]
        return [read_robot(path) for path in sorted(copies, key=lambda path: int(path.stem))]

    found = []
    for text in settings.start:
        path = Path(text).expanduser()
        if text.startswith(ZOO):
            robots = [zoo(text.removeprefix(ZOO))]
        elif path.suffix == ".pt" or (path.is_dir() and not has_designs(path)):
            robots = robots_of(path)
            if not robots:
                raise ConfigError(f"start={text}: this search has no design with a policy yet.")
        else:
            bodies = read_bodies(text, settings.seed, "start")
            robots = [Robot(settings.task, body, full_connections(body).T, None) for body in bodies]
        if not all(robot.fully_connected for robot in robots):
            raise ConfigError(f"start={text}: this robot lacks connections, which designs of a search have.")
        found += robots
    return found


def keep_start(robots: Sequence[Robot], folder: Path) -> None:
    """Copy the starting robots into the folder of a new search."""
    shutil.rmtree(folder / _COPIES, ignore_errors=True)
    for number, robot in enumerate(robots):
        save_robot(folder / _COPIES / f"{number}.npz", robot)


def robots_of(source: str | Path, top: int = 1) -> list[Robot]:
    """Convert the best designs of a search, or the result of a training, to stored robots, best first.

    Args:
        source: folder of a design search, of a design in one (``designs/17``) or of a training, or a checkpoint in the
            latter.
        top: most designs of a search; those that were only compared have no policy of their own.

    Raises:
        RunError: no such run, or its policies are of another kind than a stored robot has.
    """
    source = Path(source)
    search = source.absolute().parent.parent

    # A design search, or a design of one
    if (source / ARCHIVE).is_file():
        with Archive.read(source / ARCHIVE) as archive:
            ranked = archive.best(max(1, archive.count()))
        return _robots_of_search(source, [record for record in ranked if record.policy_file is not None][:top])
    if source.name.isdecimal() and (search / ARCHIVE).is_file():
        with Archive.read(search / ARCHIVE) as archive:
            record = archive.record(int(source.name))
        return _robots_of_search(search, [record])

    # A training
    run = find_run(str(source), "")
    if run.is_many or run.config.get("obs", "task") != "task" or isinstance(run.config["design"], dict):
        raise RunError(
            f"{source}: stored robots are single ones with their own body that observe what the task has (obs=task)."
        )
    return [_robot(run.config["task"], check_design(run.config["design"]), run.find_checkpoint("best"))]


def _robots_of_search(folder: Path, records: Sequence[Record]) -> list[Robot]:
    """Convert designs of the search in ``folder`` to stored robots."""
    run = find_codesign(str(folder), "")
    robots = []
    for record in records:
        if record.policy_file is None:
            raise RunError(f"Design {record.id} of {folder} has no policy of its own.")
        robots.append(_robot(run.config["task"], record.candidate.body, folder / record.policy_file))
    return robots


def _robot(task: str, body: np.ndarray, checkpoint: Path) -> Robot:
    """Create a stored robot from a body and the policy of a checkpoint."""
    return Robot(task, body, full_connections(body).T, read_policy(checkpoint))
