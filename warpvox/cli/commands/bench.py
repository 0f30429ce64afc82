"""``warpvox bench``: speed, with the results checked before a time is printed.

A suite is a file of :mod:`warpvox.bench`. Each leaves ``summary.json`` and ``tables.md`` in
``outputs/bench/<suite>/<date_time>/``.
"""

from importlib import import_module
from pathlib import Path
from typing import Any

from rich.console import Console

from warpvox.cli.application import run_command
from warpvox.errors import SimulationError, listing
from warpvox.io.console import echo
from warpvox.io.writing import to_yaml
from warpvox.runs import new_folder


def run(words: list[str]) -> None:
    run_command("bench", words, measure)


def measure(config: Any, console: Console) -> Path:
    """Run one suite; returns the folder of its results."""
    with console.status("preparing"):
        from warpvox.bench.machine import machine, machine_line
        from warpvox.bench.report import Report, put_into
        from warpvox.devices.names import resolve_device
        from warpvox.devices.startup import prepare

        suite = import_module(f"warpvox.bench.{config.suite}")
        prepare(config.torch_threads, config.seed)
        config.device = resolve_device(config.device or ("cuda" if config.suite == "gpu" else "cpu"))
        document = Path(config.document) if config.document else None
        if document:
            put_into(document, config.suite)
    with new_folder(config.output_dir, "bench", config.suite, config.name, to_yaml(config)) as folder:
        facts = machine(config.device)
        report = Report(console, folder, {"suite": config.suite, "task": config.task, "machine": facts})
        echo(console, machine_line(facts))
        suite.run(config, report)
        text = report.write()
        if document:
            put_into(document, config.suite, text)
        echo(console, f"figures: {folder / 'summary.json'}")
    if failed := report.figures.get("failed"):
        raise SimulationError(f"These parts failed: {listing(failed)}; see {folder / 'summary.json'}.")
    return folder
