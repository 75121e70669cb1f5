"""Responses of many structures of any family: each is simulated as it comes, and its peaks are kept.

A statistic over structures at each time needs the values of all of them at that time. Histories go to a
temporary file meanwhile, one after another, and are read back in blocks of time.
"""

from tempfile import SpooledTemporaryFile

import numpy as np

from pymc_features.exceptions import TooStiffError
from pymc_features.simulators.excitation import excitation_of, refined_request
from pymc_features.simulators.families import NONLINEAR
from pymc_features.simulators.nonlinear.kernels import nonlinear_histories
from pymc_features.simulators.oscillators.arguments import QUANTITIES
from pymc_features.simulators.quantities import HISTORIES, Rows, checked_request, rows_of
from pymc_features.simulators.simulate import check_arguments, history_of, simulate

MEMORY = 16 * 2**20  # of a block of responses [bytes]
BLOCK = 128  # samples in a block at most


class HistoryFile:
    """Histories (row, time) of up to `capacity` structures; in memory while they take little of it.

    The file is laid out block of time after block of time, so that a block is read in one piece. It has no
    name, and is gone when it is closed or the process ends.

    Parameters
    ----------
    capacity, n_rows, total : int
        Most structures, rows, samples of a history.
    """

    def __init__(self, capacity: int, n_rows: int, total: int):
        self._capacity, self._n_rows, self._total = capacity, n_rows, total
        self._size = int(np.clip(MEMORY // (8 * capacity * n_rows), 1, BLOCK))
        self._n = 0
        self._file = SpooledTemporaryFile(max_size=MEMORY)  # noqa: SIM115  `close` is called
        if 8 * capacity * n_rows * total > MEMORY:
            self._file.rollover()

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
        """Yield (first sample, responses (row, time, structure)) of one block of time after another.

        The responses may be overwritten by whoever receives them, and are by the next block.
        """
        buffer = np.empty((self._n, self._n_rows, self._size))
        for block, first in enumerate(range(0, self._total, self._size)):
            self._file.seek(block * self._capacity * buffer[0].nbytes)
            self._file.readinto(buffer)
            count = min(self._size, self._total - first)
            yield first, np.moveaxis(buffer[:, :, :count], 0, -1)

    def close(self) -> None:
        """Remove the file."""
        self._file.close()


class Ensemble:
    """Structures of any families, and the responses of all of them.

    Parameters
    ----------
    records : list of Record or Loading
    names : list of str
        Quantities, of `HISTORIES`.
    capacity : int
        Most structures that will be added.
    settings : dict
        `dt`, `sensors`, `n_modes` and `outputs` of `simulate`.
    keep_histories : bool
        Whether `blocks` will be asked for, which needs a single record; `peaks` always may.

    Attributes
    ----------
    requests : list of Request
        What is asked of a structure under each record; empty before the first one.
    rows : dict of Rows
        Those of each quantity, of the first structure.
    """

    def __init__(self, records, names, capacity: int, settings: dict, keep_histories: bool):
        self.records, self.names, self.settings = records, names, settings
        self._capacity, self._keep = capacity, keep_histories
        self._families, self._peaks = set(), []
        self.requests, self.rows, self.files = [], {}, {}

    def __len__(self):
        return len(self._peaks)

    def add(self, structure) -> bool:
        """Simulate a structure; False, and nothing is kept, where a response is not finite."""
        if structure.family not in self._families:
            try:
                self._check(structure)
            except TooStiffError:
                return False
            self._families.add(structure.family)
        peaks = {}
        for k in range(len(self.records)):
            histories = self._histories(structure, k)
            peaks |= {(k, name): largest(values) for name, values in histories.items()}
        if not all(np.isfinite(values).all() for values in peaks.values()):
            return False
        for name, file in self.files.items():
            file.append(histories[name])
        self._peaks.append(peaks)
        return True

    def times(self, k: int) -> np.ndarray:
        """Output times for record `k` [s]."""
        request, record = self.requests[k], self.records[k]
        return request.times(record.dt, request.n_outputs(record.n_times))

    def blocks(self, name: str):
        """Blocks of time of a quantity, see `HistoryFile`."""
        return self.files[name].blocks()

    def peaks(self, k: int, name: str) -> np.ndarray:
        """Largest absolute values over the output samples, (row, structure)."""
        return np.stack([peaks[k, name] for peaks in self._peaks], axis=-1)

    def close(self) -> None:
        """Remove temporary files."""
        for file in self.files.values():
            file.close()

    def _check(self, structure) -> None:
        """Refuse what `simulate` refuses, with the first structure of a family."""
        requests = []
        for record in self.records:
            check_arguments(structure, record)
            request, outputs = [
                checked_request(structure, record, name, **self.settings) for name in self.names
            ][0]
            requests.append(refined_request(structure, record, request))
            # two samples: whether the record fits the structure; a base shear has no sensors
            without = {"sensors": None} if HISTORIES[self.names[0]].dim == "support" else {}
            simulate(structure, record.first(2), quantity=self.names[0], **(self.settings | without))
        if not self.requests:
            self.requests, self._outputs = requests, outputs
            self.rows = {name: self._rows(structure, name) for name in self.names}
            if self._keep:
                total = len(self.times(0))
                sizes = {name: len(rows.labels) for name, rows in self.rows.items()}
                self.files = {name: HistoryFile(self._capacity, n, total) for name, n in sizes.items()}

    def _rows(self, structure, name: str) -> Rows:
        """Rows of a quantity."""
        return rows_of(structure, name, self.requests[0], self._outputs)

    def _histories(self, structure, k: int) -> dict[str, np.ndarray]:
        """Histories (row, time) of all quantities; a nonlinear structure is integrated once."""
        record, request = self.records[k], self.requests[k]
        rows = {name: self._rows(structure, name) for name in self.names}
        if structure.family not in NONLINEAR:
            asked = {name: request._replace(quantity=HISTORIES[name].source) for name in rows}
            return {name: history_of(structure, record, name, asked[name], rows[name]) for name in rows}
        sources = list(dict.fromkeys(HISTORIES[name].source for name in rows))
        values = nonlinear_histories(
            NONLINEAR[structure.family],
            structure.parameters(),
            excitation_of(record.acceleration, record, request),
            np.arange(structure.n_dof),
            [QUANTITIES.index(source) for source in sources],
        )
        by_source = dict(zip(sources, values, strict=True))
        return {name: rows[name].of(by_source[HISTORIES[name].source]) for name in rows}


def largest(values) -> np.ndarray:
    """Largest absolute value over time of responses (row, time, ...)."""
    return np.maximum(values.max(axis=1), -values.min(axis=1))
