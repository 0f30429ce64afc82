"""Search for runs and design searches by name: ``latest``, a folder, a checkpoint, a pattern, ``zoo:TASK``."""

import glob
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from warpvox.algos.archive import BACKUP, FILE as ARCHIVE, Archive, archives_in, repair_hint
from warpvox.algos.robots.entry import Robot, zoo
from warpvox.errors import RunError, listing
from warpvox.io.reading import CONFIG, read_config
from warpvox.runs import CODESIGN, STAMP_LENGTH, STATE, TRAINING, ZOO, Run, as_now, without_services

NEEDED = {
    "train": ("a training", {"task", "design", "ppo"}),
    CODESIGN: ("a design search", {"task", "search", "training"}),
}
"""Kind of run made by each command, and keys that its configuration must contain."""


def find_run(text: str, output_dir: str, commands: Sequence[str] = (*TRAINING, CODESIGN), resume: bool = False) -> Run:
    """Find a run by ``latest``, its folder, a checkpoint file in it, or ``zoo:TASK``.

    A design search stands for its best design; the folders ``designs/<id>`` in it are runs of their own.

    Args:
        commands: whose runs ``latest`` may be.
        resume: ``latest`` may be a run that was stopped before it had a checkpoint to play.
    """
    if text.startswith(ZOO) and not resume:
        return run_of_robot(zoo(text.removeprefix(ZOO)))
    path = _latest(Path(output_dir), commands, resume) if text == "latest" else Path(text).expanduser()
    if not path.exists():
        raise RunError(f"There is no run at {path}: expected latest, the folder of a run or a checkpoint in it.")
    folder = _folder_of(path)
    if (folder / ARCHIVE).is_file():
        with Archive.read(folder / ARCHIVE) as archive:
            as_now(archive.settings, folder)
            best = [record for record in archive.best() if record.policy_file is not None]
        if not best:
            raise RunError(f"The design search {folder} has no design with a policy yet.")
        path = folder = (folder / str(best[0].policy_file)).parent
    return Run(folder, _config_of(folder, "train"), path if path.is_file() else None)


def run_of_robot(robot: Robot) -> Run:
    """Create a run object for a stored robot."""
    policy = "mlp" if robot.has_feedback else "gait"
    known = {"task": robot.task, "design": robot.body.tolist(), "rules": "evogym", "obs": robot.obs}
    return Run(Path(robot.source or f"{ZOO}{robot.task}"), known | {"policy": policy}, robot=robot)


def _folder_of(path: Path) -> Path:
    """Return the run's folder that contains ``path``, or ``path`` itself."""
    if path.is_dir():
        return path
    if not (path.parent / CONFIG).is_file():
        raise RunError(f"{path} is a file in a folder that is no run: there is no {CONFIG} beside it.")
    return path.parent


def find_runs(texts: Sequence[str], output_dir: str) -> list[Run]:
    """Find all runs given by name (see :func:`find_run`) or by pattern, without duplicates.

    Other files and folders that a pattern such as ``outputs/train/*/*`` matches are ignored.
    """
    found: dict[tuple[Path, Path | None], Run] = {}
    for text in texts:
        names = [text]
        if (paths := matches(text)) is not None:
            _, keys = NEEDED["train"]
            names = []
            for path in paths:
                home = path.parent if path.match("model_*.pt") else path
                if (home / CONFIG).is_file() and (keys <= read_config(home).keys() or (home / ARCHIVE).is_file()):
                    names.append(str(path))
            if not names:
                raise RunError(f"No training or design search matches {text}.")
        for name in names:
            run = find_run(name, output_dir)
            found[run.folder.resolve(), run.checkpoint] = run
    if not found:
        raise RunError("There are no runs: runs=[] names none.")
    return list(found.values())


def matches(text: str) -> list[Path] | None:
    """Expand a pattern to the matching paths; None: ``text`` is not a pattern."""
    pattern = os.path.expanduser(text)
    if not any(mark in text for mark in "*?[") or Path(pattern).exists():
        return None
    return sorted(map(Path, glob.glob(pattern, recursive=True)))


def find_codesign(text: str, output_dir: str) -> Run:
    """Find a design search by ``latest`` or its folder."""
    path = _latest(Path(output_dir), (CODESIGN,)) if text == "latest" else Path(text).expanduser()
    if not path.exists():
        raise RunError(f"There is no design search at {path}: expected latest or the folder of one.")
    folder = _folder_of(path)
    content = _config_of(folder, CODESIGN)
    if not (folder / ARCHIVE).is_file():
        hint = repair_hint(folder / ARCHIVE)
        why = f".{hint}" if hint else ": the search was stopped before its first design; start it again."
        raise RunError(f"{folder} has no {ARCHIVE}{why}")
    return Run(folder, content)


def find_searches(texts: Sequence[str], output_dir: str) -> list[Path]:
    """Find the folders of design searches by name, without duplicates; empty if ``texts`` name other runs.

    A text is ``latest``, the folder of a search, one that searches lie in, or a pattern of such.
    """
    found: dict[Path, Path] = {}
    others = []
    for text in texts:
        named = _latest(Path(output_dir), (*TRAINING, CODESIGN)) if text == "latest" else Path(text).expanduser()
        paths = matches(text) or [named]
        folders = [folder for path in paths for folder in archives_in(path)]
        found |= {folder.resolve(): folder for folder in folders}
        others += [] if folders else [text]
    if found and others:
        raise RunError(f"Some of what is named are design searches; {listing(others)} is none and has none in it.")
    return list(found.values())


def _config_of(folder: Path, command: str) -> dict[str, Any]:
    """Read a run's configuration; RunError unless the run was made by ``command``."""
    if not (folder / CONFIG).is_file():
        raise RunError(f"{folder} is not a run: it has no {CONFIG}.")
    content = read_config(folder)
    what, keys = NEEDED[command]
    if not keys <= content.keys():
        raise RunError(f"{folder} is not {what}: its {CONFIG} is that of another run.")
    return without_services(as_now(content, folder))


def _latest(root: Path, commands: Sequence[str], resume: bool = False) -> Path:
    """Return the newest run folder of these commands in ``root``."""
    folders = []
    for command in commands:
        # Files that show that a run has begun
        signs = ["model_*.pt", *[STATE] * resume]
        if command == CODESIGN:
            signs = [ARCHIVE, BACKUP]
        for file in root.glob(f"{command}/*/*/{CONFIG}"):
            if any(next(file.parent.glob(sign), None) for sign in signs):
                folders.append(file.parent)
    if not folders:
        raise RunError(f"There is no run in {root / commands[0]} yet.")
    # Names begin with date and time of the start; runs of the same second are sorted by the time of their first file.
    return max(folders, key=lambda folder: (folder.name[:STAMP_LENGTH], (folder / CONFIG).stat().st_mtime_ns))
