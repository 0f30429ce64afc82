"""``warpvox tasks``: all tasks as a table, or one in detail with a picture of its world."""

from __future__ import annotations

import os
from collections.abc import Iterable

from rich.console import Console
from rich.table import Table
from rich.text import Text

from warpvox.errors import ConfigError

__all__ = ["run"]

USAGE = "usage: warpvox tasks [ID]\n\nLists the tasks; with an ID shows that task in detail, with its world."
# of empty, rigid, soft, horizontal actuator, vertical actuator, fixed cells
PAINT = {0: "", 1: "on grey23", 2: "on grey66", 3: "on dark_orange", 4: "on deep_sky_blue1", 5: "on grey42"}
GLYPHS = ".#o-|%"
ROBOT_SIZE = 5
SAME_ROWS = 5
"""Equal rows of a world that are printed one by one."""


def run(words: list[str]) -> None:
    """Do what ``warpvox tasks`` is asked for."""
    if words and words[0] in ("-h", "--help"):
        print(USAGE)
        return
    if len(words) > 1 or (words and words[0].startswith("-")):
        raise ConfigError(f"`warpvox tasks` takes one task id at most, got '{' '.join(words)}'.")
    console = Console()
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = 120  # a pipe has no width of its own; 80 columns would cut the sentences
    if words:
        _print_task(words[0], console)
    else:
        _print_all(console)


def _print_all(console: Console) -> None:
    from warpvox.envs.registry import get_task, task_ids

    table = Table()
    for heading, justify in (
        ("task", "left"),
        ("level", "left"),
        ("steps", "right"),
        ("section", "left"),
        ("goal", "left"),
    ):
        table.add_column(heading, justify=justify, overflow="fold")
    for name in task_ids():
        task = get_task(name)
        table.add_row(task.id, task.difficulty, str(task.max_episode_steps), task.section, task.summary)
    console.print(table)


def _print_task(name: str, console: Console) -> None:
    from warpvox.envs.registry import get_task

    task = get_task(name)
    console.print(f"[bold]{task.id}[/bold] ({task.difficulty}, paper section {task.section})")
    console.print(task.summary)
    console.print(f"episode: {task.max_episode_steps} control steps at most", highlight=False)
    console.print("observation: " + _terms(task.observations), highlight=False)
    console.print("reward: " + _terms(task.rewards), highlight=False)
    ends = _terms(task.terminations) if task.terminations else "by the time limit or self-folding only"
    console.print("ends: " + ends, highlight=False)
    changed = ", ".join(key.replace("_", " ") for key in task.paper)
    console.print("rules=paper changes: " + (changed or "nothing but the physics"), highlight=False)
    console.print("world (the robot's place is marked R):")
    _print_world(task, console)


def _terms(terms: Iterable[object]) -> str:
    parts = []
    for term in terms:
        given = ", ".join(f"{key}={value}" for key, value in term.params if key not in ("name",))
        name = dict(term.params).get("name", "")
        parts.append(f"{term.function.__name__}({', '.join(filter(None, [name, given]))})")
    return ", ".join(parts)


def _print_world(task: object, console: Console) -> None:
    """The world cell by cell, in colours on a terminal, in letters elsewhere; wide worlds fold."""
    cells: dict[tuple[int, int], int] = {}
    for item in task.objects:
        rows = item.grid.shape[0]
        for row in range(rows):
            for column in range(item.grid.shape[1]):
                if item.grid[row, column]:
                    cells[item.x + column, item.y + rows - 1 - row] = int(item.grid[row, column])
    left, bottom = task.robot_cell
    robot = {(left + dx, bottom + dy) for dx in range(ROBOT_SIZE) for dy in range(ROBOT_SIZE)}
    places = [*cells, *robot]
    width, height = max(x for x, _ in places) + 1, max(y for _, y in places) + 1
    colour = console.is_terminal and console.color_system is not None
    per_cell = 2 if colour else 1
    fold = max((console.width - 1) // per_cell, 10)
    for start in range(0, width, fold):
        lines = []
        for y in range(height - 1, -1, -1):
            line = Text()
            for x in range(start, min(start + fold, width)):
                kind = cells.get((x, y), 0)
                if kind == 0 and (x, y) in robot:
                    line.append("R" * per_cell, style="bold" if colour else "")
                else:
                    line.append("  " if colour else GLYPHS[kind], style=PAINT[kind] if colour else "")
            lines.append(line)
        _print_lines(lines, console)
        if start + fold < width:
            console.print()


def _print_lines(lines: list[Text], console: Console) -> None:
    """Print the rows of a world; of many equal ones in a row only the first and the last."""
    start = 0
    while start < len(lines):
        end = start
        while end < len(lines) and lines[end] == lines[start]:
            end += 1
        if end - start > SAME_ROWS:
            rows = [
                lines[start],
                Text(f"  ({end - start - 2} more rows like these)", style="dim"),
                lines[end - 1],
            ]
        else:
            rows = lines[start:end]
        for row in rows:
            console.print(row, soft_wrap=True)
        start = end
