"""``warpvox tasks``: lists all tasks, or shows one in detail with a picture of its world."""

from collections.abc import Collection
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from warpvox.configs.tools import TasksConfig
from warpvox.design import example_designs
from warpvox.errors import ConfigError, WorldError, listing
from warpvox.examples import MADE_FOR
from warpvox.io.console import echo, literal
from warpvox.io.writing import check_suffix


def run(config: TasksConfig, given: Collection[str], console: Console) -> None:
    """Print the table of tasks or one task, or write the gallery."""
    for key, value, goes in (
        ("picture", config.picture, config.task is not None),
        ("rules", None if config.rules == "evogym" else config.rules, config.task is not None),
        ("gallery", config.gallery, config.task is None),
    ):
        if value is not None and not goes:
            raise ConfigError(f"{key} goes {'without' if key == 'gallery' else 'with'} a task, `warpvox tasks ID`.")
        if value is not None and key != "rules":
            check_suffix(key, value, (".png",), ConfigError)
    if config.gallery is not None:
        from warpvox.algos.report.gallery import everywhere, write_gallery

        echo(console, f"gallery: {write_gallery(config.gallery, everywhere(config.design))}")
    elif config.task is None:
        _print_all(console)
    else:
        _print_task(config.task, config, console)


def _print_all(console: Console) -> None:
    """Print all tasks as a table."""
    from warpvox.envs.registry import get_task, task_ids

    table = Table()
    for heading in ("task", "level", "steps", "observes", "section", "goal"):
        table.add_column(heading, justify="right" if heading in ("steps", "observes") else "left", overflow="fold")
    for name in task_ids():
        task = get_task(name)
        fixed = sum(term.about.size(dict(term.params), 0) for term in task.observations)
        with_point = sum(term.about.size(dict(term.params), 1) for term in task.observations)
        observes = f"{fixed} + {with_point - fixed} n"
        steps = str(task.max_episode_steps)
        table.add_row(task.id, task.difficulty, steps, observes, task.section, literal(task.summary))
    console.print(table)
    echo(console, "steps: the longest episode; observes: numbers in an observation of a robot of n points")
    echo(console, "`warpvox tasks ID` shows one in detail, `warpvox train task=ID` trains a robot for it.")


def _print_task(name: str, config: TasksConfig, console: Console) -> None:
    """Print one task in detail, and write the picture of its world if asked for."""
    from warpvox.envs.registry import get_task
    from warpvox.envs.worlds import load_worlds
    from warpvox.view.body_picture import draw_world, scene_of_world
    from warpvox.view.cell_text import print_world
    from warpvox.view.painter import save_png

    whole = get_task(name)
    task = whole.under(config.rules)
    world = load_worlds(task, [config.design], None)[1][0]
    section = f"paper section {task.section}, " if task.section else ""
    heading = literal(f" ({task.difficulty}, {section}rules={config.rules})")
    console.print(Text.assemble(literal(task.id, "bold"), heading))
    echo(console, f"{task.summary}\n")
    echo(console, f"episode  {task.max_episode_steps} control steps at most")

    # The reward of a control step, term by term
    lines = []
    for term in task.rewards:
        weight = "" if abs(term.weight) == 1 else f"{abs(term.weight):g} "
        sign = "- " if term.weight < 0 else "+ " if lines else ""
        lines.append(f"{sign}{weight}{term.formula}")
    lines.append("(Δ: after the step less before; [condition]: only where it holds after the step)")
    echo(console, "reward   " + "\n         ".join(lines))

    # The conditions of the end, with what each adds to the reward
    lines = []
    for term in task.terminations:
        lines.append(f"{term.formula}: {term.bonus:+g}" if term.bonus else f"{term.formula}: no bonus")
    lines.append(f"{'a' if task.partners else 'the'} robot folds into itself: {task.unstable_penalty:+g}")
    echo(console, "ends     " + "\n         ".join(lines))

    if task.memory:
        moved = f"; every episode places {listing(task.randomized)} anew" if task.randomized else ""
        echo(console, f"memory   {listing(memory.name for memory in task.memory)}{moved}")
    if whole.paper:
        other = {"evogym": "rules=paper changes", "paper": "different under rules=evogym"}[config.rules]
        echo(console, f"rules    {other}: {listing(key.replace('_', ' ') for key in whole.paper)}")
    echo(console, f"designs  {_designs(task)}")
    scene, _ = scene_of_world(world)
    _print_observation(task, config.design, {obj.name: obj.num_points for obj in scene.objects}, console)
    print_world(world, console)
    if config.picture is not None:
        echo(console, f"\npicture: {save_png(draw_world(world), config.picture)}")


def _designs(task: Any) -> str:
    """List, as text, the example designs that fit the task's world, recommended ones first."""
    from warpvox.envs.worlds import task_world

    if task.partners:
        return f"one each for {listing(task.robots)}"
    made = []
    others = []
    for name, body in example_designs().items():
        try:
            task_world(task, body)
        except WorldError:
            continue
        if task.id in MADE_FOR.get(name, ()):
            made.append(f"{name} (made for it)")
        else:
            others.append(name)
    return f"examples that fit: {listing(made + others)}"


def _print_observation(task: Any, design: Any, points: dict[str, int], console: Console) -> None:
    """Print the terms of a task's observation; ``points``: number of points by object."""
    from warpvox.envs.about import UNITS
    from warpvox.envs.worlds import task_team

    table = Table(title_justify="left")
    for heading in ("entries", "what", "unit", "values"):
        table.add_column(heading, justify="right" if heading == "entries" else "left", overflow="fold")
    start = 0
    units = set()
    for term in task.observations:
        about = term.about
        params = dict(term.params)
        end = start + about.size(params, points.get(params.get("name", ""), 0))
        low = f"{about.low:.4g}"
        high = f"{about.high:.4g}"
        values = "any" if (low, high) == ("-inf", "inf") else f"{low} to {high}"
        table.add_row(f"{start}:{end}", literal(term.formula), literal(about.unit), values)
        units.add(about.unit)
        start = end
    robots = ", ".join(f"{points[name]} points of {name}: {body}" for name, body in task_team(task, design).items())
    table.title = literal(f"observation: {start} numbers ({robots})")

    console.print()
    console.print(table)
    echo(console, "; ".join(f"{unit}: {meaning}" for unit, meaning in UNITS.items() if unit in units))
    echo(console, "x, y: centre of mass; v: its velocity; θ: turn since the beginning; p: (x, y); 0:2 is [0] and [1]")
    echo(console, "obs=timed: one number more at the end: the control steps since the episode began")
    echo(console, "obs=voxel: 25 numbers for every cell of a robot instead of its c, before the others\n")
