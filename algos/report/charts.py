"""Charts as SVG text: lines, steps and dots over two axes. Colours come from the page's style sheet."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from warpvox.io.text import in_html
from warpvox.view.player import asset

SIZE, SMALL = (920, 340), (440, 250)
"""Pixels of a chart on a page, and of one in a notebook."""
LEFT, RIGHT, TOP, BOTTOM = 56, 16, 28, 40


@dataclass(frozen=True)
class Series:
    """Points ``(x, y)`` shown as ``line``, ``step`` (holds until the next) or ``dots``, in the colour ``--s<colour>``.

    ``notes`` are shown when a dot is pointed at.
    """

    name: str
    points: Sequence[tuple[float, float]] = ()
    kind: str = "line"
    colour: int = 1
    notes: Sequence[str] = ()


def ticks(low: float, high: float, count: int = 6) -> list[float]:
    """About ``count`` round numbers that lie in ``low`` to ``high``."""
    if not high > low:
        return [low]
    rough = (high - low) / count
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1, 2, 2.5, 5, 10) if factor * power >= rough * 0.999)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [round(k * step, 12) for k in range(first, last + 1)]


def chart(series: Sequence[Series], x_label: str, y_label: str) -> str:
    """A figure with axes, grid, legend and all series; a sentence if there is nothing to show."""
    figure = _figure(series, x_label, y_label, SIZE)
    if not figure:
        return '<p class="faint">Nothing to show yet.</p>'
    names = []
    for one in series:
        if one.points:
            look = "dot" if one.kind == "dots" else "line"
            names.append(f'<li><i class="{look} s{one.colour}"></i>{in_html(one.name)}</li>')
    return f'<ul class="legend">{"".join(names)}</ul>{figure}'


def picture(points: Sequence[tuple[float, float]], x_label: str, y_label: str, kind: str = "line") -> str:
    """A curve as ``<img>`` with a style of its own, for notebooks."""
    figure = _figure([Series("", points, kind)], x_label, y_label, SMALL)
    # Programs other than browsers do not know variables, so that their values are filled in
    style = asset("page.css", package="warpvox.algos.report")
    values = dict(re.findall(r"(--\w+): ([^;]+);", style[: style.index("}")]))
    style = re.sub(r"var\((--\w+)\)", lambda match: values[match[1]], style[style.index("* {") :])
    kept = [line for line in style.splitlines() if line.startswith((".chart", ".s1", ".curve", "circle {"))]
    ground = f'<style>{" ".join(kept)}</style><rect width="100%" height="100%" fill="{values["--page"]}"/>'
    size = f'viewBox="0 0 {SMALL[0]} {SMALL[1]}" width="{SMALL[0]}" height="{SMALL[1]}"'
    letters = 'font-family="system-ui, Helvetica, Arial, sans-serif"'
    svg = f'<svg xmlns="http://www.w3.org/2000/svg" class="chart" {size} {letters}>{ground}{figure}</svg>'
    return f'<img alt="{in_html(y_label)}" src="data:image/svg+xml;base64,{base64.b64encode(svg.encode()).decode()}">'


def _figure(series: Sequence[Series], x_label: str, y_label: str, size: tuple[int, int]) -> str:
    """Axes, grid and all series as ``<svg>``; nothing if there is nothing to show."""
    points = [point for one in series for point in one.points if all(map(math.isfinite, point))]
    if not points:
        return ""
    span_x, span_y = (_span([point[axis] for point in points]) for axis in (0, 1))
    span_x = (min(0.0, span_x[0]), span_x[1])
    frame = _Frame(span_x, span_y, size)
    parts = _axes(frame, x_label, y_label)
    # dots first: lines stay visible on top of them
    for one in sorted(series, key=lambda item: item.kind != "dots"):
        kept = [(k, point) for k, point in enumerate(one.points) if all(map(math.isfinite, point))]
        places = [frame.at(point) for _, point in kept]
        # A line of one point could not be seen.
        if one.kind == "dots" or len(places) == 1:
            for (number, _), (x, y) in zip(kept, places, strict=True):
                note = f"<title>{in_html(one.notes[number])}</title>" if one.notes else ""
                parts.append(f'<circle class="s{one.colour}" cx="{x:.1f}" cy="{y:.1f}" r="3.5">{note}</circle>')
        elif places:
            path = f"M{places[0][0]:.1f} {places[0][1]:.1f}"
            for x, y in places[1:]:
                path += f"H{x:.1f}V{y:.1f}" if one.kind == "step" else f"L{x:.1f} {y:.1f}"
            parts.append(f'<path class="curve s{one.colour}" d="{path}"/>')
    label = in_html(f"{y_label} over {x_label}")
    head = f'<svg class="chart" role="img" aria-label="{label}" viewBox="0 0 {size[0]} {size[1]}">'
    return f"{head}{''.join(parts)}</svg>"


def sparkline(values: Sequence[float], width: int = 96, height: int = 24) -> str:
    """A small line without axes; empty for less than two values."""
    if len(values) < 2:
        return ""
    low, high = min(values), max(values)
    scale = (height - 4) / (high - low) if high > low else 0.0
    steps = (width - 4) / (len(values) - 1)
    points = " ".join(f"{2 + k * steps:.1f},{height - 2 - (v - low) * scale:.1f}" for k, v in enumerate(values))
    places = f"0 0 {SMALL[0]} {SMALL[1]}"
    size = f'viewBox="{places}" width="{SMALL[0]}" height="{SMALL[1]}"'
    return f'<svg class="spark" {size} aria-hidden="true"><polyline points="{points}"/></svg>'


@dataclass(frozen=True)
class _Frame:
    """From values to pixels."""

    x: tuple[float, float]
    y: tuple[float, float]
    size: tuple[int, int] = SIZE

    def at(self, point: tuple[float, float]) -> tuple[float, float]:
        across = (point[0] - self.x[0]) / (self.x[1] - self.x[0])
        up = (point[1] - self.y[0]) / (self.y[1] - self.y[0])
        width, height = self.size
        return LEFT + across * (width - LEFT - RIGHT), height - BOTTOM - up * (height - TOP - BOTTOM)


def _span(values: Sequence[float]) -> tuple[float, float]:
    low, high = min(values), max(values)
    margin = 0.04 * (high - low) or max(0.5, 1e-9 * abs(low))  # 0.5 would vanish beside 1e17
    return low - margin, high + margin


def _axes(frame: _Frame, x_label: str, y_label: str) -> list[str]:
    width, height = frame.size
    floor, right = height - BOTTOM, width - RIGHT
    parts = []
    for value in ticks(*frame.y, max(2, height // 55)):
        y = frame.at((frame.x[0], value))[1]
        parts.append(f'<path class="grid" d="M{LEFT} {y:.1f}H{right}"/>')
        parts.append(f'<text x="{LEFT - 8}" y="{y + 4:.1f}" text-anchor="end">{_number(value)}</text>')
    for value in ticks(*frame.x, width // 110):
        x = frame.at((value, frame.y[0]))[0]
        parts.append(f'<path class="tick" d="M{x:.1f} {floor}v5"/>')
        parts.append(f'<text x="{x:.1f}" y="{floor + 18}" text-anchor="middle">{_number(value)}</text>')
    parts.append(f'<path class="axis" d="M{LEFT} {floor}H{right}"/>')
    parts.append(f'<text class="label" x="{right}" y="{height - 4}" text-anchor="end">{in_html(x_label)}</text>')
    parts.append(f'<text class="label" x="{LEFT}" y="{TOP - 10}">{in_html(y_label)}</text>')
    return parts


def _number(value: float) -> str:
    if value and abs(value) >= 1e6:
        return f"{value / 1e6:g}M"
    if abs(value) >= 1e4:
        return f"{value / 1e3:g}k"
    return f"{value:g}"
