"""Histories of many structures in a temporary file, written one by one, read back in blocks of time."""

from tempfile import SpooledTemporaryFile

import numpy as np

from pymc_features.prediction import histories


class HistoryFile:
    """Histories (row, time) of up to `capacity` structures; in memory while they take little of it.

    The file is laid out block of time after block of time, so that a block is read in one piece. It has no
    name, and is gone when it is closed or the process ends.

    Parameters
    ----------
    capacity, n_rows, total : int
        Most structures, rows, samples of a history.
    size : int
        Samples in a block.
    """

    def __init__(self, capacity: int, n_rows: int, total: int, size: int):
        self._capacity, self._n_rows, self._total, self._size = capacity, n_rows, total, size
        self._n = 0
        self._file = SpooledTemporaryFile(max_size=histories.MEMORY)  # noqa: SIM115  `close` is called

    def append(self, history) -> None:
        """Keep the history (row, time) of one more structure."""
        slot = 8 * self._n_rows * self._size
        padded = np.zeros((self._n_rows, self._size))
        for block, first in enumerate(range(0, self._total, self._size)):
            count = min(self._size, self._total - first)
            padded[:, :count] = history[:, first : first + count]
            self._file.seek((block * self._capacity + self._n) * slot)
            self._file.write(padded)
        self._n += 1

    def blocks(self):
        """Yield (first sample, responses (row, time, structure)) of one block after another."""
        buffer = np.empty((self._n, self._n_rows, self._size))
        for block, first in enumerate(range(0, self._total, self._size)):
            self._file.seek(block * self._capacity * buffer[0].nbytes)
            self._file.readinto(buffer)
            count = min(self._size, self._total - first)
            yield first, np.moveaxis(buffer[:, :, :count], 0, -1)

    def close(self) -> None:
        """Remove the file."""
        self._file.close()
