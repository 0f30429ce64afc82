"""``warpvox play``: runs a trained policy or a simple agent, prints returns and shows or exports the episode."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Collection, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from warpvox.algos.find import find_run
from warpvox.algos.protocols import NOMINAL
from warpvox.cli.exports import (
    LARGE,
    ROLLOUT,
    check_exports,
    print_returns,
    record_agent,
    record_run,
    tiles_of,
    write_exports,
)
from warpvox.code import Code
from warpvox.configs.show import PlayConfig
from warpvox.errors import ConfigError, DisplayError, listing
from warpvox.io.console import echo
from warpvox.io.text import escaped, shown
from warpvox.io.writing import to_yaml
from warpvox.runs import ZOO, as_name, new_folder, write_summary
from warpvox.types import FRAME_SECONDS
from warpvox.view.window import SWITCH, Window, wanted, why_no_window

if TYPE_CHECKING:
    from warpvox.view.rollout import Rollout


_OF_AGENTS = ("task", "design", "rules")
"""Keys for untrained agents only; a trained run has its own values."""


def run(config: PlayConfig, given: Collection[str], console: Console) -> Path:
    """Play one episode in every environment, write and show the rollout, and return the folder of the results."""
    check_source(config)
    obstacle = why_no_window() if wanted() else f"{SWITCH}=none switches windows off"
    if config.window == "on" and obstacle is not None:
        raise DisplayError(f"window=on cannot be: {obstacle}. Leave it away, and look at files: export=[gif,html].")
    in_window = config.window != "off" and obstacle is None
    formats = ([] if in_window else ["html"]) if config.export is None else config.export
    check_exports(formats, config.size)
    if config.rollout is not None:
        others = [name for name in ("agent", "zoo", *_OF_AGENTS) if getattr(config, name) is not None]
        if others:
            raise ConfigError(f"rollout shows what was recorded: {listing(others)} cannot be given with it.")
        from warpvox.view.rollout import Rollout

        rollout = Rollout.load(config.rollout)
        source = str(config.rollout)
        config = dataclasses.replace(config, run="", record=False)
    elif config.agent is None:
        rollout, source = play_run(config, console)
    else:
        if config.zoo is not None:
            raise ConfigError(
                "agent acts in place of a policy, zoo names one: give one of them (design=zoo:TASK takes the body)."
            )
        with console.status("loading"):
            from warpvox.devices.startup import prepare

            prepare(config.torch_threads, config.seed or 0)
        with console.status("simulating"):
            rollout = record_agent(config)
        source = f"agent {config.agent}"
        config = dataclasses.replace(config, run="")
    folder = write_results(rollout, config, source, "play", formats, console, config.record)
    if in_window:
        echo(console, "close the window to go on")
        width, height = config.size or LARGE
        play_in_window(rollout, tiles_of(rollout), (width, height))
    return folder


def check_source(config: Any) -> None:
    """Raise ConfigError if a run and another source (rollout, agent, zoo robot) are given, or a key needs a run."""
    other = next((name for name in ("rollout", "agent", "zoo") if getattr(config, name, None) is not None), None)
    if other and config.run not in ("latest", ""):  # the default, and the value stored without a run
        raise ConfigError(f"run and {other} both say what is shown: give one of them.")
    usual = {"checkpoint": "best"} | ({} if other == "zoo" else {"stochastic": False, "protocol": NOMINAL})
    for name in (name for name in usual if other and getattr(config, name, usual[name]) != usual[name]):
        raise ConfigError(f"{name} goes with a run, not with {other}.")


def play_run(config: Any, console: Console) -> tuple[Rollout, str]:
    """Record an episode of a run's policy; return the rollout and the path of the checkpoint or folder."""
    given = [name for name in _OF_AGENTS if getattr(config, name, None) is not None]
    if "task" in given and isinstance(config.task, Code):
        given.remove("task")  # code may be named for a run, too
    _check_not_given(name for name in given if name != "design")
    source = find_run(config.run if config.zoo is None else f"{ZOO}{config.zoo}", config.output_dir)
    if not source.is_many:
        _check_not_given(given)
    with console.status("loading"):
        from warpvox.algos.training.loading import load_run
        from warpvox.devices.startup import prepare

        prepare(config.torch_threads, config.seed or 0)
        env, controller = load_run(source, config, getattr(config, "design", None))
    with console.status("simulating"):
        protocol = getattr(config, "protocol", NOMINAL)
        rollout = record_run(source, env, controller, config.steps, config.stochastic, protocol)
    echo(console, f"run: {shown(source.folder)}")
    return rollout, str(source.checkpoint or source.folder)


def _check_not_given(names: Iterable[str]) -> None:
    """Raise ConfigError for keys that only an untrained agent takes."""
    for name in names:
        raise ConfigError(f"{name} goes with agent=random|sine|zero; a trained run has its own {name}.")


def write_results(
    rollout: Rollout, config: Any, source: str, command: str, formats: list[str], console: Console, keep: bool = True
) -> Path:
    """Print the returns of a rollout, write it with exports to a folder, and return the folder.

    Args:
        source: run, agent or file that the rollout comes from; replaces ``config.run`` if that names a run.
        keep: write the rollout itself as well.
    """
    resolved = dataclasses.replace(config, run=source, zoo=None) if config.run else config
    # The task's name may come from a file that somebody else has written: it must stay a name.
    place = as_name(rollout.title) or "rollout"
    with new_folder(config.output_dir, command, place, config.name, to_yaml(resolved)) as folder:
        print_returns(rollout, console)
        if keep:
            rollout.save(folder / ROLLOUT)
        write_exports(rollout, folder, formats, console, config.size, config.every)

        # Summary
        returns = rollout.returns[-1]
        summary = {
            "command": command,
            "task": rollout.title,
            "source": source,
            "seed": rollout.metadata.get("seed"),
            "mean_return": float(returns.mean()),
            "returns": [float(value) for value in returns],
            "lengths": [int(value) for value in rollout.lengths],
        }
        if "names" in rollout.metadata:
            summary["environments"] = rollout.names
        write_summary(folder, summary)
    return folder


def play_in_window(
    rollout: Rollout,
    envs: list[int],
    size: tuple[int, int],
    clock: Callable[[], float] = time.perf_counter,
    make_window: Callable[[tuple[int, int], str], Any] = Window,
) -> int:
    """Show running environments side by side until the window is closed; return the number of pictures.

    Time runs as in the simulation: a machine too slow to draw every frame leaves some out.
    """
    from warpvox.view.render import Film

    film = Film(rollout, envs, size)
    window = make_window(size, f"{escaped(rollout.title)} - warpvox")
    last = int(rollout.lengths.max())
    shown = -1
    count = 0
    start = clock()
    while not window.closed:
        passed = clock() - start
        frame = min(last, int(passed / FRAME_SECONDS))
        if frame != shown:
            picture = film.array(frame)
            shown = frame
            count += 1
        else:
            time.sleep(FRAME_SECONDS / 4)
        window.show(picture)  # also without a new picture, because this call handles the window's events
        # Show the last picture for a second before the episode starts again.
        if passed > last * FRAME_SECONDS + 1.0:
            start = clock()
    return count
