"""Report of a design search as one self-contained HTML page.

It is made from the archive alone, so it can be made again at any time, also while the search is running.
"""

import base64
import html
import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from warpvox.algos.archive import Archive, Record
from warpvox.algos.candidate import FINALIST, best_so_far
from warpvox.algos.find import find_run
from warpvox.algos.report.charts import Series, chart, sparkline
from warpvox.algos.report.members import SearchResult
from warpvox.code import words_of_code
from warpvox.errors import RunError
from warpvox.io.text import in_html, shell_argument
from warpvox.palette import body_svg
from warpvox.runs import CONFIG
from warpvox.view.player import asset, fill_template

FILE, FILM = "report.html", "film.webp"
"""File names of the report in a search's folder, and of the film in a design's."""


def report_page(archive: Archive, facts: Mapping[str, str], folder: Path) -> str:
    """Build the report as an HTML page.

    Args:
        facts: what stands under the title, by name: status, search, version, ...
        folder: of the search, with policies and films of designs.
    """
    # Data
    records = archive.records()
    done = [record for record in records if record.fitness is not None]
    best = archive.best(10, with_parents=True)
    ancestors = archive.lineage(best[0].id) if best else []
    line = [record for record in ancestors if record.fitness is not None]
    search = SearchResult(folder, "", archive.settings, records, best[0] if best else None, {})
    learning = []
    for colour, record in enumerate(best[:5], 1):
        learning.append(Series(f"#{record.id}", best_so_far(record.curve), "step", colour))
    facts = _figures(done, best) | dict(facts)
    title = " · ".join(facts[name] for name in ("task", "search") if name in facts) or "design search"

    # Parts of the page
    named = []
    for name, value in facts.items():
        named.append(f"<div><dt>{in_html(name)}</dt><dd>{in_html(str(value))}</dd></div>")
    parts = {
        "facts": "".join(named),
        "progress": _progress(search, archive),
        "best": "".join(_card(record, folder) for record in best) or '<p class="faint">No design is evaluated yet.</p>',
        "curves": chart(learning, "control steps", "best return so far"),
        "tree": family_tree(line) if line else '<p class="faint">Nothing to show yet.</p>',
        "rows": "".join(_row(record) for record in records),
        "settings": html.escape(json.dumps(archive.settings, indent=2)),
    }

    # The page. It needs no network and links to nothing.
    text = partial(asset, package="warpvox.algos.report")
    main = fill_template(text("search.html"), {}, **parts)
    style = text("page.css")
    script = text("page.js")
    return fill_template(text("page.html"), {}, main=main, title=in_html(title), style=style, script=script)


def _figures(done: Sequence[Record], best: Sequence[Record]) -> dict[str, str]:
    """Collect the main figures of the search, as text by name."""
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
    """Draw fitness over evaluations: designs, finalists, best so far, mean of each generation."""
    trained = [record for record in search.records if record.reused is None and record.fitness is not None]
    dots = []
    notes = []
    finals = []
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
    """Build the HTML card of a design: film or body, origin, curve, and the command to play it."""
    candidate = record.candidate
    parents = ", ".join(f"#{parent}" for parent in candidate.parents)
    descent = f"{candidate.origin} of {parents}" if parents else candidate.origin
    lines = [f"#{record.id} · generation {candidate.generation}", descent]
    text = "".join(f"<span>{in_html(line)}</span>" for line in lines)
    text += sparkline([value for _, value in best_so_far(record.curve)])

    # The folder of its policy
    film = ""
    place = (folder / str(record.policy_file)).parent
    if record.policy_file is not None and (place / CONFIG).is_file():
        try:
            keys = words_of_code(find_run(str(place), "").config)
            text += f"<code>warpvox play {in_html(shell_argument('run', place) + keys)}</code>"
        except RunError as error:  # shown in this design's card, so that the others appear
            text += f'<p class="faint">{in_html(str(error))}</p>'
        if (place / FILM).is_file():
            data = base64.b64encode((place / FILM).read_bytes()).decode()
            film = f'<img src="data:image/webp;base64,{data}" alt="an episode of design {record.id}">'

    body = body_svg(candidate.body, 22)
    return f'<figure class="card">{film}{body}<figcaption><b>{record.fitness:.3f}</b>{text}</figcaption></figure>'


def _row(record: Record) -> str:
    """Build the HTML row of a design in the table of all designs."""
    candidate = record.candidate
    state = ""
    if record.reused is not None:
        state = f"same body as #{record.reused}"
    elif record.diverged:
        state = "diverged"
    elif record.stopped:
        state = "stopped early"
    elif candidate.origin == FINALIST:
        state = "policy of its own"
    elif record.fitness is None:
        state = "waiting"
    fitness = "" if record.fitness is None else record.fitness

    # Cells as (sort key or None, HTML)
    cells = (
        (record.id, f"{record.id}"),
        (None, body_svg(candidate.body, 5)),
        (fitness, f"{fitness:.4f}" if fitness != "" else ""),
        (candidate.generation, f"{candidate.generation}"),
        (None, in_html(candidate.origin)),
        (None, ", ".join(f"#{parent}" for parent in candidate.parents)),
        (record.steps or 0, "" if record.steps is None else f"{record.steps:,}"),
        (None, sparkline([value for _, value in best_so_far(record.curve)], 72, 20)),
        (None, state),
    )
    parts = []
    for key, content in cells:
        sorted_by = "" if key is None else f' data-v="{key}"'
        parts.append(f"<td{sorted_by}>{content}</td>")
    return f"<tr>{''.join(parts)}</tr>\n"


def places(line: Sequence[Record]) -> dict[int, tuple[int, int]]:
    """Lay out the family tree: column and row of each design, by generation and near its parents."""
    # Columns. In a search that evaluates one design at a time, parent and child may be of the same generation.
    order = sorted({record.candidate.generation for record in line})
    column = {record.id: order.index(record.candidate.generation) for record in line}

    # Children
    children: dict[int, list[int]] = {record.id: [] for record in line}
    for record in line:
        for parent in record.candidate.parents:
            if parent in children:
                children[parent].append(record.id)

    # Rows, from the last column on: nodes in the order of the mean rows of their children
    row: dict[int, int] = {}
    for number in reversed(range(len(order))):
        wish = {}
        for record in line:
            if column[record.id] == number:
                known = [row[child] for child in children[record.id] if child in row]
                wish[record.id] = sum(known) / max(1, len(known))
        for place, node in enumerate(sorted(wish, key=lambda node: (wish[node], node))):
            row[node] = place
    return {record.id: (column[record.id], row[record.id]) for record in line}


def family_tree(line: Sequence[Record]) -> str:
    """Draw the family tree as an ``<svg>`` element, with a note if ancestors are left out."""
    # The nearest ancestors, and their positions in pixels
    shown = list(line)[-60:]
    cell = 8
    margin = 12
    wide = cell * max(record.candidate.body.shape[1] for record in shown)
    high = cell * max(record.candidate.body.shape[0] for record in shown)
    column_width = max(98, wide + 60)
    row_height = max(92, high + 48)
    corner = {}
    for node, (column, row) in places(shown).items():
        corner[node] = margin + column * column_width, margin + row * row_height

    # Edges
    parts = []
    for record in shown:
        for parent in record.candidate.parents:
            if parent in corner:
                x0 = corner[parent][0] + wide + 4
                y0 = corner[parent][1] + high / 2
                x1 = corner[record.id][0]
                y1 = corner[record.id][1] + high / 2
                handle = max(20.0, (x1 - x0) / 2)
                curve = f"M{x0:g} {y0:g}C{x0 + handle:g} {y0:g} {x1 - handle - 4:g} {y1:g} {x1 - 4:g} {y1:g}"
                parts.append(f'<path class="edge" d="{curve}"/>')

    # Nodes
    for record in shown:
        x, y = corner[record.id]
        item = record.candidate
        note = f"design {record.id}, generation {item.generation}, {in_html(item.origin)}, fitness {record.fitness:.3f}"
        last = " winner" if record is shown[-1] else ""
        parts.append(
            f'<g class="node{last}" transform="translate({x} {y})"><title>{note}</title>'
            f'<rect x="-5" y="-5" width="{wide + 10}" height="{high + 10}" rx="6"/>'
            f"{body_svg(item.body, cell)}"
            f'<text y="{high + 20}">#{record.id}</text>'
            f'<text y="{high + 34}" class="value">{record.fitness:.2f}</text></g>'
        )

    width = max(x for x, _ in corner.values()) + column_width + margin
    height = max(y for _, y in corner.values()) + row_height
    cut = len(line) - len(shown)
    note = f'<p class="faint">{cut} earlier ancestors are not shown.</p>' if cut else ""
    size = f'viewBox="0 0 {width} {height}" width="{width}" height="{height}"'
    return f'{note}<div class="scroll"><svg class="tree" {size}>{"".join(parts)}</svg></div>'
