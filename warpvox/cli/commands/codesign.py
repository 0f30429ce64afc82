"""``warpvox codesign``: searches for designs and writes all of them, with policies, to a folder."""

import dataclasses
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from warpvox.algos.archive import FILE, Archive
from warpvox.algos.codesign.archive_export import FORMATS
from warpvox.algos.codesign.settings import CHANGEABLE, Codesign
from warpvox.algos.find import find_codesign
from warpvox.code import code_of
from warpvox.configs.codesign import CodesignConfig
from warpvox.errors import ConfigError, listing
from warpvox.io.console import echo
from warpvox.io.text import shown
from warpvox.io.writing import check_links, check_writable
from warpvox.runs import CONFIG, check_unchanged, read_summary


def check(config: CodesignConfig, given: Collection[str]) -> None:
    """Raise WarpvoxError if a search with these settings cannot start or resume."""
    from warpvox.algos.codesign.run import plan_codesign

    if config.report is None:
        plan_codesign(config, _resumed(config))


def run(config: CodesignConfig, given: Collection[str], console: Console) -> Path:
    """Run or resume a design search, or only write its report; return its folder."""
    if config.report is not None:
        keys = ("report", "export", "top", "output_dir")  # keys that a report depends on
        others = [key for key in given if key not in keys]
        if others:
            raise ConfigError(f"{listing(others)} cannot change a report: {listing(keys[1:])} may go with it.")
        return _report(config, console)
    folder = _resumed(config)
    config = dataclasses.replace(config, resume=None)
    with console.status("loading"):
        from warpvox.algos.codesign.results import Found, Results
        from warpvox.algos.codesign.run import plan_codesign, run_codesign
        from warpvox.progress.search import SearchProgress, with_tracker

    def show(found: Found) -> None:
        """Film the best designs, and write the report and the exports."""
        with Archive.read(found.folder / FILE) as archive:
            results = Results(found.folder, archive, found.settings)
            with console.status("filming the best"):
                results.film(config)
                results.report(found.summary)
            _export(archive, found.folder, config.export, console)

    plan = plan_codesign(config, folder)
    return run_codesign(plan, with_tracker(config, [SearchProgress(console)]), finish=show).folder


def _resumed(config: CodesignConfig) -> Path | None:
    """Return the folder of the search to resume (None: new search); ConfigError if fixed settings changed."""
    if config.resume is None:
        return None
    source = find_codesign(config.resume, config.output_dir)
    check_writable(source.folder)
    check_unchanged(source.config, dataclasses.replace(config, resume=None), CHANGEABLE)
    return source.folder


def _export(archive: Archive, folder: Path, formats: Sequence[str], console: Console) -> None:
    """Export the archive in each format and print the paths."""
    for name in dict.fromkeys(formats):
        echo(console, shown(FORMATS[name](archive, folder)))


def _report(config: CodesignConfig, console: Console) -> Path:
    """Write report, pictures and exports of an existing search, finished or running; return its folder."""
    from warpvox.algos.codesign.results import Results
    from warpvox.algos.report import FILE as REPORT

    source = find_codesign(str(config.report), config.output_dir)
    stored = Codesign.of(source.config, source.folder / CONFIG)
    check_links(source.folder)
    summary: dict[str, Any] = {"status": "running"} | read_summary(source.folder)
    with Archive.read(source.folder / FILE) as archive:
        settings = dataclasses.replace(stored, top=config.top)
        results = Results(source.folder, archive, settings)
        for row in archive.generations():
            if row["evaluated"] == row["designs"]:
                results.draw(row["generation"], keep=False)
        if not code_of(stored):  # a stored search does not bring the user's own code
            results.film(stored)
        written = None
        while written != summary["status"]:  # again if the search ends meanwhile and writes its own page
            written = summary["status"]
            results.report(summary)
            summary |= read_summary(source.folder)
        echo(console, shown(source.folder / REPORT))
        _export(archive, source.folder, config.export, console)
    return source.folder
