"""Run folders: ``outputs/<command>/<task>/<date_time>[_name]/``."""

import dataclasses
import errno
import functools
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from warpvox import __version__
from warpvox.checks import is_number
from warpvox.code import code_of, same_code
from warpvox.errors import ConfigError, RunError, StorageError, listing
from warpvox.io.reading import CONFIG, END, SUMMARY, read_facts
from warpvox.io.writing import (
    MARK,
    check_encodable,
    check_writable,
    claimed,
    complaint,
    sweep,
    to_json,
    write_bytes,
    write_text,
)
from warpvox.system import is_device_name, processor_name

ZOO = "zoo:"
"""Prefix that names a stored robot of the zoo in place of a run or a design."""
BEST = "model_best.pt"
STATE = "state.pt"
"""File with the complete training state, to resume from; only the newest is kept."""
TRAINING = ("train",)
CODESIGN = "codesign"
label: ContextVar[str] = ContextVar("label", default="")
"""Label of a run in a sweep, for its folder's name: the values that differ from other runs."""
STAMP, STAMP_LENGTH = "%Y-%m-%d_%H-%M-%S", 19
_NOT_IN_NAMES = re.compile(r"[^\w.+-]+")
_LONGEST_NAME, LONGEST_BYTES = 100, 150
"""Maximum lengths, in characters and bytes, of a name within a folder's name (limit: 255 bytes)."""


@dataclass(frozen=True)
class Run:
    """The folder of a training, or a stored robot; ``checkpoint`` is set if the user named a single file.

    ``robot``: instead of a folder, a stored robot (``zoo:Walker-v0``).
    """

    folder: Path
    config: dict[str, Any]
    checkpoint: Path | None = None
    robot: Any = None

    @property
    def is_many(self) -> bool:
        """Whether the run's policy was trained on many bodies."""
        designs = self.config.get("designs")
        return isinstance(designs, Mapping) and designs.get("bodies") is not None

    @property
    def iterations(self) -> list[int]:
        """Iterations with a checkpoint, ascending."""
        found = (re.fullmatch(r"model_(\d+)\.pt", file.name) for file in self.folder.iterdir())
        return sorted(int(match[1]) for match in found if match)

    def find_checkpoint(self, which: str) -> Path:
        """Return the path of a checkpoint: ``best`` (the last one without evaluations), ``last`` or an iteration.

        If the run was named by a checkpoint, that one.
        """
        which = str(which)
        if self.checkpoint is not None:
            if which != "best":
                raise RunError(f"checkpoint={which} goes with the folder of a run; {self.checkpoint} is a checkpoint.")
            return self.checkpoint
        if which == "best" and (self.folder / BEST).is_file():
            return self.folder / BEST
        known = self.iterations
        if not known:
            raise RunError(f"The run {self.folder} has no checkpoint yet.")
        if which in ("best", "last"):
            return self.folder / f"model_{known[-1]}.pt"
        if not which.isdigit() or int(which) not in known:
            raise RunError(f"checkpoint must be best, last or one of {listing(known)}, got '{which}'.")
        return self.folder / f"model_{which}.pt"


def without_services(stored: Mapping[str, Any]) -> dict[str, Any]:
    """Remove settings that connect to a service; the user has to give these again.

    A logger may send figures to the user's own account, and who connects to a Ray cluster can be made to run code.
    """
    kept = {key: value for key, value in stored.items() if key != "address"}
    if kept.get("logger") not in ("tensorboard", "none"):
        kept.pop("logger", None)
    return kept


def as_now(stored: Mapping[str, Any], place: object) -> dict[str, Any]:
    """Convert the stored settings of a training or design search to the keys of the present version.

    Raises:
        RunError: they ask for something that later versions do not have; ``place`` is where they are from.
    """
    parts = {name: dict(value) for name, value in stored.items() if isinstance(value, Mapping)}
    settings = {**stored, **parts}

    # Keys that a search no longer has
    if "search" in settings:
        training = parts.get("training", {})
        kind = parts.get("evaluation", {}).get("name")
        gone = {
            "policy": (settings.pop("policy", "mlp"), "mlp"),
            "network": (settings.pop("network", None), None),
            "training.method": (training.pop("method", "population"), "population"),
            "evaluation": (kind if kind in ("shared", "few_shot") else None, None),
        }
        for key, (value, usual) in gone.items():
            if value != usual:
                raise RunError(
                    f"{place} is a search of warpvox 0.1.0 with {key}={value}, which later versions do not have."
                )
        training.pop("save_interval", None)

    # Keys that have another name
    if settings.get("fitness") in ("nominal", "robust"):
        settings["protocol"] = settings.pop("fitness").replace("robust", "noise")
    names = {"evaluation": "fitness", "eval_envs": "episodes", "max_evaluations": "max_designs"}
    for values in (parts.get("search", {}), parts.get("training", {}), settings):
        for name in names.keys() & values.keys():
            values[names[name]] = values.pop(name)
    return settings


@contextmanager
def new_folder(output_dir: str, command: str, task: str, name: str | None, config: str) -> Iterator[Path]:
    """Create a run's folder with its ``config.yaml``; delete it if the block fails before any result."""
    check_name(name)
    stamp = datetime.now().strftime(STAMP)
    if ":" in task:  # a task of the user's own, module:NAME, is known by its id
        from warpvox.envs.registry import get_task

        task = get_task(task).id
        if len(os.fsencode(task)) > LONGEST_BYTES:
            raise ConfigError(
                f"The id of the task names a folder and may have {LONGEST_BYTES} bytes at most, got '{task:.30}...'."
            )
    parent = Path(output_dir) / command / task
    made = [folder for folder in (parent, *parent.parents) if not folder.exists()]
    folder = _make_folder(parent, stamp, "".join(f"_{part}" for part in (name, label.get()) if part))
    try:
        with _open_folder(folder, config):
            yield folder
    except BaseException:
        found = [file.name for file in folder.glob("*.*") if file.suffix in (".pt", ".npz", ".json", ".sqlite")]
        # the state before the first iteration holds nothing that the configuration does not
        if folder.is_dir() and all(name.startswith((MARK, "state")) for name in found):
            shutil.rmtree(folder, ignore_errors=True)
            for empty in made:
                if empty.is_dir() and not any(empty.iterdir()):
                    empty.rmdir()
        raise


def check_output(config: Any) -> None:
    """Raise an error if a command cannot write its folder: the name is invalid, or the disk is full or read-only."""
    check_name(getattr(config, "name", None))
    if not any(getattr(config, key, None) for key in ("resume", "report")) and hasattr(config, "name"):
        check_writable(config.output_dir)


def check_name(name: str | None) -> None:
    """Raise ConfigError unless ``name`` can be the end of a folder's name."""
    if name and (not name.strip(".") or is_device_name(name)):
        raise ConfigError(f"name cannot be '{name}', which stands for something else than a folder of its own.")
    if name and _NOT_IN_NAMES.search(name):
        raise ConfigError(f"name may hold letters, digits and . _ + - only, got '{name:.200}'.")
    if name and (len(name) > _LONGEST_NAME or len(os.fsencode(name)) > LONGEST_BYTES):
        raise ConfigError(f"name may have {_LONGEST_NAME} characters ({LONGEST_BYTES} bytes) at most, got {len(name)}.")


def as_name(text: str) -> str:
    """Convert any ``text`` to a valid folder name: letters, digits and . _ + - only."""
    name = _NOT_IN_NAMES.sub("_", text).encode(errors="replace")[:_LONGEST_NAME].decode(errors="ignore")
    return name.strip(".")


def _make_folder(parent: Path, stamp: str, ending: str = "") -> Path:
    """Create a new folder; runs that start in the same second are numbered."""
    check_encodable(parent)
    for number in range(1, 1000):
        folder = parent / (stamp + (f"-{number}" if number > 1 else "") + ending)
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            if not parent.is_dir():
                raise RunError(f"{parent} cannot be made: a file is in the way.") from None
            continue
        except OSError as error:
            reason = "it cannot be created there" if error.errno == errno.ENOENT else complaint(error)
            raise StorageError(f"The folder {folder} cannot be made: {reason}.", error) from None
        return folder
    raise RunError(f"{parent} has too many runs of this second.")


def run_folder(
    folder: Path | None,
    config: Any,
    command: str,
    text: str,
    place: Path | None = None,
    known: Collection[str] = (),
    check: Callable[[], object] = lambda: None,
) -> AbstractContextManager[Path]:
    """Open the folder of a run within a block: ``folder`` to resume, or a new one; writes ``config.yaml``.

    Args:
        place: of a new one; None: it lies in ``output_dir`` and is named by the time.
        known: files that may be there, of a run that was stopped when it began, besides what it left half written.
        check: of a run that is resumed: see :func:`_open_folder`.
    """
    if folder is not None:
        return _open_folder(folder, text, check)
    if place is None:
        return new_folder(config.output_dir, command, config.task, config.name, text)
    if place.exists() and not (
        place.is_dir() and all(file.name in known or file.name.startswith(MARK) for file in place.iterdir())
    ):
        raise RunError(f"{place} exists already: name another folder, or resume={place} to go on with a run.")
    check_encodable(place)
    place.mkdir(parents=True, exist_ok=True)
    return _open_folder(place, text)


@contextmanager
def _open_folder(folder: Path, config: str, check: Callable[[], object] = lambda: None) -> Iterator[Path]:
    """Lock a run's folder, remove unfinished files, write ``config.yaml``, and yield the folder.

    ``check``: called before anything is written; until then another process may have gone on with the run.
    """
    with claimed(folder):
        check()
        sweep(folder)
        try:
            write_text(folder / CONFIG, config + END, make_folders=False)
            yield folder
        finally:
            # an interrupt may come when a temporary file is made and the block that would remove it has not begun
            sweep(folder)


def keep_code(settings: Any, folder: Path) -> None:
    """Copy the user's own code named in the settings into the run's folder, for readers; it is never imported."""
    for key, text in code_of(settings).items():
        place = text.rpartition(":")[0]
        if not place.endswith(".py"):
            place = getattr(sys.modules.get(place), "__file__", None) or ""
        source = Path(place).expanduser()
        if source.is_file():
            write_bytes(folder / "code" / key / source.name, source.read_bytes())


def read_summary(folder: Path) -> dict[str, Any]:
    """Read the valid entries of ``summary.json``; empty if the file is missing or unreadable."""
    known = read_facts(folder / SUMMARY)
    fresh = known.get("fresh_seeds")
    judged = isinstance(fresh, dict) and all(is_number(fresh.get(name)) for name in ("mean", "low", "high", "episodes"))
    numbers = ("evaluations", "steps", "elapsed_seconds", "best_fitness")
    good = {name: is_number(known.get(name)) for name in numbers} | {"fresh_seeds": judged}
    return {name: value for name, value in known.items() if good.get(name, True)}


def write_summary(folder: Path, content: dict[str, Any]) -> None:
    """Write ``summary.json``: ``content`` plus version, commit and processor."""
    # The processor, and the GPU that this process has used
    processors = [processor_name()]
    torch = sys.modules.get("torch")
    if torch is not None and torch.cuda.is_initialized():
        with suppress(RuntimeError):  # of a device that has failed, which is reported elsewhere
            processors.append(torch.cuda.get_device_name())

    made = {"version": __version__, "commit": _commit(), "processor": ", ".join(processors)}
    write_text(folder / SUMMARY, to_json(content | made) + "\n", make_folders=False)


@functools.cache
def _commit() -> str | None:
    """Return the git commit, with ``-dirty`` if files were changed; None without a git checkout."""
    root = Path(__file__).resolve().parents[1]
    if not (root / ".git").exists():
        return None
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        # git may wait for the disk of a network.
        done = subprocess.run(command, capture_output=True, text=True, timeout=20.0, stdin=subprocess.DEVNULL)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip() or None if done.returncode == 0 else None


def check_unchanged(before: Mapping[str, Any], config: Any, changeable: Sequence[str]) -> None:
    """Raise ConfigError if a resumed run changes a setting that is not ``changeable``."""
    for key, old, new in _changes(before, config):
        if key not in changeable:
            raise ConfigError(
                f"{key} cannot change when a run is resumed (it has {old}, asked for {new});"
                f" what can: {listing(changeable[:-2])}."
            )


def _changes(before: Mapping[str, Any], config: Any, prefix: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yield dotted key, stored value and new value of every changed setting."""
    for item in dataclasses.fields(config):
        old = before.get(item.name)
        new = getattr(config, item.name)
        if dataclasses.is_dataclass(new) and isinstance(old, Mapping):
            yield from _changes(old, new, f"{prefix}{item.name}.")
        elif item.name in before and old != new and not same_code(old, new):
            yield prefix + item.name, old, new
