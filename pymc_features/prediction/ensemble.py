"""Responses of many structures of any family at once, in blocks of time.

Structures come one by one, and of each no more is kept than its response needs: the parameters of a chain,
the modes of a linear structure, to be marched together (`marching`). What has no oscillators to march, a
nonlinear structure or damping that couples the modes, is simulated at once; its histories go to a temporary
file if blocks of time are wanted, and else leave nothing but their peaks.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.prediction.histories import block_size
from pymc_features.prediction.history_file import Spill
from pymc_features.prediction.marched import Chains, Oscillators
from pymc_features.prediction.simulated import Simulated, largest
from pymc_features.simulators.linear.system import is_coupled
from pymc_features.simulators.quantities import checked_request, rows_of
from pymc_features.simulators.request import Request
from pymc_features.simulators.simulate import check_arguments, simulate


class Question(NamedTuple):
    """What is asked of every structure: records with their requests, quantities, what the user passed."""

    records: list
    requests: list[Request]
    names: list[str]
    outputs: np.ndarray | None
    settings: dict


def ask(structure, records, names, settings) -> Question:
    """Refuse what `simulate` refuses, with the first structure of a family.

    Parameters
    ----------
    settings : dict
        `dt`, `sensors`, `n_modes` and `outputs` of `simulate`.
    """
    requests = []
    for record in records:
        check_arguments(structure, record)
        asked, outputs = [checked_request(structure, record, name, **settings) for name in names][0]
        requests.append(asked)
        # two samples: whether the record fits the structure
        simulate(structure, record.first(2), dt=settings["dt"], n_modes=settings["n_modes"])
    return Question(records, requests, names, outputs, settings)


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
    """

    def __init__(self, records, names, capacity: int, settings: dict, keep_histories: bool):
        self._asked = records, names, settings
        self._capacity, self._keep = capacity, keep_histories
        self._groups, self._places, self._families = {}, [], set()
        self.question, self.rows = None, {}

    def __len__(self):
        return len(self._places)

    def add(self, structure) -> bool:
        """Take up a structure; False, and it is left out, where it has no response to one of the records."""
        if structure.family not in self._families:
            self._families.add(structure.family)
            question = ask(structure, *self._asked)
        if self.question is None:
            self.question = question
            sensors, outputs = self.question.requests[0].sensors, self.question.outputs
            self.rows = {name: rows_of(structure, name, sensors, outputs) for name in self.question.names}
        kind = kind_of(structure, self.question.requests[0].n_modes)
        if kind not in self._groups:
            spills = (self._spills(),) if kind is Simulated else ()
            self._groups[kind] = kind(self.question, *spills)
        group = self._groups[kind]
        taken = group.add(structure)
        if taken:
            self._places.append((kind, len(group) - 1))
        return taken

    def times(self, k: int) -> np.ndarray:
        """Output times for record `k` [s]."""
        asked, record = self.question.requests[k], self.question.records[k]
        return asked.times(record.dt, asked.n_outputs(record.n_times))

    def blocks(self, k: int, name: str):
        """Yield (first sample, responses (row, time, structure)) of one block of time after another.

        The responses may be overwritten by whoever receives them, and are by the next block.
        """
        size, total = self._size(name), len(self.times(k))
        groups = [group.blocks(k, name, size) for group in self._groups.values() if len(group)]
        if len(groups) == 1:
            yield from groups[0]
            return
        starts = np.cumsum([0, *(len(group) for group in self._groups.values())])
        start = dict(zip(self._groups, starts[:-1], strict=True))
        order = [start[kind] + place for kind, place in self._places]
        for first in range(0, total, size):
            yield first, np.concatenate([next(group)[1] for group in groups], axis=-1)[..., order]

    def peaks(self, k: int, name: str) -> np.ndarray:
        """Largest absolute values over the output samples, (row, structure)."""
        found = {}
        for kind, group in self._groups.items():
            if kind is Simulated:
                found[kind] = [peaks[k, name] for peaks in group.found]
            elif len(group):
                blocks = group.blocks(k, name, self._size(name))
                found[kind] = np.maximum.reduce([largest(values) for _, values in blocks]).T
        return np.stack([found[kind][place] for kind, place in self._places], axis=-1)

    def close(self) -> None:
        """Remove temporary files."""
        for group in self._groups.values():
            group.close()

    def _size(self, name):
        """Samples in a block."""
        return block_size(self._capacity, len(self.rows[name].labels))

    def _spills(self):
        if not self._keep:
            return {}
        total = len(self.times(0))
        return {
            name: Spill(self._capacity, len(rows.labels), total, self._size(name))
            for name, rows in self.rows.items()
        }


def kind_of(structure, n_modes: int) -> type:
    """How a structure is carried through time."""
    if structure.family == "chain":
        return Chains
    if structure.is_linear and not is_coupled(structure.modal_damping(n_modes)):
        return Oscillators
    return Simulated
