"""The likelihood of a population's parameters, from stored draws of its members."""

from typing import NamedTuple

import numpy as np
import pytensor

from pymc_features.events.evidence import Evidence
from pymc_features.events.population import Population
from pymc_features.events.weights import drawn_by, normalised, pareto_k

CHECKED = 200  # values of psi at which the weights are looked at
OFTEN = 0.9  # of which so many must have weights that can be trusted


class Stored(NamedTuple):
    """Draws of one event, and the prior under which they were sampled.

    Attributes
    ----------
    draws : dict of arrays (draw, ...)
        Of the parameters that vary in the population.
    log_prior : array (draw,)
        ln pi_e(theta).
    log_evidence, error : float
        ln Z_e under that prior, and its standard error.
    """

    draws: dict[str, np.ndarray]
    log_prior: np.ndarray
    log_evidence: float
    error: float


class Marginal:
    """ln p(d_e | psi) / Z_e of all events, compiled once, for stored draws that may be exchanged.

    Parameters
    ----------
    population : Population
    stored : list of Stored
    n : int
        Draws of each event, at most.
    """

    def __init__(self, population: Population, stored: list[Stored], n: int):
        self.population, self.stored = population, stored
        self.n = min(n, *(len(one.log_prior) for one in stored))
        self.columns = [
            pytensor.shared(self.thinned([one.draws[name] for one in stored])) for name in population.names
        ]
        self.log_weights = pytensor.shared(np.zeros((len(stored), self.n)))
        self.model = population.marginal(self.columns, self.log_weights)
        self.density = population.density_function(self.columns)

    def thinned(self, columns) -> np.ndarray:
        """Take as many draws of each event (event, draw, ...), evenly spaced."""
        return np.stack([x[np.linspace(0, len(x) - 1, self.n).round().astype(int)] for x in columns])

    def set(self, stored: list[Stored]) -> None:
        """Exchange the draws."""
        self.stored = stored
        for name, column in zip(self.population.names, self.columns, strict=True):
            column.set_value(self.thinned([one.draws[name] for one in stored]))
        self.log_weights.set_value(-self.thinned([one.log_prior for one in stored]) - np.log(self.n))

    def evidence(self) -> Evidence:
        """ln of the product of all Z_e, and its standard error."""
        values = [one.log_evidence for one in self.stored]
        return Evidence(float(np.sum(values)), float(np.linalg.norm([one.error for one in self.stored])))

    def rows(self, posterior) -> list[dict]:
        """Draws of psi, one dictionary each."""
        columns = {}
        for rv in self.population.parameters:
            values = posterior[rv.name].transpose("chain", "draw", ...).values
            columns[rv.name] = values.reshape(-1, *values.shape[2:]).astype(rv.dtype)
        n = len(next(iter(columns.values())))
        return [{name: column[i] for name, column in columns.items()} for i in range(n)]

    def log_ratios(self, row: dict) -> np.ndarray:
        """ln of p(theta | psi) / pi_e(theta) / S at the stored draws (event, draw)."""
        return self.density(**row) + self.log_weights.get_value(borrow=True)

    def pareto_k(self, rows: list[dict], rng: np.random.Generator) -> np.ndarray:
        """Shape of each event's largest weights (event,), which nine tenths of psi do not exceed."""
        some = rng.choice(len(rows), min(CHECKED, len(rows)), replace=False)
        shapes = [[pareto_k(of_event) for of_event in self.log_ratios(rows[i])] for i in some]
        return np.quantile(shapes, OFTEN, axis=0, method="higher")

    def of_events(self, rows: list[dict], rng: np.random.Generator):
        """Draws of theta (row, event, ...) given psi, and the variance of ln Z that the stored draws add.

        By the delta method: ln Z moves with the mean over psi of the relative error of each p(d_e | psi).
        """
        n_events, n = self.log_weights.get_value(borrow=True).shape
        chosen, total = np.empty((len(rows), n_events), dtype=int), np.zeros((n_events, n))
        for i, row in enumerate(rows):
            weights = normalised(self.log_ratios(row))
            chosen[i] = drawn_by(weights, rng)
            total += weights
        relative = n * total / len(rows)
        columns = [column.get_value(borrow=True) for column in self.columns]
        theta = {
            name: column[np.arange(n_events), chosen]
            for name, column in zip(self.population.names, columns, strict=True)
        }
        return theta, float(relative.var(axis=1).sum() / n)
