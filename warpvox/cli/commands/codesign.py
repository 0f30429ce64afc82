"""``warpvox codesign``: from a configuration to a folder with the designs that were tried, the best of them trained."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from warpvox.algos.codesign.archive import FILE, Archive
from warpvox.algos.codesign.archive_export import FORMATS
from warpvox.algos.codesign.settings import CHANGEABLE, Codesign
from warpvox.cli.application import run_command
from warpvox.cli.config import load, load_values
from warpvox.cli.overrides import check_report, key_and_value
from warpvox.configs.codesign import CodesignConfig
from warpvox.errors import ConfigError, RunError, listing
from warpvox.io.console import echo, shown
from warpvox.io.writing import check_links, check_writable, to_yaml
from warpvox.runs import check_unchanged, find_codesign, find_searches, new_folder, read_summary
from warpvox.trust import again, as_stored

Job = tuple[CodesignConfig, Path | None]
"""One search to be made, and the folder of the one that it goes on with."""


def run(words: list[str]) -> None:
    run_command("codesign", words, _make, _prepare)


def _prepare(config: CodesignConfig, overrides: list[str], config_dir: Path | None) -> Job:
    """The job of a configuration; with ``resume`` on top of that of the search that it goes on with."""
    from warpvox.algos.codesign.run import check

    folder = None
    if config.report is not None:
        check_report((key_and_value(word)[0] for word in overrides), ("export", "top", "name", "output_dir"))
        return config, None
    if config.resume is not None:
        source = find_codesign(config.resume, config.output_dir)
        check_writable(folder := source.folder)
        config = load("codesign", overrides, config_dir, base=source.config, home=folder)
        config = dataclasses.replace(config, resume=None)
        check_unchanged(source.config, as_stored(config, source.config), CHANGEABLE)
    check(config, folder)
    return config, folder


def _make(job: Job, console: Console) -> Path:
    """Make a search, or go on with one; returns its folder."""
    config, folder = job
    if config.report is not None:
        return _report(config, console)
    with console.status("loading"):
        from warpvox.algos.codesign.progress import SearchProgress
        from warpvox.algos.codesign.run import run_codesign

    class Films(SearchProgress):
        def ended(self, summary: Mapping[str, Any]) -> None:  # before another process may write to the folder
            super().ended(summary)
            if summary.get("status") == "done":
                results = self.run.results
                with console.status("filming the best"):
                    results.film(config)
                    results.report(summary)
                _export(results.archive, results.folder, config.export, console)

    return run_codesign(config, folder, [Films(console)], console=console).folder


def _export(archive: Archive, folder: Path, formats: Sequence[str], console: Console) -> None:
    for name in dict.fromkeys(formats):
        echo(console, shown(FORMATS[name](archive, folder)))


def _report(config: CodesignConfig, console: Console) -> Path:
    """Make report, pictures and exports of a search again, also while it is running; returns its folder."""
    from warpvox.algos.codesign.results import Results
    from warpvox.algos.report import FILE as REPORT

    texts = [str(text) for text in (config.report if isinstance(config.report, list) else [config.report])]
    if texts != ["latest"]:
        searches = find_searches(texts, config.output_dir)
        if len(texts) != 1 or searches not in ([], [Path(texts[0]).expanduser()]):
            return _compare(config, texts, searches, console)
    source = find_codesign(texts[0], config.output_dir)
    stored = Codesign.of(vars(load_values("codesign", source.config)))
    check_links(source.folder)
    summary: dict[str, Any] = {"status": "running"} | read_summary(source.folder)
    with Archive.read(source.folder / FILE) as archive:
        settings = dataclasses.replace(stored, top=config.top)
        results = Results(source.folder, archive, settings, summary.get("pretraining_steps"))
        for row in archive.generations():
            if row["evaluated"] == row["designs"]:
                results.draw(row["generation"], keep=False)
        if not again(stored):  # code of the user's own, which a file does not bring
            results.film(stored)
        told = None
        while told != summary["status"]:  # once more if the search ends meanwhile, with a page of its own
            told = summary["status"]
            results.report(summary)
            summary |= read_summary(source.folder)
        echo(console, shown(source.folder / REPORT))
        _export(archive, source.folder, config.export, console)
    return source.folder


def _compare(config: CodesignConfig, texts: list[str], searches: list[Path], console: Console) -> Path:
    """Write one report of several searches: into the folder that they lie in, if one was named, or a new one."""
    from warpvox.algos.report.benchmark import write_benchmark

    if not searches:
        raise RunError(f"There is no design search at {listing(texts)}: expected latest, folders or a pattern of some.")
    if config.export or config.top != CodesignConfig.top:
        raise ConfigError("export and top go with the report of one search, and this is of several.")
    home = Path(texts[0]).expanduser()
    if len(texts) == 1 and home.is_dir():
        page = write_benchmark(home, searches)
    else:
        with new_folder(config.output_dir, "report", "several", config.name, to_yaml(config)) as folder:
            page = write_benchmark(folder, searches)
    echo(console, f"report of {len(searches)} design searches: {page.resolve().as_uri()}")
    return page.parent
