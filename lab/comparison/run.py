"""Runner of a comparison: every search on every task with every seed, several in parallel.

    python -m lab.comparison.run outputs/look --tasks Walker-v0 Carrier-v0 --searches ga bo --seeds 3 --designs 24

The same command again leaves out members that are finished and continues interrupted ones.
"""

from __future__ import annotations

import argparse
import ast
import dataclasses
import json
import multiprocessing
import os
import signal
import threading
import traceback
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import warpvox as wv
from warpvox.configs.composition import settings_named
from warpvox.envs.registry import get_task

SHAPES = {"Lifter-v0": [5, 7]}
"""Grid sizes (rows, columns) of the paper's bodies, where not 5 x 5."""
OF_MEMBERS = ("task", "seed", "device", "threads")
"""Settings that a comparison sets itself for every search."""


@dataclass(frozen=True)
class Member:
    """One design search of a comparison: search, task and seed.

    Attributes:
        search: its name in the comparison.
        settings: arguments of ``wv.codesign`` besides task, seed, device, threads and folder; another process gets
            them by pickle.
    """

    task: str
    search: str
    seed: int
    settings: Mapping[str, Any]

    def folder(self, home: Path) -> Path:
        """Folder of the search in the comparison's folder."""
        return home / "members" / self.task / self.search / f"seed{self.seed}"


def named_settings(task: str, search: str, designs: int | None, changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of ``wv.codesign`` for a search given by name, for instance ``bo_paper``.

    Args:
        designs: how many it may evaluate; None: as many as by default.
        changes: values of other keys of ``warpvox codesign``: ``{"training": "fast", "training.iterations": 60}``.
    """
    # Sets of settings that have a name
    names: dict[str, str] = {"search": search}
    for group in ("fitness", "training"):
        if group in changes:
            names[group] = changes[group]
    settings = wv.Codesign(**settings_named("codesign", **names))

    # Single values
    values: dict[str, Any] = {"shape": SHAPES.get(task, [5, 5])}
    if designs is not None:
        values["search.max_designs"] = designs
    values.update(changes)
    for key, value in values.items():
        if key in OF_MEMBERS:
            raise wv.ConfigError(f"{key} is an option of the comparison, the same for all of its searches.")
        if key not in names:
            settings = changed(settings, key, value)
    return {name: value for name, value in vars(settings).items() if name not in OF_MEMBERS}


def changed(settings: Any, key: str, value: Any) -> Any:
    """Change one setting by dotted key."""
    name, _, rest = key.partition(".")
    if name not in [field.name for field in dataclasses.fields(settings)]:
        known = ", ".join(field.name for field in dataclasses.fields(settings))
        raise wv.ConfigError(f"{type(settings).__name__} has no setting '{name}'; there are {known}.")
    if rest:
        value = changed(getattr(settings, name), rest, value)
    return dataclasses.replace(settings, **{name: value})


def finished(folder: Path) -> bool:
    """Return whether the search in ``folder`` has finished."""
    try:
        return json.loads((folder / "summary.json").read_text(encoding="utf-8"))["status"] == "done"
    except (OSError, ValueError, KeyError):
        return False


def run(members: Sequence[Member], home: Path, workers: int, device: str = "cpu") -> list[tuple[Member, str]]:
    """Run all unfinished searches; return those that failed, with their errors.

    Raises:
        RunError: a link stands where a member's folder is to lie; nothing is written.
        KeyboardInterrupt: interrupted; the members have saved their states.
        BrokenProcessPool: a process was killed; what is stored is whole, and the same call continues.
    """
    # A folder that came from elsewhere may hold links that lead out of it.
    for member in members:
        below = member.folder(home).relative_to(home)
        for place in (home / part for part in [below, *below.parents][:-1]):
            if place.is_symlink():
                raise wv.RunError(f"{place} is a link; members of a comparison lie in its own folder.")

    waiting = deque(member for member in members if not finished(member.folder(home)))
    workers = max(1, min(workers, len(waiting)))
    threads = max(1, (os.cpu_count() or 1) // workers)
    total = len(members)
    print(f"{total} members, {total - len(waiting)} of them finished; {workers} at a time, {threads} threads each")

    running: dict[Future[str], Member] = {}
    failed: list[tuple[Member, str]] = []
    context = multiprocessing.get_context("spawn")  # a fork would copy the threads of torch and Warp
    with ProcessPoolExecutor(workers, context, initializer=_begin_process) as pool:
        while waiting or running:
            # One member a process: what is not begun cannot be interrupted
            while waiting and len(running) < workers:
                member = waiting.popleft()
                running[pool.submit(make, member, member.folder(home), device, threads)] = member

            ended, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in ended:
                member = running.pop(future)
                error = future.result()
                if error:
                    failed.append((member, error))
                left = len(waiting) + len(running)
                print(f"{total - left}/{total} {member.task} {member.search} seed {member.seed}: {error or 'finished'}")
    return failed


def make(member: Member, folder: Path, device: str, threads: int) -> str:
    """Run or resume one search in a worker process; return the error message, empty if none."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        options = {"device": device, "threads": threads, "progress": False}
        wv.codesign(member.task, seed=member.seed, folder=folder, **options, **member.settings)
    except wv.WarpvoxError as error:
        return str(error)
    except Exception:  # a defect; the other members go on
        return traceback.format_exc()
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    return ""


def _begin_process() -> None:
    """Set up a worker process: ignore Ctrl-C between searches, and exit with the parent process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None  # of a process of the pool
    parent.join()
    os._exit(1)


def value_of(word: str) -> tuple[str, Any]:
    """Parse ``KEY=VALUE``; a value that is no Python literal is a string."""
    key, given, text = word.partition("=")
    if not given:
        raise argparse.ArgumentTypeError(f"expected KEY=VALUE, got '{word}'")
    try:
        return key, ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return key, text


def part_of(word: str) -> tuple[int, int]:
    """Parse ``K/N`` into two numbers."""
    part, _, parts = word.partition("/")
    if not (part.isdigit() and parts.isdigit() and 1 <= int(part) <= int(parts)):
        raise argparse.ArgumentTypeError(f"expected K/N with K from 1 to N, got '{word}'")
    return int(part), int(parts)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the common command-line options of scripts that run searches."""
    parser.add_argument("folder", type=Path, help="folder of the comparison, new or to be continued")
    parser.add_argument("--workers", type=int, help="members at a time; by default one a core, with a GPU one in all")
    parser.add_argument("--device", default="cpu", help="cpu, cuda, cuda:1, ...")
    parser.add_argument("--part", type=part_of, default=(1, 1), help="K/N: every N-th member from the K-th on")


def run_given(members: Sequence[Member], given: argparse.Namespace) -> int:
    """Run the searches selected on the command line; return the exit code."""
    part, parts = given.part
    workers = given.workers or (os.cpu_count() or 1 if given.device == "cpu" else 1)
    try:
        failed = run(members[part - 1 :: parts], given.folder, workers, given.device)
    except wv.RunError as error:
        print(error)
        return 2
    except BrokenProcessPool:
        print("A process was killed, perhaps for lack of memory; the same command with fewer --workers continues.")
        return 1
    except KeyboardInterrupt:
        print("Interrupted, states saved; the same command continues.")
        return 130
    if failed:
        print(f"{len(failed)} members have failed; the same command tries them again.")
    return 1 if failed else 0


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_options(parser)
    parser.add_argument("--tasks", nargs="+", required=True)
    parser.add_argument("--searches", nargs="+", required=True, help="names that search of warpvox codesign takes")
    parser.add_argument("--seeds", type=int, default=3, help="number of seeds, counted from 0")
    parser.add_argument("--designs", type=int, help="designs that a search may evaluate")
    parser.add_argument(
        "--set", nargs="+", type=value_of, default=[], metavar="KEY=VALUE", help="other keys of warpvox codesign"
    )
    given = parser.parse_args(words)
    try:
        for task in given.tasks:
            get_task(task)
        members = [
            Member(task, search, seed, named_settings(task, search, given.designs, dict(given.set)))
            for seed in range(given.seeds)
            for task in given.tasks
            for search in given.searches
        ]
    except wv.WarpvoxError as error:
        parser.error(str(error))
    return run_given(members, given)


if __name__ == "__main__":
    raise SystemExit(main())
