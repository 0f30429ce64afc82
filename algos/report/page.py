"""Common parts of the pages of this package: a frame with style and script, lists of facts, rows of tables."""

from collections.abc import Iterable, Mapping
from functools import partial

from warpvox.algos.archive import Record
from warpvox.io.text import in_html
from warpvox.palette import body_svg
from warpvox.view.player import asset, fill_template

text = partial(asset, package="warpvox.algos.report")
"""The content of a file of this package."""
NOTHING = '<p class="faint">No design is evaluated yet.</p>'


def page(template: str, title: str, slots: Mapping[str, str]) -> str:
    """A page as text: it needs no network and links to nothing.

    Args:
        slots: HTML for the ``{{names}}`` in it.
    """
    frame = {"title": in_html(title), "style": text("page.css"), "script": text("page.js")}
    return fill_template(text("page.html"), {}, main=fill_template(text(template), {}, **slots), **frame)


def fact_list(facts: Mapping[str, object]) -> str:
    """Names with their values, for a ``<dl class="facts">``."""
    return "".join(
        f"<div><dt>{in_html(name)}</dt><dd>{in_html(str(value))}</dd></div>" for name, value in facts.items()
    )


def card(record: Record, lines: Iterable[str], cell: int = 22, more: str = "", film: str = "") -> str:
    """A design with its fitness, some lines of text and more HTML, ``film`` above; ``cell``: pixels of a voxel."""
    spans = "".join(f"<span>{in_html(line)}</span>" for line in lines)
    head = f'<figure class="card">{film}{body_svg(record.candidate.body, cell)}<figcaption><b>{record.fitness:.3f}</b>'
    return f"{head}{spans}{more}</figcaption></figure>"


def row(cells: Iterable[tuple[float | str | None, str]]) -> str:
    """A row of a table from pairs: what its column is sorted by (None: it is not), and HTML."""
    parts = (f"<td{'' if key is None else f' data-v={chr(34)}{key}{chr(34)}'}>{html}</td>" for key, html in cells)
    return f"<tr>{''.join(parts)}</tr>\n"
