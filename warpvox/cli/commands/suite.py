"""``warpvox suite``: design searches for many tasks, searches and seeds in one folder, gone on with as a whole."""

import dataclasses
import re
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from pathlib import Path

from rich.console import Console

from warpvox.algos.suite.members import FAILED, MEMBERS, RUNNING, WAITING, Member, Table
from warpvox.algos.suite.progress import results
from warpvox.cli.application import run_command
from warpvox.cli.config import load, load_values
from warpvox.cli.overrides import check_report, key_and_value
from warpvox.cli.suite_plan import gone_on_with, merged, plan, seeds_of, task_names
from warpvox.code import is_code
from warpvox.configs.codesign import SuiteConfig
from warpvox.errors import ConfigError, RunError, counted, listing
from warpvox.io.console import echo, shell_argument, shown
from warpvox.io.writing import check_links, check_writable, claimed, to_yaml
from warpvox.runs import STAMP, check_unchanged, find_suite, make_folder, run_folder
from warpvox.trust import COPIES, STORED, again, keep_code

GROWING = ("tasks", "searches", "seeds")
"""Keys that may get more entries when a suite is resumed."""
CHANGEABLE = (*GROWING, "retry", "executor", "address", "workers", "device", "threads", "name", "resume", "output_dir")


@dataclass
class Job:
    """A suite to be made: its members; of the one that it goes on with the folder, and the words that are stored."""

    config: SuiteConfig
    members: list[Member] = field(default_factory=list)
    folder: Path | None = None
    words: list[str] = field(default_factory=list)


def run(words: list[str]) -> None:
    own, typed = split(words)
    run_command("suite", own, suite, partial(_prepare, typed))


def split(words: list[str]) -> tuple[list[str], list[str]]:
    """The words about the suite, and those about all of its design searches: keys that only these have."""
    own = {*SuiteConfig.__dataclass_fields__, "hydra"}
    typed = [word for word in words if "=" in word and word[0] != "-" and re.split("[.=/]", word)[0] not in own]
    return [word for word in words if word not in typed], typed


def _prepare(typed: list[str], config: SuiteConfig, overrides: list[str], config_dir: Path | None) -> Job:
    """The job of a configuration; with ``resume`` on top of that of the suite that it goes on with."""
    named = {word.partition("=")[0] for word in overrides}
    if {"evaluations", "control_steps"} <= named:
        raise ConfigError("evaluations and control_steps are both a budget: give one of them.")
    if config.report is not None:
        check_report((word.partition("=")[0] for word in [*overrides, *typed]), ("output_dir",))
        return Job(config)
    if config.resume is not None:
        job = _resumed(config, typed, overrides, config_dir)
    elif config.retry:
        raise ConfigError("retry=true goes with resume=latest or resume=FOLDER.")
    else:
        job = Job(dataclasses.replace(config, codesign=merged(config.codesign, typed, config.output_dir)))
    if config.executor == "local" and config.address is not None:
        raise ConfigError("address goes with executor=ray.")
    job.members = plan(job.config, config_dir)
    _check(job)
    return job


def _resumed(config: SuiteConfig, typed: list[str], overrides: list[str], config_dir: Path | None) -> Job:
    source = find_suite(str(config.resume), config.output_dir)
    check_writable(source.folder)
    config = load("suite", overrides, config_dir, base=source.config, home=source.folder)
    check_unchanged(source.config, config, CHANGEABLE)
    words, trusted = gone_on_with(load_values("suite", source.config).codesign, typed, source.folder)
    _check_growth(config, source.folder)
    return Job(dataclasses.replace(config, resume=None, codesign=trusted), folder=source.folder, words=words)


def _check_growth(config: SuiteConfig, folder: Path) -> None:
    before = load_values("suite", find_suite(str(folder), "").config)
    parts = ((task_names(one.tasks), one.searches, seeds_of(one.seeds)) for one in (before, config))
    for key, old, new in zip(GROWING, *parts, strict=True):
        lost = [entry for entry in old if entry not in new]
        if lost:
            raise ConfigError(f"{key} may only grow when a suite is resumed; {listing(lost)} would be left out.")


def _check(job: Job) -> None:
    """Find mistakes of members before anything is made: seeds of a task and search are alike."""
    from warpvox.algos.codesign.run import check

    several = len({member.search for member in job.members}) > 1
    for member in {(member.task, member.search): member for member in job.members}.values():
        try:
            check(member.settings, here=job.config.executor == "local")
        except ConfigError as error:
            raise ConfigError(f"{member.search}: {error}" if several else str(error)) from None


def suite(job: Job, console: Console) -> Path:
    """Make a suite, go on with one, or write its report again, also while it is running; returns its folder.

    Raises:
        WarpvoxError: something cannot be made; RunError: members have failed, the others are made all the same.
        KeyboardInterrupt: interrupted; what the members had done has been saved.
    """
    from warpvox.algos.suite.run import make_members

    if job.config.report is not None:
        source = find_suite(str(job.config.report), job.config.output_dir)
        check_links(source.folder)
        state = RUNNING
        with suppress(RunError), claimed(source.folder):  # nobody is making it: what was running was killed
            state = WAITING
        counts = None
        while counts != (table := Table.stored(source.folder)).counts:  # until no member has ended meanwhile
            counts = table.counts
            if not counts:
                raise RunError(f"{table.folder / MEMBERS} cannot be read; suite resume={source.folder} makes it again.")
            for member in table.of(RUNNING):
                member.state = state
            _write_report(table, load_values("suite", source.config), console)
        return source.folder
    config = dataclasses.replace(job.config, retry=False)
    home = Path(config.output_dir) / "suite"
    place = job.folder or (home / config.name if config.name else make_folder(home, datetime.now().strftime(STAMP)))
    stored = to_yaml(dataclasses.replace(config, codesign=job.words or config.codesign))
    with run_folder(job.folder, config, "suite", stored, place, check=lambda: _check_growth(config, place)) as folder:
        for member in {member.search: member for member in job.members}.values():
            keep_code(member.settings, folder, console)
        table = Table.of_plan(folder, job.members, job.config.retry)
        table.write()
        done = ", ".join(f"{count} {state}" for state, count in table.counts.items() if state != WAITING)
        echo(console, f"{counted(len(table.members), 'members')}{f', {done} already' if done else ''}")
        echo(console, f"folder: {shown(folder)}")
        try:
            if table.of(WAITING):
                make_members(table, config, console)
        except BaseException:
            _advise(table, config, console)
            raise
        _write_report(table, config, console)
        return _conclude(table, config, console)


def _write_report(table: Table, config: SuiteConfig, console: Console) -> None:
    """Write ``curves.csv`` and the page that compares the members, and say where it is."""
    from warpvox.algos.report.benchmark import write_benchmark

    table.write_curves()
    archives = table.archives()
    if archives:
        states = ", ".join(f"{count} {state}" for state, count in table.counts.items())
        page = write_benchmark(table.folder, archives, {"suite": config.suite or "", "members": states})
        echo(console, f"report: {page.resolve().as_uri()}")


def _advise(table: Table, config: SuiteConfig, console: Console, more: str = "") -> None:
    values = dict(map(key_and_value, config.codesign))
    code = "".join(f" {key}={STORED}" for key, value in values.items() if key in COPIES and is_code(value))
    echo(console, f"go on: warpvox suite {shell_argument('resume', table.folder)}{again(config)}{code}{more}")


def _conclude(table: Table, config: SuiteConfig, console: Console) -> Path:
    """Say how the suite has ended."""
    console.print(results(table.members))
    echo(console, f"members: {shown(table.folder / MEMBERS)}")
    failed, left, count = table.of(FAILED), table.of(WAITING), len(table.members)
    if left and not failed:
        _advise(table, config, console)
        raise RunError(f"{len(left)} of {count} members were asked to end (SIGTERM) before they were done.")
    if not failed:
        return table.folder
    _advise(table, config, console, " retry=true")
    task, search, seed = failed[0].key
    raise RunError(
        f"{len(failed)} of {count} members failed, the first of them ({task}, {search}, seed {seed}) with:"
        f" {failed[0].error.rstrip('.')}. All are listed in {table.folder / MEMBERS}."
    )
