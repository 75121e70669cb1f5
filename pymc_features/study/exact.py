r"""Exact posteriors of the study by quadrature, to judge samplers by: `reference` gives that of a likelihood.

NORM, TN and EXP depend on theta through S(theta) = sum_j e_j only: up to a constant,

    ln L = -m ln(sigma) - c S / (2 sigma^2),    m, c = N_0 N_D, N_D (NORM); N_0, 1 (TN); 2 N_0, 1 (EXP).

With uniform priors the posterior is integrated on a grid of theta and ln sigma, spaced by a sinh so
that it resolves the narrowest posterior and still covers the prior; in such variables the trapezoidal
rule converges exponentially. ABC with the uniform kernel is uniform on {theta: S(theta) <= delta}.

Under errors correlated in time, with phi = exp(-dt / tau) common to all sensors, the log-density depends on
theta through

    W(theta, tau) = sum_j [ r_0^2 + Q_j / (1 - phi^2) ],

a combination of four sums over the sensors. With tau known the posterior of theta and sigma has the form
above with W for S; with tau inferred sigma is integrated in closed form, and theta and ln(tau) on a grid.
CAL is NORM's likelihood to a power, stretched about its maximum along theta and sigma.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.optimize import brentq, minimize_scalar
from scipy.special import expit, gammaincc, gammaln, logit

from pymc_features.calibration.residuals import Comparison, Event
from pymc_features.calibration.sandwich import sandwich, stretching
from pymc_features.likelihoods import LIKELIHOODS, abc_tolerance
from pymc_features.likelihoods.catalogue import EXP, NORM, Exponents
from pymc_features.study import paper

PARAMETERS = ("theta", "sigma", "tau")
STATISTICS = ("map", "q05", "q50", "q95")
PROBABILITIES = (0.05, 0.5, 0.95)
N_THETA, N_SIGMA = 1201, 601
N_COARSE, N_SPREAD, N_TAU, N_SCALE = 601, 201, 401, 401  # nodes where tau is inferred
NEGLIGIBLE = 1e-12
DIFFERENCE = 1e-4  # of theta, over which the response is differentiated


class Marginal(NamedTuple):
    """A distribution on a grid: nodes (n,) ascending, density (n,), probability below (n,)."""

    nodes: np.ndarray
    density: np.ndarray
    below: np.ndarray

    @classmethod
    def on_grid(cls, nodes, weights, u):
        """Normalise `weights`, the density times d nodes / d u, on an even grid `u`."""
        cumulative = CubicSpline(u, weights).antiderivative()(u)
        cumulative = np.maximum.accumulate(cumulative - cumulative[0])
        slopes = np.gradient(nodes, u)
        return cls(nodes, weights / slopes / cumulative[-1], cumulative / cumulative[-1])

    def quantile(self, probability):
        """Quantiles, shape of `probability`."""
        inside = np.concatenate([[True], np.diff(self.below) > 1e-15])
        return PchipInterpolator(self.below[inside], self.nodes[inside])(probability)


class DiscrepancyCurve:
    """S(theta) on a grid that is fine near its minimum and covers the prior.

    Parameters
    ----------
    total : callable
        S(theta) = sum_j e_j.
    bounds : tuple of float
        Range of the uniform prior of theta.
    n_data : int
        N_0 N_D, which sets the finest scale that matters.
    n_nodes : int
        Of the grid; 401 more values are needed to find the minimum.

    Attributes
    ----------
    minimiser, minimum, curvature : float
        theta_hat, S_min and a in S = S_min + a (theta - theta_hat)^2 near it.
    scale : float
        Standard deviation of theta under NORM.
    u, theta, slope, values : array (n_nodes,)
        Even grid variable, nodes, d theta / d u, and S.
    """

    def __init__(
        self,
        total: Callable[[float], float],
        bounds: tuple[float, float],
        n_data: int,
        n_nodes: int = N_THETA,
    ):
        low, high = self.bounds = bounds
        self.total = total
        coarse = np.linspace(low, high, 401)
        rough = np.array([total(t) for t in coarse])
        best = int(rough.argmin())
        bracket = coarse[max(best - 1, 0)], coarse[min(best + 1, 400)]
        found = minimize_scalar(total, bounds=bracket, method="bounded", options={"xatol": 1e-10})
        self.minimiser, self.minimum = float(found.x), float(found.fun)
        h = 1e-4 * (high - low)
        sides = [total(self.minimiser + s * h) - self.minimum for s in (-1, 1)]
        self.curvature = float(sum(sides)) / (2.0 * h * h)
        self.scale = np.sqrt(self.minimum / self.curvature / n_data)
        self.u = np.linspace(*map(self.grid_variable, bounds), n_nodes)
        self.theta = np.clip(self.minimiser + self.scale * np.sinh(self.u), low, high)
        self.slope = self.scale * np.cosh(self.u)
        self.values = np.array([total(t) for t in self.theta])

    def grid_variable(self, theta):
        """u of theta, in which the nodes are even."""
        return np.arcsinh((theta - self.minimiser) / self.scale)

    def at(self, theta):
        """S between the nodes, by straight lines."""
        return np.interp(theta, self.theta, self.values)


class Stretch(NamedTuple):
    """A likelihood of x in place of y, with logit(x) = logit(centre) + factor (logit(y) - logit(centre)).

    logit is that of the place between the bounds, on which a uniform prior is sampled.
    """

    bounds: tuple[float, float]
    centre: float
    factor: float

    def inside(self, y):
        """x of y."""
        return self._moved(y, self.factor)

    def outside(self, x):
        """y of x, and its slope."""
        y = self._moved(x, 1.0 / self.factor)
        low, high = self.bounds
        with np.errstate(invalid="ignore"):
            slope = (y - low) * (high - y) / ((x - low) * (high - x)) / self.factor
        return y, np.nan_to_num(slope)  # at the bounds, where nothing is left of the likelihood

    def _moved(self, x, factor):
        low, high = self.bounds
        at = logit((self.centre - low) / (high - low))
        return low + (high - low) * expit(at + factor * (logit((x - low) / (high - low)) - at))


class ExactPosterior(NamedTuple):
    """Posterior of theta and sigma: marginals, maximum, and log evidence."""

    theta: Marginal
    sigma: Marginal
    map: tuple[float, float]
    log_evidence: float


def exact_posterior(
    curve: DiscrepancyCurve,
    exponents: Exponents,
    sigma_bounds: tuple[float, float],
    stretches: tuple[Stretch, Stretch] | None = None,
) -> ExactPosterior:
    """Integrate the posterior under uniform priors of theta and sigma.

    `stretches` are those of the likelihood along theta and sigma, about its maximum.
    """
    m, c, _ = exponents
    low, high = sigma_bounds
    best_sigma = min(np.sqrt(c * curve.minimum / m), high)
    width = 1.0 / np.sqrt(2.0 * m)
    # below this, exp(-c S_min / (2 sigma^2)) is smaller than 1e-30 of its maximum
    floor = max(low, best_sigma / np.sqrt(1.0 + 150.0 / m + np.sqrt(300.0 / m)))
    ends = [np.arcsinh(np.log(s / best_sigma) / width) for s in (floor, high)]
    t = np.linspace(*ends, N_SIGMA)
    sigma = np.clip(best_sigma * np.exp(width * np.sinh(t)), floor, high)
    slope = sigma * width * np.cosh(t)
    log_likelihood = -m * np.log(sigma) - c * curve.values[:, None] / (2.0 * sigma**2)
    top = log_likelihood.max()
    mass = np.exp(log_likelihood - top) * curve.slope[:, None] * slope
    theta = curve.theta
    if stretches is not None:
        (theta, of_theta), (sigma, of_sigma) = (
            stretch.outside(x) for stretch, x in zip(stretches, (theta, sigma), strict=True)
        )
        mass *= of_theta[:, None] * of_sigma
    du, dt = curve.u[1] - curve.u[0], t[1] - t[0]
    volume = (curve.bounds[1] - curve.bounds[0]) * (high - low)
    evidence = np.trapezoid(np.trapezoid(mass, dx=dt, axis=1), dx=du) / volume
    return ExactPosterior(
        Marginal.on_grid(theta, np.trapezoid(mass, dx=dt, axis=1), curve.u),
        Marginal.on_grid(sigma, np.trapezoid(mass, dx=du, axis=0), t),
        (curve.minimiser, float(best_sigma)),
        float(np.log(evidence) + top + exponents.constant),
    )


def tolerance_interval(curve: DiscrepancyCurve, delta: float) -> tuple[float, float]:
    """Ends of {theta: S(theta) <= delta} around the minimum, the exact ABC posterior's support."""
    if delta <= curve.minimum:
        raise ValueError(
            f"`delta` must exceed the smallest discrepancy {curve.minimum:.6g}, got {delta:.6g}. "
            "Use the 90 % quantile of sigma under EXP."
        )
    ends = []
    for direction, bound in ((-1, curve.bounds[0]), (1, curve.bounds[1])):
        side = curve.theta[direction * (curve.theta - curve.minimiser) > 0]
        values = curve.values[direction * (curve.theta - curve.minimiser) > 0]
        outside = side[values > delta]
        if outside.size == 0:
            ends.append(bound)
            continue
        first = outside[np.abs(outside - curve.minimiser).argmin()]
        ends.append(brentq(lambda t: curve.total(t) - delta, curve.minimiser, first, xtol=1e-13))
    return ends[0], ends[1]


def weighted_square(sums, dt: float, tau):
    """W of errors with correlation time tau [s].

    Parameters
    ----------
    sums : array (4, ...)
        Over the sensors: squares S, squared increments D, first and last squared misfit.
    dt : float
        Sampling step [s].
    tau : array (...)
    """
    squares, increments, first, last = sums
    phi, rest = np.exp(-dt / tau), -np.expm1(-dt / tau)
    form = phi * increments + rest * (last - first + rest * (squares - last))
    return first - form / np.expm1(-2.0 * dt / tau)


def log_determinant(n_sensors: int, n_times: int, dt: float, tau):
    """Half the log-determinant of all correlation matrices."""
    return 0.5 * n_sensors * (n_times - 1) * np.log(-np.expm1(-2.0 * dt / tau))


def correlated_exponents(n_sensors: int, n_times: int, dt: float, tau: float) -> Exponents:
    """Exponents in W of the likelihood with tau known, and its constant."""
    n = n_sensors * n_times
    constant = -0.5 * n * np.log(2.0 * np.pi) - log_determinant(n_sensors, n_times, dt, tau)
    return Exponents(n, 1.0, constant)


def known_scale_posterior(curve: DiscrepancyCurve, exponents: Exponents, sigma: float):
    """Marginal of theta and log evidence with sigma known; `curve` is that of W."""
    log_weights = -0.5 * (curve.values - curve.minimum) / sigma**2
    mass = np.exp(log_weights) * curve.slope
    marginal = Marginal.on_grid(curve.theta, mass, curve.u)
    low, high = curve.bounds
    evidence = np.trapezoid(mass, curve.u) / (high - low)
    top = -exponents.m * np.log(sigma) - 0.5 * curve.minimum / sigma**2 + exponents.constant
    return marginal, float(np.log(evidence) + top)


def unknown_time_posterior(curve, sums, shape, dt, sigma_bounds, tau_bounds):
    """Integrate the posterior under uniform priors of theta, sigma (from zero) and ln(tau).

    Parameters
    ----------
    curve : DiscrepancyCurve
        Of S, for its nodes.
    sums : array (4, n)
        At the nodes of `curve`; see `weighted_square`.
    shape : tuple of int
        Sensors and samples.
    dt : float
        Sampling step [s].
    sigma_bounds, tau_bounds : tuple of float
        Of the priors.

    Returns
    -------
    marginals : dict
        Of theta, sigma and tau.
    best : tuple of float
        theta, sigma and tau of the highest density.
    log_evidence : float
    """
    half = 0.5 * (np.prod(shape) - 1.0)
    top_sigma, log_bounds = sigma_bounds[1], np.log(tau_bounds)
    spline = CubicSpline(curve.u, sums, axis=1)

    def masses(u, log_tau):
        tau = np.exp(log_tau)
        weighted = weighted_square(spline(u)[:, :, None], dt, tau)
        log_p = -half * np.log(0.5 * weighted) - log_determinant(*shape, dt, tau)
        with np.errstate(divide="ignore"):
            log_p += np.log(gammaincc(half, 0.5 * weighted / top_sigma**2))
        slope = np.interp(u, curve.u, curve.slope)
        return weighted, log_p, log_p + np.log(slope)[:, None]

    u, log_tau = curve.u[::6], np.linspace(*log_bounds, N_COARSE)
    *_, log_mass = masses(u, log_tau)
    matters = log_mass > log_mass.max() + np.log(NEGLIGIBLE)
    u = spread(u, matters.any(axis=1), N_SPREAD)
    log_tau = spread(log_tau, matters.any(axis=0), N_TAU)
    weighted, log_p, log_mass = masses(u, log_tau)
    top = log_mass.max()
    mass = np.exp(log_mass - top)
    over_theta = np.trapezoid(mass, u, axis=0)
    theta = np.interp(u, curve.u, curve.theta)
    marginals = {
        "theta": Marginal.on_grid(theta, np.trapezoid(mass, log_tau, axis=1), u),
        "sigma": scale_marginal(weighted[::4, ::4], mass[::4, ::4], half, top_sigma),
        "tau": Marginal.on_grid(np.exp(log_tau), over_theta, log_tau),
    }
    i, j = np.unravel_index(log_p.argmax(), log_p.shape)
    best = float(theta[i]), float(np.sqrt(weighted[i, j] / np.prod(shape))), float(np.exp(log_tau[j]))
    volume = (curve.bounds[1] - curve.bounds[0]) * top_sigma * (log_bounds[1] - log_bounds[0])
    evidence = np.log(np.trapezoid(over_theta, log_tau)) + top - np.log(volume)
    constant = gammaln(half) - np.log(2.0) - 0.5 * np.prod(shape) * np.log(2.0 * np.pi)
    return marginals, best, float(evidence + constant)


def spread(nodes, matters, n):
    """An even grid over the part of `nodes` that matters, one step further on each side."""
    where = np.flatnonzero(matters)
    first, last = max(where[0] - 1, 0), min(where[-1] + 1, len(nodes) - 1)
    return np.linspace(nodes[first], nodes[last], n)


def scale_marginal(weighted, mass, half, top_sigma):
    """Marginal of sigma: W / (2 sigma^2) is a gamma variable given theta and tau."""
    matters = mass > NEGLIGIBLE
    weighted, mass = weighted[matters], mass[matters] / mass[matters].sum()
    best, width = np.sqrt(0.5 * weighted / half), 8.0 / np.sqrt(4.0 * half)
    sigma = np.linspace(best.min() * (1.0 - width), min(best.max() * (1.0 + width), top_sigma), N_SCALE)
    below = np.array([mass @ gammaincc(half, 0.5 * weighted / s**2) for s in sigma])
    return Marginal(sigma, np.gradient(below, sigma), below / below[-1])


@dataclass(eq=False)
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
    scale : float
        Standard deviation of the noise, where sigma is known [m/s^2].
    response : callable
        theta -> array (sensor, time), the prediction of the measurements.
    frequencies : callable
        theta -> array (m,), natural frequencies of the structure [Hz].
    """

    sums: Callable[[float], np.ndarray]
    data: xr.DataArray
    dt: float
    scale: float
    response: Callable[[float], np.ndarray]
    frequencies: Callable[[float], np.ndarray]

    def __post_init__(self):
        self.shape = self.data.shape
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

    def _curve(self, total):
        return DiscrepancyCurve(total, paper.THETA_RANGE, self.data.size)

    @cached_property
    def node_sums(self) -> np.ndarray:
        """`at` the nodes of `curve`, (4, n)."""
        return np.array([self.at(theta) for theta in self.curve.theta]).T


class Reference(NamedTuple):
    """Exact statistics (parameter, statistic), NaN for what is no parameter; log evidence; and a log-density.

    `log_density` takes the draws, a dictionary of arrays (n,), and returns an array (n,), up to a constant.
    """

    statistics: np.ndarray
    log_evidence: float
    log_density: Callable[[dict], np.ndarray]


def reference(kind: str, step: Step) -> Reference:
    """Exact posterior of one of `WITH_REFERENCE` at one sampling step of the study."""
    if kind in OWN_POSTERIORS:
        return OWN_POSTERIORS[kind](step)
    return posterior_of_curve(step.curve, LIKELIHOODS[kind].exponents(*step.shape))


def posterior_of_curve(curve: DiscrepancyCurve, exponents: Exponents, stretches=None) -> Reference:
    """Theta and sigma inferred by a likelihood of one curve, which may be stretched."""
    exact = exact_posterior(curve, exponents, paper.SIGMA_RANGE, stretches)

    def log_density(draws):
        theta, sigma = draws["theta"], draws["sigma"]
        if stretches is not None:
            theta, sigma = (s.inside(x) for s, x in zip(stretches, (theta, sigma), strict=True))
        return -exponents.m * np.log(sigma) - exponents.c * curve.at(theta) / (2.0 * sigma**2)

    statistics = rows(exact.map, {"theta": exact.theta, "sigma": exact.sigma})
    return Reference(statistics, exact.log_evidence, log_density)


def rows(best, marginals) -> np.ndarray:
    """Maximum (in the order of `PARAMETERS`) and quantiles of some of them, a dictionary, as a table."""
    table = np.full((len(PARAMETERS), len(STATISTICS)), np.nan)
    for k, name in enumerate(PARAMETERS[: len(marginals)]):
        table[k] = [best[k], *marginals[name].quantile(PROBABILITIES)]
    return table


def exact_tolerance(step: Step) -> float:
    """delta from the exact EXP posterior, Eq. (16).

    The width of ABC goes with the root of what delta has beyond the smallest rho, which would double the
    relative error of a quantile of draws.
    """
    of_exp = exact_posterior(step.curve, EXP.exponents(*step.shape), paper.SIGMA_RANGE)
    return abc_tolerance(float(of_exp.sigma.quantile(0.9)), step.shape[0])


def exact_interval(step: Step) -> tuple[float, float]:
    """Ends of the exact set {theta: S(theta) <= delta}."""
    return tolerance_interval(step.curve, exact_tolerance(step))


def with_tolerance(step: Step) -> Reference:
    """ABC: uniform on {theta: S(theta) <= delta}."""
    curve, (low, high) = step.curve, exact_interval(step)
    table = np.full((len(PARAMETERS), len(STATISTICS)), np.nan)
    table[0] = [curve.minimiser, *(low + np.array(PROBABILITIES) * (high - low))]
    prior = paper.THETA_RANGE[1] - paper.THETA_RANGE[0]
    return Reference(table, float(np.log((high - low) / prior)), lambda draws: -curve.at(draws["theta"]))


def with_known_errors(step: Step) -> Reference:
    """CN: theta, with tau and sigma known."""
    curve, exponents = step.weighted_curve, correlated_exponents(*step.shape, step.dt, paper.CORRELATION_TIME)
    marginal, log_evidence = known_scale_posterior(curve, exponents, step.scale)
    statistics = rows((curve.minimiser,), {"theta": marginal})
    return Reference(statistics, log_evidence, lambda draws: -curve.at(draws["theta"]))


def with_known_time(step: Step) -> Reference:
    """CN-SIGMA: theta and sigma, with tau known."""
    exponents = correlated_exponents(*step.shape, step.dt, paper.CORRELATION_TIME)
    return posterior_of_curve(step.weighted_curve, exponents)


def with_unknown_time(step: Step) -> Reference:
    """CN-TAU: theta, sigma and tau."""
    curve, sums = step.curve, step.node_sums
    marginals, best, log_evidence = unknown_time_posterior(
        curve, sums, step.shape, step.dt, paper.SIGMA_RANGE, paper.TAU_RANGE
    )

    def log_density(draws):
        at_draws = np.array([np.interp(draws["theta"], curve.theta, row) for row in sums])
        exponents = correlated_exponents(*step.shape, step.dt, draws["tau"])
        weighted, sigma = weighted_square(at_draws, step.dt, draws["tau"]), draws["sigma"]
        return exponents.constant - exponents.m * np.log(sigma) - 0.5 * weighted / sigma**2

    return Reference(rows(best, marginals), log_evidence, log_density)


def calibrated(step: Step) -> Reference:
    """CAL: NORM's likelihood to a power, stretched along theta and sigma around its maximum.

    The maximum follows from S(theta), its curvature A in closed form. theta and sigma do not mix: neither in
    A nor in the covariance B of the score. The model is the structure, so that bands are not compared.
    """
    curve, norm = step.curve, NORM.exponents(*step.shape)
    theta, sigma = curve.minimiser, np.sqrt(norm.c * curve.minimum / norm.m)
    # slopes of theta and ln(sigma) by the unconstrained parameters
    low, high = paper.THETA_RANGE
    of_theta = (theta - low) * (high - theta) / (high - low)
    of_sigma = 1.0 - sigma / paper.SIGMA_RANGE[1]
    ends = [step.response(theta + sign * DIFFERENCE) for sign in (1.0, -1.0)]
    slope = (ends[0] - ends[1]) / (2.0 * DIFFERENCE * sigma) * of_theta
    n_sensors, n_times = step.shape
    value = Comparison(step.response(theta), step.data.values, sigma, n_times, step=step.dt).by_sensor()
    slopes = np.stack([slope, np.zeros_like(slope)], axis=-1)
    of_scale = np.tile([0.0, of_sigma], (n_sensors, 1))
    event = Event(value, slopes, of_scale, step.frequencies(theta))
    curvature = norm.c * curve.curvature * (of_theta / sigma) ** 2
    information = np.diag([curvature, 2.0 * norm.m * of_sigma**2])
    precision = sandwich([event], model_error=None)._replace(information=information).precision
    power, matrix = stretching(information, precision)
    raised = Exponents(*(power * np.array(norm)))
    return posterior_of_curve(
        curve,
        raised,
        (
            Stretch(paper.THETA_RANGE, theta, float(matrix[0, 0])),
            Stretch(paper.SIGMA_RANGE, float(sigma), float(matrix[1, 1])),
        ),
    )


OWN_POSTERIORS = {
    "ABC": with_tolerance,
    "CN": with_known_errors,
    "CN-SIGMA": with_known_time,
    "CN-TAU": with_unknown_time,
    "CAL": calibrated,
}
#: Names of the likelihoods that the study can judge by their exact posteriors.
WITH_REFERENCE = tuple(
    name for name, entry in LIKELIHOODS.items() if entry.exponents is not None or name in OWN_POSTERIORS
)
