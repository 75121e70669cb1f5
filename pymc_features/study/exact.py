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
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.optimize import brentq, minimize_scalar
from scipy.special import expit, gammaincc, gammaln, logit

from pymc_features.calibration.residuals import Comparison, Fit
from pymc_features.calibration.sandwich import Peak, stretching
from pymc_features.likelihoods import LIKELIHOODS, abc_tolerance
from pymc_features.likelihoods.catalogue import NORM, Exponents
from pymc_features.study import paper

PARAMETERS = ("theta", "sigma", "tau")
STATISTICS = ("map", "q05", "q50", "q95")
PROBABILITIES = (0.05, 0.5, 0.95)
N_THETA, N_SIGMA = 1201, 601
N_COARSE, N_SPREAD, N_TAU, N_SCALE = 601, 201, 401, 401  # nodes where tau is inferred
NEGLIGIBLE = 1e-12
DIFFERENCE = 1e-4  # of theta, over which the response is differentiated


class Grid(NamedTuple):
    """Nodes (n,) of a parameter, ascending; the even variable u (n,) that they follow; d prior / d u (n,)."""

    nodes: np.ndarray
    u: np.ndarray
    slope: np.ndarray


class Marginal(NamedTuple):
    """A distribution on a grid: nodes (n,) ascending, probability below them (n,)."""

    nodes: np.ndarray
    below: np.ndarray

    def quantile(self, probability):
        """Quantiles, shape of `probability`."""
        inside = np.concatenate([[True], np.diff(self.below) > 1e-15])
        return PchipInterpolator(self.below[inside], self.nodes[inside])(probability)


class ExactPosterior(NamedTuple):
    """Marginals by parameter, the maximum in their order, log evidence, and the log-density.

    `log_density` takes parameters by name, arrays that broadcast, and returns an array, up to a constant.
    """

    marginals: dict[str, Marginal]
    map: tuple[float, ...]
    log_evidence: float
    log_density: Callable[[dict], np.ndarray]

    @property
    def statistics(self) -> np.ndarray:
        """Maximum and quantiles (parameter, statistic), NaN for what is no parameter."""
        table = np.full((len(PARAMETERS), len(STATISTICS)), np.nan)
        for name, best in zip(self.marginals, self.map, strict=True):
            table[PARAMETERS.index(name)] = best, *self.marginals[name].quantile(PROBABILITIES)
        return table


def log_masses(log_density: Callable[[dict], np.ndarray], grids: dict[str, Grid]) -> np.ndarray:
    """Log-density times d prior / d u at all nodes of some grids, one dimension for each."""
    nodes = np.ix_(*(grid.nodes for grid in grids.values()))
    with np.errstate(divide="ignore"):
        slopes = np.ix_(*(np.log(grid.slope) for grid in grids.values()))
    return log_density(dict(zip(grids, nodes, strict=True))) + sum(slopes)


def integrate(log_mass: np.ndarray, grids: dict[str, Grid]) -> tuple[dict[str, Marginal], float]:
    """Marginals and the log of the whole mass, whose logarithms are `log_masses`, by the trapezoidal rule."""
    top, marginals = log_mass.max(), {}
    mass = np.exp(log_mass - top)
    for axis, (name, grid) in enumerate(grids.items()):
        along = mass
        for other, rest in reversed(list(enumerate(grids.values()))):
            along = along if other == axis else np.trapezoid(along, rest.u, axis=other)
        below = CubicSpline(grid.u, along).antiderivative()(grid.u)
        below = np.maximum.accumulate(below - below[0])
        marginals[name] = Marginal(grid.nodes, below / below[-1])
    return marginals, float(np.log(np.trapezoid(along, grid.u)) + top)


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
    grid : Grid (n_nodes,)
        Nodes of theta.
    values : array (n_nodes,)
        S there.
    """

    def __init__(
        self,
        total: Callable[[float], float],
        bounds: tuple[float, float],
        n_data: int,
        n_nodes: int = N_THETA,
    ):
        self.total, self.bounds, (low, high) = total, bounds, bounds
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
        self.grid = self.grid_at(np.linspace(*map(self.grid_variable, bounds), n_nodes))
        self.values = np.array([total(t) for t in self.grid.nodes])

    def grid_variable(self, theta):
        """u of theta, in which the nodes are even."""
        return np.arcsinh((theta - self.minimiser) / self.scale)

    def grid_at(self, u: np.ndarray) -> Grid:
        """Nodes at some values of u."""
        low, high = self.bounds
        theta = np.clip(self.minimiser + self.scale * np.sinh(u), low, high)
        return Grid(theta, u, self.scale * np.cosh(u) / (high - low))

    def at(self, theta):
        """S between the nodes, by straight lines."""
        return np.interp(theta, self.grid.nodes, self.values)


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

    def grid(self, of_x: Grid) -> Grid:
        """The grid of y that belongs to one of x."""
        x, (low, high) = of_x.nodes, self.bounds
        y = self._moved(x, 1.0 / self.factor)
        with np.errstate(invalid="ignore"):
            slope = (y - low) * (high - y) / ((x - low) * (high - x)) / self.factor
        # not a number at the bounds, where nothing is left of the likelihood
        return Grid(y, of_x.u, of_x.slope * np.nan_to_num(slope))

    def _moved(self, x, factor):
        low, high = self.bounds
        at = logit((self.centre - low) / (high - low))
        return low + (high - low) * expit(at + factor * (logit((x - low) / (high - low)) - at))


def exact_posterior(
    curve: DiscrepancyCurve,
    exponents: Exponents,
    sigma_bounds: tuple[float, float] = paper.SIGMA_RANGE,
    *,
    sigma: float | None = None,
    stretches: dict[str, Stretch] | None = None,
) -> ExactPosterior:
    """Posterior of theta, and of sigma unless it is known, under uniform priors by a likelihood of one curve.

    `stretches` are those of the likelihood along theta and sigma, about its maximum.
    """
    m, c, constant = exponents
    grids, best = {"theta": curve.grid}, (curve.minimiser,)
    if sigma is None:
        of_sigma = float(min(np.sqrt(c * curve.minimum / m), sigma_bounds[1]))
        grids["sigma"], best = scale_grid(of_sigma, m, sigma_bounds), (curve.minimiser, of_sigma)
    if stretches is not None:
        grids = {name: stretch.grid(grids[name]) for name, stretch in stretches.items()}

    def log_density(draws):
        if stretches is not None:
            draws = {name: stretch.inside(draws[name]) for name, stretch in stretches.items()}
        scale = draws["sigma"] if sigma is None else sigma
        return constant - m * np.log(scale) - c * curve.at(draws["theta"]) / (2.0 * scale**2)

    marginals, log_evidence = integrate(log_masses(log_density, grids), grids)
    return ExactPosterior(marginals, best, log_evidence, log_density)


def scale_grid(best: float, m: float, bounds: tuple[float, float]) -> Grid:
    """Nodes of sigma about the best one, fine there, down to where nothing is left of the likelihood."""
    low, high = bounds
    width = 1.0 / np.sqrt(2.0 * m)
    # below this, exp(-c S_min / (2 sigma^2)) is smaller than 1e-30 of its maximum
    floor = max(low, best / np.sqrt(1.0 + 150.0 / m + np.sqrt(300.0 / m)))
    u = np.linspace(*(np.arcsinh(np.log(s / best) / width) for s in (floor, high)), N_SIGMA)
    nodes = np.clip(best * np.exp(width * np.sinh(u)), floor, high)
    return Grid(nodes, u, nodes * width * np.cosh(u) / (high - low))


def tolerance_interval(curve: DiscrepancyCurve, delta: float) -> tuple[float, float]:
    """Ends of {theta: S(theta) <= delta} around the minimum, the exact ABC posterior's support."""
    if delta <= curve.minimum:
        raise ValueError(
            f"`delta` must exceed the smallest discrepancy {curve.minimum:.6g}, got {delta:.6g}. "
            "Use the 90 % quantile of sigma under EXP."
        )
    theta, ends = curve.grid.nodes, []
    for direction in (-1, 1):
        outside = theta[(curve.values > delta) & (direction * (theta - curve.minimiser) > 0)]
        if outside.size == 0:
            ends.append(theta[0] if direction < 0 else theta[-1])
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


def correlated_exponents(n_sensors: int, n_times: int, dt: float, tau) -> Exponents:
    """Exponents in W of the likelihood with this tau, and its constant: of the determinant, too."""
    n = n_sensors * n_times
    determinant = n_sensors * (n_times - 1) * np.log(-np.expm1(-2.0 * dt / tau))
    return Exponents(n, 1.0, -0.5 * (n * np.log(2.0 * np.pi) + determinant))


def unknown_time_posterior(
    curve: DiscrepancyCurve,
    sums: Callable[[np.ndarray], np.ndarray],
    shape: tuple[int, int],
    dt: float,
    largest_sigma: float = paper.SIGMA_RANGE[1],
    tau_bounds: tuple[float, float] = paper.TAU_RANGE,
) -> ExactPosterior:
    """Posterior under uniform priors of theta, sigma (from zero) and ln(tau).

    Parameters
    ----------
    curve : DiscrepancyCurve
        Of S, for its nodes.
    sums : callable
        theta -> array (4, ...), see `weighted_square`.
    shape : tuple of int
        Sensors and samples.
    dt : float
        Sampling step [s].
    largest_sigma, tau_bounds : float and tuple of float
        Of the priors.
    """
    half = 0.5 * (np.prod(shape) - 1.0)
    of_sigma = gammaln(half) - np.log(2.0 * largest_sigma)

    def log_density(draws):
        m, c, constant = correlated_exponents(*shape, dt, draws["tau"])
        weighted, sigma = weighted_square(sums(draws["theta"]), dt, draws["tau"]), draws["sigma"]
        return constant - m * np.log(sigma) - c * weighted / (2.0 * sigma**2)

    def without_sigma(draws):
        constant = correlated_exponents(*shape, dt, draws["tau"]).constant + of_sigma
        weighted = weighted_square(sums(draws["theta"]), dt, draws["tau"])
        with np.errstate(divide="ignore"):
            tail = np.log(gammaincc(half, 0.5 * weighted / largest_sigma**2))
        return constant - half * np.log(0.5 * weighted) + tail

    def grids_at(u, log_tau):
        even = np.full(log_tau.size, 1.0 / np.ptp(np.log(tau_bounds)))
        return {"theta": curve.grid_at(u), "tau": Grid(np.exp(log_tau), log_tau, even)}

    u, log_tau = curve.grid.u[::6], np.linspace(*np.log(tau_bounds), N_COARSE)
    log_mass = log_masses(without_sigma, grids_at(u, log_tau))
    matters = log_mass > log_mass.max() + np.log(NEGLIGIBLE)
    u = spread(u, matters.any(axis=1), N_SPREAD)
    grids = grids_at(u, spread(log_tau, matters.any(axis=0), N_TAU))
    log_mass = log_masses(without_sigma, grids)
    marginals, log_evidence = integrate(log_mass, grids)
    theta, tau = grids["theta"].nodes, grids["tau"].nodes
    weighted = weighted_square(sums(theta[:, None]), dt, tau)
    mass = np.exp(log_mass - log_mass.max())
    marginals["sigma"] = scale_marginal(weighted[::4, ::4], mass[::4, ::4], half, largest_sigma)
    slope = np.log(grids["theta"].slope)[:, None]
    i, j = np.unravel_index((log_mass - slope).argmax(), log_mass.shape)
    best = float(theta[i]), float(np.sqrt(weighted[i, j] / np.prod(shape))), float(tau[j])
    marginals = {name: marginals[name] for name in PARAMETERS}
    return ExactPosterior(marginals, best, log_evidence, log_density)


def spread(nodes, matters, n):
    """An even grid over the part of `nodes` that matters, one step further on each side."""
    where = np.flatnonzero(matters)
    first, last = max(where[0] - 1, 0), min(where[-1] + 1, len(nodes) - 1)
    return np.linspace(nodes[first], nodes[last], n)


def scale_marginal(weighted, mass, half, largest):
    """Marginal of sigma: W / (2 sigma^2) is a gamma variable given theta and tau."""
    matters = mass > NEGLIGIBLE
    weighted, mass = weighted[matters], mass[matters] / mass[matters].sum()
    best, width = np.sqrt(0.5 * weighted / half), 8.0 / np.sqrt(4.0 * half)
    sigma = np.linspace(best.min() * (1.0 - width), min(best.max() * (1.0 + width), largest), N_SCALE)
    below = np.array([mass @ gammaincc(half, 0.5 * weighted / s**2) for s in sigma])
    return Marginal(sigma, below / below[-1])


class Step:
    """Misfit between the measurements (sensor, time) of a `Study` at one sampling step and its structure."""

    def __init__(self, study, multiplier: float):
        self.study, self.row = study, study.multipliers.index(multiplier)
        self.data, self.dt = study.data(multiplier), study.step(multiplier)

    def sums(self, theta) -> np.ndarray:
        """Sums (4, ...) of squares of the misfit and its increments; over the sensors of first and last."""
        return np.moveaxis(self.study.sums(theta)[..., self.row, :], -1, 0)

    @cached_property
    def curve(self) -> DiscrepancyCurve:
        """S(theta), the sum of mean squares."""
        n_times = self.data.shape[1]
        return self._curve(lambda theta: float(self.sums(theta)[0]) / n_times)

    @cached_property
    def weighted_curve(self) -> DiscrepancyCurve:
        """W(theta) at the known correlation time."""
        return self._curve(
            lambda theta: float(weighted_square(self.sums(theta), self.dt, paper.CORRELATION_TIME))
        )

    def _curve(self, total):
        return DiscrepancyCurve(total, paper.THETA_RANGE, self.data.size)

    @property
    def correlated(self) -> Exponents:
        """Exponents in W at the known correlation time."""
        return correlated_exponents(*self.data.shape, self.dt, paper.CORRELATION_TIME)


def reference(kind: str, step: Step) -> ExactPosterior:
    """Exact posterior of one of `WITH_REFERENCE` at one sampling step of the study."""
    if kind in OWN_POSTERIORS:
        return OWN_POSTERIORS[kind](step)
    return exact_posterior(step.curve, LIKELIHOODS[kind].exponents(*step.data.shape))


def exact_tolerance(step: Step) -> float:
    """delta from the exact EXP posterior, Eq. (16).

    The width of ABC goes with the root of what delta has beyond the smallest rho, which would double the
    relative error of a quantile of draws.
    """
    return abc_tolerance(float(reference("EXP", step).marginals["sigma"].quantile(0.9)), step.data.shape[0])


def exact_interval(step: Step) -> tuple[float, float]:
    """Ends of the exact set {theta: S(theta) <= delta}."""
    return tolerance_interval(step.curve, exact_tolerance(step))


def with_tolerance(step: Step) -> ExactPosterior:
    """ABC: uniform on {theta: S(theta) <= delta}."""
    ends, curve = np.array(exact_interval(step)), step.curve
    share = float(np.ptp(ends) / np.ptp(curve.bounds))
    uniform = {"theta": Marginal(ends, np.array([0.0, 1.0]))}
    return ExactPosterior(
        uniform, (curve.minimiser,), float(np.log(share)), lambda draws: -curve.at(draws["theta"])
    )


def calibrated(step: Step) -> ExactPosterior:
    """CAL: NORM's likelihood to a power, stretched along theta and sigma around its maximum.

    The maximum follows from S(theta), its curvature A in closed form. theta and sigma do not mix: neither in
    A nor in the covariance B of the score. The model is the structure, so that bands are not compared.
    """
    curve, norm = step.curve, NORM.exponents(*step.data.shape)
    theta, sigma = curve.minimiser, float(np.sqrt(norm.c * curve.minimum / norm.m))
    # slopes of theta and ln(sigma) by the unconstrained parameters
    low, high = paper.THETA_RANGE
    of_theta = (theta - low) * (high - theta) / (high - low)
    of_sigma = 1.0 - sigma / paper.SIGMA_RANGE[1]
    response = partial(step.study.response, dt=step.dt)
    ends = [response(theta + sign * DIFFERENCE) for sign in (1.0, -1.0)]
    slope = (ends[0] - ends[1]) / (2.0 * DIFFERENCE * sigma) * of_theta
    n_sensors, n_times = step.data.shape
    value = Comparison(response(theta), step.data.values, sigma, n_times, step=step.dt).by_sensor()
    slopes = np.stack([slope, np.zeros_like(slope)], axis=-1)
    of_scale = np.tile([0.0, of_sigma], (n_sensors, 1))
    frequencies = step.study.at(theta).modes().natural_frequencies
    event = value._replace(sensitivities=slopes, of_scale=of_scale, frequencies=frequencies)
    curvature = norm.c * curve.curvature * (of_theta / sigma) ** 2
    information = np.diag([curvature, 2.0 * norm.m * of_sigma**2])
    precision = Peak.at(Fit(None, None, [event]), None)._replace(information=information).precision
    power, matrix = stretching(information, precision)
    stretches = {
        "theta": Stretch(paper.THETA_RANGE, theta, float(matrix[0, 0])),
        "sigma": Stretch(paper.SIGMA_RANGE, sigma, float(matrix[1, 1])),
    }
    return exact_posterior(curve, Exponents(*(power * np.array(norm))), stretches=stretches)


OWN_POSTERIORS = {
    "ABC": with_tolerance,
    "CN": lambda step: exact_posterior(step.weighted_curve, step.correlated, sigma=step.study.scale),
    "CN-SIGMA": lambda step: exact_posterior(step.weighted_curve, step.correlated),
    "CN-TAU": lambda step: unknown_time_posterior(step.curve, step.sums, step.data.shape, step.dt),
    "CAL": calibrated,
}
#: Names of the likelihoods that the study can judge by their exact posteriors.
WITH_REFERENCE = tuple(
    name for name, entry in LIKELIHOODS.items() if entry.exponents is not None or name in OWN_POSTERIORS
)
