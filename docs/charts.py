"""Draws the charts of performance and results from the tables of these pages: ``python docs/charts.py``.

Not part of the library; ``make charts`` runs it, and ``tests/docs`` says when a chart is out of date. Plain SVG, the
same on every machine.
"""

from __future__ import annotations

import re
from math import log10
from pathlib import Path

from compare_figures import FIGURES, tables

from warpvox.envs.registry import known_returns

IMAGES = FIGURES.parent / "images"
RESULTS = FIGURES.parent / "results.md"
INK, FAINT, OURS, THEIRS = "#222", "#ddd", "#ff7043", "#5c6bc0"
WIDTH, LEFT, RIGHT, ROW = 640, 200, 60, 18
Row = dict[str, str]


def number(cell: str) -> float:
    """The first number of a cell: that of ``106,762 (101,797 to 108,963)`` is 106762."""
    return float(re.match(r"-?[\d.,]*\d", cell)[0].replace(",", ""))


def svg(width: int, height: int, parts: list[str]) -> str:
    """A picture with a white ground, which both themes can bear."""
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}"'
    style = f' font-family="sans-serif" font-size="12" fill="{INK}">'
    ground = f'<rect width="{width}" height="{height}" rx="4" fill="#fff"/>'
    return "\n".join([head + style, ground, *parts, "</svg>\n"])


def text(x: float, y: float, words: str, anchor: str = "start", more: str = "") -> str:
    """Words at a place."""
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}"{more}>{words}</text>'


def bars(title: str, rows: list[tuple[str, float, str]]) -> str:
    """Horizontal bars: name, value, what is written beside the bar."""
    most = max(value for _, value, _ in rows)
    parts = [text(12, 22, title, more=' font-weight="bold"')]
    for place, (name, value, words) in enumerate(rows):
        y = 34 + place * ROW
        length = (WIDTH - LEFT - RIGHT) * value / most
        parts.append(text(LEFT - 8, y + 12, name, "end"))
        parts.append(f'<rect x="{LEFT}" y="{y + 2}" width="{length:.1f}" height="{ROW - 5}" fill="{OURS}"/>')
        parts.append(text(round(LEFT + length + 6, 1), y + 12, words))
    return svg(WIDTH, 44 + len(rows) * ROW, parts)


def lines(title: str, across: str, curves: dict[str, list[tuple[float, float]]]) -> str:
    """Curves over a logarithmic axis, from 0 up; points are written out."""
    height, left, bottom = 300, 70, 250
    xs = sorted({x for curve in curves.values() for x, _ in curve})
    most = max(y for curve in curves.values() for _, y in curve)
    scale = (WIDTH - left - 170) / (log10(xs[-1]) - log10(xs[0]))

    def place(x: float, y: float) -> tuple[float, float]:
        return round(left + (log10(x) - log10(xs[0])) * scale, 1), round(bottom - 200 * y / most, 1)

    parts = [text(12, 22, title, more=' font-weight="bold"'), text((left + WIDTH - 170) / 2, 290, across, "middle")]
    step = next(step for step in (100, 200, 500, 1e3, 2e3, 5e3, 1e4, 2e4, 5e4, 1e5) if 6 * step > most)
    for value in range(0, int(most) + 1, int(step)):
        _, y = place(xs[0], value)
        parts.append(f'<path d="M{left} {y}H{WIDTH - 170}" stroke="{FAINT}"/>')
        parts.append(text(left - 8, y + 4, f"{value:,}", "end"))
    parts += [text(place(x, 0)[0], 268, f"{x:,.0f}", "middle") for x in xs]
    for colour, (name, curve) in zip((OURS, THEIRS, "#26a69a"), curves.items(), strict=False):
        points = [place(x, y) for x, y in curve]
        path = "L".join(f"{x} {y}" for x, y in points)
        parts.append(f'<path d="M{path}" fill="none" stroke="{colour}" stroke-width="2.5"/>')
        parts += [f'<circle cx="{x}" cy="{y}" r="3.5" fill="{colour}"/>' for x, y in points]
        parts.append(text(points[-1][0] + 10, points[-1][1] + 4, name, more=f' fill="{colour}"'))
    return svg(WIDTH, height, parts)


def scores(rows: list[Row]) -> str:
    """A bar for each task: our return on the way from chance (0) to the best published return (1)."""
    most, width = 2.0, 720
    rows = [row for row in rows if row["published"] != "none"]
    scale = (width - LEFT - 150) / most
    bottom = 58 + len(rows) * ROW
    parts = [text(12, 22, "Our return under noise and the best published return", more=' font-weight="bold"')]
    parts += [text(LEFT, 46, "chance", "middle"), text(LEFT + scale, 46, "best published", "middle")]
    parts.append(text(width - 12, 46, "ours / published", "end"))
    for place, row in enumerate(rows):
        y = 54 + place * ROW
        ours, best = number(row["under noise"].strip("*")), number(row["published"])
        chance = known_returns()[row["task"]].random
        score = (ours - chance) / (best - chance)
        colour = OURS if ours >= best else "#b0b6c3"
        length = min(score, most) * scale
        parts.append(text(LEFT - 8, y + 12, row["task"], "end"))
        parts.append(f'<rect x="{LEFT}" y="{y + 2}" width="{length:.1f}" height="{ROW - 5}" fill="{colour}"/>')
        if score > most:
            parts.append(text(LEFT + length + 4, y + 12, "→"))
        parts.append(text(width - 12, y + 12, f"{ours:.3f} / {best:g}", "end"))
    parts.append(f'<path d="M{LEFT + scale:g} 50V{bottom}" stroke="{INK}" stroke-dasharray="4 3"/>')
    words = "orange: at or above the best published return; →: more than twice as far from chance"
    parts.append(text(12, bottom + 20, words, more=' fill="#555"'))
    return svg(width, bottom + 32, parts)


def charts(page: str, results: str) -> dict[str, str]:
    """File name -> SVG, from the pages of figures and results."""

    def table(suite: str, index: int = 0) -> list[Row]:
        return tables(page.split(f"<!-- bench {suite} -->")[1].split("<!-- end -->")[0])[index]

    ratios = sorted(((row["task"], number(row["ratio"])) for row in table("tasks")), key=lambda pair: -pair[1])
    bodies = [(number(row["voxels"]), row) for row in table("scaling")]
    batch = [(number(row["environments"]), row) for row in table("scaling", 1)]
    rates = ("step only", "with training")
    return {
        "speed_tasks.svg": bars("Times EvoGym's speed, one core", [(n, v, f"{v:.0f}") for n, v in ratios]),
        "speed_bodies.svg": lines(
            "Voxels simulated per second and core (thousands)",
            "voxels of the body",
            {
                "warpvox, a batch": [(x, x * number(row["in a batch"]) / 1e3) for x, row in bodies],
                "warpvox, one": [(x, x * number(row["steps/s"]) / 1e3) for x, row in bodies],
                "EvoGym": [(x, x * number(row["reference"]) / 1e3) for x, row in bodies],
            },
        ),
        "speed_batch.svg": lines(
            "Control steps per second and core, Walker-v0",
            "environments",
            {name: [(x, number(row[name])) for x, row in batch] for name in rates},
        ),
        "results.svg": scores(tables(results)[0]),
    }


if __name__ == "__main__":
    for name, picture in charts(FIGURES.read_text(encoding="utf-8"), RESULTS.read_text(encoding="utf-8")).items():
        (Path(IMAGES) / name).write_text(picture, encoding="utf-8")
