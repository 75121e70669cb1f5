"""The measurements of the study at one sampling step, and the exact posterior that a sampler should find."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import xarray as xr

from pymc_features.likelihoods.exact.correlated import weighted_square
from pymc_features.likelihoods.exact.quadrature import DiscrepancyCurve, Exponents, exact_posterior

PARAMETERS = ("theta", "sigma", "tau")
STATISTICS = ("map", "q05", "q50", "q95")
PROBABILITIES = (0.05, 0.5, 0.95)


@dataclass(frozen=True)
class Priors:
    """What is known of the parameters before.

    Attributes
    ----------
    theta, sigma : tuple of float
        Ranges of the uniform priors [-], [m/s^2].
    tau : tuple of float
        Range of the correlation time of the errors [s]; its logarithm is uniform.
    known_tau, known_sigma : float
        Where they are known.
    """

    theta: tuple[float, float]
    sigma: tuple[float, float]
    tau: tuple[float, float]
    known_tau: float
    known_sigma: float


class Step:
    """Misfit of the model at one sampling step, as a function of theta.

    Parameters
    ----------
    sums : callable
        theta -> array (4,): sums over the sensors of e_j, of the mean squared increments of the misfit, and
        of its first and last square.
    data : DataArray (sensor, time)
        Measurements.
    dt : float
        Sampling step [s].
    priors : Priors
    response : callable
        theta -> array (sensor, time), the prediction of the measurements.
    frequencies : callable
        theta -> array (m,), natural frequencies of the structure [Hz].
    """

    def __init__(
        self,
        sums: Callable[[float], np.ndarray],
        data: xr.DataArray,
        dt: float,
        priors: Priors,
        response: Callable[[float], np.ndarray],
        frequencies: Callable[[float], np.ndarray],
    ):
        self.sums, self.data, self.dt, self.priors = sums, data, dt, priors
        self.response, self.frequencies = response, frequencies
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
            lambda theta: float(weighted_square(self.at(theta), self.dt, self.priors.known_tau))
        )

    def _curve(self, total):
        return DiscrepancyCurve(total, self.priors.theta, self.data.size)

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


def posterior_of_curve(curve: DiscrepancyCurve, exponents: Exponents, sigma_bounds) -> Reference:
    """Theta and sigma inferred by a likelihood of one curve."""
    exact = exact_posterior(curve, exponents, sigma_bounds)
    best = dict(zip(PARAMETERS, exact.map, strict=False))

    def log_density(draws):
        values = np.interp(draws["theta"], curve.theta, curve.values)
        sigma = draws["sigma"]
        return -exponents.m * np.log(sigma) - exponents.c * values / (2.0 * sigma**2)

    return Reference(
        rows(best, {"theta": exact.theta, "sigma": exact.sigma}), exact.log_evidence, log_density
    )
