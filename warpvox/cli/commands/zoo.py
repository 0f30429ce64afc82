"""``warpvox zoo``: lists the trained robots that come with the package, or shows one in detail."""

from collections.abc import Collection
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Column, Table

from warpvox.algos.robots.entry import read_robot
from warpvox.configs.tools import ZooConfig
from warpvox.design import ZOO_FOLDER
from warpvox.envs.registry import get_task, task_ids
from warpvox.errors import RunError, counted, did_you_mean, listing
from warpvox.examples import bare_id
from warpvox.io.console import echo, literal
from warpvox.io.text import duration, figure
from warpvox.view.cell_text import body_rows


def run(config: ZooConfig, given: Collection[str], console: Console) -> None:
    """Print a table of the robots, or one robot in detail."""
    folder = ZOO_FOLDER if config.folder is None else Path(config.folder).expanduser()

    # Files by task, in the order of the paper; tasks of the user's own last
    found = {path.stem: path for path in sorted(folder.glob("[!.]*.npz"))}
    if not found:
        raise RunError(f"{folder} has no robots, which are files TASK.npz.")
    entries = {name: found[name] for name in dict.fromkeys([*task_ids(), *found]) if name in found}

    if config.task is None:
        _print_all(entries, folder, console)
        return
    task = bare_id(config.task)
    if task not in entries:
        raise RunError(f"{folder} has no robot for {task}.{did_you_mean(task, entries)} It has {listing(entries, 40)}.")
    _print_one(entries[task], console)


def _print_all(entries: dict[str, Path], folder: Path, console: Console) -> None:
    """Print all robots as a table."""
    table = Table()
    # on a narrow terminal the body takes several lines
    for heading in ("task", "under noise", "nominal", "policy", "steps", "trained", "body"):
        side = "left" if heading in ("task", "policy", "body") else "right"
        table.add_column(heading, justify=side, no_wrap=heading != "body", overflow="fold")
    failed = []
    for name, path in entries.items():
        try:
            robot = read_robot(path)
        except RunError as error:
            failed.append(error)
            continue
        lengths = robot.about.get("lengths") or []
        spent = robot.about.get("control_steps")
        cells = (
            name,
            figure(robot.robust_return),
            figure(robot.mean_return),
            "network" if robot.has_feedback else "gait",
            f"{sum(lengths) / len(lengths):.0f}" if lengths else "-",
            "-" if spent is None else f"{spent:,}",
            "/".join("".join(map(str, row)) for row in robot.body.tolist()),
        )
        table.add_row(*map(literal, cells))
    console.print(table)
    for error in failed:
        echo(console, f"left out: {error}")
    total = sum(path.stat().st_size for path in entries.values())
    echo(console, f"{counted(len(entries) - len(failed), 'robots')} in {folder}, {total / 1e6:.2f} MB")
    echo(console, "under noise: mean of 32 episodes with noise of 0.01 on every action; nominal: as EvoGym gives it")
    echo(console, "steps: control steps of the nominal episode; both in exact arithmetic")
    echo(console, "trained: control steps of the whole search; body: cell types, rows from the top")
    echo(
        console,
        "policy: a network observes what the task has, the actions of a gait depend on the time alone",
    )
    echo(console, "`warpvox zoo task=ID` shows one in detail, `warpvox play zoo=ID` plays it.")


def _print_one(path: Path, console: Console) -> None:
    """Print one robot in detail."""
    robot = read_robot(path)
    console.print(body_rows([robot.body], [robot.task], console))
    about = robot.about
    limit = f" of at most {get_task(robot.task).max_episode_steps}" if robot.task in task_ids() else ""

    # Policy
    if robot.policy is None:
        policy = "none"
    elif robot.policy.spec.gait is not None:
        from warpvox.algos.robots.policies import arrays_of

        arrays = arrays_of(robot.policy)
        parameters = (
            sum(array.size for array in arrays.values()) - 1
        )  # without the beginning of the first stage, which is always 0
        policy = f"gait, open loop: {parameters} parameters, {counted(len(arrays['begin']), 'stages')}"
    else:
        spec = robot.policy.spec
        sizes = [spec.num_obs, *spec.hidden, spec.num_actions]
        policy = f"{'-'.join(map(str, sizes))}, {spec.activation}"

    # Cost of training
    steps = about.get("control_steps")
    seconds = about.get("wall_s")
    training = "unknown" if steps is None else f"{steps:,} control steps"
    if seconds is not None:
        training += f" in {duration(seconds)}"

    # Its nominal return, of several seeds where the task draws at random
    nominal = f"{about.get('return')}"
    returns = about.get("returns", [])
    seeds = about.get("seeds", [])
    if min(len(returns), len(seeds)) > 1:
        nominal += f", the mean over the seeds {seeds[0]} to {seeds[-1]}: {listing(returns)}"

    # The table
    rows: list[tuple[str, Any]] = [
        ("under noise", f"{figure(robot.robust_return)}, the mean of 32 episodes"),
        ("return", nominal),
        ("control steps", f"{listing(about.get('lengths', []))}{limit}"),
        ("policy", policy),
        ("training", training),
        *(("first", before["command"]) for before in about.get("start", ()) if "command" in before),
        ("command", about.get("command", "unknown")),
        (
            "made",
            f"{about.get('date', '-')}, warpvox {about.get('version')}, commit {about.get('commit') or 'unknown'}",
        ),
        ("processor", about.get("processor") or "unknown"),
        ("SHA-256", robot.sha256),
        ("file", path),
    ]
    table = Table("", Column(overflow="fold"), box=None, show_header=False)
    for name, value in rows:
        table.add_row(name, literal(value))
    console.print(table)
