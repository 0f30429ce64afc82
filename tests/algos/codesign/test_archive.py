"""The archive: what is written is what is read, and files that are none are refused."""

import csv
import json
import math
import os
import sqlite3
import struct
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from refusals import refused

from warpvox.algos.archive import APPLICATION, BACKUP, FILE, VERSION, Archive, Finished
from warpvox.algos.candidate import Candidate, Outcome, candidate_seed
from warpvox.algos.codesign.archive_export import COLUMNS, FORMATS, write_csv, write_parquet
from warpvox.design import full_connections, load_design, sample_design
from warpvox.errors import RunError, StorageError
from warpvox.runs import END

SETTINGS = {"task": "Walker-v0", "search": {"name": "ga"}}
ENDLESS = "import sys, time; from pathlib import Path; from warpvox.algos.archive import Archive\n"


def bodies(count: int, seed: int = 0) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [sample_design((3, 4), rng) for _ in range(count)]


def candidates(count: int, start: int = 0, generation: int = 0) -> list[Candidate]:
    parents = [(), (0,), (1, 0)]
    return [
        Candidate(start + k, body, parents[min(start + k, 2)], "mutation" if k else "random", generation)
        for k, body in enumerate(bodies(count, start))
    ]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "archive.sqlite"


@pytest.fixture
def filled(path: Path) -> Archive:
    """Two generations of three; the last candidate is still waiting."""
    archive = Archive.create(path, SETTINGS)
    archive.propose(candidates(3), seed=7)
    archive.finish([Finished(k, Outcome(float(k), [(10, 0.5), (20, float(k))], 20), f"p{k}", "x") for k in range(3)])
    archive.propose(candidates(3, start=3, generation=1), seed=7)
    archive.finish(
        [Finished(3, Outcome(-1.0, steps=5, stopped=True)), Finished(4, Outcome(2.0), reused=2)], seconds=1.5
    )
    yield archive
    archive.close()


def test_what_is_written_is_what_is_read(filled: Archive, path: Path) -> None:
    with Archive.read(path) as archive:
        assert archive.settings == SETTINGS
        records = archive.records()
        for record, candidate in zip(records, [*candidates(3), *candidates(3, 3, 1)], strict=True):
            assert np.array_equal(record.candidate.body, candidate.body)
            assert record.candidate.body.dtype == np.int8
            for name in ("id", "parents", "origin", "generation"):
                assert getattr(record.candidate, name) == getattr(candidate, name)
            assert record.seed == candidate_seed(7, candidate.id)
        assert [record.fitness for record in records] == [0.0, 1.0, 2.0, -1.0, 2.0, None]
        assert records[1].curve == [(10, 0.5), (20, 1.0)]
        assert (records[1].policy_file, records[1].policy_sha256, records[1].steps) == ("p1", "x", 20)
        assert (records[3].stopped, records[3].seconds, records[4].reused) == (True, 1.5, 2)
        assert (archive.count(), archive.trained()) == (6, 4)
        assert [row["evaluated"] for row in archive.generations()] == [3, 2]
        assert [(row["best"], row["mean"]) for row in archive.generations()] == [(2.0, 1.0), (2.0, 0.5)]


@settings(max_examples=30)
@given(data=st.data())
def test_the_best_and_the_lineage_by_brute_force(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    pool = bodies(4)
    count = data.draw(st.integers(1, 12))
    parents = [
        tuple(data.draw(st.lists(st.integers(0, k - 1), max_size=2, unique=True))) if k else () for k in range(count)
    ]
    items = [Candidate(k, pool[data.draw(st.integers(0, 3))], parents[k]) for k in range(count)]
    fitness = [data.draw(st.floats(-5, 5)) for _ in items]
    with Archive.create(tmp_path_factory.mktemp("a") / "a.sqlite", {}) as archive:
        archive.propose(items, 0)
        archive.finish([Finished(k, Outcome(value)) for k, value in enumerate(fitness)])
        ranked = sorted(range(count), key=lambda k: (-fitness[k], k))
        seen, best = set(), []
        for k in ranked:
            text = str(items[k].body.tolist())
            if text not in seen:
                best.append(k)
            seen.add(text)
        assert [record.id for record in archive.best(3)] == best[:3]
        line, left = set(), [count - 1]
        while left:
            number = left.pop()
            line.add(number)
            left += parents[number]
        assert [record.id for record in archive.lineage(count - 1)] == sorted(line)


def test_the_digest_is_of_the_content_alone(tmp_path: Path) -> None:
    def make(name: str, settings: dict = SETTINGS, fitness: float = 1.0, seconds: float = 0.0, seed: int = 0) -> str:
        with Archive.create(tmp_path / name, settings) as archive:
            archive.propose(candidates(2), seed)
            archive.finish([Finished(0, Outcome(fitness, [(1, 0.1)]))], seconds)
            return archive.digest()

    first = make("a")
    assert make("b", seconds=9.0) == first
    others = [make("c", {"task": "x"}), make("d", fitness=math.nextafter(1.0, 2.0)), make("e", seed=1)]
    assert len({first, *others}) == 4


def test_all_or_nothing_is_written(filled: Archive) -> None:
    before = filled.digest()
    for wrong in ([Finished(5, Outcome(1.0)), Finished(4, Outcome(1.0))], [Finished(5, Outcome(1.0, [(1, math.nan)]))]):
        with pytest.raises(RunError):
            filled.finish(wrong)
    for wrong in (Candidate(7, bodies(1)[0]), Candidate(6, bodies(1)[0], parents=(6,))):
        with pytest.raises(RunError):
            filled.propose([wrong], 0)
    assert filled.digest() == before


def test_a_result_that_was_deleted_by_hand_is_made_again(filled: Archive, path: Path) -> None:
    db = sqlite3.connect(path)
    db.execute("UPDATE candidates SET stopped=NULL, fitness=NULL, steps=NULL WHERE id=4")
    db.execute("DELETE FROM curves WHERE candidate=4")
    db.commit()
    trained = filled.trained()
    filled.finish([Finished(4, Outcome(7.0))])
    assert filled.record(4).fitness == 7.0
    assert filled.trained() == trained + 1


def test_rows_that_others_have_left_are_damage(filled: Archive, path: Path) -> None:
    """A candidate was deleted by hand, but not its parents."""
    filled.back_up()
    db = sqlite3.connect(path)
    db.execute("INSERT INTO parents VALUES (6, 0, 1)")
    db.commit()
    with refused(RunError, "is damaged (UNIQUE", f"{BACKUP} beside it"):
        filled.propose([Candidate(6, bodies(1)[0], parents=(0,))], 0)


def test_one_process_writes_and_others_read(filled: Archive, path: Path) -> None:
    with refused(RunError, "Another process is writing"):
        Archive.open(path)
    with Archive.read(path) as reader:
        assert reader.count() == 6
        filled.finish([Finished(5, Outcome(9.0))])
        assert reader.best()[0].fitness == 9.0
        with pytest.raises(RunError):
            reader.finish([])
    filled.close()
    Archive.open(path).close()


def test_a_killed_writer_leaves_what_it_had_finished(path: Path) -> None:
    # killed in the middle of a transaction that SQLite has begun to write to the file
    code = ENDLESS + (
        "archive = Archive.create(Path(sys.argv[1]), {})\n"
        "db = archive._db\n"
        "db.execute('INSERT INTO experiment VALUES (?, ?)', ('kept', '1'))\n"
        "db.execute('PRAGMA cache_size = 1'); db.execute('PRAGMA cache_spill = 1'); db.execute('BEGIN IMMEDIATE')\n"
        "[db.execute('INSERT INTO experiment VALUES (?, ?)', (str(k), 'x' * 4000)) for k in range(200)]\n"
        "print('ready', flush=True); time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE) as process:
        assert process.stdout.readline().strip() == b"ready"
        size = path.stat().st_size
        process.kill()
    assert size > 200_000
    assert path.with_name(path.name + "-journal").is_file()
    with Archive.read(path) as archive:
        keys = [key for (key,) in archive._db.execute("SELECT key FROM experiment ORDER BY key")]
    assert keys == ["created_at", "kept", "settings"]
    Archive.open(path).close()


def test_files_that_are_no_archives_are_refused(tmp_path: Path) -> None:
    def other(name: str, application: int = 0, version: int = 0) -> Path:
        db = sqlite3.connect(tmp_path / name)
        db.execute("CREATE TABLE t (x)")
        db.execute(f"PRAGMA application_id = {application}")
        db.execute(f"PRAGMA user_version = {version}")
        db.commit()
        db.close()
        return tmp_path / name

    text = tmp_path / "text"
    text.write_text("not a database" * 100)
    empty = tmp_path / "empty"
    empty.write_text("")
    good = tmp_path / "good"
    with Archive.create(good, SETTINGS) as archive:
        archive.propose(candidates(200), 0)
    cut = tmp_path / "cut"
    cut.write_bytes(good.read_bytes()[:9000])
    for file, phrase in {
        tmp_path / "nothing": "no archive at",
        text: "no SQLite file",
        empty: "no archive of warpvox",
        other("foreign"): "no archive of warpvox",
        other("newer", APPLICATION, VERSION + 1): "install a newer one",
        other("lacking", APPLICATION, VERSION): "lacks the table",
        cut: "damaged",
    }.items():
        for way in (Archive.read, Archive.open):
            with refused(RunError, phrase):
                way(file)
    with refused(RunError, "never overwritten"):
        Archive.create(good, {})
    with pytest.raises(StorageError):
        Archive.create(tmp_path / "missing" / "a", {})
    Archive.open(good).close()
    lock = good.with_name(f"{good.name}.lock")
    lock.write_text("a note of somebody's" * 100)
    with refused(StorageError, f"{lock.name} cannot be written: file is not a database"):
        Archive.open(good)  # the archive itself is intact
    lock.unlink()
    Archive.open(good).close()
    (tmp_path / BACKUP).write_bytes(good.read_bytes())
    with refused(RunError, f"{BACKUP} beside it"):
        Archive.read(empty)  # as a file system may leave it after a power failure


def test_csv_holds_every_candidate(filled: Archive, tmp_path: Path) -> None:
    rows = list(csv.DictReader(write_csv(filled, tmp_path / "a.csv").open()))
    assert list(rows[0]) == list(COLUMNS)
    for row, record in zip(rows, filled.records(), strict=True):
        assert json.loads(row["body"]) == record.candidate.body.tolist()
        assert json.loads(row["parents"]) == list(record.candidate.parents)
        assert row["fitness"] == ("" if record.fitness is None else repr(record.fitness))
        assert list(zip(json.loads(row["curve_steps"]), json.loads(row["curve_values"]), strict=True)) == record.curve


def test_parquet_holds_the_same(filled: Archive, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
    table = parquet.read_table(write_parquet(filled, tmp_path / "a.parquet")).to_pylist()
    rows = csv.DictReader(write_csv(filled, tmp_path / "a.csv").open())
    for ours, theirs in zip(table, rows, strict=True):
        for name, value in ours.items():
            text = theirs[name]
            assert value == (json.loads(text) if name not in ("body", "origin", "policy") and text else text or None)


def test_parquet_without_pyarrow_says_what_to_do(filled: Archive, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with refused(RunError, "warpvox[analysis]"):
        FORMATS["parquet"](filled, tmp_path)
    assert sorted(os.listdir(tmp_path)) == ["archive.sqlite", "archive.sqlite.lock"]


@pytest.mark.parametrize("name", ["npz", "json"])
def test_designs_leave_in_the_formats_of_evogym_and_come_back(filled: Archive, tmp_path: Path, name: str) -> None:
    folder = FORMATS[name](filled, tmp_path)
    done = [record for record in filled.records() if record.fitness is not None]
    for record in done:
        file = folder / f"generation_{record.candidate.generation}" / "structure" / f"{record.id}.{name}"
        if name == "npz":
            with np.load(file) as content:
                assert sorted(content) == ["arr_0", "arr_1"]
                assert np.array_equal(content["arr_0"], record.candidate.body)
                assert np.array_equal(content["arr_1"], full_connections(record.candidate.body).T)
    assert (folder / "generation_0" / "output.txt").read_text() == "2\t\t2.0\n1\t\t1.0\n0\t\t0.0\n"
    back = {str(body.tolist()) for body in map(load_design, folder.rglob(f"*.{name}"))}
    assert back == {str(record.candidate.body.tolist()) for record in done}


@pytest.mark.parametrize("name", [FILE, f"{FILE}.lock"])
def test_no_journal_has_a_file_elsewhere_deleted(name: str, tmp_path: Path) -> None:
    """SQLite's journals may name another one, which it deletes when it has undone what they are about."""
    path, victim = tmp_path / "run" / FILE, tmp_path / "victim.txt"
    path.parent.mkdir()
    victim.write_text("mine")
    Archive.create(path, {"a": 1}).close()
    file = path.with_name(name)
    with closing(sqlite3.connect(file, isolation_level=None)) as db:
        db.execute("CREATE TABLE more AS SELECT 1 AS x")
        db.execute("PRAGMA cache_size = 1")
        db.execute("BEGIN IMMEDIATE")
        numbers = "WITH RECURSIVE c(x) AS (SELECT 0 UNION ALL SELECT x + 1 FROM c LIMIT 3000)"
        db.execute(f"INSERT INTO more {numbers} SELECT hex(randomblob(200)) FROM c")
        journal = file.with_name(f"{name}-journal").read_bytes()  # the cache is full: the disk has a part already
        half_written = file.read_bytes()
    text = str(victim).encode()
    mark = struct.pack(">II", len(text), sum(text)) + bytes.fromhex("d9d505f920a163d7")
    file.write_bytes(half_written)
    file.with_name(f"{name}-journal").write_bytes(journal + struct.pack(">I", (1 << 30) // 4096 + 1) + text + mark)
    if name == FILE:
        with refused(RunError, "journal"):
            Archive.read(path)
    with refused((RunError, StorageError), "journal"):
        Archive.open(path)
    assert victim.read_text() == "mine"


ENDLESS_ROWS = "WITH RECURSIVE c(x) AS (SELECT 0 UNION ALL SELECT x + 1 FROM c) SELECT x AS generation FROM c"
FOREIGN = {
    **{f"view of {name}": f"DROP TABLE {name}; CREATE VIEW {name} AS {ENDLESS_ROWS}"
       for name in ("experiment", "candidates", "parents", "curves")},
    "another view": f"DROP VIEW generations; CREATE VIEW generations AS {ENDLESS_ROWS}",
    "one view more": f"CREATE VIEW more AS {ENDLESS_ROWS}",
    "one table more": "CREATE TABLE more (x)",
    "one index more": "CREATE INDEX more ON candidates(origin)",
    "one index less": "DROP INDEX candidates_by_body",
    "trigger": "CREATE TRIGGER more AFTER UPDATE ON candidates BEGIN UPDATE candidates SET steps = 1; END",
    "column": "ALTER TABLE candidates ADD COLUMN more",
}  # fmt: skip


@pytest.mark.parametrize("name", FOREIGN)
def test_an_archive_has_our_tables_and_nothing_else(filled: Archive, name: str) -> None:
    filled.close()
    db = sqlite3.connect(filled.path)
    db.executescript(FOREIGN[name])
    db.close()
    for way in (Archive.read, Archive.open):
        with refused(RunError, "table or view"):
            way(filled.path)


def test_every_command_refuses_a_foreign_view(filled: Archive, warpvox: Callable, tmp_path: Path) -> None:
    filled.close()
    folder = tmp_path / "run"
    folder.mkdir()
    db = sqlite3.connect(filled.path)
    db.executescript(FOREIGN["another view"])
    db.close()
    filled.path.rename(folder / "archive.sqlite")
    (folder / "config.yaml").write_text(f"task: Walker-v0\nsearch: {{algorithm: ga}}\ntraining: {{}}\n{END}")
    for words in (
        ["play", f"run={folder}"],
        ["evaluate", f"runs=[{folder}]"],
        ["codesign", f"report={folder}"],
        ["codesign", f"resume={folder}"],
    ):
        done = warpvox(*words, code=None)
        assert "table or view" in " ".join((done.out + done.err).split()), words


def test_an_interrupt_ends_a_query(filled: Archive) -> None:
    code = f"""
import signal, sqlite3, threading
from pathlib import Path
from warpvox.algos.archive import Archive
path = Path({str(filled.path)!r})
with Archive.read(path) as archive:
    archive.generations()
    other = sqlite3.connect(path)
    other.executescript({FOREIGN["another view"]!r})
    other.close()
    threading.Timer(0.5, signal.raise_signal, [signal.SIGINT]).start()
    archive.generations()
"""
    filled.close()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stderr.strip().endswith("KeyboardInterrupt"), done.stderr
