"""Responses of many structures of any family at once, in blocks of time.

Structures come one by one, and of each no more is kept than its response needs: the parameters of a chain,
the modes of a linear structure, to be integrated together (`Marched`). A nonlinear structure, or one whose
damping couples the modes, is simulated at once (`simulated`); its histories go to a temporary file if blocks
of time are wanted, and otherwise only their peaks are kept.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pymc_features.exceptions import TooStiffError
from pymc_features.prediction.histories import Recursions, block_size, response_blocks
from pymc_features.prediction.simulated import HistoryFile, Simulated, largest
from pymc_features.simulators.chain.parameters import ChainParameters, chain_feed, modes_of
from pymc_features.simulators.excitation import excitation_of, refined_request
from pymc_features.simulators.families import FAMILIES
from pymc_features.simulators.linear.arguments import Arguments
from pymc_features.simulators.linear.system import is_coupled, observe, solve_system, uncoupled
from pymc_features.simulators.oscillators.arguments import QUANTITIES, Outputs
from pymc_features.simulators.oscillators.table import N_ROWS, scale_input, whole_vectors, write_table
from pymc_features.simulators.quantities import HISTORIES, Rows, checked_request, force_share, rows_of
from pymc_features.simulators.request import Request
from pymc_features.simulators.simulate import check_arguments, simulate


class Marched:
    """Structures that are kept to be integrated together.

    Each kind has `add(structure)`, which keeps a structure and returns True, or returns False where it has no
    response to one of the records; and `recursions(k, name)`, those for record `k` and a quantity.

    Parameters
    ----------
    wanted : WantedResponses
        What is asked of every structure.
    """

    def __init__(self, wanted):
        self.wanted, self.kept = wanted, []
        pairs = zip(wanted.records, wanted.requests, strict=True)
        excitations = [excitation_of(record.inputs, record, request) for record, request in pairs]
        self.steps = [given.dt / given.substeps for given in excitations]

    def __len__(self):
        return len(self.kept)

    def blocks(self, k: int, name: str, size: int):
        """Yield (first sample, responses (row, time, structure)) of one block after another."""
        excitation = excitation_of(
            self.wanted.records[k].inputs, self.wanted.records[k], self.wanted.requests[k]
        )
        return response_blocks(self.recursions(k, name), excitation, size)

    def peaks(self, k: int, name: str, size: int) -> np.ndarray:
        """Largest absolute values over the output samples, (row, structure)."""
        return np.maximum.reduce([largest(values) for _, values in self.blocks(k, name, size)])

    def close(self) -> None:
        """Nothing is open."""


class Chains(Marched):
    """Spring-mass chains, whose modes compiled code finds in microseconds: kept as they are."""

    def add(self, structure) -> bool:
        """Keep a chain; False where it has no response to one of the records."""
        parameters = ChainParameters(*structure.parameters())
        outputs = Outputs(np.zeros(1, dtype=np.int64), self.wanted.requests[0].n_modes, 0)
        if not all(modes_of(parameters, step, outputs)[0] for step in set(self.steps)):
            return False
        self.kept.append((structure, parameters))
        return True

    def recursions(self, k: int, name: str) -> Recursions:
        """Recursions for record `k` and a quantity."""
        (first, _), request, quantity = self.kept[0], self.wanted.requests[k], HISTORIES[name]
        rows, degrees = self.wanted.rows(first, name), request.sensors
        combinations = rows.outputs
        if combinations is not None:
            degrees = np.arange(first.n_dof)
        if quantity.dim == "support":  # of each structure its own masses
            combinations = np.stack([self.wanted.rows(chain, name).outputs for chain, _ in self.kept])
        wanted = Outputs(degrees, request.n_modes, QUANTITIES.index(quantity.source))
        complete, found = request.n_modes == first.n_dof, []
        for _, parameters in self.kept:
            _, system, _, _ = modes_of(parameters, self.steps[k], wanted)
            table = np.zeros((1, N_ROWS, whole_vectors(request.n_modes)))
            write_table(system.omega, system.damping, self.steps[k], wanted.quantity, table[0])
            # with the participation in the shapes a response is that of `simulate` to the last bit
            found.append(
                (table, system.shapes * system.participation[:, 0], chain_feed(system, wanted, complete))
            )
        tables, shapes, direct = (np.stack(part) for part in zip(*found, strict=True))
        if combinations is not None:
            shapes, direct = combinations @ shapes, combinations @ direct
        return Recursions(tables, shapes, direct)


class KeptModes(NamedTuple):
    """Modes of a linear structure.

    Attributes
    ----------
    omega, modal_damping : array (m,)
        [rad/s] and 2 zeta omega [1/s].
    participation : dict
        Gamma' (d, m), by kind of load.
    output_shapes : dict
        S Phi (row, m), by quantity.
    direct : dict
        Feed-through (row, d), by quantity and kind of load.
    """

    omega: np.ndarray
    modal_damping: np.ndarray
    participation: dict
    output_shapes: dict
    direct: dict


class Oscillators(Marched):
    """Linear structures whose damping the modes diagonalise: kept as modes at the rows asked for.

    All motions of the supports load the modes in one way, each record of forces in its own.
    """

    def __init__(self, wanted):
        super().__init__(wanted)
        of_forces = [record.is_force for record in wanted.records]
        self.loads = [k if force else "supports" for k, force in enumerate(of_forces)]
        # the record with the longest step stands for all with its kind of load
        ascending = np.argsort(self.steps, kind="stable")
        self.examples = {self.loads[k]: k for k in ascending}
        self.combinations = {}

    def add(self, structure) -> bool:
        """Keep the modes of a structure; False where it has no response to one of the records."""
        family, modes = FAMILIES[structure.family], structure.modes(self.wanted.requests[0].n_modes)
        known = modes.angular_frequencies, modes.mode_shapes
        participation, output_shapes, direct = {}, {}, {}
        for load, k in self.examples.items():
            record, request = self.wanted.records[k], self.wanted.requests[k]
            excitation = excitation_of(structure.excitation(record), record, request)
            rows = np.empty((0, structure.n_dof))
            inputs = family.inputs_of(structure, record, excitation, rows, request.n_modes)
            a = Arguments(*family.assemble(inputs, request.quantity_code))
            system = solve_system(a, known=known)
            if system is None:
                return False
            participation[load] = np.ascontiguousarray(system.participation.T)
            for name in self.wanted.names:
                outputs = self.outputs(structure, name, request)
                modal_system, direct[name, load] = observe(a._replace(wanted=outputs), system)
                output_shapes[name] = modal_system.shapes
                share = force_share(structure, record, name)
                if share is not None:
                    direct[name, load] += share
        modal_damping = uncoupled(system.modal_damping)
        self.kept.append(KeptModes(system.omega, modal_damping, participation, output_shapes, direct))
        return True

    def outputs(self, structure, name: str, request) -> Outputs:
        """Outputs of a quantity, the same for all structures unless they are sums over their masses."""
        quantity = HISTORIES[name]
        if name not in self.combinations or quantity.dim == "support":
            picked = self.wanted.rows(structure, name).picked
            self.combinations[name] = FAMILIES[structure.family].rows(picked, structure.n_dof)
        return Outputs(self.combinations[name], request.n_modes, QUANTITIES.index(quantity.source))

    def recursions(self, k: int, name: str) -> Recursions:
        """Recursions for record `k` and a quantity."""
        load, code = self.loads[k], QUANTITIES.index(HISTORIES[name].source)
        n_inputs, n_modes = self.kept[0].participation[load].shape
        tables = np.zeros((len(self), n_inputs, N_ROWS, whole_vectors(n_modes)))
        for modes, of_inputs in zip(self.kept, tables, strict=True):
            for table, participation in zip(of_inputs, modes.participation[load], strict=True):
                write_table(modes.omega, modes.modal_damping, self.steps[k], code, table)
                scale_input(table, participation)
        return Recursions(
            tables,
            np.stack([modes.output_shapes[name] for modes in self.kept]),
            np.stack([modes.direct[name, load] for modes in self.kept]),
        )


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
