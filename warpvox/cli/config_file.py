"""``config=FILE``: the values of a file as the beginning of a new run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from warpvox.cli.help import flat_keys, flat_values
from warpvox.cli.runs import CONFIG, LARGEST_CONFIG
from warpvox.configs.schema import COMMANDS
from warpvox.errors import ConfigError, did_you_mean, listing
from warpvox.io.reading import Unreadable, parse_yaml, read_text

__all__ = ["read_config_file"]

NOT_TAKEN = ("resume", "report", "config")
"""Keys of the run that the file has come from: they say what it did, not with what."""


def read_config_file(text: str, command: str) -> dict[str, Any]:
    """The values that a file holds for ``command``; ``text`` names the file or a run's folder.

    Raises:
        ConfigError: no such file, not YAML, or keys that the command does not have.
    """
    path = Path(text).expanduser()
    path = path / CONFIG if path.is_dir() else path
    if not path.is_file():
        raise ConfigError(f"There is no file {path}: config must be a YAML file or the folder of a run.")
    try:
        values = parse_yaml(read_text(path, LARGEST_CONFIG))
    except Unreadable as error:
        raise ConfigError(f"{path} cannot be read as YAML: {error}.") from None
    if not isinstance(values, dict) or not values:
        raise ConfigError(f"{path} holds no KEY: VALUE.")
    keys = {name: [key for key, _ in flat_keys(schema)] for name, schema in COMMANDS.items()}
    unknown = [name for name in flat_values(values) if name not in keys[command]]
    if unknown:
        other = next(
            (name for name in keys if "config" in keys[name] and {*flat_values(values)} <= {*keys[name]}), None
        )
        advice = (
            f"It is a configuration of `warpvox {other}`: warpvox {other} config=FILE."
            if other
            else f"Remove it, or write it as this version has it (`warpvox {command} --help`)."
        )
        names = f"the key '{unknown[0]}'" if len(unknown) == 1 else f"the keys {listing(unknown)}"
        hint = did_you_mean(unknown[0], keys[command])
        raise ConfigError(f"{path} has {names}, unknown to this version of warpvox.{hint} {advice}")
    return {name: value for name, value in values.items() if name not in NOT_TAKEN}
