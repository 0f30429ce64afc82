"""Charts as SVG text: lines, steps and dots over two axes. Colours come from the page's style sheet."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

__all__ = ["Series", "chart", "sparkline", "ticks"]

WIDTH, HEIGHT = 920, 340
LEFT, RIGHT, TOP, BOTTOM = 56, 16, 12, 40


@dataclass(frozen=True)
class Series:
    """Points ``(x, y)`` shown as ``line``, ``step`` (holds until the next) or ``dots``, in the colour ``--s<colour>``.

    ``notes`` are shown when a dot is pointed at.
    """

    name: str
    points: Sequence[tuple[float, float]]
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
    points = [point for one in series for point in one.points if all(map(math.isfinite, point))]
    if not points:
        return '<p class="faint">Nothing to show yet.</p>'
    span_x, span_y = (_span([point[axis] for point in points]) for axis in (0, 1))
    span_x = (min(0.0, span_x[0]), span_x[1])
    frame = _Frame(span_x, span_y)
    parts = [*_axes(frame, x_label, y_label)]
    # dots first: lines stay visible on top of them
    for one in sorted(series, key=lambda item: item.kind != "dots"):
        parts += _marks(one, frame)
    legend = "".join(
        f'<li><i class="{"dot" if one.kind == "dots" else "line"} s{one.colour}"></i>{escape(one.name)}</li>'
        for one in series
        if one.points
    )
    label = escape(f"{y_label} over {x_label}")
    head = f'<svg class="chart" role="img" aria-label="{label}" viewBox="0 0 {WIDTH} {HEIGHT}">'
    return f'<ul class="legend">{legend}</ul>{head}{"".join(parts)}</svg>'


def sparkline(values: Sequence[float], width: int = 96, height: int = 24) -> str:
    """A small line without axes; empty for less than two values."""
    if len(values) < 2:
        return ""
    low, high = min(values), max(values)
    scale = (height - 4) / (high - low) if high > low else 0.0
    steps = (width - 4) / (len(values) - 1)
    points = " ".join(f"{2 + k * steps:.1f},{height - 2 - (v - low) * scale:.1f}" for k, v in enumerate(values))
    size = f'viewBox="0 0 {width} {height}" width="{width}" height="{height}"'
    return f'<svg class="spark" {size} aria-hidden="true"><polyline points="{points}"/></svg>'


@dataclass(frozen=True)
class _Frame:
    """From values to pixels."""

    x: tuple[float, float]
    y: tuple[float, float]

    def at(self, point: tuple[float, float]) -> tuple[float, float]:
        across = (point[0] - self.x[0]) / (self.x[1] - self.x[0])
        up = (point[1] - self.y[0]) / (self.y[1] - self.y[0])
        return LEFT + across * (WIDTH - LEFT - RIGHT), HEIGHT - BOTTOM - up * (HEIGHT - TOP - BOTTOM)


def _span(values: Sequence[float]) -> tuple[float, float]:
    low, high = min(values), max(values)
    if low == high:
        return low - 0.5, high + 0.5
    margin = 0.04 * (high - low)
    return low - margin, high + margin


def _axes(frame: _Frame, x_label: str, y_label: str) -> list[str]:
    floor, right = HEIGHT - BOTTOM, WIDTH - RIGHT
    parts = []
    for value in ticks(*frame.y):
        y = frame.at((frame.x[0], value))[1]
        parts.append(f'<path class="grid" d="M{LEFT} {y:.1f}H{right}"/>')
        parts.append(f'<text x="{LEFT - 8}" y="{y + 4:.1f}" text-anchor="end">{_number(value)}</text>')
    for value in ticks(*frame.x, 8):
        x = frame.at((value, frame.y[0]))[0]
        parts.append(f'<path class="tick" d="M{x:.1f} {floor}v5"/>')
        parts.append(f'<text x="{x:.1f}" y="{floor + 18}" text-anchor="middle">{_number(value)}</text>')
    parts.append(f'<path class="axis" d="M{LEFT} {floor}H{right}"/>')
    parts.append(f'<text class="label" x="{right}" y="{HEIGHT - 4}" text-anchor="end">{escape(x_label)}</text>')
    parts.append(f'<text class="label" x="{LEFT + 6}" y="{TOP + 10}">{escape(y_label)}</text>')
    return parts


def _marks(series: Series, frame: _Frame) -> list[str]:
    kept = [(k, point) for k, point in enumerate(series.points) if all(map(math.isfinite, point))]
    places = [frame.at(point) for _, point in kept]
    if series.kind == "dots":
        parts = []
        for (number, _), (x, y) in zip(kept, places, strict=True):
            note = f"<title>{escape(series.notes[number])}</title>" if series.notes else ""
            parts.append(f'<circle class="s{series.colour}" cx="{x:.1f}" cy="{y:.1f}" r="3.5">{note}</circle>')
        return parts
    if not places:
        return []
    path = f"M{places[0][0]:.1f} {places[0][1]:.1f}"
    for x, y in places[1:]:
        path += f"H{x:.1f}V{y:.1f}" if series.kind == "step" else f"L{x:.1f} {y:.1f}"
    return [f'<path class="curve s{series.colour}" d="{path}"/>']


def _number(value: float) -> str:
    if value and abs(value) >= 1e6:
        return f"{value / 1e6:g}M"
    if abs(value) >= 1e4:
        return f"{value / 1e3:g}k"
    return f"{value:g}"
