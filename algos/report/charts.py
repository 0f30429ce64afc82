"""Charts as SVG text: lines, steps, bands and dots over two axes. Colours come from the page's style sheet."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from warpvox.algos.report.page import text
from warpvox.algos.statistics import Interval
from warpvox.io.console import in_html

SIZE, PANEL = (920, 340), (440, 250)
"""Pixels of a chart that has a row for itself, and of one of several."""
LEFT, RIGHT, TOP, BOTTOM = 56, 16, 28, 40
COLOURS = (1, 2, 4, 5, 6, 7)
"""Colours of things that are compared; colour 3 is for what is less important."""


@dataclass(frozen=True)
class Series:
    """Points ``(x, y)`` shown as ``line``, ``step`` (holds until the next) or ``dots``, in the colour ``--s<colour>``.

    ``notes`` are shown when a dot is pointed at; ``band`` is the outline of an area in the same colour, ``look`` is
    ``dash`` or ``rule`` (thin) for a line that is not solid.
    """

    name: str
    points: Sequence[tuple[float, float]] = ()
    kind: str = "line"
    colour: int = 1
    notes: Sequence[str] = ()
    band: Sequence[tuple[float, float]] = ()
    look: str = ""

    def over(self, places: Iterable[float], mean: Iterable[float], *ends: Iterable[float]) -> Series:
        """A line of the same looks; ``ends``: the lower and the upper end of its band, if it has one."""
        points, *band = (list(zip(places, values, strict=True)) for values in (mean, *ends))
        return replace(self, points=points, band=[*band[1], *reversed(band[0])] if band else ())


def ticks(low: float, high: float, count: int = 6) -> list[float]:
    """About ``count`` round numbers that lie in ``low`` to ``high``."""
    if not high > low:
        return [low]
    rough = (high - low) / count
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1, 2, 2.5, 5, 10) if factor * power >= rough * 0.999)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [round(k * step, 12) for k in range(first, last + 1)]


def chart(
    series: Sequence[Series], x_label: str, y_label: str, size: tuple[int, int] = SIZE, names: bool = True
) -> str:
    """A figure with axes, grid, legend and all series; a sentence if there is nothing to show."""
    points = [point for one in series for point in (*one.points, *one.band) if all(map(math.isfinite, point))]
    if not points:
        return '<p class="faint">Nothing to show yet.</p>'
    span_x, span_y = (_span([point[axis] for point in points]) for axis in (0, 1))
    span_x = (min(0.0, span_x[0]), span_x[1])
    frame = _Frame(span_x, span_y, size)
    parts = _axes(frame, x_label, y_label)
    for one in (one for one in series if one.band):
        corners = "L".join("{:.1f} {:.1f}".format(*frame.at(point)) for point in one.band)
        parts.append(f'<path class="band s{one.colour}" d="M{corners}Z"/>')
    # dots first: lines stay visible on top of them
    for one in sorted(series, key=lambda item: item.kind != "dots"):
        parts += _marks(one, frame)
    head = legend([one for one in series if one.points]) if names else ""
    return head + _svg(parts, f"{y_label} over {x_label}", size)


def legend(series: Sequence[Series]) -> str:
    """The names of series with their colours."""
    items = (
        f'<li><i class="{"dot" if one.kind == "dots" else one.look or "line"} {"line " if one.look else ""}'
        f's{one.colour}"></i>{in_html(one.name)}</li>'
        for one in series
    )
    return f'<ul class="legend">{"".join(items)}</ul>'


def intervals(rows: Sequence[tuple[str, int, Interval]], x_label: str) -> str:
    """A figure with a row for each (name, colour, estimate): the estimate as a dot, its interval as a line."""
    ends = [v for _, _, one in rows for v in (one.mean, one.low, one.high) if math.isfinite(v)]
    size = (PANEL[0], TOP + BOTTOM + 36 * len(rows))
    frame = _Frame(_span(ends), (-len(rows), 0), size)
    parts = _axes(frame, "", x_label, y_ticks=False)
    for number, (name, colour, one) in enumerate(rows):
        x, y = frame.at((one.mean, -number - 0.7))
        if math.isfinite(one.low):
            low, high = (frame.at((end, 0.0))[0] for end in (one.low, one.high))
            parts.append(f'<path class="curve s{colour}" d="M{low:.1f} {y:.1f}H{high:.1f}"/>')
        parts.append(f'<circle class="s{colour}" cx="{x:.1f}" cy="{y:.1f}" r="5"/>')
        parts.append(f'<text x="{LEFT}" y="{y - 9:.1f}">{in_html(name)} {in_html(str(one))}</text>')
    return _svg(parts, x_label, size)


def _svg(parts: Sequence[str], label: str, size: tuple[int, int]) -> str:
    head = f'<svg class="chart" role="img" aria-label="{in_html(label)}" viewBox="0 0 {size[0]} {size[1]}">'
    return f"{head}{''.join(parts)}</svg>"


def sheet(charts: Sequence[str], series: Sequence[Series] = (), columns: int = 2) -> str:
    """A picture of its own, as the text of an SVG file: charts side by side, the names of ``series`` above them.

    Args:
        charts: what :func:`chart` gives without a legend, or :func:`intervals`.
    """
    found = [re.search(r'<svg class="chart".*?viewBox="0 0 (\d+) (\d+)">', one) for one in charts]
    shown = [(one[m.start() :], int(m[1]), int(m[2])) for one, m in zip(charts, found, strict=True) if m]
    parts, top, x = [], 34 if series else 8, 8.0
    for one in series:
        parts.append(f'<path class="curve s{one.colour} {one.look}" d="M{x:g} 18h18"/>')
        parts.append(f'<text x="{x + 24:g}" y="22">{in_html(one.name)}</text>')
        x += 48 + 7 * len(one.name)
    wide = max([columns * max([width for _, width, _ in shown], default=0), x])
    for start in range(0, len(shown), columns):
        left = 0
        for one, width, height in shown[start : start + columns]:
            place = f'<svg x="{left}" y="{top}" width="{width}" height="{height}" '
            parts.append(one.replace("<svg ", place, 1))
            left += width
        top += max(height for _, _, height in shown[start : start + columns]) + 8
    # programs other than browsers do not know variables, so that their values are filled in
    style = text("page.css")
    values = dict(re.findall(r"(--\w+): ([^;]+);", style[: style.index("}")]))
    style = re.sub(r"var\((--\w+)\)", lambda match: values[match[1]], style[style.index("* {") :])
    kept = [line for line in style.splitlines() if line.startswith((".chart", ".s1", ".curve", ".band", "circle {"))]
    head = f'<svg xmlns="http://www.w3.org/2000/svg" class="chart" viewBox="0 0 {wide:g} {top}" width="{wide:g}" '
    letters = 'font-family="system-ui, Helvetica, Arial, sans-serif"'
    return (
        f'{head}height="{top}" {letters}><style>{" ".join(kept)}</style>'
        f'<rect width="100%" height="100%" fill="{values["--page"]}"/>{"".join(parts)}</svg>\n'
    )


def picture(points: Sequence[tuple[float, float]], x_label: str, y_label: str, kind: str = "line") -> str:
    """A curve as ``<img>`` with a style of its own, for notebooks."""
    text = sheet([chart([Series("", points, kind)], x_label, y_label, PANEL, names=False)], columns=1)
    return f'<img alt="{in_html(y_label)}" src="data:image/svg+xml;base64,{base64.b64encode(text.encode()).decode()}">'


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


def _axes(frame: _Frame, x_label: str, y_label: str, y_ticks: bool = True) -> list[str]:
    width, height = frame.size
    floor, right = height - BOTTOM, width - RIGHT
    parts = []
    for value in ticks(*frame.y, max(2, height // 55)) if y_ticks else ():
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


def _marks(series: Series, frame: _Frame) -> list[str]:
    kept = [(k, point) for k, point in enumerate(series.points) if all(map(math.isfinite, point))]
    places = [frame.at(point) for _, point in kept]
    if series.kind == "dots" or len(places) == 1:  # a line of one point could not be seen
        parts = []
        for (number, _), (x, y) in zip(kept, places, strict=True):
            note = f"<title>{in_html(series.notes[number])}</title>" if series.notes else ""
            parts.append(f'<circle class="s{series.colour}" cx="{x:.1f}" cy="{y:.1f}" r="3.5">{note}</circle>')
        return parts
    if not places:
        return []
    path = f"M{places[0][0]:.1f} {places[0][1]:.1f}"
    for x, y in places[1:]:
        path += f"H{x:.1f}V{y:.1f}" if series.kind == "step" else f"L{x:.1f} {y:.1f}"
    look = f" {series.look}" if series.look else ""
    return [f'<path class="curve s{series.colour}{look}" d="{path}"/>']


def _number(value: float) -> str:
    if value and abs(value) >= 1e6:
        return f"{value / 1e6:g}M"
    if abs(value) >= 1e4:
        return f"{value / 1e3:g}k"
    return f"{value:g}"
