"""What the samplers should find at one sampling step: an exact reference for each likelihood of the study."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import xarray as xr

from pymc_features.likelihood_free import abc_tolerance
from pymc_features.study import paper
from pymc_features.study.correlated import (
    correlated_likelihood,
    known_scale_posterior,
    unknown_time_posterior,
    weighted_square,
)
from pymc_features.study.quadrature import (
    DiscrepancyCurve,
    exact_posterior,
    exponents,
    tolerance_interval,
)

PARAMETERS = ("theta", "sigma", "tau")
STATISTICS = ("map", "q05", "q50", "q95")
PROBABILITIES = (0.05, 0.5, 0.95)


class Step:
    """Misfit of the model at one sampling step, as a function of theta.

    Parameters
    ----------
    sums : callable
        theta -> array (4,): sums over the sensors of e_j, of the mean squared increments of the misfit, and
        of its first and last square.
    data : DataArray (sensor, time)
        Measurements.
    dt, sigma : float
        Sampling step [s], and the scale of the noise that CN knows [m/s^2].
    """

    def __init__(self, sums: Callable[[float], np.ndarray], data: xr.DataArray, dt: float, sigma: float):
        self.sums, self.data, self.dt, self.sigma = sums, data, dt, sigma
        self.shape = data.shape
        self._known: dict[float, np.ndarray] = {}

    def at(self, theta: float) -> np.ndarray:
        """Sums (4,) over sensors and samples: squares, squared increments, first and last square."""
        if theta not in self._known:
            n_times = self.shape[1]
            self._known[theta] = self.sums(theta) * np.array([n_times, n_times, 1.0, 1.0])
        return self._known[theta]

    @cached_property
    def curve(self) -> DiscrepancyCurve:
        """S(theta), the sum of mean squares."""
        return self._curve(lambda theta: float(self.at(theta)[0]) / self.shape[1])

    @cached_property
    def weighted_curve(self) -> DiscrepancyCurve:
        """W(theta) at the known correlation time."""
        return self._curve(
            lambda theta: float(weighted_square(self.at(theta), self.dt, paper.CORRELATION_TIME))
        )

    @cached_property
    def delta(self) -> float:
        """Tolerance of ABC from the exact EXP posterior, Eq. (16).

        The width of ABC goes with the root of what delta has beyond the smallest rho, which would double the
        relative error of a quantile of draws.
        """
        exact = exact_posterior(self.curve, exponents("EXP", *self.shape), paper.SIGMA_RANGE)
        return abc_tolerance(float(exact.sigma.quantile(0.9)), self.shape[0])

    def _curve(self, total):
        return DiscrepancyCurve(total, paper.THETA_RANGE, self.data.size)

    @cached_property
    def node_sums(self) -> np.ndarray:
        """`at` the nodes of `curve`, (4, n)."""
        return np.array([self.at(theta) for theta in self.curve.theta]).T


@dataclass(frozen=True, eq=False)
class Reference:
    """Exact statistics (parameter, statistic), NaN for what is no parameter; log evidence; and a log-density.

    `log_density` takes the draws, a dictionary of arrays (n,), and returns an array (n,), up to a constant.
    """

    statistics: np.ndarray
    log_evidence: float
    log_density: Callable[[dict], np.ndarray]


def rows(best, marginals) -> np.ndarray:
    """Maximum and quantiles of some of `PARAMETERS`, dictionaries by name, as a table."""
    table = np.full((len(PARAMETERS), len(STATISTICS)), np.nan)
    for name, marginal in marginals.items():
        table[PARAMETERS.index(name)] = [best[name], *marginal.quantile(PROBABILITIES)]
    return table


def of_discrepancy(curve, likelihood) -> Reference:
    """Theta and sigma inferred by a likelihood of one curve: NORM, TN, EXP, and CN with tau known."""
    exact = exact_posterior(curve, likelihood, paper.SIGMA_RANGE)
    best = dict(zip(PARAMETERS, exact.map, strict=False))

    def log_density(draws):
        values = np.interp(draws["theta"], curve.theta, curve.values)
        sigma = draws["sigma"]
        return -likelihood.m * np.log(sigma) - likelihood.c * values / (2.0 * sigma**2)

    return Reference(
        rows(best, {"theta": exact.theta, "sigma": exact.sigma}), exact.log_evidence, log_density
    )


def feature(kind: str) -> Callable[[Step], Reference]:
    """NORM, TN or EXP."""
    return lambda step: of_discrepancy(step.curve, exponents(kind, *step.shape))


def tolerance(step: Step) -> Reference:
    """ABC: uniform on {theta: S(theta) <= delta}."""
    curve = step.curve
    low, high = tolerance_interval(curve, step.delta)
    table = np.full((len(PARAMETERS), len(STATISTICS)), np.nan)
    table[0] = [curve.minimiser, *(low + np.array(PROBABILITIES) * (high - low))]
    prior = paper.THETA_RANGE[1] - paper.THETA_RANGE[0]
    return Reference(
        table,
        float(np.log((high - low) / prior)),
        lambda draws: -np.interp(draws["theta"], curve.theta, curve.values),
    )


def known_time(step: Step) -> Reference:
    """CN with tau known and sigma inferred."""
    return of_discrepancy(
        step.weighted_curve, correlated_likelihood(*step.shape, step.dt, paper.CORRELATION_TIME)
    )


def all_known(step: Step) -> Reference:
    """CN with tau and sigma known."""
    curve = step.weighted_curve
    likelihood = correlated_likelihood(*step.shape, step.dt, paper.CORRELATION_TIME)
    marginal, log_evidence = known_scale_posterior(curve, likelihood, step.sigma)
    return Reference(
        rows({"theta": curve.minimiser}, {"theta": marginal}),
        log_evidence,
        lambda draws: -np.interp(draws["theta"], curve.theta, curve.values),
    )


def unknown_time(step: Step) -> Reference:
    """CN with tau and sigma inferred."""
    curve, sums = step.curve, step.node_sums
    marginals, best, log_evidence = unknown_time_posterior(
        curve, sums, step.shape, step.dt, paper.SIGMA_RANGE, paper.TAU_RANGE
    )

    def log_density(draws):
        at_draws = np.array([np.interp(draws["theta"], curve.theta, row) for row in sums])
        likelihood = correlated_likelihood(*step.shape, step.dt, draws["tau"])
        weighted, sigma = weighted_square(at_draws, step.dt, draws["tau"]), draws["sigma"]
        return likelihood.constant - likelihood.m * np.log(sigma) - 0.5 * weighted / sigma**2

    return Reference(rows(dict(zip(PARAMETERS, best, strict=True)), marginals), log_evidence, log_density)


REFERENCES = {
    "NORM": feature("NORM"),
    "TN": feature("TN"),
    "EXP": feature("EXP"),
    "ABC": tolerance,
    "CN": all_known,
    "CN-SIGMA": known_time,
    "CN-TAU": unknown_time,
}
