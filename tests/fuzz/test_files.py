"""Damaged files of every format: refused with an error of ours, in time and memory, or read to something of use.

``--hypothesis-profile=thorough`` draws many more of them.
"""

from __future__ import annotations

import io
import json
import sqlite3
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
import yaml
from bounds import fuzz
from damage import (
    VALUES,
    as_json,
    damaged_bytes,
    damaged_json,
    damaged_npy,
    damaged_npz,
    damaged_tree,
    damaged_zip,
    npy,
    unzipped,
    zipped,
)
from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy
from sample_files import SCHEMES, archive_bytes, checkpoint_content, config_text, rollout_bytes, world_tree

from warpvox.algos.checkpoints.files import load_controller
from warpvox.algos.codesign.archive import Archive
from warpvox.cli.config import load_values
from warpvox.cli.runs import find_run
from warpvox.compile import compile_world
from warpvox.design import example_designs, full_connections, load_design, save_design
from warpvox.envs.registry import get_task
from warpvox.envs.worlds import task_world
from warpvox.errors import WorldError
from warpvox.evogym.simulator_cpp import Sim
from warpvox.evogym.world import EvoWorld
from warpvox.types import Physics
from warpvox.view.player import page_of
from warpvox.view.render import write_png
from warpvox.view.rollout import Rollout
from warpvox.view.usd import write_usd
from warpvox.world import World

BODY = example_designs()["walker"]


def use_design(path: Path) -> None:
    """What is read can be saved, read back, and put into a task or refused by its world."""
    body = load_design(path)
    assert np.array_equal(load_design(save_design(path.with_stem("again"), body)), body)
    if body.size <= 400:
        try:
            compile_world(task_world(get_task("Walker-v0"), body), Physics.preset("evogym"))
        except WorldError as error:
            if "does not fit" not in str(error):
                raise


def use_world(path: Path) -> None:
    """What is read can be written, read back and compiled."""
    world = World.from_json(path)
    assert World.from_json(json.loads(world.to_json())) == world
    assert world.grid().shape == (world.height, world.width)
    if sum(obj.grid.size for obj in world.objects.values()) < 2000:
        compile_world(world, Physics.preset("evogym"))


def use_evogym_world(path: Path) -> None:
    """The same file for the drop-in."""
    assert all(obj.get_structure().any() for obj in EvoWorld.from_json(str(path)).objects.values())


def use_object(path: Path) -> None:
    """A single object, as EvoGym's simulator reads it."""
    Sim().read_object_from_file(str(path), "thing", 1, 1)


def use_rollout(path: Path) -> None:
    """What is read can be drawn, put on a page and written as USD."""
    rollout = Rollout.load(path)
    write_png(rollout, path.with_suffix(".png"), size=(64, 48))
    page_of(rollout).encode()
    write_usd(rollout, path.with_suffix(".usda"))


def use_checkpoint(path: Path) -> None:
    """A policy that is read acts: finite numbers in the range of actions."""
    controller = load_controller(path)
    actions = controller(torch.zeros(2, controller.spec.num_obs))
    assert actions.shape == (2, controller.spec.num_actions)
    assert bool(((actions >= 0.6) & (actions <= 1.6)).all())


def use_archive(path: Path) -> None:
    """All that can be asked of an archive is answered."""
    path.with_name(f"{path.name}-journal").unlink(missing_ok=True)
    Archive.open(path).close()
    with Archive.read(path) as archive:
        assert isinstance(archive.settings, dict)
        json.dumps([archive.created_at, archive.trained(), archive.generations(), archive.digest()])
        records = archive.records()
        assert len(records) == archive.count()
        archive.best(until=0)
        if records:
            archive.lineage(records[-1].id)


def use_config(path: Path) -> None:
    """The configuration of a run becomes the checked one of the command."""
    load_values("train", find_run(str(path.parent), "outputs").config)


def damaged_rollout(data: bytes) -> SearchStrategy[bytes]:
    parts = unzipped(data)
    header = json.loads(np.load(io.BytesIO(parts["header.npy"])).tobytes())

    def with_header(tree: Any) -> bytes:
        return zipped(parts | {"header.npy": npy(np.frombuffer(as_json(tree), np.uint8))})

    return damaged_tree(header).map(with_header) | damaged_npz(parts)


def saved(content: Any) -> bytes:
    """A checkpoint; nothing where torch refuses to write it."""
    target = io.BytesIO()
    with suppress(UnicodeEncodeError, OverflowError):
        torch.save(content, target)
    return target.getvalue()


@st.composite
def altered_archive(draw: Callable, data: bytes, folder: Path) -> bytes:
    path = folder / "draft.sqlite"
    path.write_bytes(data)
    with closing(sqlite3.connect(path, isolation_level=None)) as db:
        if not draw(st.integers(0, 4)):
            db.executescript(draw(st.sampled_from([*SCHEMES, "PRAGMA user_version = 99", "DELETE FROM experiment"])))
            return path.read_bytes()
        table = draw(st.sampled_from(["experiment", "candidates", "parents", "curves"]))
        column = draw(st.sampled_from([row[1] for row in db.execute(f"PRAGMA table_info({table})")]))
        value = draw(VALUES)
        with suppress(sqlite3.Error, UnicodeEncodeError, OverflowError):
            db.execute(f"UPDATE {table} SET {column} = ?", [str(value) if isinstance(value, (list, dict)) else value])
    return path.read_bytes()


TAGS = ["!!python/object/apply:os.system ['touch pwned']", "&a [*a]", "${oc.env:HOME}", "2001-99-99", "'\\ud800'"]
TAGS += ["9" * 5000, "1:60:60.5", ".nan", "[" * 3000, "{a: " * 3000, "<<: 5", "!!binary 'x'"]


def damaged_config(data: bytes) -> SearchStrategy[bytes]:
    trees = damaged_tree(yaml.safe_load(data)).map(lambda tree: yaml.safe_dump(tree).encode())
    lines = st.sampled_from(TAGS).map(lambda word: data.replace(b"seed: 1", f"seed: {word}".encode()))
    return damaged_bytes(data) | trees | lines


class Reader(NamedTuple):
    """A name of a file, a valid content, damaged ones made of it, and what uses a file.

    Attributes:
        share: of the profile's number of examples.
    """

    name: str
    valid: Callable[[], bytes]
    damaged: Callable[[bytes, Path], SearchStrategy[bytes]]
    use: Callable[[Path], None]
    share: float = 1.0


def _object_text() -> bytes:
    return " ".join(map(str, [*BODY.T.shape, *BODY.ravel(), *full_connections(BODY).ravel()])).encode()


def _structure() -> bytes:
    return zipped({"arr_0.npy": npy(BODY), "arr_1.npy": npy(full_connections(BODY).T)})


def _json(data: bytes, _: Path) -> SearchStrategy[bytes]:
    return damaged_json(json.loads(data))


def _archive(data: bytes, folder: Path) -> SearchStrategy[bytes]:
    return damaged_bytes(data) | altered_archive(data, folder)


def _checkpoint(data: bytes, _: Path) -> SearchStrategy[bytes]:
    return damaged_tree(checkpoint_content()).map(saved) | damaged_zip(unzipped(data), damaged_bytes)


READERS = [
    Reader("world.json", lambda: as_json(world_tree()), _json, use_world),
    Reader("evogym_world.json", lambda: as_json(world_tree()), _json, use_evogym_world),
    Reader("object.txt", _object_text, lambda data, _: damaged_bytes(data), use_object),
    Reader("design.json", lambda: as_json({"body": BODY.tolist()}), _json, use_design),
    Reader("rows.json", lambda: as_json(BODY.tolist()), _json, use_design, 0.5),
    Reader("design.npz", _structure, lambda data, _: damaged_npz(unzipped(data)), use_design),
    Reader("design.npy", lambda: npy(BODY), lambda data, _: damaged_npy(BODY), use_design),
    Reader("rollout.npz", rollout_bytes, lambda data, _: damaged_rollout(data), use_rollout, 0.6),
    Reader("model_1.pt", lambda: saved(checkpoint_content()), _checkpoint, use_checkpoint, 0.6),
    Reader("archive.sqlite", archive_bytes, _archive, use_archive),
    Reader("config.yaml", lambda: config_text().encode(), lambda data, _: damaged_config(data), use_config, 0.2),
]


@pytest.mark.parametrize("reader", READERS, ids=lambda reader: reader.name)
def test_damaged_files_are_refused_or_of_use(reader: Reader, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)

    def use(data: bytes) -> None:
        path = tmp_path / reader.name
        path.write_bytes(data)
        reader.use(path)

    valid = reader.valid()
    use(valid)
    fuzz(reader.damaged(valid, tmp_path), use, reader.share)
    assert list(tmp_path.rglob("pwned")) == []
