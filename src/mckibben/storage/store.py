"""One SQLite file per study: jobs, the settings that determine each of them, and their records with checksums."""

from __future__ import annotations

import io
import json
import sqlite3
import threading
import warnings
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mckibben.errors import FileError, McKibbenWarning, Problem
from mckibben.storage.files import file_lock, make_folder

if TYPE_CHECKING:
    from numpy.typing import NDArray

STUDY = "study.sqlite"
"""Name of the file of a study in its folder."""

RESUME = "continue it with --resume (resume=True)"
_APPLICATION, _VERSION = 0x6D636B62, 1  # "mckb" in the header of the file
_SCHEMA = """
CREATE TABLE job (name TEXT PRIMARY KEY, about TEXT NOT NULL, checksum INTEGER NOT NULL);
CREATE TABLE record (job TEXT, number INTEGER, content BLOB NOT NULL, checksum INTEGER NOT NULL,
                     PRIMARY KEY (job, number));
"""
_DIGEST = "digest of "
_LONGEST = 160  # characters of a value in an error


class Store:
    """Jobs of a study in an SQLite file, or in memory; use `open_store`.

    A record is on the disk when `Job.add` returns (write-ahead log, synced), and survives a kill, a power cut and a
    full disk. Its checksum covers the settings of its job and its number, so that damage is never read as a result.
    """

    def __init__(self, path: Path | None, *, read_only: bool = False) -> None:
        self.path = path
        self.folder = Path() if path is None else path.parent
        self._lock = threading.Lock()
        self._count = 0
        self.begun = False
        name = ":memory:" if path is None else f"{path.absolute().as_uri()}?mode={'ro' if read_only else 'rwc'}"
        with self.explain_errors():
            self._connection = sqlite3.connect(name, uri=True, isolation_level=None, check_same_thread=False)
            self._prepare(read_only=read_only)

    def _prepare(self, *, read_only: bool) -> None:
        """Create the tables of a file without any, or check the version of an existing one."""
        run = self._connection.execute
        if not read_only and not run("SELECT count(*) FROM sqlite_master").fetchone()[0]:
            run("PRAGMA journal_mode = WAL")
            self._connection.executescript(
                f"BEGIN; PRAGMA application_id = {_APPLICATION}; PRAGMA user_version = {_VERSION}; {_SCHEMA} COMMIT"
            )
        run("PRAGMA synchronous = FULL")
        version = run("PRAGMA application_id").fetchone()[0], run("PRAGMA user_version").fetchone()[0]
        if version != (_APPLICATION, _VERSION):
            message = "it is not a study, or one of another version of mckibben"
            raise FileError(str(self.path), [Problem(message, field="version", remedy="choose another folder")])

    def close(self) -> None:
        """Close the file, so that it needs no others beside it."""
        with suppress(sqlite3.Error):  # a full disk: the write-ahead log remains, and is read when it is opened again
            self._connection.execute("PRAGMA journal_mode = DELETE")
        self._connection.close()

    @contextmanager
    def explain_errors(self) -> Iterator[None]:
        """Raise a `FileError` for a full or failing disk, a damaged file, or a folder that has disappeared."""
        try:
            yield
        except sqlite3.Error as error:
            code = getattr(error, "sqlite_errorcode", 0) & 0xFF
            kept = f"; {self._count} records are kept" if self._count else ""
            if code == sqlite3.SQLITE_FULL:
                problem = Problem(f"the disk is full{kept}", remedy=f"make room, and {RESUME}")
            elif code in (sqlite3.SQLITE_IOERR, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN):
                problem = Problem(f"it cannot be written or read ({error}){kept}", remedy=f"mend that, and {RESUME}")
            else:
                remedy = "restore the file from a copy, or start again in another folder"
                problem = Problem(f"it is damaged, or not a study: {error}", remedy=remedy)
            raise FileError(str(self.path), [problem]) from error

    def is_blank(self) -> bool:
        """Whether nothing is recorded, as after a kill before the first record."""
        with self.explain_errors():
            return self._connection.execute("SELECT 1 FROM record").fetchone() is None

    def about(self, name: str = "") -> dict[str, Any] | None:
        """Return the settings of a job; None if it has not begun. `FileError` if they are damaged."""
        with self.explain_errors():
            row = self._connection.execute("SELECT about, checksum FROM job WHERE name = ?", (name,)).fetchone()
        if row is None:
            return None
        if not isinstance(row[0], str) or zlib.crc32(row[0].encode()) != row[1]:
            remedy = "restore the file from a copy, or start again in another folder"
            raise FileError(
                str(self.path), [Problem("the settings of the study are damaged", field="about", remedy=remedy)]
            )
        return json.loads(row[0])

    def job(self, about: Mapping[str, Any], name: str = "") -> Job:
        """Begin a job, or continue the one of that name.

        Parameters
        ----------
        about
            All that determines the records, for JSON.

        Raises
        ------
        FileError
            If the job was begun with other settings, one problem per difference; or as `explain_errors`.
        """
        settings = json.loads(json.dumps(about))
        if (begun := self.about(name)) is None:
            text, begun = json.dumps(settings), settings
            self._write("INSERT INTO job VALUES (?, ?, ?)", [(name, text, zlib.crc32(text.encode()))])
        elif problems := differences(begun, settings):
            raise FileError(str(self.path or name), problems)
        self.begun = True
        job = Job(self, name, begun)
        self._count += len(job.numbers)
        return job

    def _write(self, statement: str, rows: list[tuple[Any, ...]]) -> None:
        """Write rows, all or none."""
        with self._lock, self.explain_errors():
            if self.path is not None and not self.path.exists():
                message = "the file has disappeared, or was moved, together with the records"
                raise FileError(str(self.path), [Problem(message, remedy="begin anew")])
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                self._connection.executemany(statement, rows)
                self._connection.execute("COMMIT")
            except BaseException:
                with suppress(sqlite3.Error):
                    self._connection.execute("ROLLBACK")
                raise


class Job:
    """Records of a job by number; `numbers` are those of the intact ones.

    Each record has a checksum over its number, the settings of the job and its content, so that one that is damaged, or
    belongs to another job, is computed again with a warning.
    """

    def __init__(self, store: Store, name: str, about: Mapping[str, Any]) -> None:
        self.about = dict(about)
        self._store, self._name = store, name
        self._seed = zlib.crc32(json.dumps(self.about).encode())
        with store.explain_errors():
            rows = store._connection.execute("SELECT number, content, checksum FROM record WHERE job = ?", (name,))
            intact = {number: self._checksum(number, content) == checksum for number, content, checksum in rows}
        self.numbers = {number for number, holds in intact.items() if holds}
        if damaged := len(intact) - len(self.numbers):
            message = f"{store.path}: {damaged} damaged records will be computed again"
            warnings.warn(message, McKibbenWarning, stacklevel=4)

    def _checksum(self, number: int, content: object) -> int:
        hashed = content if isinstance(content, bytes) else b""
        return zlib.crc32(hashed, zlib.crc32(f"{self._name} {number}".encode(), self._seed))

    def read(self, number: int) -> bytes:
        """Return the content of an intact record."""
        run = self._store._connection.execute
        with self._store._lock, self._store.explain_errors():
            return run("SELECT content FROM record WHERE job = ? AND number = ?", (self._name, number)).fetchone()[0]

    def add(self, records: Mapping[int, bytes]) -> None:
        """Write records by number, all or none; thread-safe. They are on the disk when it returns.

        Raises `FileError` if the disk is full, fails, or the file has disappeared.
        """
        rows = [(self._name, number, content, self._checksum(number, content)) for number, content in records.items()]
        self._store._write("INSERT OR REPLACE INTO record VALUES (?, ?, ?, ?)", rows)
        self._store._count += len(records.keys() - self.numbers)
        self.numbers |= records.keys()

    def read_arrays(self, number: int) -> dict[str, NDArray[Any]]:
        """Return a record of arrays by name, as `add_arrays` wrote it."""
        import numpy as np  # the command line starts without it

        with np.load(io.BytesIO(self.read(number)), allow_pickle=False) as file:
            return dict(file.items())

    def add_arrays(self, number: int, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Write a record of arrays by name."""
        import numpy as np

        content = io.BytesIO()
        np.savez(content, **arrays)  # type: ignore[arg-type]  # our names, none of which savez reserves
        self.add({number: content.getvalue()})


@contextmanager
def open_store(path: Path | None, *, resume: bool = False) -> Iterator[Store]:
    """Open the file of a study for writing; None for a study in memory. The file is locked for other processes.

    Raises
    ------
    FileError
        As `check_study`; if another process has the file, whose number is named; or as `Store.explain_errors`.
    """
    if path is not None:
        check_study(path, resume=resume)
        make_folder(path.parent)
    lock = nullcontext() if path is None else file_lock(path.with_name(f".{path.name}.lock"), "computing this study")
    with lock:
        if path is not None:  # nor meanwhile
            check_study(path, resume=resume)
        store = Store(path)
        try:
            if not resume:  # settings without records
                store._write("DELETE FROM job", [()])
            yield store
        finally:
            begun = store.begun or resume
            store.close()
            if path is not None and not begun:  # the arguments were not valid
                path.unlink(missing_ok=True)


def check_study(path: Path, *, resume: bool) -> None:
    """Raise `FileError` if there is no file of a study to continue, or one with records, which is never overwritten.

    A study that was killed before its first record can be begun in both ways.
    """
    if resume and not path.is_file():
        problem = Problem("there is no study to continue", remedy="leave out --resume (resume=True)")
    elif not resume and path.exists() and not _is_blank(path):
        problem = Problem("a study exists already", remedy=f"{RESUME}, or choose another folder")
    else:
        return
    raise FileError(str(path), [problem])


def _is_blank(path: Path) -> bool:
    store = Store(path)  # for writing, which also mends what a kill left
    try:
        return store.is_blank()
    finally:
        store._connection.close()


@contextmanager
def read_store(path: Path) -> Iterator[Store]:
    """Open the file of a study for reading only; `FileError` if there is none."""
    if not path.is_file():
        raise FileError(str(path), [Problem("there is no such study", remedy="give the file of a study")])
    store = Store(path, read_only=True)
    try:
        yield store
    finally:
        store._connection.close()


def differences(begun: Mapping[str, Any], settings: Mapping[str, Any]) -> list[Problem]:
    """Return one problem per difference between the settings of a study and those of its continuation.

    Settings whose name begins with "digest of " are reported if no other differs: they say that a file has changed, not
    how.

        >>> [problem.field for problem in differences({"seed": 3, "runs": 9}, {"seed": 4, "runs": 9})]
        ['seed']
    """
    remedy = "give the same, or leave out what the study knows, or choose another folder"
    problems = [
        Problem(f"the study was started with {_as_text(before)}, not {_as_text(now)}", field=field, remedy=remedy)
        for name in dict.fromkeys([*settings, *begun])
        if not name.startswith(_DIGEST)
        for field, before, now in _different(name, begun.get(name), settings.get(name))
    ]
    changed = [name for name in settings if name.startswith(_DIGEST) and begun.get(name) != settings[name]]
    what = "it has changed: a file that is named, the catalog, or the version of a library"
    fields = () if problems else (name.removeprefix(_DIGEST) for name in changed)
    return problems or [Problem(what, field=field, remedy="start again in another folder") for field in fields]


def _different(name: str, before: Any, now: Any) -> Iterator[tuple[str, Any, Any]]:
    """Field, old and new value of each difference between two values; of texts the first line that differs."""
    if before == now:
        return
    if isinstance(before, dict) and isinstance(now, dict):
        for key in {**before, **now}:
            yield from _different(f"{name} {key}", before.get(key), now.get(key))
    elif isinstance(before, str) and isinstance(now, str) and "\n" in before + now:
        lines = zip_longest(before.splitlines(), now.splitlines(), fillvalue="")
        yield next((name, old.strip(), new.strip()) for old, new in lines if old != new)
    else:
        yield name, before, now


def _as_text(value: Any) -> str:
    """Return a short text of a value; lists of numbers as count and range."""
    if isinstance(value, list) and value and all(isinstance(item, int | float) for item in value):
        return f"{len(value)} values from {min(value):.6g} to {max(value):.6g}"
    text = ", ".join(map(str, value)) if isinstance(value, list) else "nothing" if value is None else str(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."
