"""Responses of many structures of any family at once, in blocks of time.

Structures come one by one, and of each no more is kept than its response needs: the parameters of a chain,
the modes of a linear structure, to be integrated together (`marched`). A nonlinear structure, or one whose
damping couples the modes, is simulated at once (`simulated`); its histories go to a temporary file if blocks
of time are wanted, and otherwise only their peaks are kept.
"""

from dataclasses import dataclass

import numpy as np

from pymc_features.exceptions import TooStiffError
from pymc_features.prediction.histories import block_size
from pymc_features.prediction.marched import Chains, Oscillators
from pymc_features.prediction.simulated import HistoryFile, Simulated
from pymc_features.simulators.excitation import refined_request
from pymc_features.simulators.linear.system import is_coupled
from pymc_features.simulators.quantities import HISTORIES, Rows, checked_request, rows_of
from pymc_features.simulators.request import Request
from pymc_features.simulators.simulate import check_arguments, simulate


@dataclass(frozen=True)
class WantedResponses:
    """The responses that are asked of every structure: records with their requests, and quantities.

    `settings` are `dt`, `sensors`, `n_modes` and `outputs` of `simulate`, `outputs` as it was checked.
    """

    records: list
    requests: list[Request]
    names: list[str]
    outputs: np.ndarray | None
    settings: dict

    def rows(self, structure, name: str) -> Rows:
        """Rows of a quantity."""
        return rows_of(structure, name, self.requests[0], self.outputs)


def checked_responses(structure, records, names, settings) -> WantedResponses:
    """Refuse what `simulate` refuses, with the first structure of a family."""
    requests = []
    for record in records:
        check_arguments(structure, record)
        request, outputs = [checked_request(structure, record, name, **settings) for name in names][0]
        requests.append(refined_request(structure, record, request))
        # two samples: whether the record fits the structure; a base shear has no sensors
        without = {"sensors": None} if HISTORIES[names[0]].dim == "support" else {}
        simulate(structure, record.first(2), quantity=names[0], **(settings | without))
    return WantedResponses(records, requests, names, outputs, settings)


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
        self._given = records, names, settings
        self._capacity, self._keep = capacity, keep_histories
        self._groups, self._places, self._families = {}, [], set()
        self.wanted, self.rows = None, {}

    def __len__(self):
        return len(self._places)

    def add(self, structure) -> bool:
        """Keep a structure; False, and it is left out, where it has no response to one of the records."""
        if structure.family not in self._families:
            try:
                wanted = checked_responses(structure, *self._given)
            except TooStiffError:
                return False
            self._families.add(structure.family)
            if self.wanted is None:
                self.wanted = wanted
                self.rows = {name: wanted.rows(structure, name) for name in wanted.names}
        kind = kind_of(structure, self.wanted.requests[0].n_modes)
        if kind not in self._groups:
            files = (self._files(),) if kind is Simulated else ()
            self._groups[kind] = kind(self.wanted, *files)
        group = self._groups[kind]
        added = group.add(structure)
        if added:
            self._places.append((kind, len(group) - 1))
        return added

    def times(self, k: int) -> np.ndarray:
        """Output times for record `k` [s]."""
        request, record = self.wanted.requests[k], self.wanted.records[k]
        return request.times(record.dt, request.n_outputs(record.n_times))

    def blocks(self, k: int, name: str):
        """Yield (first sample, responses (row, time, structure)) of one block of time after another.

        The responses may be overwritten by whoever receives them, and are by the next block.
        """
        groups, order = self._in_order()
        blocks = [group.blocks(k, name, self._size(name)) for group in groups]
        if len(blocks) == 1:
            yield from blocks[0]
            return
        for parts in zip(*blocks, strict=True):
            yield parts[0][0], np.concatenate([values for _, values in parts], axis=-1)[..., order]

    def peaks(self, k: int, name: str) -> np.ndarray:
        """Largest absolute values over the output samples, (row, structure)."""
        groups, order = self._in_order()
        return np.concatenate([group.peaks(k, name, self._size(name)) for group in groups], axis=-1)[:, order]

    def close(self) -> None:
        """Remove temporary files."""
        for group in self._groups.values():
            group.close()

    def _in_order(self):
        """Groups that have structures, and where in their sequence each structure stands."""
        used = {kind: group for kind, group in self._groups.items() if len(group)}
        starts = np.cumsum([0, *(len(group) for group in used.values())])
        start = dict(zip(used, starts[:-1], strict=True))
        return list(used.values()), [start[kind] + place for kind, place in self._places]

    def _size(self, name):
        """Samples in a block."""
        return block_size(self._capacity, len(self.rows[name].labels))

    def _files(self):
        """A file for the histories of each quantity, if they are to be kept."""
        if not self._keep:
            return {}
        total = len(self.times(0))
        return {
            name: HistoryFile(self._capacity, len(rows.labels), total, self._size(name))
            for name, rows in self.rows.items()
        }


def kind_of(structure, n_modes: int) -> type:
    """Class of the group that a structure belongs to."""
    if structure.family == "chain":
        return Chains
    if structure.is_linear and not is_coupled(structure.modal_damping(n_modes)):
        return Oscillators
    return Simulated
