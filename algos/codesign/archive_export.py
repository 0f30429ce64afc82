"""Exports of an archive: tables for analysis, and bodies in EvoGym's file formats."""

import json
from pathlib import Path
from typing import Any

from warpvox.algos.archive import Archive, Record, body_text
from warpvox.design import save_design
from warpvox.errors import RunError
from warpvox.io.writing import atomic_path, check_suffix, write_table, write_text

COLUMNS = {
    "id": "int64", "generation": "int64", "body": "string", "rows": "int64", "columns": "int64", "origin": "string",
    "parents": ["int64"], "seed": "int64", "fitness": "float64", "steps": "int64", "stopped": "bool",
    "diverged": "bool", "reused": "int64", "policy": "string", "seconds": "float64", "curve_steps": ["int64"],
    "curve_values": ["float64"],
}  # fmt: skip
"""Columns of the tables with Arrow types; bodies are JSON text, and lists are too in CSV."""


def write_csv(archive: Archive, path: Path) -> Path:
    """Write the candidates as CSV with the columns :data:`COLUMNS`; unknown values are empty cells.

    RunError: another suffix than .csv.
    """
    check_suffix("The table", path, (".csv",), RunError)
    rows = []
    for record in archive.records():
        cells = []
        for value in _row(record).values():
            if isinstance(value, list):
                value = json.dumps(value)
            elif isinstance(value, bool):
                value = int(value)
            cells.append(value)
        rows.append(cells)
    write_table(path, COLUMNS, rows)
    return path


def write_parquet(archive: Archive, path: Path) -> Path:
    """Write the candidates as Parquet with the columns :data:`COLUMNS`. Needs the extra ``analysis`` (pyarrow).

    RunError: another suffix than .parquet, or pyarrow is missing.
    """
    check_suffix("The table", path, (".parquet",), RunError)
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        raise RunError(
            "Parquet needs pyarrow, which is not installed: pip install 'warpvox[analysis]', or write CSV."
        ) from None
    kinds = {
        name: pa.list_(pa.type_for_alias(*kind)) if isinstance(kind, list) else pa.type_for_alias(kind)
        for name, kind in COLUMNS.items()
    }
    table = pa.Table.from_pylist([_row(record) for record in archive.records()], schema=pa.schema(kinds))
    with atomic_path(path) as temporary:
        parquet.write_table(table, temporary)
    return path


def _write_designs(archive: Archive, folder: Path, suffix: str) -> Path:
    """Write every evaluated body to its own file, in the folders of EvoGym's searches.

    ``generation_<n>/structure/<id>.npz`` (or ``.json``) and, per generation, ``output.txt`` with a line
    ``<id> <fitness>`` for each design, best first.

    Args:
        suffix: ``.npz``, EvoGym's structure file (body and connections), or ``.json``.
    """
    for row in archive.generations():
        done = [record for record in archive.records(row["generation"]) if record.fitness is not None]
        place = folder / f"generation_{row['generation']}"
        for record in done:
            save_design(place / "structure" / f"{record.id}{suffix}", record.candidate.body)
        ranked = sorted(done, key=lambda record: (-(record.fitness or 0.0), record.id))
        write_text(place / "output.txt", "".join(f"{record.id}\t\t{record.fitness}\n" for record in ranked))
    return folder


def _row(record: Record) -> dict[str, Any]:
    """Convert a record to a row of the table."""
    item = record.candidate
    known = vars(record) | vars(item) | {"body": body_text(item.body), "parents": list(item.parents)}
    known["policy"] = record.policy_file
    known |= dict(zip(("rows", "columns"), item.body.shape, strict=True))
    for place, name in enumerate(("curve_steps", "curve_values")):
        known[name] = [point[place] for point in record.curve]
    return {name: known[name] for name in COLUMNS}


FORMATS = {
    "csv": lambda archive, folder: write_csv(archive, folder / "designs.csv"),
    "parquet": lambda archive, folder: write_parquet(archive, folder / "designs.parquet"),
    "npz": lambda archive, folder: _write_designs(archive, folder / "structures", ".npz"),
    "json": lambda archive, folder: _write_designs(archive, folder / "structures", ".json"),
}
"""Export functions by format: each writes an archive into a folder and returns the file's path."""
