"""The family tree of a design as SVG: columns of generations, bodies as nodes, lines to their parents."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from warpvox.algos.codesign.archive import Record
from warpvox.view.palette import body_svg

LIMIT = 60
"""Ancestors that are shown at most, the nearest ones."""
CELL, COLUMN, ROW, MARGIN = 8, 98, 92, 12


def places(line: Sequence[Record]) -> dict[int, tuple[int, int]]:
    """Column and row of each node: generations from left to right, parents about where their children are."""
    order = sorted({record.candidate.generation for record in line})
    # A parent may, in a search that evaluates one design at a time, be of the same generation as its child.
    column = {record.id: order.index(record.candidate.generation) for record in line}
    children: dict[int, list[int]] = {record.id: [] for record in line}
    for record in line:
        for parent in record.candidate.parents:
            if parent in children:
                children[parent].append(record.id)
    row: dict[int, int] = {}
    for number in reversed(range(len(order))):
        nodes = [record.id for record in line if column[record.id] == number]

        def wish(node: int) -> tuple[float, int]:
            known = [row[child] for child in children[node] if child in row]
            return (sum(known) / len(known) if known else 0.0, node)

        for place, node in enumerate(sorted(nodes, key=wish)):
            row[node] = place
    return {record.id: (column[record.id], row[record.id]) for record in line}


def family_tree(line: Sequence[Record]) -> str:
    """The tree as an ``<svg>`` element, with a sentence if it had to be cut."""
    shown = list(line)[-LIMIT:]
    where = places(shown)
    rows, columns = (max(record.candidate.body.shape[axis] for record in shown) for axis in (0, 1))
    column, row = max(COLUMN, columns * CELL + 60), max(ROW, rows * CELL + 48)
    parts = []
    for record in shown:
        for parent in record.candidate.parents:
            if parent in where:
                (x0, y0), (x1, y1) = (_corner(where[node], column, row) for node in (parent, record.id))
                x0, y0, y1 = x0 + columns * CELL + 4, y0 + rows * CELL / 2, y1 + rows * CELL / 2
                bend = max(20.0, (x1 - x0) / 2)
                curve = f"M{x0:g} {y0:g}C{x0 + bend:g} {y0:g} {x1 - bend - 4:g} {y1:g} {x1 - 4:g} {y1:g}"
                parts.append(f'<path class="edge" d="{curve}"/>')
    for record in shown:
        x, y = _corner(where[record.id], column, row)
        item = record.candidate
        note = f"design {record.id}, generation {item.generation}, {escape(item.origin)}, fitness {record.fitness:.3f}"
        last = " winner" if record is shown[-1] else ""
        parts.append(
            f'<g class="node{last}" transform="translate({x} {y})"><title>{note}</title>'
            f'<rect x="-5" y="-5" width="{columns * CELL + 10}" height="{rows * CELL + 10}" rx="6"/>'
            f"{body_svg(item.body, CELL)}"
            f'<text y="{rows * CELL + 20}">#{record.id}</text>'
            f'<text y="{rows * CELL + 34}" class="value">{record.fitness:.2f}</text></g>'
        )
    wide = MARGIN * 2 + (1 + max(x for x, _ in where.values())) * column
    high = MARGIN + (1 + max(y for _, y in where.values())) * row
    cut = len(line) - len(shown)
    note = f'<p class="faint">{cut} earlier ancestors are not shown.</p>' if cut else ""
    size = f'viewBox="0 0 {wide} {high}" width="{wide}" height="{high}"'
    return f'{note}<div class="scroll"><svg class="tree" {size}>{"".join(parts)}</svg></div>'


def _corner(place: tuple[int, int], column: int, row: int) -> tuple[int, int]:
    return MARGIN + place[0] * column, MARGIN + place[1] * row
