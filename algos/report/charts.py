"""Charts as SVG: lines, steps and dots with two axes; colours come from the page's style sheet."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from warpvox.io.text import in_html
from warpvox.view.player import asset


@dataclass(frozen=True)
class Series:
    """Data of a chart: points ``(x, y)`` drawn as ``line``, ``step`` (holds until the next) or ``dots``.

    ``notes`` are shown when a dot is pointed at.
    """

    name: str
    points: Sequence[tuple[float, float]] = ()
    kind: str = "line"
    colour: int = 1
    notes: Sequence[str] = ()


def ticks(low: float, high: float, count: int = 6) -> list[float]:
    """Choose about ``count`` round numbers between ``low`` and ``high``."""
    if not high > low:
        return [low]
    rough = (high - low) / count
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1, 2, 2.5, 5, 10) if factor * power >= rough * 0.999)
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return [round(k * step, 12) for k in range(first, last + 1)]


def chart(series: Sequence[Series], x_label: str, y_label: str) -> str:
    """Draw series with axes, grid and legend as HTML; a sentence if there is no data."""
    figure = _figure(series, x_label, y_label, 920, 340)
    if not figure:
        return '<p class="faint">Nothing to show yet.</p>'
    names = []
    for one in series:
        if one.points:
            look = "dot" if one.kind == "dots" else "line"
            names.append(f'<li><i class="{look} s{one.colour}"></i>{in_html(one.name)}</li>')
    return f'<ul class="legend">{"".join(names)}</ul>{figure}'


def picture(points: Sequence[tuple[float, float]], x_label: str, y_label: str, kind: str = "line") -> str:
    """Draw one curve as a self-contained ``<img>``, for notebooks."""
    width = 440
    height = 250
    figure = _figure([Series("", points, kind)], x_label, y_label, width, height)

    # Programs other than browsers do not know variables, so that their values are filled in
    style = asset("page.css", package="warpvox.algos.report")
    values = dict(re.findall(r"(--\w+): ([^;]+);", style[: style.index("}")]))
    style = re.sub(r"var\((--\w+)\)", lambda match: values[match[1]], style[style.index("* {") :])
    kept = [line for line in style.splitlines() if line.startswith((".chart", ".s1", ".curve", "circle {"))]

    ground = f'<style>{" ".join(kept)}</style><rect width="100%" height="100%" fill="{values["--page"]}"/>'
    size = f'viewBox="0 0 {width} {height}" width="{width}" height="{height}"'
    letters = 'font-family="system-ui, Helvetica, Arial, sans-serif"'
    svg = f'<svg xmlns="http://www.w3.org/2000/svg" class="chart" {size} {letters}>{ground}{figure}</svg>'
    return f'<img alt="{in_html(y_label)}" src="data:image/svg+xml;base64,{base64.b64encode(svg.encode()).decode()}">'


def _figure(series: Sequence[Series], x_label: str, y_label: str, width: int, height: int) -> str:
    """Draw axes, grid and all series as ``<svg>``; empty without data."""
    points = [point for one in series for point in one.points if all(map(math.isfinite, point))]
    if not points:
        return ""

    # Ranges of the axes, with a margin (0.5 would vanish beside 1e17); x begins at 0
    spans = []
    for axis in (0, 1):
        low = min(point[axis] for point in points)
        high = max(point[axis] for point in points)
        margin = 0.04 * (high - low) or max(0.5, 1e-9 * abs(low))
        spans.append((low - margin, high + margin))
    (x_low, x_high), (y_low, y_high) = spans
    x_low = min(0.0, x_low)

    # From values to pixels
    left = 56
    right = width - 16
    top = 28
    bottom = height - 40

    def at_x(value: float) -> float:
        return left + (value - x_low) / (x_high - x_low) * (right - left)

    def at_y(value: float) -> float:
        return bottom - (value - y_low) / (y_high - y_low) * (bottom - top)

    # Axes and grid
    parts = []
    for value in ticks(y_low, y_high, max(2, height // 55)):
        y = at_y(value)
        parts.append(f'<path class="grid" d="M{left} {y:.1f}H{right}"/>')
        parts.append(f'<text x="{left - 8}" y="{y + 4:.1f}" text-anchor="end">{_number(value)}</text>')
    for value in ticks(x_low, x_high, width // 110):
        x = at_x(value)
        parts.append(f'<path class="tick" d="M{x:.1f} {bottom}v5"/>')
        parts.append(f'<text x="{x:.1f}" y="{bottom + 18}" text-anchor="middle">{_number(value)}</text>')
    parts.append(f'<path class="axis" d="M{left} {bottom}H{right}"/>')
    parts.append(f'<text class="label" x="{right}" y="{height - 4}" text-anchor="end">{in_html(x_label)}</text>')
    parts.append(f'<text class="label" x="{left}" y="{top - 10}">{in_html(y_label)}</text>')

    # Series, dots first: lines stay visible on top of them
    for one in sorted(series, key=lambda item: item.kind != "dots"):
        shown = [number for number, point in enumerate(one.points) if all(map(math.isfinite, point))]
        places = [(at_x(one.points[number][0]), at_y(one.points[number][1])) for number in shown]
        # A line of one point could not be seen.
        if one.kind == "dots" or len(places) == 1:
            for number, (x, y) in zip(shown, places, strict=True):
                note = f"<title>{in_html(one.notes[number])}</title>" if one.notes else ""
                parts.append(f'<circle class="s{one.colour}" cx="{x:.1f}" cy="{y:.1f}" r="3.5">{note}</circle>')
        elif places:
            path = f"M{places[0][0]:.1f} {places[0][1]:.1f}"
            for x, y in places[1:]:
                path += f"H{x:.1f}V{y:.1f}" if one.kind == "step" else f"L{x:.1f} {y:.1f}"
            parts.append(f'<path class="curve s{one.colour}" d="{path}"/>')
    label = in_html(f"{y_label} over {x_label}")
    head = f'<svg class="chart" role="img" aria-label="{label}" viewBox="0 0 {width} {height}">'
    return f"{head}{''.join(parts)}</svg>"


def sparkline(values: Sequence[float], width: int = 96, height: int = 24) -> str:
    """Draw a small line without axes as ``<svg>``; empty for less than two values."""
    if len(values) < 2:
        return ""
    low = min(values)
    high = max(values)
    scale = (height - 4) / (high - low) if high > low else 0.0
    steps = (width - 4) / (len(values) - 1)
    points = " ".join(f"{2 + k * steps:.1f},{height - 2 - (v - low) * scale:.1f}" for k, v in enumerate(values))
    size = f'viewBox="0 0 {width} {height}" width="{width}" height="{height}"'
    return f'<svg class="spark" {size} aria-hidden="true"><polyline points="{points}"/></svg>'


def _number(value: float) -> str:
    """Format a tick's number, with k for thousands and M for millions."""
    if value and abs(value) >= 1e6:
        return f"{value / 1e6:g}M"
    if abs(value) >= 1e4:
        return f"{value / 1e3:g}k"
    return f"{value:g}"
