"""Keys of ``warpvox codesign``."""

# ruff: noqa: RUF009  (key() is dataclasses.field with a meaning)

from dataclasses import dataclass

from warpvox.algos.codesign.archive_export import FORMATS
from warpvox.algos.codesign.settings import FITNESS, Codesign, Fitness
from warpvox.algos.search.settings import ALGORITHMS, SearchSettings
from warpvox.configs.schema import CONFIG_FILE, PresetConfig
from warpvox.keys import MISSING, key


@dataclass
class CodesignConfig(Codesign, PresetConfig):
    """Keys of ``warpvox codesign``."""

    search: SearchSettings = key(MISSING, "how designs are proposed", nodes=ALGORITHMS)
    fitness: Fitness = key(MISSING, "how the fitness of a design is found", nodes=FITNESS)
    export: list[str] = key(
        [],
        "formats in which the archive is written at the end: csv, parquet, npz and json (designs)",
        choices=tuple(FORMATS),
    )
    resume: str | None = key(None, "continue a search: latest or its folder")
    config: str | None = key(None, CONFIG_FILE)
    report: str | None = key(None, "only make the report and the exports of a search again: latest or its folder")
