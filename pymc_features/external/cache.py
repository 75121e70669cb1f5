"""Results of simulations on disk, found again by what they depend on."""

import sqlite3
import threading
import time
from contextlib import closing
from pathlib import Path
from weakref import WeakSet

import numpy as np

from pymc_features.external.workers.calls import Outcome
from pymc_features.system import at_fork

VERSION = 1
WAIT_SECONDS = 60.0  # for other writers
TABLES = """
CREATE TABLE results (
    key TEXT PRIMARY KEY, parameters BLOB, shape TEXT, value BLOB, seconds REAL, at REAL
) WITHOUT ROWID;
CREATE TABLE failures (
    key TEXT, parameters BLOB, state TEXT, message TEXT, seconds REAL, at REAL
);
"""

_ALL: WeakSet["EvaluationCache"] = WeakSet()
_HELD: list["EvaluationCache"] = []


class EvaluationCache:
    """A SQLite file of results and failures; several processes of one machine may use it at once.

    Every result is written when it arrives. Numbers are float64 bytes; nothing is pickled.

    Raises
    ------
    ValueError
        If the file cannot be written, is something else, or of another version.
    """

    def __init__(self, path):
        self.__setstate__({"path": Path(path).absolute()})
        try:
            with closing(connected(self.path)) as connection:
                prepare(connection, self.path)
        except sqlite3.OperationalError as error:
            raise ValueError(
                f"`cache` must be a file that can be written, got {self.path} ({error}). Is there its folder?"
            ) from None
        except sqlite3.DatabaseError as error:
            raise ValueError(
                f"`cache` must be a cache of simulations, got {self.path} ({error}). It is damaged or "
                "something else; choose another file."
            ) from None

    def execute(self, *statement):
        """Rows of a statement; the connection is opened when it is first needed."""
        with self.lock:
            if self.connection is None:
                self.connection = connected(self.path)
            return self.connection.execute(*statement).fetchall()

    def find(self, key: str) -> np.ndarray | None:
        """The result of a call, or None."""
        rows = self.execute("SELECT shape, value FROM results WHERE key = ?", (key,))
        if not rows:
            return None
        shape = tuple(int(n) for n in rows[0][0].split(",") if n)
        return np.frombuffer(rows[0][1], dtype=np.float64).reshape(shape).copy()

    def add(self, key: str, parameters: tuple, outcome: Outcome):
        """Keep what became of a call."""
        flat = np.concatenate([np.ravel(p) for p in parameters]).astype(np.float64)
        own = flat.tobytes(), outcome.seconds, time.time()
        if outcome.state == "ok":
            shape = ",".join(map(str, outcome.value.shape))
            self.execute(
                "INSERT OR IGNORE INTO results VALUES (?, ?, ?, ?, ?, ?)",
                (key, own[0], shape, outcome.value.tobytes(), *own[1:]),
            )
        else:
            self.execute(
                "INSERT INTO failures VALUES (?, ?, ?, ?, ?, ?)",
                (key, own[0], outcome.state, outcome.message, *own[1:]),
            )

    def failures(self) -> list[dict]:
        """All failures, the oldest first: parameters (one array), state, message, seconds, at (Unix time)."""
        names = ("parameters", "state", "message", "seconds", "at")
        rows = self.execute(f"SELECT {', '.join(names)} FROM failures ORDER BY rowid")
        return [dict(zip(names, (np.frombuffer(p), *more), strict=True)) for p, *more in rows]

    def close(self):
        """Close the connection; it opens again when needed."""
        with self.lock:
            if self.connection is not None:
                self.connection.close()
            self.connection = None

    def __getstate__(self):
        return {"path": self.path}

    def __setstate__(self, state):
        self.path, self.connection, self.lock = state["path"], None, threading.RLock()
        _ALL.add(self)


def connected(path) -> sqlite3.Connection:
    """A connection that any thread may use, one at a time."""
    connection = sqlite3.connect(path, timeout=WAIT_SECONDS, isolation_level=None, check_same_thread=False)
    connection.execute("PRAGMA synchronous = NORMAL")  # outlives the process, if not the power supply
    return connection


def prepare(connection, path):
    """Make the tables in a new file, all or nothing; refuse another one."""
    if connection.execute("PRAGMA user_version").fetchone()[0] != VERSION:
        connection.execute("BEGIN IMMEDIATE")
        version = connection.execute("PRAGMA user_version").fetchone()[0]
        if version != VERSION:  # nor has another process made it meanwhile
            if version or connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
                connection.execute("ROLLBACK")
                raise ValueError(
                    f"`cache` must be a cache of simulations of version {VERSION}, got {path} with version "
                    f"{version}. Choose another file."
                )
            for statement in TABLES.split(";")[:-1]:
                connection.execute(statement)
            connection.execute(f"PRAGMA user_version = {VERSION}")
        connection.execute("COMMIT")
    write_ahead(connection)
    connection.execute("SELECT count(*) FROM results").fetchone()


def write_ahead(connection):
    """Let readers and a writer work at once. SQLite does not wait here for others, so we do."""
    end = time.monotonic() + WAIT_SECONDS
    while True:
        try:
            connection.execute("PRAGMA journal_mode = WAL")
            return
        except sqlite3.OperationalError as error:
            if "locked" not in str(error) or time.monotonic() > end:
                raise
            time.sleep(0.02)


def before_fork():
    """Close all connections: SQLite's do not survive a fork."""
    _HELD.extend(_ALL)
    for cache in _HELD:
        cache.lock.acquire()
        cache.close()


def after_fork():
    """Reopen connections after a fork."""
    while _HELD:
        _HELD.pop().lock.release()


at_fork(before_fork, after_fork, after_fork)
