"""Results of simulations on disk, found again by what they depend on."""

import os
import sqlite3
import time
from pathlib import Path

import numpy as np

from pymc_features.external.calls import Outcome

VERSION = 1
TABLES = """
CREATE TABLE IF NOT EXISTS results (
    key TEXT PRIMARY KEY, parameters BLOB, shape TEXT, value BLOB, seconds REAL, at REAL
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS failures (
    key TEXT, parameters BLOB, state TEXT, message TEXT, seconds REAL, at REAL
);
"""


class EvaluationCache:
    """A SQLite file of results and failures; several processes may use it at once.

    Parameters
    ----------
    path : path-like
        The file; made if absent.

    Raises
    ------
    ValueError
        If the file is something else, or of another version.

    Notes
    -----
    Every result is written when it arrives. Numbers are float64 bytes; nothing is pickled.
    """

    def __init__(self, path):
        self.path = Path(path)
        self._connection, self._pid = None, None
        self.connection  # noqa: B018  a wrong file is refused now

    @property
    def connection(self) -> sqlite3.Connection:
        """This process's connection: SQLite's do not survive a fork."""
        if self._connection is None or self._pid != os.getpid():
            self._connection, self._pid = self._open(), os.getpid()
        return self._connection

    def _open(self):
        try:
            connection = sqlite3.connect(
                self.path, timeout=60.0, isolation_level=None, check_same_thread=False
            )
            version = connection.execute("PRAGMA user_version").fetchone()[0]
            known = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
            if version != VERSION and known:
                raise ValueError(
                    f"`cache` must be a cache of simulations of version {VERSION}, got {self.path} with "
                    f"version {version}. Choose another file."
                )
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = NORMAL")
            connection.executescript(TABLES)
            connection.execute(f"PRAGMA user_version = {VERSION}")
        except sqlite3.OperationalError as error:
            raise ValueError(
                f"`cache` must be a file that can be written, got {self.path} ({error}). Is there its folder?"
            ) from None
        except sqlite3.DatabaseError as error:
            raise ValueError(
                f"`cache` must be a cache of simulations, got {self.path} ({error}). It is damaged or "
                "something else; choose another file."
            ) from None
        return connection

    def find(self, key: str) -> np.ndarray | None:
        """The result of a call, or None."""
        row = self.connection.execute("SELECT shape, value FROM results WHERE key = ?", (key,)).fetchone()
        if row is None:
            return None
        shape = tuple(int(n) for n in row[0].split(",") if n)
        return np.frombuffer(row[1], dtype=np.float64).reshape(shape).copy()

    def add(self, key: str, parameters: tuple, outcome: Outcome):
        """Keep what became of a call."""
        flat = np.concatenate([np.ravel(p) for p in parameters]).astype(np.float64)
        own = flat.tobytes(), outcome.seconds, time.time()
        if outcome.state == "ok":
            shape = ",".join(map(str, outcome.value.shape))
            self.connection.execute(
                "INSERT OR IGNORE INTO results VALUES (?, ?, ?, ?, ?, ?)",
                (key, own[0], shape, outcome.value.tobytes(), *own[1:]),
            )
        else:
            self.connection.execute(
                "INSERT INTO failures VALUES (?, ?, ?, ?, ?, ?)",
                (key, own[0], outcome.state, outcome.message, *own[1:]),
            )

    def close(self):
        """Close this process's connection."""
        if self._connection is not None and self._pid == os.getpid():
            self._connection.close()
        self._connection = None

    def __getstate__(self):
        return {"path": self.path}

    def __setstate__(self, state):
        self.path, self._connection, self._pid = state["path"], None, None
