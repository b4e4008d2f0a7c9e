"""Index of a folder of parameter files, with what was judged of them: a database in the user's cache folder.

It lies with the user and not beside the files: who hands those over could write anything into it. It can be deleted at any
time. A manufacturer's folder has a million files, and a question is about ten of them: a database finds the rows of one serial
number without the others, and takes new ones without being written anew.
"""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing, suppress
from pathlib import Path
from typing import NamedTuple, TypeVar

from imufield.files import Origin, open_to_read

Found = TypeVar("Found")
State = str
"""Size of a file in bytes, and time of its last change in ns: what tells that it is still the one that was read."""

# In the name of the index: programs of two versions have one each. Raise it where entries or judgements hold other things.
INDEX_VERSION = 18
_IN_THIS_RUN = Path(":memory:")  # What SQLite calls a database that is never written.
_WAIT_S = 1.0  # For another program that writes the index; to put some thousands of rows takes less.
# Texts of entries are apart, so that names and states of all files are few pages.
_TABLES = """
    CREATE TABLE IF NOT EXISTS file
        (name TEXT PRIMARY KEY NOT NULL, state TEXT NOT NULL, fault TEXT NOT NULL, serial_number TEXT NOT NULL);
    CREATE TABLE IF NOT EXISTS entry (name TEXT PRIMARY KEY NOT NULL, text TEXT NOT NULL);
    CREATE INDEX IF NOT EXISTS instrument ON file (serial_number);
    CREATE TABLE IF NOT EXISTS judgement (instrument TEXT PRIMARY KEY NOT NULL, digest TEXT NOT NULL, text TEXT NOT NULL);
"""
# What stands in the way of an index that may be sound; whatever else SQLite says, it is damaged.
_IN_THE_WAY = {
    sqlite3.SQLITE_BUSY,
    sqlite3.SQLITE_LOCKED,
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_CANTOPEN,
    sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_IOERR,
}
_PRIMARY = 0xFF  # Bits of an error code of SQLite without its details.


class UnsoundIndexError(Exception):
    """What is no index of ours, or damaged: it is made anew."""


class Row(NamedTuple):
    """What was read of a TOML file."""

    fault: str
    """Why it is no entry; empty where it was never meant to be one."""
    serial_number: str
    entry: str | None
    """JSON."""


class Index:
    """Rows by names of files, relative to the folder."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection

    def unread(self, states: Mapping[str, State]) -> dict[str, State]:
        """Return the files that were not read in the state they are in; those that are no more are forgotten."""
        left, gone = dict(states), []
        for stored, state in self._connection.execute("SELECT name, state FROM file"):
            name = _plain(stored)
            if name not in states:
                gone.append((stored,))
            elif states[name] == state:
                del left[name]
        if gone:
            with self._connection:
                self._connection.executemany("DELETE FROM file WHERE name = ?", gone)
                self._connection.executemany("DELETE FROM entry WHERE name = ?", gone)
        return left

    def put(self, rows: Iterable[tuple[str, State, Row]]) -> None:
        """Keep what was read of some files, in one transaction."""
        # As JSON, which is ASCII, so that names of any bytes come back as they were.
        with self._connection:
            for name, state, row in rows:
                stored = json.dumps(name)
                file = (stored, state, json.dumps(row.fault), json.dumps(row.serial_number))
                self._connection.execute("REPLACE INTO file VALUES (?, ?, ?, ?)", file)
                self._connection.execute("DELETE FROM entry WHERE name = ?", (stored,))
                if row.entry is not None:
                    self._connection.execute("INSERT INTO entry VALUES (?, ?)", (stored, row.entry))

    def entries(self, serial_number: str | None) -> Iterator[str]:
        """Yield the entries of one instrument, or of all."""
        if serial_number is None:
            found = self._connection.execute("SELECT text FROM entry")
        else:
            join = "SELECT text FROM entry JOIN file USING (name) WHERE serial_number = ?"
            found = self._connection.execute(join, (json.dumps(serial_number),))
        yield from (text for (text,) in found)

    def judgement(self, instrument: str) -> tuple[str, str] | None:
        """Return digest and text of the judgement that is kept of an instrument; None where there is none."""
        found = self._connection.execute("SELECT digest, text FROM judgement WHERE instrument = ?", (json.dumps(instrument),))
        row: tuple[str, str] | None = found.fetchone()
        return row

    def put_judgements(self, rows: Iterable[tuple[str, str, str]]) -> None:
        """Keep instrument, digest and text of some judgements."""
        with self._connection:
            stored = ((json.dumps(instrument), digest, text) for instrument, digest, text in rows)
            self._connection.executemany("REPLACE INTO judgement VALUES (?, ?, ?)", stored)

    def faults(self) -> dict[str, str]:
        """Return what is wrong with files, by name."""
        found = self._connection.execute("SELECT name, fault FROM file WHERE fault != ?", (json.dumps(""),))
        return {_plain(name): _plain(fault) for name, fault in found}

    def __len__(self) -> int:
        """Return the number of entries."""
        return int(self._connection.execute("SELECT count(*) FROM entry").fetchone()[0])


def _plain(stored: str) -> str:
    try:
        text = json.loads(stored)
    except (ValueError, TypeError) as error:
        raise UnsoundIndexError(stored) from error
    if not isinstance(text, str):
        raise UnsoundIndexError(stored)
    return text


def index_file(folder: Path) -> Path:
    """Return where the index of a folder is kept."""
    import platformdirs  # Only here.

    name = hashlib.sha256(os.fsencode(folder.resolve())).hexdigest()
    return platformdirs.user_cache_path("imufield") / "history" / f"{name[:32]}-{INDEX_VERSION}.sqlite"


def with_index(folder: Path, work: Callable[[Index], Found]) -> Found:
    """Return what ``work`` finds by the index of a folder, which is of this run alone where none can be written."""
    path = index_file(folder)
    with suppress(OSError, sqlite3.DatabaseError):
        for _ in range(2):
            try:
                with closing(_connected(path)) as connection:
                    return work(Index(connection))
            except (sqlite3.DatabaseError, UnsoundIndexError) as error:
                if getattr(error, "sqlite_errorcode", 0) & _PRIMARY in _IN_THE_WAY:
                    raise
                path.unlink()
    with closing(_connected(_IN_THIS_RUN)) as connection:
        return work(Index(connection))


def _connected(path: Path) -> sqlite3.Connection:
    if path != _IN_THIS_RUN:
        path.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileNotFoundError):
            # SQLite would follow a link to another program's database, and wait at a pipe for ever.
            open_to_read(path, Origin.INSIDE).close()
    connection = sqlite3.connect(path, timeout=_WAIT_S)
    try:
        # An index that is up to date is only read: also from where nothing can be written.
        if not connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
            connection.executescript(_TABLES)
    except BaseException:
        connection.close()
        raise
    return connection
