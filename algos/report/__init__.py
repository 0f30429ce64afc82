"""The report of a design search: one page without scripts from elsewhere, network or server.

It is made from the archive alone, so it can be made again at any time, also while the search is running.
"""

import base64
import html
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from warpvox.algos.archive import Archive, Record
from warpvox.algos.candidate import FINALIST, best_so_far
from warpvox.algos.find import find_run
from warpvox.algos.report.charts import Series, chart, sparkline
from warpvox.algos.report.members import SearchResult
from warpvox.algos.report.page import NOTHING, card, fact_list, page, row
from warpvox.code import words_of_code
from warpvox.errors import RunError
from warpvox.io.text import in_html, shell_argument
from warpvox.palette import body_svg
from warpvox.runs import CONFIG

FILE, FILM = "report.html", "film.webp"
"""The report in the folder of a search, and an episode of a robot in that of its design."""


def report_page(archive: Archive, facts: Mapping[str, str], folder: Path) -> str:
    """The page as text.

    Args:
        facts: what stands under the title, by name: status, search, version, ...
        folder: of the search, with policies and films of designs.
    """
    records = archive.records()
    done = [record for record in records if record.fitness is not None]
    best = archive.best(10)
    line = [record for record in archive.lineage(best[0].id) if record.fitness is not None] if best else []
    search = SearchResult(folder, "", archive.settings, records, best[0] if best else None, {})
    learning = [Series(f"#{one.id}", best_so_far(one.curve), "step", k) for k, one in enumerate(best[:5], 1)]
    title = " · ".join(str(facts[name]) for name in ("task", "search") if name in facts)
    slots = {
        "facts": fact_list(_figures(done, best) | dict(facts)),
        "progress": _progress(search, archive),
        "best": "".join(_card(one, folder) for one in best) or NOTHING,
        "curves": chart(learning, "control steps", "best return so far"),
        "tree": family_tree(line) if line else '<p class="faint">Nothing to show yet.</p>',
        "rows": "".join(_row(record) for record in records),
        "settings": html.escape(json.dumps(archive.settings, indent=2)),
    }
    return page("search.html", title or "design search", slots)


def _figures(done: Sequence[Record], best: Sequence[Record]) -> dict[str, str]:
    if not done:
        return {"evaluations": "0"}
    trained = [record for record in done if record.reused is None]
    finalists = sum(record.candidate.origin == FINALIST for record in trained)
    diverged = sum(record.diverged for record in trained)
    reused = f" (+{len(done) - len(trained)} reused)" if len(trained) < len(done) else ""
    return {
        "best fitness": f"{best[0].fitness:.3f}" if best else "-",
        "evaluations": f"{len(trained) - finalists}{reused}{f', and {finalists} finalists' if finalists else ''}",
        "control steps": f"{sum(record.steps or 0 for record in done):,}",
    } | ({"diverged": str(diverged)} if diverged else {})


def _progress(search: SearchResult, archive: Archive) -> str:
    """Fitness over evaluations: every design, finalists by themselves, the best so far, the mean of each generation."""
    trained = [record for record in search.records if record.reused is None and record.fitness is not None]
    dots, notes, finals = [], [], []
    ends: dict[int, int] = {}
    for number, record in enumerate(trained, start=1):
        if record.candidate.origin == FINALIST:
            finals.append((number, record.fitness))
            continue
        dots.append((number, record.fitness))
        ends[record.candidate.generation] = number
        fate = "diverged, counts as " if record.diverged else ""
        notes.append(f"design {record.id}, generation {record.candidate.generation}: {fate}{record.fitness:.3f}")
    means = [(ends[row["generation"]], row["mean"]) for row in archive.generations() if row["generation"] in ends]
    best = list(zip(search.evaluations.tolist(), search.best.tolist(), strict=True))
    series = [
        Series("designs", dots, "dots", 3, notes),
        Series("mean of the generation", means, "line", 2),
        Series("best so far", best, "step", 1),
        Series("finalists, each with a policy of its own", finals, "dots", 4),
    ]
    return chart(series, "designs trained", "fitness")


def _card(record: Record, folder: Path) -> str:
    """A design, in motion if there is a film of it, with the command that plays it if it is there."""
    item = record.candidate
    parents = ", ".join(f"#{parent}" for parent in item.parents)
    lines = f"#{record.id} · generation {item.generation}", f"{item.origin}{f' of {parents}' if parents else ''}"
    more, film = sparkline([value for _, value in best_so_far(record.curve)]), ""
    place = (folder / str(record.policy)).parent
    if record.policy is not None and (place / CONFIG).is_file():
        try:
            keys = words_of_code(find_run(str(place), "").config)
            more += f"<code>warpvox play {in_html(shell_argument('run', place) + keys)}</code>"
        except RunError as error:  # of this design alone
            more += f'<p class="faint">{in_html(str(error))}</p>'
        if (place / FILM).is_file():
            data = base64.b64encode((place / FILM).read_bytes()).decode()
            film = f'<img src="data:image/webp;base64,{data}" alt="an episode of design {record.id}">'
    return card(record, lines, more=more, film=film)


def _row(record: Record) -> str:
    item = record.candidate
    states = {
        f"same body as #{record.reused}": record.reused is not None,
        "diverged": record.diverged,
        "stopped early": record.stopped,
        "policy of its own": item.origin == FINALIST,
        "waiting": record.fitness is None,
    }
    state = next((text for text, holds in states.items() if holds), "")
    cells = (
        (record.id, f"{record.id}"),
        (None, body_svg(item.body, 5)),
        ("" if record.fitness is None else record.fitness, "" if record.fitness is None else f"{record.fitness:.4f}"),
        (item.generation, f"{item.generation}"),
        (None, in_html(item.origin)),
        (None, ", ".join(f"#{parent}" for parent in item.parents)),
        (record.steps or 0, "" if record.steps is None else f"{record.steps:,}"),
        (None, sparkline([value for _, value in best_so_far(record.curve)], 72, 20)),
        (None, state),
    )
    return row(cells)


CELL, MARGIN = 8, 12


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
        known = {node: [row[child] for child in children[node] if child in row] for node in nodes}
        wish = {node: sum(rows) / max(1, len(rows)) for node, rows in known.items()}
        for place, node in enumerate(sorted(nodes, key=lambda node: (wish[node], node))):
            row[node] = place
    return {record.id: (column[record.id], row[record.id]) for record in line}


def family_tree(line: Sequence[Record]) -> str:
    """The tree as an ``<svg>`` element, with a sentence if it had to be cut."""
    # The nearest ancestors
    shown = list(line)[-60:]
    where = places(shown)
    rows, columns = (max(record.candidate.body.shape[axis] for record in shown) for axis in (0, 1))
    column, row = max(98, columns * CELL + 60), max(92, rows * CELL + 48)
    parts = []
    for record in shown:
        for parent in record.candidate.parents:
            if parent in where:
                (x0, y0), (x1, y1) = (_corner(where[node], column, row) for node in (parent, record.id))
                x0, y0, y1 = x0 + columns * CELL + 4, y0 + rows * CELL / 2, y1 + rows * CELL / 2
                handle = max(20.0, (x1 - x0) / 2)
                curve = f"M{x0:g} {y0:g}C{x0 + handle:g} {y0:g} {x1 - handle - 4:g} {y1:g} {x1 - 4:g} {y1:g}"
                parts.append(f'<path class="edge" d="{curve}"/>')
    for record in shown:
        x, y = _corner(where[record.id], column, row)
        item = record.candidate
        note = f"design {record.id}, generation {item.generation}, {in_html(item.origin)}, fitness {record.fitness:.3f}"
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
