"""``warpvox export``: writes a run's policy, or a rollout, in one format or several."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection
from pathlib import Path
from typing import Any

from rich.console import Console

from warpvox.cli.commands.play import check_source, play_run, write_results
from warpvox.cli.exports import check_exports
from warpvox.configs.schema import EXPORTS
from warpvox.configs.show import POLICY_EXPORTS
from warpvox.errors import ConfigError, listing
from warpvox.io.console import echo
from warpvox.io.text import shown
from warpvox.io.writing import to_yaml
from warpvox.runs import ZOO, as_name, new_folder, write_summary


def run(config: Any, given: Collection[str], console: Console) -> Path:
    """Export a run's policy or rollout in each requested format, and return the folder."""
    check_source(config)
    check_exports(config.format, config.size)
    if not config.format:
        raise ConfigError(f"format must be some of {listing((*EXPORTS, *POLICY_EXPORTS))}; got [].")
    pictures = [name for name in config.format if name in EXPORTS]
    programs = [name for name in config.format if name in POLICY_EXPORTS]

    # A recorded rollout
    if config.rollout is not None:
        if config.zoo is not None:
            raise ConfigError("rollout exports what was recorded: zoo cannot be given with it.")
        if programs:
            raise ConfigError(f"format={programs[0]} writes the policy of a run; a rollout holds none.")
        from warpvox.view.rollout import Rollout

        rollout = Rollout.load(config.rollout)
        source = config.rollout
        config = dataclasses.replace(config, run="")  # no run takes part
        return write_results(rollout, config, source, "export", pictures, console, keep=False)

    # A policy
    policy: Any = None
    if programs:  # first, so that errors of the policy show before anything is simulated
        with console.status("loading"):
            from warpvox.algos.training.loading import load_policy

            places = {"checkpoint": config.checkpoint, "output_dir": config.output_dir, "policy": config.policy}
            policy = load_policy(config.run if config.zoo is None else f"{ZOO}{config.zoo}", **places)
    if pictures:
        rollout, source = play_run(config, console)
        folder = write_results(rollout, config, source, "export", pictures, console)
        _write_policy(policy, folder, programs, console)
        return folder

    # The task's name comes from a file that somebody else may have written: it must stay a name.
    place = as_name(str(policy.metadata.get("task", ""))) or "policy"
    if config.run == "latest" and config.zoo is None:  # store the run's name, because `latest` changes
        config = dataclasses.replace(config, run=str(Path(policy.metadata["source"]).parent))
    with new_folder(config.output_dir, "export", place, config.name, to_yaml(config)) as folder:
        checks = _write_policy(policy, folder, programs, console)
        summary = {"command": "export", "task": policy.metadata.get("task"), "source": policy.metadata.get("source")}
        write_summary(folder, summary | {"checks": checks})
    return folder


def _write_policy(policy: Any, folder: Path, formats: list[str], console: Console) -> dict[str, str]:
    """Write the policy in each format and print the paths; return how each file was verified."""
    from warpvox.algos.checkpoints.export import POLICY_WRITERS

    checks = {}
    for name in dict.fromkeys(formats):
        file, write = POLICY_WRITERS[name]
        with console.status(f"writing {file}"):
            checks[name] = write(policy, folder / file)
        echo(console, f"{shown(folder / file)}  ({(folder / file).stat().st_size / 1e3:.0f} kB), {checks[name]}")
    return checks
