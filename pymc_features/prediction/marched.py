"""Structures whose modes are oscillators, kept to be marched through time together, see `histories`."""

import numpy as np

from pymc_features.prediction.histories import Systems, response_blocks
from pymc_features.simulators.linear.system import STIFFEST
from pymc_features.simulators.oscillators.arguments import (
    ABSOLUTE_ACCELERATION,
    QUANTITIES,
    RELATIVE_ACCELERATION,
)
from pymc_features.simulators.oscillators.march import modal_table
from pymc_features.simulators.oscillators.recursion import N_ROWS, modal_system
from pymc_features.simulators.quantities import HISTORIES, force_share, rows_of


class Marched:
    """What both kinds of structures share.

    A kind has `add(structure)`, which tells whether the structure has a response to every record and if so
    keeps it, `__len__`, and `systems(k, name)`, the `Systems` for record `k` and a quantity.

    Parameters
    ----------
    question : Question
        See `ensemble`.
    """

    def __init__(self, question):
        self.question = question
        pairs = zip(question.records, question.requests, strict=True)
        self.steps = [record.dt / asked.substeps for record, asked in pairs]

    def blocks(self, k: int, name: str, size: int):
        """Yield (first sample, responses (row, time, structure)) of one block after another."""
        systems = self.systems(k, name)
        return response_blocks(systems, self.question.records[k].inputs, self.question.requests[k], size)

    def close(self) -> None:
        """Nothing is open."""


class Chains(Marched):
    """Spring-mass chains, whose modes compiled code finds in microseconds: kept as they are."""

    def __init__(self, question):
        super().__init__(question)
        self.structures, self.parameters = [], []

    def __len__(self):
        return len(self.structures)

    def add(self, structure) -> bool:
        """Keep a chain; False where it has no response to one of the records."""
        own, first = structure.parameters(), np.zeros(1, dtype=np.int64)
        n_modes = self.question.requests[0].n_modes
        if not all(modal_system(*own, step, first, n_modes, 0)[0] for step in set(self.steps)):
            return False
        self.structures.append(structure)
        self.parameters.append(own)
        return True

    def systems(self, k: int, name: str) -> Systems:
        """Recursions for record `k` and a quantity."""
        asked, outputs = self.question.requests[k], self.question.outputs
        source, dim, _ = HISTORIES[name]
        rows = rows_of(self.structures[0], name, asked.sensors, outputs)
        picked, at = rows.outputs, asked.sensors
        if picked is not None:
            at = np.arange(self.structures[0].n_dof)
        if dim == "support":  # rows of their own for each
            picked = np.stack([rows_of(one, name, asked.sensors).outputs for one in self.structures])
        code = QUANTITIES.index(source)
        found = [modal_system(*own, self.steps[k], at, asked.n_modes, code)[1:] for own in self.parameters]
        tables, shapes, direct = (np.stack(part) for part in zip(*found, strict=True))
        direct = direct[..., None]
        if picked is not None:
            shapes, direct = picked @ shapes, picked @ direct
        # the kernel's shapes are products with the participation factors already
        return Systems(tables, np.ones((len(self), 1, asked.n_modes)), shapes, direct)


class Oscillators(Marched):
    """Linear structures whose damping the modes diagonalise: kept as modes at the rows asked for.

    Records are grouped by how they load the modes: all motions of the supports in the same way, forces each
    in its own.
    """

    def __init__(self, question):
        super().__init__(question)
        forces = [k for k, record in enumerate(question.records) if record.is_force]
        self.loads = [1 + forces.index(k) if k in forces else 0 for k in range(len(question.records))]
        self.omega, self.drag, self.participation, self.seen, self.direct = [], [], [], [], []

    def __len__(self):
        return len(self.omega)

    def add(self, structure) -> bool:
        """Keep the modes of a structure; False where it has no response to one of the records."""
        question, n_modes = self.question, self.question.requests[0].n_modes
        modes, drag = structure.modes(n_modes), structure.modal_damping(n_modes)
        # no negative damping beyond rounding
        drag = np.maximum(drag if drag.ndim == 1 else np.diagonal(drag), 0.0)
        if not max(modes.angular_frequencies.max(), drag.max()) * max(self.steps) < STIFFEST:
            return False
        loads = {load: question.records[k] for k, load in enumerate(self.loads)}
        shares = {load: participation(structure, record, modes) for load, record in loads.items()}
        seen, direct = {}, {}
        for name in question.names:
            rows = rows_of(structure, name, question.requests[0].sensors, question.outputs)
            seen[name] = rows.of(modes.mode_shapes)
            for load, record in loads.items():
                direct[name, load] = feed_through(structure, record, name, rows, seen[name] @ shares[load])
        self.omega.append(modes.angular_frequencies)
        self.drag.append(drag)
        self.participation.append(shares)
        self.seen.append(seen)
        self.direct.append(direct)
        return True

    def systems(self, k: int, name: str) -> Systems:
        """Recursions for record `k` and a quantity."""
        load, code = self.loads[k], QUANTITIES.index(HISTORIES[name].source)
        tables = np.empty((len(self), N_ROWS, self.omega[0].size))
        for omega, drag, table in zip(self.omega, self.drag, tables, strict=True):
            modal_table(omega, drag, self.steps[k], code, table)
        return Systems(
            tables,
            np.stack([np.ascontiguousarray(shares[load].T) for shares in self.participation]),
            np.stack([seen[name] for seen in self.seen]),
            np.stack([direct[name, load] for direct in self.direct]),
        )


def participation(structure, record, modes) -> np.ndarray:
    """Gamma (m, d) of q" + ... = -Gamma a(t)."""
    shapes = modes.mode_shapes
    if record.is_force:
        return record.applied(-shapes.T)
    return modes.participation_factors.reshape(shapes.shape[1], -1)


def feed_through(structure, record, name, rows, carried) -> np.ndarray:
    """What the inputs add to the rows directly, (row, d); `carried` (row, d) by the modes at once."""
    code = QUANTITIES.index(HISTORIES[name].source)
    if code not in (ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION):
        return np.zeros_like(carried)
    if record.is_force:
        share = force_share(structure, record, name)
        return -carried if share is None else share - carried
    moved = rows.of(structure.influence.reshape(structure.n_dof, -1))
    return moved - carried if code == ABSOLUTE_ACCELERATION else -carried
