"""The readers of files under test: a seed of each format, how it is spoilt, and what is done with what is accepted."""

from __future__ import annotations

import copy
import io
import itertools
import json
import random
import sqlite3
from collections.abc import Callable
from contextlib import closing
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import fuzz_mutate as mutate
import numpy as np
import yaml
from fuzz_harness import Target

from warpvox.compile import compile_world
from warpvox.design import example_designs, full_connections, load_design, sample_design, save_design
from warpvox.errors import WorldError
from warpvox.types import Physics
from warpvox.view.rollout import Rollout
from warpvox.world import World

Draw = random.Random

# ------------------------------------------------------------------------------------------------------- seeds


@cache
def world_trees() -> list[dict]:
    """Worlds as EvoGym writes them and as we do (with a ``box``)."""
    trees = []
    for seed in range(3):
        world = World(12, 8)
        world.add_from_array("ground", np.full((1, 12), 5), 0, 0)
        world.add_from_array("robot", sample_design((3, 3), seed), 2, 2)
        padded = np.zeros((3, 4), int)
        padded[1, 1:3] = 1, 2
        world.add_from_array("stone ä", padded, 7, 3)
        trees.append(json.loads(world.to_json()))
    del trees[0]["objects"]["stone ä"]["box"]
    return trees


@cache
def design_arrays() -> list[np.ndarray]:
    """Bodies, small and not so small."""
    return [*list(example_designs().values())[:4], np.array([[3]], np.int8), sample_design((7, 6), 1)]


@cache
def rollout_bytes() -> tuple[bytes, ...]:
    """Two short rollouts: of one environment, and of two with different bodies."""
    from warpvox.envs.vec_env import make_vec
    from warpvox.view.rollout import record

    made = []
    for designs, count in ((["mini"], 1), ([[[3]], [[4, 3]]], 2)):
        target = io.BytesIO()
        rollout = record(make_vec("Walker-v0", designs, count, device="cpu", threads=1), "sine", 3)
        rollout_file(target, rollout)
        made.append(target.getvalue())
    return tuple(made)


def rollout_file(target: io.BytesIO, rollout: Rollout) -> None:
    """A rollout as a file in memory."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        target.write(rollout.save(Path(folder, "rollout.npz")).read_bytes())


@cache
def checkpoint_content() -> dict[str, Any]:
    """What a checkpoint of a small policy holds."""
    import torch

    from warpvox.algos.checkpoints.files import PolicySpec, build_actor, spec_dict

    spec = PolicySpec(6, 3, [8, 4], "elu", True, 0.4)
    with torch.random.fork_rng():
        torch.manual_seed(0)
        weights = build_actor(spec).state_dict()
    return {"policy": spec_dict(spec), "actor_state_dict": weights, "iteration": 3, "score": [1.0, None]}


@cache
def archive_bytes() -> bytes:
    """An archive of two generations."""
    import tempfile

    from warpvox.algos.candidate import Candidate, Outcome
    from warpvox.algos.codesign.archive import Archive, Finished

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "archive.sqlite")
        with Archive.create(path, {"task": "Walker-v0", "search": {"name": "ga"}}) as archive:
            for generation in range(2):
                items = [
                    Candidate(
                        2 * generation + k,
                        sample_design((3, 3), 2 * generation + k),
                        (0,) * generation,
                        "x",
                        generation,
                    )
                    for k in range(2)
                ]
                archive.propose(items, seed=1)
                done = [
                    Finished(i.id, Outcome(float(i.id), [(10, 0.5)], 20), f"designs/{i.id}/p.pt", "ab") for i in items
                ]
                archive.finish(done, seconds=1.0)
        return path.read_bytes()


@cache
def config_text() -> str:
    """The configuration of a run as it is stored."""
    from warpvox.cli.config import load, to_yaml

    return to_yaml(load("train", []))


# ------------------------------------------------------------------------------------------------------ making


def world_json(draw: Draw) -> bytes:
    """A spoilt world file."""
    trees = world_trees()
    if draw.random() < 0.7:
        tree = mutate.spoil_tree(draw, draw.choice(trees))
        return mutate.as_json(draw, tree)
    return mutate.spoil_bytes(draw, json.dumps(draw.choice(trees)).encode(), json.dumps(draw.choice(trees)).encode())


def design_json(draw: Draw) -> bytes:
    """A spoilt design file."""
    rows = draw.choice(design_arrays()).tolist()
    tree = {"body": rows} if draw.random() < 0.6 else rows
    if draw.random() < 0.7:
        return mutate.as_json(draw, mutate.spoil_tree(draw, tree))
    return mutate.spoil_bytes(draw, json.dumps(tree).encode(), b'{"body": [[3, 3]], "body": [[4]]}')


def design_npz(draw: Draw) -> bytes:
    """A spoilt structure file."""
    body = draw.choice(design_arrays())
    arrays = {draw.choice(("arr_0", "arr_0", "body")): body, "arr_1": full_connections(body).T}
    if draw.random() < 0.5:
        name = draw.choice(list(arrays))
        arrays[name] = mutate.spoil_array(draw, arrays[name])
    return spoil_npz(draw, {f"{name}.npy": mutate.npy_bytes(array) for name, array in arrays.items()})


def spoil_npz(draw: Draw, parts: dict[str, bytes]) -> bytes:
    """An archive of arrays, spoilt at one of its levels."""
    data = mutate.zip_bytes(parts, packed=draw.random() < 0.5)
    kind = draw.randrange(5)
    if kind == 0:
        return mutate.spoil_bytes(draw, data, data)
    if kind == 1:
        return mutate.spoil_directory(draw, data)
    if kind == 2:
        return mutate.spoil_zip(draw, data, lambda d, name, part: mutate.false_header(d, part))
    if kind == 3:
        return mutate.spoil_zip(draw, data, lambda d, name, part: mutate.spoil_bytes(d, part))
    return data


def design_npy(draw: Draw) -> bytes:
    """A spoilt array file."""
    array = draw.choice(design_arrays())
    kind = draw.randrange(4)
    if kind == 0:
        return mutate.npy_bytes(mutate.spoil_array(draw, array))
    if kind == 1:
        return mutate.false_header(draw, mutate.npy_bytes(array))
    return mutate.spoil_bytes(draw, mutate.npy_bytes(array), mutate.npy_bytes(design_arrays()[0]))


def rollout_npz(draw: Draw) -> bytes:
    """A spoilt rollout."""
    parts = mutate.unzip(draw.choice(rollout_bytes()))
    kind = draw.randrange(4)
    if kind == 0:
        name = draw.choice([name for name in parts if name != "header.npy"])
        array = np.load(io.BytesIO(parts[name]))
        parts[name] = mutate.npy_bytes(mutate.spoil_array(draw, array))
        return mutate.zip_bytes(parts)
    if kind == 1 or kind == 2:
        header = json.loads(np.load(io.BytesIO(parts["header.npy"])).tobytes())
        text = mutate.as_json(draw, mutate.spoil_tree(draw, header))
        parts["header.npy"] = mutate.npy_bytes(np.frombuffer(text, np.uint8))
        return mutate.zip_bytes(parts)
    return spoil_npz(draw, parts)


def checkpoint_pt(draw: Draw) -> bytes:
    """A spoilt checkpoint."""
    import torch

    content = copy.deepcopy(checkpoint_content())
    kind = draw.randrange(4)
    if kind == 0:
        content = mutate.spoil_tree(draw, content)
    elif kind == 1:
        weights = content["actor_state_dict"]
        name = draw.choice(list(weights))
        changes = (
            lambda tensor: tensor.double(),
            lambda tensor: tensor.reshape(-1),
            lambda tensor: tensor.T,
            lambda tensor: tensor[:0],
            lambda tensor: torch.full_like(tensor, draw.choice((0, 1, 2**20))),
            lambda tensor: tensor.flatten()[:1].expand(10**6, 10**6),
            lambda tensor: tensor.float() * float("nan"),
            lambda tensor: tensor.to(torch.complex64),
            lambda tensor: tensor.to_sparse() if tensor.ndim else tensor,
            lambda tensor: None,
        )
        try:
            weights[name] = draw.choice(changes)(weights[name])
        except (RuntimeError, IndexError):
            del weights[name]
    target = io.BytesIO()
    try:
        torch.save(content, target)
    except (RecursionError, OverflowError, UnicodeEncodeError):
        return b""
    data = target.getvalue()
    if kind == 2:
        return mutate.spoil_bytes(draw, data, data)
    if kind == 3:
        parts = mutate.unzip(data)
        name = draw.choice((*[n for n in parts if n.endswith("data.pkl")] * 3, *parts))
        parts[name] = mutate.spoil_bytes(draw, parts[name])
        return mutate.zip_bytes(parts, packed=draw.random() < 0.1)
    return data


COLUMNS = {
    "experiment": ("key", "value"),
    "candidates": (
        *("id", "generation", "body", "origin", "seed", "fitness", "steps", "stopped", "reused", "policy"),
        *("policy_sha256", "proposed_at", "finished_at", "seconds"),
    ),
    "parents": ("child", "position", "parent"),
    "curves": ("candidate", "position", "steps", "value"),
}
SCHEMES = (
    "DROP TABLE curves",
    "DROP VIEW generations",
    "CREATE TABLE more (x)",
    "CREATE TRIGGER t AFTER UPDATE ON candidates BEGIN DELETE FROM candidates; END",
    "CREATE INDEX i ON candidates(abs(seed))",
    "ALTER TABLE candidates ADD COLUMN y",
    "ALTER TABLE candidates RENAME TO c; CREATE VIEW candidates AS SELECT * FROM c",
    "DROP VIEW generations; CREATE VIEW generations AS WITH RECURSIVE n(generation) AS (VALUES (1) UNION ALL SELECT"
    " generation + 1 FROM n) SELECT generation, 1 AS designs FROM n",
    "DROP VIEW generations; CREATE TABLE generations (generation, designs)",
    "DROP TABLE experiment; CREATE VIEW experiment AS WITH RECURSIVE n(key) AS (VALUES (1) UNION ALL SELECT key + 1"
    " FROM n) SELECT key, 'x' AS value FROM n",
    "PRAGMA user_version = 99",
    "PRAGMA user_version = 0",
    "PRAGMA application_id = 5",
    "DELETE FROM experiment",
    "DELETE FROM candidates WHERE id = 0",
)


def archive_sqlite(draw: Draw) -> bytes:
    """A spoilt archive."""
    if draw.random() < 0.4:
        return mutate.spoil_bytes(draw, archive_bytes(), archive_bytes())
    with closing(sqlite3.connect(":memory:", isolation_level=None)) as db:
        db.deserialize(archive_bytes())
        if draw.random() < 0.2:
            db.executescript(draw.choice(SCHEMES))
        for _ in range(draw.choice((0, 1, 1, 2))):
            table = draw.choice(list(COLUMNS))
            column = draw.choice(COLUMNS[table])
            given = mutate.value(draw)
            if isinstance(given, (list, dict)):
                given = mutate.as_json(draw, given) if draw.random() < 0.5 else json.dumps(str(given))
            elif isinstance(given, int) and not -(2**63) <= given < 2**63:
                given = str(given)
            where = f"WHERE rowid % {draw.choice((1, 2))} = 0" if table == "candidates" else ""
            try:
                db.execute(f"UPDATE {table} SET {column} = ? {where}", (given,))
            except (sqlite3.Error, UnicodeEncodeError):
                continue
        return db.serialize()


def config_yaml(draw: Draw) -> bytes:
    """A spoilt configuration."""
    text = config_text()
    kind = draw.randrange(4)
    if kind == 0:
        return mutate.spoil_bytes(draw, text.encode(), b"a: &a [x, x]\nb: [*a, *a]\n")
    if kind == 1:
        lines = text.splitlines(keepends=True)
        spot = draw.randrange(len(lines))
        word = draw.choice(
            (
                "!!python/object/apply:os.system ['touch pwned']",
                "!!python/name:os.system ''",
                "!!binary 'x'",
                "&a [*a]",
                "${oc.env:HOME}",
                "${seed}",
                "2001-99-99",
                "1" * 5000,
                "0x" + "f" * 300,
                "1:60:60.5",
                ".nan",
                "[" * draw.choice((10, 3000)),
                "{a: " * 3000,
                "'\\ud800'",
                '"\\ud800"',
                "<<: 5",
            )
        )
        lines[spot] = lines[spot].split(":")[0] + ": " + word + "\n"
        return "".join(lines).encode()
    tree = mutate.spoil_tree(draw, yaml.safe_load(text))
    try:
        return yaml.safe_dump(tree, allow_unicode=draw.random() < 0.5, sort_keys=False).encode("utf-8", "replace")
    except (RecursionError, yaml.YAMLError):
        return b"[" * 5000


def object_text(draw: Draw) -> bytes:
    """A spoilt file of EvoGym's for a single object: columns, rows, cells, pairs."""
    body = draw.choice(design_arrays())
    words = [body.shape[1], body.shape[0], *body.ravel().tolist(), *full_connections(body).ravel().tolist()]
    if draw.random() < 0.5:
        spoilt = mutate.spoil_tree(draw, words)
        words = [str(word) for word in spoilt] if isinstance(spoilt, list) else [str(spoilt)]
        return " ".join(words).encode("utf-8", "replace")
    return mutate.spoil_bytes(draw, " ".join(map(str, words)).encode())


# ----------------------------------------------------------------------------------------------- what is done


class Readers:
    """The readers, each with what an accepted input must be good for.

    Args:
        folder: for the files.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._turn = itertools.count()

    def _file(self, name: str, data: bytes) -> Path:
        path = self.folder / name
        path.write_bytes(data)
        return path

    def world(self, data: bytes) -> None:
        """What is read can be written, read back, drawn and compiled."""
        world = World.from_json(self._file("world.json", data))
        assert World.from_json(json.loads(world.to_json())) == world
        assert world.grid().shape == (world.height, world.width)
        if sum(obj.grid.size for obj in world.objects.values()) < 2000:
            compile_world(world, Physics.preset("evogym"))

    def drop_in_world(self, data: bytes) -> None:
        """The same file for the drop-in."""
        from warpvox.evogym.world import EvoWorld

        world = EvoWorld.from_json(str(self._file("evoworld.json", data)))
        assert all(obj.get_structure().any() for obj in world.objects.values())

    def drop_in_object(self, data: bytes) -> None:
        """An object from a text of numbers."""
        from warpvox.evogym.simulator_cpp import Sim

        Sim().read_object_from_file(str(self._file("object.txt", data)), "thing", 1, 1)

    def design(self, suffix: str) -> Callable[[bytes], None]:
        """What is read can be saved, read back, and put into a task or refused by its world."""

        def read(data: bytes) -> None:
            body = load_design(self._file(f"design{suffix}", data))
            saved = save_design(self.folder / f"again{suffix}", body)
            assert np.array_equal(load_design(saved), body)
            fits_or_refused(body)

        return read

    def rollout(self, data: bytes) -> None:
        """What is read can be drawn, put on a page, and every now and then written as USD."""
        from warpvox.view.player import page_of
        from warpvox.view.render import write_png

        rollout = Rollout.load(self._file("rollout.npz", data))
        write_png(rollout, self.folder / "picture.png", size=(64, 48))
        page_of(rollout).encode()
        if next(self._turn) % 10 == 0:
            from warpvox.view.usd import write_usd

            write_usd(rollout, self.folder / "rollout.usda")

    def checkpoint(self, data: bytes) -> None:
        """A policy that is read acts: finite numbers in the range of actions."""
        import torch

        from warpvox.algos.checkpoints.files import load_controller

        controller = load_controller(self._file("model_1.pt", data))
        actions = controller(torch.zeros(2, controller.spec.num_obs))
        assert actions.shape == (2, controller.spec.num_actions)
        assert bool(((actions >= 0.6) & (actions <= 1.6)).all())

    def archive(self, data: bytes) -> None:
        """All that can be asked of an archive is answered."""
        from warpvox.algos.codesign.archive import Archive

        path = self._file("archive.sqlite", data)
        (self.folder / "archive.sqlite-journal").unlink(missing_ok=True)
        with Archive.read(path) as archive:
            count = archive.count()
            assert isinstance(archive.settings, dict)
            json.dumps([archive.created_at, archive.trained(), archive.generations(), archive.digest()])
            records = archive.records()
            assert len(records) == count
            archive.best(3)
            archive.best(until=0)
            if records:
                archive.lineage(records[-1].id)

    def config(self, data: bytes) -> None:
        """The configuration of a run becomes the checked one of the command."""
        from warpvox.cli.config import load_values
        from warpvox.cli.runs import find_run

        run = self.folder / "run"
        run.mkdir(exist_ok=True)
        (run / "config.yaml").write_bytes(data)
        load_values("train", find_run(str(run), "outputs").config)

    def targets(self) -> list[Target]:
        """One for every reader."""
        # seconds of imports that are not an input's
        for name in ("render", "usd", "player", "envs.worlds", "algos.archive", "algos.checkpoint", "cli.config"):
            import_module(f"warpvox.{name}")
        return [
            Target("world .json", world_json, self.world, weight=200),
            Target("world .json, drop-in", world_json, self.drop_in_world, weight=120),
            Target("object .txt, drop-in", object_text, self.drop_in_object, weight=150),
            Target("design .json", design_json, self.design(".json"), weight=150),
            Target("design .npz", design_npz, self.design(".npz"), weight=80),
            Target("design .npy", design_npy, self.design(".npy"), weight=120),
            Target("rollout .npz", rollout_npz, self.rollout, weight=40),
            Target("checkpoint .pt", checkpoint_pt, self.checkpoint, weight=40),
            Target("archive .sqlite", archive_sqlite, self.archive, weight=50),
            Target("config.yaml of a run", config_yaml, self.config, weight=6),
        ]


def fits_or_refused(body: np.ndarray) -> None:
    """A valid body stands in the world of a task, or the world says why not."""
    from warpvox.envs.registry import get_task
    from warpvox.envs.worlds import task_world

    if body.size > 400:
        return
    try:
        compile_world(task_world(get_task("Walker-v0"), body), Physics.preset("evogym"))
    except WorldError as error:
        if "does not fit" not in str(error):
            raise
