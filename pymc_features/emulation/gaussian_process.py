r"""A Gaussian process of a few outputs that share one kernel, about a polynomial trend.

Outputs y (point, output) have the mean H(x) beta, with beta unknown and a flat prior, and the covariance
s_c^2 [k(x, x') + noise delta(x, x')], with a variance s_c^2 for each output: universal kriging. The kernel is
a squared exponential or a Matern 5/2, with one length scale for each parameter; the one of more likelihood is
taken. Restricted marginal likelihood, with beta and s_c^2 eliminated (Santner, Williams & Notz, The Design
and Analysis of Computer Experiments, 2nd ed. 2018, section 3.3):

    -2 ln L = q [ln |K| + ln |H' K^-1 H|] + (n - p) sum_c ln s_c^2,   s_c^2 = y_c' P y_c / (n - p),
    P = K^-1 - K^-1 H (H' K^-1 H)^-1 H' K^-1.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cho_solve, cholesky, solve_triangular
from scipy.optimize import minimize

LENGTH_BOUNDS = (0.05, 100.0)  # in spreads of the first design
NOISE_BOUNDS = (1e-8, 1e-1)  # over the variance of the process
# weak prior of the logarithm of a length scale, lest a flat likelihood run away
LENGTH_PRIOR = (np.log(2.0), 2.0)
JITTER = 1e-11
MOST_STEPS, ENOUGH = 40, 1e-6  # of the search, and the relative gain below which it ends
MANY_POINTS = 60  # from which a kernel that was chosen is kept


class Kernel(NamedTuple):
    """A correlation as a function of the squared distance r^2, in length scales.

    Attributes
    ----------
    value : callable
        k(r^2).
    slope : callable
        -2 dk/d(r^2), from r^2 and k.
    """

    value: Callable
    slope: Callable


def gaussian(squares):
    """exp(-r^2 / 2)."""
    return np.exp(-0.5 * squares)


def gaussian_slope(squares, value):
    """Derivative of `gaussian` by the squares."""
    return value


def matern(squares):
    """Matern 5/2: (1 + a + a^2 / 3) exp(-a), a = sqrt(5) r."""
    a = np.sqrt(5.0 * squares)
    return (1.0 + a + a * a / 3.0) * np.exp(-a)


def matern_slope(squares, value):
    """5/3 (1 + a) exp(-a)."""
    a = np.sqrt(5.0 * squares)
    return (5.0 / 3.0) * (1.0 + a) * np.exp(-a)


KERNELS = {
    "squared exponential": Kernel(gaussian, gaussian_slope),
    "Matern 5/2": Kernel(matern, matern_slope),
}


class Hyperparameters(NamedTuple):
    """Name of the kernel, its length scales (parameter,), noise; `objective` is -2 ln L with the prior."""

    kernel: str
    lengths: np.ndarray
    noise: float
    objective: float = np.inf


def squared_distances(x, other):
    """(n, m) from scaled points (n, d) and (m, d)."""
    squares = (x * x).sum(axis=1)[:, None] + (other * other).sum(axis=1) - 2.0 * (x @ other.T)
    return np.maximum(squares, 0.0)


def trend(x, degree):
    """Polynomials (n, p) of a degree up to 2 at points (n, d)."""
    columns = [np.ones((len(x), 1))]
    if degree > 0:
        columns.append(x)
    if degree > 1:
        i, j = np.triu_indices(x.shape[1])
        columns.append(x[:, i] * x[:, j])
    return np.concatenate(columns, axis=1)


def trend_slope(x, degree):
    """Their derivatives (n, p, d)."""
    n, d = x.shape
    slopes = np.zeros((n, trend(x[:1], degree).shape[1], d))
    if degree > 0:
        slopes[:, 1 : d + 1] = np.eye(d)
    if degree > 1:
        for column, (i, j) in enumerate(zip(*np.triu_indices(d), strict=True), start=d + 1):
            slopes[:, column, i] += x[:, j]
            slopes[:, column, j] += x[:, i]
    return slopes


def largest_degree(n: int, d: int) -> int:
    """Degree of a trend that n points in d dimensions determine with as many to spare."""
    return 2 if n >= (d + 1) * (d + 2) else 1 if n >= 2 * (d + 1) else 0


def factors(x, y, kernel, lengths, noise, basis):
    """Cholesky factor, its solutions for trend and outputs, and what of the outputs the trend leaves."""
    squares = squared_distances(x / lengths, x / lengths)
    np.fill_diagonal(squares, 0.0)
    correlation = KERNELS[kernel].value(squares)
    factor = cholesky(correlation + (noise + JITTER) * np.eye(len(x)), lower=True)
    q, r = np.linalg.qr(solve_triangular(factor, basis, lower=True))
    right = solve_triangular(factor, y, lower=True)
    return squares, correlation, factor, q, r, right


def objective(parameters, x, y, kernel, basis):
    """-2 ln L with the prior of the length scales, and its gradient by ln lengths and ln noise."""
    n, q_outputs = y.shape
    lengths, noise = np.exp(parameters[:-1]), np.exp(parameters[-1])
    try:
        squares, correlation, factor, q, r, right = factors(x, y, kernel, lengths, noise, basis)
    except LinAlgError:
        return 1e12, np.zeros(len(parameters))
    rest = right - q @ (q.T @ right)
    variance = np.maximum((rest**2).sum(axis=0) / (n - basis.shape[1]), 1e-300)
    log_det = 2.0 * np.log(np.diag(factor)).sum() + 2.0 * np.log(np.abs(np.diag(r))).sum()
    value = q_outputs * log_det + (n - basis.shape[1]) * np.log(variance).sum()
    whole = solve_triangular(factor, np.eye(n), lower=True)
    across = q.T @ whole
    p = whole.T @ whole - across.T @ across
    by_y = solve_triangular(factor, rest, lower=True, trans=1)
    inner = q_outputs * p - (by_y / variance) @ by_y.T
    gradient = np.empty(len(parameters))
    a = inner * KERNELS[kernel].slope(squares, correlation)
    scaled = x / lengths
    gradient[:-1] = 2.0 * (a.sum(axis=1) @ scaled**2 - np.einsum("ik,ij,jk->k", scaled, a, scaled))
    gradient[-1] = noise * np.trace(inner)
    off = (parameters[:-1] - LENGTH_PRIOR[0]) / LENGTH_PRIOR[1]
    gradient[:-1] += 2.0 * off / LENGTH_PRIOR[1]
    return value + off @ off, gradient


def fit_hyperparameters(x, y, start: Hyperparameters | None = None) -> Hyperparameters:
    """Find the hyperparameters of most likelihood, of the better kernel.

    Parameters
    ----------
    x, y : array (point, parameter), (point, output)
    start : Hyperparameters, optional
        Where to begin; of many points its kernel is kept.
    """
    basis = trend(x, largest_degree(*x.shape))
    y = y / np.maximum(y.std(axis=0), 1e-300)
    bounds = [np.log(LENGTH_BOUNDS)] * x.shape[1] + [np.log(NOISE_BOUNDS)]
    found = []
    kept = start is not None and len(x) > MANY_POINTS
    for kernel in [start.kernel] if kept else KERNELS:
        if start is not None and start.kernel == kernel:
            first = np.append(np.log(start.lengths), np.log(start.noise))
        else:
            first = np.append(np.full(x.shape[1], np.log(2.0)), np.log(1e-6))
        first = np.clip(first, *np.transpose(bounds))
        result = minimize(
            objective,
            first,
            args=(x, y, kernel, basis),
            jac=True,
            method="L-BFGS-B",
            bounds=bounds,
            options={"maxiter": MOST_STEPS, "ftol": ENOUGH},
        )
        found.append(
            Hyperparameters(kernel, np.exp(result.x[:-1]), float(np.exp(result.x[-1])), float(result.fun))
        )
    return min(found, key=lambda h: h.objective)


class GaussianProcess:
    """The process that passes near given points.

    Parameters
    ----------
    x, y : array (point, parameter), (point, output)
    hyperparameters : Hyperparameters

    Attributes
    ----------
    variance : array (output,)
        s_c^2.

    Raises
    ------
    LinAlgError
        If the points determine nothing.
    """

    def __init__(self, x, y, hyperparameters: Hyperparameters):
        self.x, self.hyperparameters = x, hyperparameters
        self.kernel, self.lengths = KERNELS[hyperparameters.kernel], hyperparameters.lengths
        self.degree = largest_degree(*x.shape)
        self.noise = hyperparameters.noise + JITTER
        basis = trend(x, self.degree)
        *_, self.factor, q, self.r, right = factors(
            x, y, hyperparameters.kernel, self.lengths, hyperparameters.noise, basis
        )
        rest = right - q @ (q.T @ right)
        self.beta = solve_triangular(self.r, q.T @ right)
        self.weights = solve_triangular(self.factor, rest, lower=True, trans=1)
        self.variance = (rest**2).sum(axis=0) / max(len(x) - basis.shape[1], 1)
        self.inverse = solve_triangular(self.factor, np.eye(len(x)), lower=True)
        self.by_trend = cho_solve((self.factor, True), basis)  # K^-1 H

    def correlation(self, x, other):
        """k (n, m) between points."""
        return self.kernel.value(squared_distances(x / self.lengths, other / self.lengths))

    def features(self, x):
        """k (n, point), L^-1 k (n, point), and what the trend leaves open (n, p)."""
        cross = self.correlation(x, self.x)
        known = cross @ self.inverse.T
        rest = (trend(x, self.degree) - cross @ self.by_trend).T
        open_ = solve_triangular(self.r, rest, trans=1, check_finite=False).T
        return cross, known, open_

    @np.errstate(over="ignore", invalid="ignore")  # far out in a prior, where no density will be finite
    def predict(self, x):
        """Means (n, output), and the variance (n,) for s_c^2 = 1."""
        cross, known, open_ = self.features(x)
        mean = trend(x, self.degree) @ self.beta + cross @ self.weights
        return mean, np.maximum(1.0 - (known**2).sum(axis=1) + (open_**2).sum(axis=1), 0.0)

    def covariance(self, x):
        """Covariance (n, n) of the process at points, given all runs, for s_c^2 = 1."""
        _, known, open_ = self.features(x)
        return self.correlation(x, x) - known @ known.T + open_ @ open_.T

    def slopes(self, x, by_mean, by_variance):
        """Gradient (n, d) of sum_c by_mean_c mean_c + by_variance variance; weights (n, output), (n,)."""
        squares = squared_distances(x / self.lengths, self.x / self.lengths)
        cross = self.kernel.value(squares)
        slope = self.kernel.slope(squares, cross)  # dk/dx = -slope (x - x_i) / lengths^2
        known = (cross @ self.inverse.T) @ self.inverse  # k' K^-1
        basis = trend(x, self.degree)
        open_ = solve_triangular(self.r, (basis - cross @ self.by_trend).T, trans=1)
        open_ = solve_triangular(self.r, open_).T  # (H' K^-1 H)^-1 u
        by_cross = by_mean @ self.weights.T - 2.0 * by_variance[:, None] * (known + open_ @ self.by_trend.T)
        by_basis = by_mean @ self.beta.T + 2.0 * by_variance[:, None] * open_
        a = by_cross * slope
        gradient = (a @ self.x - a.sum(axis=1, keepdims=True) * x) / self.lengths**2
        return gradient + np.einsum("np,npd->nd", by_basis, trend_slope(x, self.degree))
