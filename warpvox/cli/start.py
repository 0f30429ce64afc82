"""The key ``start`` of ``warpvox codesign``: robots known before the search, which its folder has copies of."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpvox.configs.schema import CodesignConfig
from warpvox.design import full_connections
from warpvox.errors import ConfigError
from warpvox.robots.entry import Robot, find_robot, read_robot, save_robot
from warpvox.robots.gait import Gait as RobotGait
from warpvox.runs import ZOO

if TYPE_CHECKING:
    from warpvox.algos.codesign.gaits import Gait

__all__ = ["gaits_of", "history_of", "keep_start", "read_start"]

COPIES = Path("training") / "start"
"""In a search's folder: a search that is resumed does not depend on a zoo or on other files."""


def read_start(config: CodesignConfig, folder: Path | None = None) -> list[Robot]:
    """The robots that the first generation contains.

    Args:
        folder: of the search, which has copies; None: there are none yet.

    Raises:
        RunError, DesignError: no such robot or body. ConfigError: one that the search cannot take.
    """
    if folder is not None:
        return copies_of(folder)
    robots = []
    for text in config.start:
        found = _robots(text, config)
        if not all(robot.fully_connected for robot in found):
            raise ConfigError(f"start={text}: this robot lacks connections, which designs of a search have.")
        robots += found
    return robots


def _robots(text: str, config: CodesignConfig) -> list[Robot]:
    if text.startswith(ZOO):
        return [find_robot(text.removeprefix(ZOO))]
    from warpvox.algos.training.bodies import has_designs, read_bodies

    folder = Path(text).expanduser()
    if folder.is_dir() and not has_designs(folder):
        from warpvox.cli.robot_entries import robots_of

        robot = next(robots_of(folder, 1), None)
        if robot is None:
            raise ConfigError(f"start={text}: this search has evaluated no design yet.")
        return [robot]
    bodies = read_bodies(text, config.seed, "start")
    return [Robot(config.task, body, full_connections(body).T, None) for body in bodies]


def keep_start(robots: Sequence[Robot], folder: Path) -> None:
    """Copy the robots into the folder of a search."""
    for number, robot in enumerate(robots):
        if not (folder / COPIES / f"{number}.npz").is_file():
            save_robot(folder / COPIES / f"{number}.npz", robot)


def copies_of(folder: Path) -> list[Robot]:
    """The robots that the search in ``folder`` began with."""
    return [read_robot(path) for path in sorted((folder / COPIES).glob("*.npz"), key=lambda path: int(path.stem))]


def gaits_of(robots: Sequence[Robot]) -> dict[bytes, Gait]:
    """The gaits of those robots that have one, by the bytes of their bodies."""
    from warpvox.algos.codesign.gaits import Gait
    from warpvox.robots.replay import by_cell

    return {
        robot.body.tobytes(): Gait(robot.policy.begin, robot.policy.period, **by_cell(robot.policy, robot.body))
        for robot in robots
        if isinstance(robot.policy, RobotGait)
    }


def history_of(folder: Path) -> list[dict[str, Any]]:
    """What the zoo tells of the robots that a search began with."""
    return [
        {
            "task": robot.task,
            "sha256": robot.sha256,
            "return": robot.about.get("return"),
            "control_steps": robot.about.get("control_steps"),
            "wall_s": robot.about.get("wall_s"),
            "processor": robot.about.get("processor"),
        }
        for robot in copies_of(folder)
    ]
