"""Keys of ``warpvox train``."""

# ruff: noqa: RUF009  (key() is dataclasses.field with a meaning)

from dataclasses import dataclass

from warpvox.algos.training.settings import Training
from warpvox.configs.schema import CONFIG_FILE, EXPORTS, PresetConfig
from warpvox.keys import key


@dataclass
class TrainConfig(Training, PresetConfig):
    """Keys of ``warpvox train``."""

    export: list[str] = key(
        [],
        "formats in which an episode of the best policy is written into the run's folder at the end",
        choices=EXPORTS,
    )
    config: str | None = key(None, CONFIG_FILE)
