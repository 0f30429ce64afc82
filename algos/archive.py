"""Archive of a design search: one SQLite file with all candidates and results.

Every change is a transaction, so that a process killed at any moment leaves a consistent file, and other programs
can read it while the search is running. The tables are described in ``docs/formats.md``.

The journal is SQLite's default, not WAL: an experiment then is a single file between two transactions, may be copied,
and may lie on the shared disk of a cluster, where WAL does not work. Writing happens once an evaluation, so that its
speed does not matter.
"""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import re
import sqlite3
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from warpvox.algos.candidate import FINALIST, Candidate, Outcome, candidate_seed
from warpvox.design import Design, as_grid
from warpvox.errors import RunError, StorageError
from warpvox.io.reading import parse_json
from warpvox.io.writing import atomic_path

FILE = "archive.sqlite"
"""File name of the archive in a run's folder."""
BACKUP = "archive.backup.sqlite"
"""File name of the copy made after each complete generation."""

APPLICATION = 0x77766F78
"""SQLite application id of archive files: "wvox"."""
VERSION = 1
"""Version of the tables in archive.sql; files of later versions are refused."""

_KINDS = {
    "id": int, "generation": int, "body": str, "origin": str, "seed": int, "fitness": float, "steps": int,
    "stopped": int, "reused": int, "policy": str, "policy_sha256": str, "seconds": float,
}  # fmt: skip
"""Columns of a candidate and their types; ``fitness`` and the columns after it may be NULL."""
DIVERGED = 2
"""Value of the column ``stopped`` for a candidate whose training diverged before any evaluation."""


@dataclass(frozen=True)
class Record:
    """A row of the archive: a candidate, and its result once evaluated.

    ``fitness`` and the fields after it are None until then. ``reused`` is the id of the earlier candidate with an equal
    body whose result was copied; ``policy_file`` is a path relative to the archive's folder; ``seconds`` the wall time
    since the previous batch ended, which is that of its own batch unless several are evaluated at a time. ``diverged``:
    learning gave no evaluation; once its generation is complete, ``fitness`` is set to the worst of all others so far
    (:meth:`Archive.rank_diverged`). ``folder`` is that of the archive.
    """

    candidate: Candidate
    seed: int
    fitness: float | None = None
    steps: int | None = None
    stopped: bool | None = None
    reused: int | None = None
    policy_file: str | None = None
    policy_sha256: str | None = None
    seconds: float | None = None
    curve: list[tuple[int, float]] = field(default_factory=list)
    diverged: bool = False
    folder: Path | None = field(default=None, repr=False, compare=False)

    def __repr__(self) -> str:
        rows, columns = self.body.shape
        parents = " and ".join(f"#{parent}" for parent in self.candidate.parents)
        descent = f"{self.candidate.origin} of {parents}" if parents else self.candidate.origin
        result = "not evaluated" if self.fitness is None else f"fitness {self.fitness:.2f}"
        return f"Record(#{self.id}, {rows}x{columns}, {descent}, {result})"

    @property
    def body(self) -> Design:
        """Body, int8 ``[rows, columns]``."""
        return self.candidate.body

    @property
    def design(self) -> Design:
        """Same as :attr:`body`, so that functions that take a design accept a record."""
        return self.body

    @property
    def policy_source(self) -> Path:
        """The folder that holds this design's policy, laid out like a training run.

        Raises:
            RunError: none was kept.
        """
        if self.folder is None or self.policy_file is None:
            raise RunError(f"Design {self.id} has no policy that was kept.")
        return (self.folder / self.policy_file).parent

    @property
    def finished(self) -> bool:
        """True once the candidate has been evaluated."""
        return self.stopped is not None

    @property
    def id(self) -> int:
        """Number of the candidate in its search."""
        return self.candidate.id


@dataclass(frozen=True)
class Finished:
    """Result to store for the candidate ``id``; ``policy_file`` and ``policy_sha256`` as in :class:`Record`."""

    id: int
    outcome: Outcome
    policy_file: str | None = None
    policy_sha256: str | None = None
    reused: int | None = None


class Archive(AbstractContextManager["Archive"]):
    """The SQLite file of one search, for reading and writing; a context manager that closes the file.

    Open it with :meth:`create`, :meth:`open` or :meth:`read`. Only one process at a time may write.
    """

    def __init__(self, path: Path, db: sqlite3.Connection, lock: sqlite3.Connection | None) -> None:
        self.path = path
        self._db = db
        self._lock = lock

    @classmethod
    def create(cls, path: Path, settings: Mapping[str, Any]) -> Archive:
        """Create an archive at ``path`` and open it for writing.

        Args:
            settings: all that the results follow from, as JSON can hold it.

        Raises:
            RunError: something stands there already. StorageError: the file cannot be written.
        """
        if path.exists():
            raise RunError(f"{path} exists already: an archive is never overwritten.")
        if hint := repair_hint(path):
            raise RunError(f"{path} is gone.{hint}")
        lock = _lock_for_writing(path)
        try:
            with atomic_path(path, make_folders=False) as temporary:  # a killed process leaves no empty archive
                cls._create_tables(temporary, settings)
            return cls(path, _connect(path, "rw"), lock)
        except (sqlite3.Error, StorageError) as error:
            lock.close()
            raise _write_error(path, error) from None

    @staticmethod
    def _create_tables(path: Path, settings: Mapping[str, Any]) -> None:
        """Create the tables of a new archive and store ``settings``, in one transaction."""
        with closing(_connect(path, "rwc")) as db, _transaction(db):
            for statement in _statements():
                db.execute(statement)
            for key, value in {"settings": dict(settings), "created_at": _now()}.items():
                db.execute("INSERT INTO experiment VALUES (?, ?)", (key, json.dumps(value)))
            # Inside the transaction: a file with our mark has all tables.
            db.execute(f"PRAGMA application_id = {APPLICATION}")
            db.execute(f"PRAGMA user_version = {VERSION}")

    @classmethod
    def open(cls, path: Path) -> Archive:
        """Open the archive at ``path`` for writing.

        Raises:
            RunError: no archive, a damaged or foreign one, or another process is writing it.
        """
        _check_exists(path)
        lock = _lock_for_writing(path)
        try:
            return cls(path, _open_checked(path), lock)
        except RunError:
            lock.close()
            raise

    @classmethod
    def read(cls, path: Path) -> Archive:
        """Open the archive at ``path`` for reading, even while another process writes to it.

        Raises:
            RunError: no archive, or a damaged or foreign one.
        """
        _check_exists(path)
        db = _open_checked(path)
        db.execute("PRAGMA query_only = ON")
        return cls(path, db, None)

    def close(self) -> None:
        """Close the file and release the write lock."""
        self._db.close()
        if self._lock is not None:
            self._lock.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def propose(self, candidates: Sequence[Candidate], seed: int) -> None:
        """Insert new candidates before their evaluation, all or none.

        Args:
            seed: of the experiment; those of the candidates follow from it.

        Raises:
            RunError: an id that is not the next one, or a parent that is not known. StorageError: the file cannot be
                written.
        """
        known = self.count()
        for expected, candidate in enumerate(candidates, start=known):
            if candidate.id != expected:
                raise RunError(f"The next candidate must have the id {expected}, got {candidate.id}.")
            if any(not 0 <= parent < candidate.id for parent in candidate.parents):
                raise RunError(f"Candidate {candidate.id} must descend from earlier ones, got {candidate.parents}.")
        with self._write_transaction() as db:
            for item in candidates:
                values = {
                    "id": item.id,
                    "generation": item.generation,
                    "body": body_text(item.body),
                    "origin": item.origin,
                    "seed": candidate_seed(seed, item.id),
                    "proposed_at": _now(),
                }
                query = f"INSERT INTO candidates ({', '.join(values)}) VALUES (?,?,?,?,?,?)"
                db.execute(query, tuple(values.values()))
                for position, parent in enumerate(item.parents):
                    db.execute("INSERT INTO parents VALUES (?,?,?)", (item.id, position, parent))

    def finish(self, results: Iterable[Finished], seconds: float = 0.0) -> None:
        """Store results of evaluated candidates, all or none.

        Raises:
            RunError: no such candidate, one that is evaluated already, a fitness or a value of the learning curve that
                is not finite. StorageError: the file cannot be written.
        """
        with self._write_transaction() as db:
            for result in results:
                outcome = result.outcome
                numbers = [value for _, value in outcome.curve]
                if not outcome.diverged:
                    numbers.append(outcome.fitness)
                if not all(map(math.isfinite, numbers)):
                    raise RunError(f"The evaluation of candidate {result.id} gave no finite number: {outcome.fitness}.")

                # The row of the candidate
                values = {
                    "fitness": None if outcome.diverged else float(outcome.fitness),
                    "steps": int(outcome.steps),
                    "stopped": DIVERGED if outcome.diverged else int(outcome.stopped),
                    "reused": result.reused,
                    "policy": result.policy_file,
                    "policy_sha256": result.policy_sha256,
                    "finished_at": _now(),
                    "seconds": seconds,
                }
                query = f"UPDATE candidates SET {'=?, '.join(values)}=? WHERE id=? AND stopped IS NULL"
                changed = db.execute(query, (*values.values(), result.id)).rowcount
                if changed != 1:
                    raise RunError(f"There is no candidate {result.id} that waits for its evaluation.")

                # Its learning curve
                for position, (steps, value) in enumerate(outcome.curve):
                    row = (result.id, position, int(steps), float(value))
                    db.execute("INSERT INTO curves VALUES (?,?,?,?)", row)

    @contextmanager
    def _write_transaction(self) -> Iterator[sqlite3.Connection]:
        """Run a write transaction within the block, and convert SQLite's errors to ours."""
        if self._lock is None:
            raise RunError(f"The archive {self.path} was opened for reading.")
        try:
            with _transaction(self._db):
                yield self._db
        except sqlite3.IntegrityError as error:  # rows that others have left where ours go
            raise _unreadable(self.path, f"is damaged ({error})") from None
        except sqlite3.Error as error:
            _check_interrupt(error)
            raise _write_error(self.path, error) from None

    def rank_diverged(self, generation: int) -> None:
        """Set the fitness of a generation's diverged designs to the worst fitness so far.

        Searches need a finite number (a Gaussian process cannot learn from -inf), and one that follows from the
        archive alone, in whatever order the designs were trained.

        Raises:
            RunError: there is no other to compare with. StorageError: the file cannot be written.
        """
        with self._write_transaction() as db:
            query = "SELECT MIN(fitness) FROM candidates WHERE generation <= ? AND stopped < ?"
            worst = db.execute(query, (generation, DIVERGED)).fetchone()[0]
            change = "UPDATE candidates SET fitness = ? WHERE generation = ? AND stopped = ? AND fitness IS NULL"
            changed = db.execute(change, (worst, generation, DIVERGED)).rowcount
            if changed and worst is None:
                raise RunError(f"No design has a fitness yet that those of generation {generation} could be given.")

    def back_up(self) -> Path:
        """Copy the archive to its backup file atomically; return the path.

        Raises:
            StorageError: it cannot be written.
        """
        path = self.path.with_name(BACKUP)
        try:
            with atomic_path(path, make_folders=False) as temporary, closing(sqlite3.connect(temporary)) as copy:
                self._db.backup(copy)
        except sqlite3.Error as error:
            raise _write_error(path, error) from None
        return path

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of the search, as given to :meth:`create`."""
        with self._reading():
            (text,) = self._db.execute("SELECT value FROM experiment WHERE key='settings'").fetchone()
            settings = json.loads(text)
        if not isinstance(settings, dict):
            raise RunError(f"{self.path} is damaged: its settings are {settings!r:.80}.")
        return settings

    def _select_number(self, query: str) -> int:
        """Return the single number that an SQL query selects."""
        with self._reading():
            return self._db.execute(query).fetchone()[0]

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """Report values of invalid types found within the block as damage, which SQLite itself accepts."""
        try:
            yield
        except (sqlite3.Error, ValueError, TypeError) as error:
            _check_interrupt(error)
            raise _unreadable(self.path, _access_problem(error) or f"is damaged ({error})") from None

    def count(self) -> int:
        """Count all candidates, evaluated or not."""
        return self._select_number("SELECT COUNT(*) FROM candidates")

    def trained(self) -> int:
        """Count the evaluated designs, except copies of results for an equal body."""
        return self._select_number("SELECT COUNT(*) FROM candidates WHERE stopped IS NOT NULL AND reused IS NULL")

    def finalists(self) -> int:
        """Count the evaluated finalists, which :meth:`trained` includes."""
        query = f"SELECT COUNT(*) FROM candidates WHERE stopped IS NOT NULL AND origin = '{FINALIST}'"
        return self._select_number(query)

    def generations(self) -> list[dict[str, Any]]:
        """Summarise each generation in a row: generation, designs, evaluated, best, mean, worst, steps."""
        with self._reading():
            return [dict(row) for row in self._db.execute("SELECT * FROM generations ORDER BY generation")]

    def records(self, generation: int | None = None) -> list[Record]:
        """Return all candidates, or those of one generation, ordered by id."""
        return self._records("") if generation is None else self._records("WHERE generation = ?", generation)

    def record(self, number: int) -> Record:
        """Return the candidate with the id ``number``.

        Raises:
            RunError: there is none with this id.
        """
        found = self._records("WHERE id = ?", number)
        if not found:
            raise RunError(f"{self.path} has no candidate {number}; there are {self.count()}, from 0.")
        return found[0]

    def best(self, count: int = 1, until: int | None = None, *, with_parents: bool = False) -> list[Record]:
        """Return the ``count`` designs of highest fitness with distinct bodies; in ties finalists come first.

        Designs whose training diverged before any evaluation are left out.

        Args:
            with_parents: also the designs that finalists come from, which have the same bodies.
        """
        order = "fitness DESC, last DESC, id"
        group = "body, last" if with_parents else "body"
        where = ""
        values: list[object] = []
        if until is not None:
            where = "AND generation <= ?"
            values.append(until)
        query = f"""WHERE id IN (
            SELECT id FROM (
                SELECT id, fitness, last, ROW_NUMBER() OVER (PARTITION BY {group} ORDER BY {order}) AS place
                FROM (SELECT *, origin = '{FINALIST}' AS last FROM candidates)
                WHERE fitness IS NOT NULL AND stopped < {DIVERGED} {where})
            WHERE place = 1 ORDER BY {order} LIMIT ?)"""
        found = self._records(query, *values, count)
        return sorted(found, key=lambda one: (-(one.fitness or 0.0), one.candidate.origin != FINALIST, one.id))

    def lineage(self, number: int) -> list[Record]:
        """Return a candidate and all its ancestors, ordered by id."""
        query = """WHERE id IN (
            WITH RECURSIVE line(id) AS (
                VALUES (?) UNION SELECT parent FROM parents JOIN line ON parents.child = line.id)
            SELECT id FROM line)"""
        return self._records(query, number)

    def _records(self, where: str, *values: object) -> list[Record]:
        """Return the candidates selected by an SQL condition, ordered by id."""
        parents = defaultdict(list)
        curves = defaultdict(list)
        # One transaction, so that a writer cannot change the tables between the queries
        with self._reading(), _transaction(self._db, "DEFERRED"):
            chosen = f"IN (SELECT id FROM candidates {where}) ORDER BY position"
            for child, parent in self._db.execute(f"SELECT child, parent FROM parents WHERE child {chosen}", values):
                parents[child].append(parent)
            query = f"SELECT candidate, steps, value FROM curves WHERE candidate {chosen}"
            for number, *point in self._db.execute(query, values):
                curves[number].append(tuple(point))
            query = f"SELECT {', '.join(_KINDS)} FROM candidates {where} ORDER BY id"
            rows = self._db.execute(query, values).fetchall()

        records = []
        with self._reading():
            for row in rows:
                record = _record(dict(row), parents[row["id"]], curves[row["id"]])
                records.append(replace(record, folder=self.path.parent))
        return records

    def digest(self) -> str:
        """Return a SHA-256 of everything but dates and durations: equal for equal searches."""
        total = hashlib.sha256(json.dumps(self.settings, sort_keys=True).encode())
        for record in self.records():
            item = record.candidate
            row = [item.id, item.generation, body_text(item.body), item.parents, item.origin, record.seed]
            row += [record.fitness, record.steps, record.stopped, record.reused]
            row += [record.policy_file, record.policy_sha256, record.curve]
            total.update(json.dumps(row).encode())
        return total.hexdigest()


def _record(row: dict[str, Any], parents: Sequence[int], curve: list[tuple[int, float]]) -> Record:
    """Build a record from a row of :data:`_KINDS`; ValueError: a value of an invalid type.

    SQLite's columns take values of any kind, whatever their declaration says.
    """
    # Values. Those of a result may be missing, but for the fitness of one that has ended.
    number = row["id"]
    stopped = row["stopped"]
    names = list(_KINDS)
    first_missing = names.index("fitness")
    if stopped in (0, 1):
        first_missing += 1
    for place, (name, kind) in enumerate(_KINDS.items()):
        value = row[name]
        known = isinstance(value, kind) and (kind is not float or math.isfinite(value))
        if not known and not (value is None and place >= first_missing):
            raise ValueError(f"the {name} of candidate {number!r:.40} is {value!r:.40}")

    # Parents, curve and policy
    if not all(isinstance(parent, int) and 0 <= parent < number for parent in parents):
        raise ValueError(f"candidate {number} descends from {parents!r:.80}")
    if not all(isinstance(steps, int) and isinstance(value, float) and math.isfinite(value) for steps, value in curve):
        raise ValueError(f"the curve of candidate {number} is {curve!r:.80}")
    policy = PurePath(row["policy"] or "")
    if policy.is_absolute() or ".." in policy.parts:
        raise ValueError(f"the policy of candidate {number} lies outside of the experiment: {row['policy']!r:.80}")

    body = as_grid(parse_json(row["body"]))
    candidate = Candidate(number, body, tuple(parents), row["origin"], row["generation"])
    known = {name: row[name] for name in _KINDS if name in Record.__dataclass_fields__}
    known["policy_file"] = row["policy"]
    known["stopped"] = None if stopped is None else bool(stopped)
    known["diverged"] = stopped == DIVERGED
    return Record(candidate, **known, curve=curve)


def repair_hint(path: Path) -> str:
    """Return a sentence on how to restore an archive from its backup; empty without a backup."""
    backup = path.with_name(BACKUP)
    if path == backup or not backup.is_file():
        return ""
    return (
        f" {backup.name} beside it holds all generations that were whole: copy it over {path.name} (and remove"
        f" {path.name}-journal, if there is one), then resume; on the same machine the result is the same."
    )


def archives_in(folder: Path) -> list[Path]:
    """List the folders of all design searches in ``folder``, including the folder itself, by path."""
    return sorted(path.parent for path in folder.rglob(FILE))


def body_text(body: np.ndarray) -> str:
    """Encode a body as in the archive: JSON without blanks."""
    return json.dumps(np.asarray(body).tolist(), separators=(",", ":"))


def _now() -> str:
    return datetime.now(timezone.utc).isoformat(timespec="milliseconds")


@contextmanager
def _transaction(db: sqlite3.Connection, kind: str = "IMMEDIATE") -> Iterator[None]:
    """Run a transaction within the block, rolled back if the block raises."""
    db.execute(f"BEGIN {kind}")
    try:
        yield
    except BaseException:
        if db.in_transaction:  # SQLite has rolled back by itself where, say, the disk is full
            db.execute("ROLLBACK")
        raise
    db.execute("COMMIT")


def _connect(path: Path, mode: str, wait: float = 30.0) -> sqlite3.Connection:
    """Open an SQLite file.

    Raises:
        sqlite3.Error: it cannot be opened, or a journal beside it says that it belongs to another one, as ours never
            does. SQLite deletes the file of that name, whatever it is, when it undoes what the journal is about.
    """
    journal = Path(f"{path.resolve()}-journal")
    if journal.is_file():
        with suppress(OSError), journal.open("rb") as file:  # what cannot be read SQLite cannot read either
            # SQLite's mark at the end of a journal that belongs to a transaction of several files
            mark = bytes.fromhex("d9d505f920a163d7")
            file.seek(0, os.SEEK_END)
            file.seek(max(0, file.tell() - len(mark)))
            if file.read() == mark:
                raise sqlite3.DatabaseError(f"{journal.name} is not of this archive alone; remove it")

    # transactions are opened by hand: isolation_level=None turns the module's own off
    options = {"uri": True, "timeout": wait, "isolation_level": None, "check_same_thread": False}
    db = sqlite3.connect(f"{path.resolve().as_uri()}?mode={mode}", **options)
    db.row_factory = sqlite3.Row
    # Called in the middle of a query, after some milliseconds of instructions, it gives Python the chance to handle a
    # signal, which ends the query.
    db.set_progress_handler(lambda: 0, 1_000_000)
    return db


def _check_interrupt(error: Exception) -> None:
    """Raise KeyboardInterrupt if Ctrl-C made a query fail."""
    if isinstance(error, sqlite3.OperationalError) and str(error) == "interrupted":
        raise KeyboardInterrupt from None


def _lock_for_writing(path: Path) -> sqlite3.Connection:
    """Lock the archive for writing by a transaction on a separate file, released when this process ends.

    The folder's own lock does not hold on Windows, nor on NFS, which locks only what is open for writing (flock(2)).
    """
    lock = path.with_name(path.name + ".lock")
    db = None
    try:
        db = _connect(lock, "rwc", wait=0)
        db.execute("PRAGMA journal_mode = MEMORY")  # nothing is ever written that would need another file
        db.execute("BEGIN EXCLUSIVE")
    except sqlite3.Error as error:
        if db is not None:
            db.close()
        if "locked" in str(error):
            raise RunError(f"Another process is writing {path}; there can be one at a time.") from None
        raise _write_error(lock, error) from None
    return db


def _write_error(path: Path, error: Exception) -> StorageError:
    """Build the error for an archive, or its lock file, that cannot be written."""
    reason = str(error).rstrip(".")
    cause = error if isinstance(error, OSError) else None
    if not path.parent.is_dir():
        reason = "its folder has vanished; was it removed or renamed, or its disk detached?"
    elif "readonly" in reason and not path.is_file():
        reason = "it has vanished; was it removed or renamed?"
    elif "full" in reason or getattr(error, "errno", None) == errno.ENOSPC:
        reason = "database or disk is full; free some space, or use a folder on another disk"
        cause = OSError(errno.ENOSPC, reason)
    return StorageError(f"{path} cannot be written: {reason}.", cause)


def _check_exists(path: Path) -> None:
    if not path.is_file():
        raise RunError(f"There is no archive at {path}.{repair_hint(path)}")


def _open_checked(path: Path) -> sqlite3.Connection:
    """Open a file and verify that it is an undamaged archive; RunError: it is not."""
    db = None
    try:
        # Writable also for reading: SQLite then undoes what a killed process has left half written.
        db = _connect(path, "rw")
        db.execute("PRAGMA trusted_schema = OFF")
        application = db.execute("PRAGMA application_id").fetchone()[0]
        version = db.execute("PRAGMA user_version").fetchone()[0]
        reason = _format_problem(db, application, version)
    except (sqlite3.Error, UnicodeDecodeError) as error:
        _check_interrupt(error)
        # SQLite repeats what is damaged, whatever bytes it has
        reason = _access_problem(error) or f"is damaged or no SQLite file ({error})"
    if reason is not None:
        if db is not None:
            db.close()
        raise _unreadable(path, reason)
    assert db is not None
    return db


def _unreadable(path: Path, reason: str) -> RunError:
    return RunError(f"{path} {reason}.{repair_hint(path) if 'damaged' in reason else ''}")


def _access_problem(error: Exception) -> str | None:
    """Return why an intact archive cannot be read now (disk full, locked, read-only); None: other causes."""
    text = str(error)
    unfinished = any(word in text for word in ("full", "I/O", "locked", "readonly"))
    if isinstance(error, sqlite3.OperationalError) and unfinished:
        return f"cannot be read ({text}): its disk must have some room and be writable, then it is as it was"
    return None


def _without_comments(statement: str) -> str:
    """Strip comments and line ends from an SQL statement."""
    return " ".join(re.sub("--[^\n]*", "", statement).split())


def _statements() -> list[str]:
    """Load the SQL statements that create the tables."""
    text = Path(__file__).with_suffix(".sql").read_text(encoding="utf-8")
    return [statement for statement in text.split(";\n") if statement.strip()]


def _format_problem(db: sqlite3.Connection, application: int, version: int) -> str | None:
    """Return, as text, why an SQLite file is not a complete archive; None: it is one."""
    # Whose it is
    if application != APPLICATION:
        return "is no archive of warpvox: an empty file, another program's, or a damaged one"
    if version > VERSION:
        return f"is an archive of version {version}; this warpvox reads up to {VERSION}: install a newer one"

    # What is missing at the end SQLite takes for zeros, which may pass for an empty page.
    pages = db.execute("PRAGMA page_count").fetchone()[0]
    size = db.execute("PRAGMA page_size").fetchone()[0]
    held = os.stat(db.execute("PRAGMA database_list").fetchone()[2]).st_size
    if held < pages * size:
        return f"is damaged (cut short: {held} of {pages * size} bytes)"

    # A view or a trigger in the place of a table, or beside it, is a program that may not end.
    wanted = set(map(_without_comments, _statements()))
    made = {_without_comments(str(text)) for (text,) in db.execute("SELECT sql FROM sqlite_master")}
    if missing := sorted(wanted - made):
        return f"is damaged: it lacks the table or view '{missing[0]:.60}...'"
    if others := sorted(made - wanted):
        return f"is no archive of warpvox: it has a table or view of somebody else's, '{others[0]:.60}...'"

    state = db.execute("PRAGMA quick_check").fetchone()[0]
    return None if state == "ok" else f"is damaged ({' '.join(state.split())})"
