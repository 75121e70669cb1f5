"""Structures that are simulated one by one: nonlinear ones, and those whose damping couples the modes.

Their histories are in a temporary file meanwhile, written one by one, read back in blocks of time.
"""

from tempfile import SpooledTemporaryFile

import numpy as np

from pymc_features.prediction import histories
from pymc_features.simulators.excitation import excitation_of
from pymc_features.simulators.families import NONLINEAR
from pymc_features.simulators.nonlinear.kernels import nonlinear_histories
from pymc_features.simulators.oscillators.arguments import QUANTITIES
from pymc_features.simulators.quantities import HISTORIES
from pymc_features.simulators.simulate import simulate


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


class Simulated:
    """Structures that are simulated one by one as they come; of each its peaks are kept.

    Parameters
    ----------
    wanted : WantedResponses
        See `ensemble`.
    files : dict of HistoryFile
        Where histories go, by quantity, of the one record; empty to keep the peaks only.
    """

    def __init__(self, wanted, files: dict[str, HistoryFile]):
        self.wanted, self.files, self.kept = wanted, files, []

    def __len__(self):
        return len(self.kept)

    def add(self, structure) -> bool:
        """Simulate a structure; False, and nothing is kept, where a response is not finite."""
        found = {}
        for k in range(len(self.wanted.records)):
            responses = self.histories(structure, k)
            found |= {(k, name): largest(values) for name, values in responses.items()}
        if not all(np.isfinite(peaks).all() for peaks in found.values()):
            return False
        for name, file in self.files.items():
            file.append(responses[name])
        self.kept.append(found)
        return True

    def histories(self, structure, k: int) -> dict[str, np.ndarray]:
        """Histories (row, time) of all quantities; a nonlinear structure is integrated once."""
        record, request, names = self.wanted.records[k], self.wanted.requests[k], self.wanted.names
        if structure.family not in NONLINEAR:
            return {name: self._simulate(structure, record, name) for name in names}
        sources = list(dict.fromkeys(HISTORIES[name].source for name in names))
        values = nonlinear_histories(
            NONLINEAR[structure.family],
            structure.parameters(),
            excitation_of(record.acceleration, record, request),
            np.arange(structure.n_dof),
            [QUANTITIES.index(source) for source in sources],
        )
        by_source = dict(zip(sources, values, strict=True))
        return {
            name: self.wanted.rows(structure, name).of(by_source[HISTORIES[name].source]) for name in names
        }

    def _simulate(self, structure, record, name):
        """History (row, time) of one quantity of a linear structure."""
        settings = self.wanted.settings
        if HISTORIES[name].dim == "support":
            settings = settings | {"sensors": None}
        values = simulate(structure, record, quantity=name, **settings).values
        return values.reshape(-1, values.shape[-1])

    def blocks(self, k: int, name: str, size: int):
        """Yield (first sample, responses (row, time, structure)) of one block after another."""
        return self.files[name].blocks()

    def peaks(self, k: int, name: str, size: int) -> np.ndarray:
        """Largest absolute values over the output samples, (row, structure)."""
        return np.stack([peaks[k, name] for peaks in self.kept], axis=-1)

    def close(self) -> None:
        """Remove the files."""
        for file in self.files.values():
            file.close()


def largest(values) -> np.ndarray:
    """Largest absolute value over time of responses (row, time, ...)."""
    return np.maximum(values.max(axis=1), -values.min(axis=1))
