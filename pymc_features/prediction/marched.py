"""Classically damped structures, integrated together one block of time at a time."""

from typing import NamedTuple

import numpy as np

from pymc_features.prediction.histories import Recursions, response_blocks
from pymc_features.prediction.simulated import largest
from pymc_features.simulators.chain.parameters import ChainParameters, chain_feed, modes_of
from pymc_features.simulators.excitation import excitation_of
from pymc_features.simulators.families import FAMILIES
from pymc_features.simulators.linear.arguments import Arguments
from pymc_features.simulators.linear.system import observe, solve_system, uncoupled
from pymc_features.simulators.oscillators.arguments import QUANTITIES, Outputs
from pymc_features.simulators.oscillators.table import N_ROWS, scale_input, whole_vectors, write_table
from pymc_features.simulators.quantities import HISTORIES, force_share


class Marched:
    """Structures that are kept to be integrated together.

    Each kind has `add(structure)`, which keeps a structure and returns True, or returns False where it has no
    response to one of the records; and `recursions(k, name)`, those for record `k` and a quantity.

    Parameters
    ----------
    wanted : WantedResponses
        See `ensemble`.
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
