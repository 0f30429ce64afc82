"""A page for each task of the benchmark, made while the site is built. Not part of the library.

Formulas are those of the terms, returns those of the zoo, of the tables of ``lab/zoo`` and of
``envs/known_returns.csv``; ``python -m lab.zoo.picture`` makes the films.
"""

import io
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from lab.zoo import results
from warpvox.algos.robots.entry import zoo
from warpvox.envs.about import UNITS
from warpvox.envs.registry import get_task, known_returns, task_ids
from warpvox.envs.spec import TaskSpec
from warpvox.envs.worlds import task_world
from warpvox.view.body_picture import draw_world

PAGE = Path(__file__).with_name("task_page.txt").read_text(encoding="utf-8")
EPISODES = {
    "noise": "with noise on the actions",
    "sticky": "with sticky actions",
    "start": "after random starts",
    "sensors": "with noise on the observations",
}


@cache
def pages() -> dict[str, str]:
    """Place in the site -> Markdown."""
    return {"tasks/index.md": _index()} | {f"tasks/{name}.md": _page(get_task(name)) for name in task_ids()}


@cache
def pictures() -> dict[str, bytes]:
    """Place in the site -> PNG of a task's world with the best robot in it."""
    made = {}
    for name in task_ids():
        file = io.BytesIO()
        draw_world(task_world(get_task(name), zoo(name).body)).save(file, "PNG", optimize=True)
        made[f"tasks/worlds/{name}.png"] = file.getvalue()
    return made


def _index() -> str:
    rows = [
        f"| [{task.id}]({task.id}.md) | {task.difficulty} | {task.max_episode_steps} | {task.summary} |"
        for task in map(get_task, task_ids())
    ]
    head = (
        "# All tasks\n\n![The worlds of all tasks](../images/gallery.png)\n\nThese pages show the released rules;"
        " [the paper's differ](../paper.md).\n\n| task | level | control steps | goal |\n|---|---|---:|---|"
    )
    return "\n".join([head, *rows, ""])


def _page(task: TaskSpec) -> str:
    kind = "a network" if zoo(task.id).has_feedback else "a gait, without feedback"
    weights = (f"{'-' if term.weight < 0 else '+'} {abs(term.weight):g} ×" for term in task.rewards)
    units = {term.about.unit for term in task.observations} - {"number"}
    named = ", ".join(f"`{memory.name}`" for memory in task.memory)
    moved = f" Every episode places {', '.join(task.randomized)} anew." if task.randomized else ""
    return PAGE.format(
        task=task,
        level=task.difficulty.capitalize(),
        kind=kind,
        rewards=_table(("weight", "term"), zip(weights, (f"`{term.formula}`" for term in task.rewards), strict=True)),
        ends=_table(("when", "added to the reward"), _ends(task)),
        observations=_table(("entries", "what", "unit", "values"), _observations(task)),
        units=" ".join(f"{name.capitalize()}: {UNITS[name]}." for name in UNITS if name in units),
        memory=f"\nEpisode state: {named}.{moved}\n" if named else "",
        returns=_table(("of", "return"), _returns(task)),
        training=_training(task.id),
        paper=_paper(task),
    )


def _table(head: tuple[str, ...], rows: Any) -> str:
    return "\n".join([f"| {' | '.join(head)} |", f"|{'---|' * len(head)}", *(f"| {' | '.join(row)} |" for row in rows)])


def _ends(task: TaskSpec) -> Iterator[tuple[str, str]]:
    for term in task.terminations:
        yield f"`{term.formula}`", f"{term.bonus:+g}" if term.bonus else "0"
    yield "the robot folds into itself", f"{task.unstable_penalty:+g}"


def _observations(task: TaskSpec) -> Iterator[tuple[str, str, str, str]]:
    for term in task.observations:
        params = dict(term.params)
        fixed, one = (term.about.size(params, points) for points in (0, 1))
        size = " + ".join([*([str(fixed)] if fixed else []), *([f"{one - fixed} n"] if one > fixed else [])])
        bounds = "any" if str(term.about.low) == "-inf" else f"{term.about.low:.4g} to {term.about.high:.4g}"
        yield size, f"`{term.formula}`", term.about.unit, bounds


def _returns(task: TaskSpec) -> Iterator[tuple[str, str]]:
    robot = zoo(task.id)
    for row in results.read_table(results.DISTURBED):
        if row["task"] == task.id:
            half = float(row["high"]) - float(row["mean"])
            yield f"our best robot, {EPISODES[row['episodes']]}", f"{row['mean']} ± {half:.3f}"
    yield f"the same, undisturbed ({'eight episodes' if task.is_random else 'one episode'})", f"{robot.mean_return:.3f}"

    repeated = results.repeated_means(results.read_table(results.REPEATED))
    if task.id in repeated:
        yield "the middle three of five trainings of its body, with noise on the actions", f"{repeated[task.id]:.3f}"

    known = known_returns()[task.id]
    published = f"best published ({known.method}: {known.protocol})"
    yield (published, f"{known.best:g}") if known.best is not None else ("best published", "none")
    yield "random bodies under random actions", f"{known.random:.3f}"


def _training(task: str) -> str:
    about = zoo(task).about
    hours, minutes = divmod(round(about["wall_s"] / 60), 60)
    time = f"{hours} h {minutes:02} min" if hours else f"{minutes} min"
    return f"{about['control_steps']:,} control steps, {time}"


def _paper(task: TaskSpec) -> str:
    changed = ", ".join(key.replace("_", " ") for key in task.paper)
    return (
        f"\nUnder `rules=paper` these differ: {changed} ([how](../paper.md#what-rulespaper-changes)).\n"
        if changed
        else ""
    )
