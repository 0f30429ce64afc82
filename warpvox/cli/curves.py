"""``warpvox curves``: learning curves of runs as one picture."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from warpvox.algos.metrics import read_metrics
from warpvox.cli.config import expand, load, read_arguments
from warpvox.cli.runs import Run, find_run
from warpvox.cli.say import say
from warpvox.cli.train import describe
from warpvox.errors import ConfigError, RunError, listing
from warpvox.files import atomic_path

__all__ = ["run", "write_curves"]

SUFFIXES = (".png", ".svg", ".pdf")
AXES = {"steps": "control steps", "elapsed": "seconds", "iteration": "iterations"}
COLOURS = ("#d96a14", "#2f6fb0", "#3a8a4d", "#8a4fa3", "#b03a48", "#5b6473")
POINTS = 200  # of the mean of several runs


def run(words: list[str]) -> None:
    """Do what ``warpvox curves`` is asked for."""
    arguments = read_arguments(words)
    if describe("curves", arguments):
        return
    for overrides in expand(arguments, "curves"):
        config = load("curves", overrides, arguments.config_dir)
        runs = [find_run(text, config.output_dir) for text in config.runs]
        if len(config.size) != 2:
            raise ConfigError(f"size must be [width,height] in pixels, got {config.size}.")
        path = write_curves(runs, config.file, config.x, (config.size[0], config.size[1]))
        say(Console(), f"curves: {path}")


def write_curves(runs: list[Run], path: str | os.PathLike[str], x: str = "steps", size: tuple[int, int] = (760, 340)):
    """Draw the deterministic return of runs: each a thin line, and the mean of the runs of one task a thick one.

    Args:
        runs: as ``find_run`` gives them.
        path: .png, .svg or .pdf; written whole or not at all.
        x: the column of ``metrics.csv`` to the right.
        size: in pixels.

    Raises:
        ConfigError: another suffix, or matplotlib is not installed. RunError: a run without an evaluation.
    """
    target = Path(path)
    if target.suffix.lower() not in SUFFIXES:
        raise ConfigError(f"file must end in {listing(SUFFIXES)}, got '{path}'.")
    try:
        from matplotlib import rc_context
        from matplotlib.figure import Figure
    except ImportError:
        raise ConfigError("Curves need matplotlib, which is not installed: pip install 'warpvox[view]'.") from None
    curves: dict[str, list[np.ndarray]] = {}
    for found in runs:
        curves.setdefault(str(found.config["task"]), []).append(_curve(found, x))
    figure = Figure(figsize=(size[0] / 100, size[1] / 100), dpi=100, layout="constrained")
    axes = figure.add_subplot()
    for number, (task, several) in enumerate(curves.items()):
        colour = COLOURS[number % len(COLOURS)]
        for curve in several:
            axes.plot(*curve, color=colour, linewidth=1, alpha=0.35 if len(several) > 1 else 0)
        label = f"{task}, mean of {len(several)} runs" if len(several) > 1 else task
        axes.plot(*_mean(several), color=colour, linewidth=2.2, label=label)
    _dress(axes, AXES[x])
    # Equal runs make equal files: names inside an SVG are hashes with a random salt otherwise.
    with atomic_path(target) as temporary, rc_context({"svg.hashsalt": "warpvox"}):
        figure.savefig(temporary, format=target.suffix[1:].lower(), metadata=_no_date(target.suffix))
    return target


def _curve(found: Run, x: str) -> np.ndarray:
    """The evaluations of a run, float64 ``[2, k]``: where and what."""
    rows = [row for row in read_metrics(found.folder) if np.isfinite(row["eval_return"])]
    if not rows:
        raise RunError(f"The run {found.folder} has no evaluation yet: there is nothing to draw.")
    return np.array([[row[x] for row in rows], [row["eval_return"] for row in rows]], float)


def _mean(curves: list[np.ndarray]) -> np.ndarray:
    """The mean where all curves are known; a run that stopped early keeps its last value."""
    if len(curves) == 1:
        return curves[0]
    places = np.linspace(max(c[0, 0] for c in curves), max(c[0, -1] for c in curves), POINTS)
    return np.stack([places, np.mean([np.interp(places, *curve) for curve in curves], axis=0)])


def _dress(axes: Any, label: str) -> None:
    axes.set_xlabel(label)
    axes.set_ylabel("deterministic return")
    axes.grid(color="#dde2ea", linewidth=0.8)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.ticklabel_format(axis="x", style="plain")
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
    axes.margins(x=0.01)
    axes.legend(frameon=False, loc="best")


def _no_date(suffix: str) -> dict[str, Any]:
    """Metadata that makes equal pictures equal files."""
    return {".png": {}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}[suffix.lower()]
