"""Exact posteriors of one parameter theta and sigma by quadrature, to judge samplers by.

NORM, TN and EXP depend on theta through S(theta) = sum_j e_j only: up to a constant,

    ln L = -m ln(sigma) - c S / (2 sigma^2),    m, c = N_0 N_D, N_D (NORM); N_0, 1 (TN); 2 N_0, 1 (EXP).

With uniform priors the posterior is integrated on a grid of theta and ln sigma, spaced by a sinh so
that it resolves the narrowest posterior and still covers the prior; in such variables the trapezoidal
rule converges exponentially. ABC with the uniform kernel is uniform on {theta: S(theta) <= delta}.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.optimize import brentq, minimize_scalar
from scipy.special import expit, logit

N_THETA = 1201
N_SIGMA = 601


@dataclass(frozen=True)
class Exponents:
    """m and c of a likelihood that depends on S only, and its constant over all sensors."""

    m: float
    c: float
    constant: float


@dataclass(frozen=True, eq=False)
class Marginal:
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


@dataclass(frozen=True)
class Stretch:
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


@dataclass(frozen=True, eq=False)
class ExactPosterior:
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
    m, c = exponents.m, exponents.c
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
