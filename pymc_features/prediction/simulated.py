"""Structures that are simulated one by one: nonlinear ones, and those whose damping couples the modes."""

import numpy as np

from pymc_features.prediction.history_file import Spill
from pymc_features.simulators.families import NONLINEAR
from pymc_features.simulators.nonlinear.response import nonlinear_histories
from pymc_features.simulators.oscillators.arguments import QUANTITIES, Excitation
from pymc_features.simulators.quantities import HISTORIES, rows_of
from pymc_features.simulators.simulate import simulate


class Simulated:
    """Structures that are simulated one by one as they come.

    Parameters
    ----------
    question : Question
        See `ensemble`.
    spills : dict of Spill
        Where histories go, by quantity, of the one record; empty to keep the peaks only.
    """

    def __init__(self, question, spills: dict[str, Spill]):
        self.question, self.spills = question, spills
        self.found = []

    def __len__(self):
        return len(self.found)

    def add(self, structure) -> bool:
        """Simulate a structure; False, and nothing is kept, where a response is not finite."""
        found = {}
        for k in range(len(self.question.records)):
            histories = self.histories(structure, k)
            found |= {(k, name): largest(values) for name, values in histories.items()}
        if not all(np.isfinite(peaks).all() for peaks in found.values()):
            return False
        for name, spill in self.spills.items():
            spill.append(histories[name])
        self.found.append(found)
        return True

    def histories(self, structure, k: int) -> dict[str, np.ndarray]:
        """Histories (row, time) of all quantities; a nonlinear structure is integrated once."""
        record, asked, names = self.question.records[k], self.question.requests[k], self.question.names
        if structure.family not in NONLINEAR:
            return {name: self._simulate(structure, record, name) for name in names}
        rows = {name: rows_of(structure, name, asked.sensors, self.question.outputs) for name in names}
        sources = list(dict.fromkeys(HISTORIES[name].source for name in names))
        values = nonlinear_histories(
            NONLINEAR[structure.family],
            structure.parameters(),
            Excitation(record.acceleration, record.dt, asked.substeps, asked.stride),
            np.arange(structure.n_dof),
            [QUANTITIES.index(source) for source in sources],
        )
        return {name: rows[name].of(values[sources.index(HISTORIES[name].source)]) for name in names}

    def _simulate(self, structure, record, name):
        """History (row, time) of one quantity of a linear structure."""
        settings = self.question.settings
        if HISTORIES[name].dim == "support":
            settings = settings | {"sensors": None}
        values = simulate(structure, record, quantity=name, **settings).values
        return values.reshape(-1, values.shape[-1])

    def blocks(self, k: int, name: str, size: int):
        """Yield (first sample, responses (row, time, structure)) of one block after another."""
        return self.spills[name].blocks()

    def close(self) -> None:
        """Remove the files."""
        for spill in self.spills.values():
            spill.close()


def largest(values) -> np.ndarray:
    """Largest absolute value over time of responses (row, time, ...)."""
    return np.maximum(values.max(axis=1), -values.min(axis=1))
