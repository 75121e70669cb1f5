r"""An emulator of a whole response: Gaussian processes of its principal components.

Responses g (sensor, time) of the runs so far are scaled by the spread of each sensor and decomposed,

    g(x) = g_0 + sum_c z_c(x) phi_c + rest,

with orthonormal phi_c (singular value decomposition). Each z_c is a Gaussian process of the parameters x;
the rest, beyond the last component that is kept, counts as an error of constant variance for each sensor.
With mean m_c and variance v_c of z_c the expected e_j of Eq. (3) is, exactly,

    E e_j = |y_j - g_0j - sum_c m_c phi_cj|^2 / N + sum_c v_c |phi_cj|^2 / N + rest_j.

A simulator that returns e_j itself is emulated by its logarithm; the expected e_j is that of a log-normal.

The processes of a group of components share one kernel, about a polynomial trend: y (point, output) has the
mean H(x) beta, with beta unknown and a flat prior, and the covariance
s_c^2 [k(x, x') + noise delta(x, x')], with a variance s_c^2 for each output: universal kriging. The kernel is
a squared exponential or a Matern 5/2, with one length scale for each parameter; the one of more likelihood is
taken. Restricted marginal likelihood, with beta and s_c^2 eliminated (Santner, Williams & Notz, The Design
and Analysis of Computer Experiments, 2nd ed. 2018, section 3.3):

    -2 ln L = q [ln |K| + ln |H' K^-1 H|] + (n - p) sum_c ln s_c^2,   s_c^2 = y_c' P y_c / (n - p),
    P = K^-1 - K^-1 H (H' K^-1 H)^-1 H' K^-1.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cho_solve, cholesky, solve_triangular
from scipy.optimize import minimize
from scipy.spatial import cKDTree

NEGLECTED = 1e-7  # share of the variance of all runs that components left out may have
MOST_COMPONENTS = 60
GROUPS = (1, 1, 1, 1, 2, 2, 4, 8, 16, 32)  # components that share a kernel, the largest alone
PREDICTED_AT_ONCE = 2000
CONSTANT = 1e-12  # relative range within which a parameter does not vary
POSITIVE_SKEW = 0.5  # by how much less skewed a logarithm must be to take the place of its parameter
LENGTH_BOUNDS = (0.05, 100.0)  # in spreads of the first design
NOISE_BOUNDS = (1e-8, 1e-1)  # over the variance of the process
# weak prior of the logarithm of a length scale, lest a flat likelihood run away
LENGTH_PRIOR = (np.log(2.0), 2.0)
JITTER = 1e-11
MOST_STEPS, ENOUGH = 40, 1e-6  # of the search, and the relative gain below which it ends
MANY_POINTS = 60  # from which a kernel that was chosen is kept


# ---- Gaussian processes ----


KERNELS = "squared exponential", "Matern 5/2"


def kernel(name: str, squares):
    """Correlation k and its slope -2 dk/d(r^2) at squared distances r^2, in length scales."""
    if name == "Matern 5/2":
        a = np.sqrt(5.0 * squares)
        decay = np.exp(-a)
        return (1.0 + a + a * a / 3.0) * decay, (5.0 / 3.0) * (1.0 + a) * decay
    value = np.exp(-0.5 * squares)
    return value, value


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


def factors(x, y, name, lengths, noise, basis):
    """Slope of the kernel, Cholesky factor, and the whitened trend (as q r), outputs and rest of these."""
    squares = squared_distances(x / lengths, x / lengths)
    np.fill_diagonal(squares, 0.0)
    correlation, slope = kernel(name, squares)
    factor = cholesky(correlation + (noise + JITTER) * np.eye(len(x)), lower=True)
    q, r = np.linalg.qr(solve_triangular(factor, basis, lower=True))
    right = solve_triangular(factor, y, lower=True)
    return slope, factor, q, r, right, right - q @ (q.T @ right)


def objective(parameters, x, y, name, basis):
    """-2 ln L with the prior of the length scales, and its gradient by ln lengths and ln noise."""
    n, q_outputs = y.shape
    lengths, noise = np.exp(parameters[:-1]), np.exp(parameters[-1])
    try:
        slope, factor, q, r, _, rest = factors(x, y, name, lengths, noise, basis)
    except LinAlgError:
        return 1e12, np.zeros(len(parameters))
    variance = np.maximum((rest**2).sum(axis=0) / (n - basis.shape[1]), 1e-300)
    log_det = 2.0 * np.log(np.diag(factor)).sum() + 2.0 * np.log(np.abs(np.diag(r))).sum()
    value = q_outputs * log_det + (n - basis.shape[1]) * np.log(variance).sum()
    whole = solve_triangular(factor, np.eye(n), lower=True)
    across = q.T @ whole
    p = whole.T @ whole - across.T @ across
    by_y = solve_triangular(factor, rest, lower=True, trans=1)
    inner = q_outputs * p - (by_y / variance) @ by_y.T
    gradient = np.empty(len(parameters))
    a, scaled = inner * slope, x / lengths
    gradient[:-1] = 2.0 * (a.sum(axis=1) @ scaled**2 - np.einsum("ik,ij,jk->k", scaled, a, scaled))
    gradient[-1] = noise * np.trace(inner)
    off = (parameters[:-1] - LENGTH_PRIOR[0]) / LENGTH_PRIOR[1]
    gradient[:-1] += 2.0 * off / LENGTH_PRIOR[1]
    return value + off @ off, gradient


def fit_hyperparameters(x, y, start: Hyperparameters | None = None) -> Hyperparameters:
    """Hyperparameters of most likelihood, of the better kernel, for points (point, parameter) and outputs
    (point, output).

    Begins at `start`, whose kernel is kept where points are many.
    """
    basis = trend(x, largest_degree(*x.shape))
    y = y / np.maximum(y.std(axis=0), 1e-300)
    bounds = [np.log(LENGTH_BOUNDS)] * x.shape[1] + [np.log(NOISE_BOUNDS)]
    found = []
    kept = start is not None and len(x) > MANY_POINTS
    for name in [start.kernel] if kept else KERNELS:
        if start is not None and start.kernel == name:
            first = np.append(np.log(start.lengths), np.log(start.noise))
        else:
            first = np.append(np.full(x.shape[1], np.log(2.0)), np.log(1e-6))
        first = np.clip(first, *np.transpose(bounds))
        result = minimize(
            objective,
            first,
            args=(x, y, name, basis),
            jac=True,
            method="L-BFGS-B",
            bounds=bounds,
            options={"maxiter": MOST_STEPS, "ftol": ENOUGH},
        )
        *lengths, noise = np.exp(result.x)
        found.append(Hyperparameters(name, np.array(lengths), float(noise), float(result.fun)))
    return min(found, key=lambda h: h.objective)


class GaussianProcess:
    """The process that passes near given points (point, parameter) and outputs (point, output).

    `variance` (output,) is s_c^2. LinAlgError if the points determine nothing.
    """

    def __init__(self, x, y, hyperparameters: Hyperparameters):
        self.x, self.hyperparameters = x, hyperparameters
        self.lengths, self.degree = hyperparameters.lengths, largest_degree(*x.shape)
        self.noise = hyperparameters.noise + JITTER
        basis = trend(x, self.degree)
        _, factor, q, self.r, right, rest = factors(x, y, *hyperparameters[:3], basis)
        self.beta = solve_triangular(self.r, q.T @ right)
        self.weights = solve_triangular(factor, rest, lower=True, trans=1)
        self.variance = (rest**2).sum(axis=0) / max(len(x) - basis.shape[1], 1)
        self.inverse = solve_triangular(factor, np.eye(len(x)), lower=True)
        self.by_trend = cho_solve((factor, True), basis)  # K^-1 H

    def kernel(self, x, other):
        """k (n, m) between points, and its slope: dk/dx = -slope (x - other) / lengths^2."""
        return kernel(self.hyperparameters.kernel, squared_distances(x / self.lengths, other / self.lengths))

    def features(self, x):
        """k (n, point), L^-1 k (n, point), and what the trend leaves open (n, p)."""
        cross, _ = self.kernel(x, self.x)
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
        return self.kernel(x, x)[0] - known @ known.T + open_ @ open_.T

    def slopes(self, x, by_mean, by_variance):
        """Gradient (n, d) of sum_c by_mean_c mean_c + by_variance variance; weights (n, output), (n,)."""
        cross, slope = self.kernel(x, self.x)
        known = (cross @ self.inverse.T) @ self.inverse  # k' K^-1
        basis = trend(x, self.degree)
        open_ = solve_triangular(self.r, (basis - cross @ self.by_trend).T, trans=1)
        open_ = solve_triangular(self.r, open_).T  # (H' K^-1 H)^-1 u
        by_cross = by_mean @ self.weights.T - 2.0 * by_variance[:, None] * (known + open_ @ self.by_trend.T)
        by_basis = by_mean @ self.beta.T + 2.0 * by_variance[:, None] * open_
        a = by_cross * slope
        gradient = (a @ self.x - a.sum(axis=1, keepdims=True) * x) / self.lengths**2
        return gradient + np.einsum("np,npd->nd", by_basis, trend_slope(x, self.degree))


# ---- the response ----


class Coordinates(NamedTuple):
    """Parameters in which the processes are stationary: some by their logarithms, all in spreads of a design.

    `varying` are the numbers of those that vary, the others are left out; `n_parameters` counts all.
    """

    varying: np.ndarray
    logarithmic: np.ndarray
    centre: np.ndarray
    scale: np.ndarray
    n_parameters: int

    @classmethod
    def of(cls, x) -> "Coordinates":
        """Choose the coordinates that suit draws from the prior (point, parameter)."""
        varying = np.flatnonzero(np.ptp(x, axis=0) > CONSTANT * np.abs(x).max(axis=0))
        own = x[:, varying]
        positive = (own > 0).all(axis=0)
        logs = np.log(np.where(positive, own, 1.0))
        logarithmic = positive & (np.abs(skewness(logs)) + POSITIVE_SKEW < np.abs(skewness(own)))
        moved = np.where(logarithmic, logs, own)
        return cls(varying, logarithmic, moved.mean(axis=0), moved.std(axis=0), x.shape[1])

    def __call__(self, x):
        """Points (n, varying)."""
        own = x[:, self.varying]
        with np.errstate(invalid="ignore", divide="ignore"):
            moved = np.where(self.logarithmic, np.log(np.where(self.logarithmic, own, 1.0)), own)
        return (moved - self.centre) / self.scale

    def pulled_back(self, gradient, x):
        """Gradient (n, parameter) by the parameters, of one by the coordinates (n, varying)."""
        result = np.zeros((len(x), self.n_parameters))
        result[:, self.varying] = gradient / self.scale
        result[:, self.varying] /= np.where(self.logarithmic, x[:, self.varying], 1.0)
        return result


def skewness(x):
    """Skewness of each column (n, d)."""
    off = x - x.mean(axis=0)
    spread = off.std(axis=0)
    return ((off / np.where(spread > 0, spread, 1.0)) ** 3).mean(axis=0)


class Comparison(NamedTuple):
    """Data as the emulator sees them: e_j = constant_j - 2 linear_j z + z' quadratic_j z, sensors first."""

    observed: np.ndarray
    constant: np.ndarray
    linear: np.ndarray
    quadratic: np.ndarray
    rest: np.ndarray


class Emulator:
    """Emulator of a response: what runs at x (run, parameter) tell about it elsewhere.

    Responses (run, sensor, time) or (run, sensor) are NaN where a run failed. The hyperparameters of an
    emulator of fewer runs, `before`, are the first guess, or kept without `refit`. `groups` are the
    components of each process.
    """

    def __init__(self, x, responses, coordinates, before=None, refit=True):
        usable = np.isfinite(responses).reshape(len(x), -1).all(axis=1)
        self.x, self.responses, self.usable, self.coordinates = x, responses, usable, coordinates
        self.of_histories = responses.ndim == 3
        points, outputs = coordinates(x[usable]), responses[usable]
        outputs = outputs if self.of_histories else np.log(np.maximum(outputs, 1e-300))[:, :, None]
        self.shape = outputs.shape[1:]
        self.mean = outputs.mean(axis=0)
        deviations = outputs - self.mean
        spread = np.sqrt((deviations**2).mean(axis=(0, 2)))
        self.sensor_scale = np.where(spread > 0, spread, 1.0)[:, None]
        flat = (deviations / self.sensor_scale).reshape(len(points), -1)
        left, sizes, right = np.linalg.svd(flat, full_matrices=False)
        power = np.cumsum(sizes**2) / max((sizes**2).sum(), 1e-300)
        count = min(int(np.searchsorted(power, 1.0 - NEGLECTED)) + 1, len(points) - 1, MOST_COMPONENTS)
        self.basis = right[:count].reshape(count, *self.shape) * self.sensor_scale
        rest = flat - (left[:, :count] * sizes[:count]) @ right[:count]
        self.rest = (rest.reshape(deviations.shape) ** 2).mean(axis=(0, 2)) * self.sensor_scale[:, 0] ** 2
        scores = left[:, :count] * sizes[:count]
        self.groups, first = [], 0
        for width in GROUPS:
            if first < count:
                self.groups.append(slice(first, min(first + width, count)))
            first += width
        self.processes = []
        for i, group in enumerate(self.groups):
            known = before.processes[i].hyperparameters if before and i < len(before.processes) else None
            if known is None or refit:
                known = fit_hyperparameters(points, scores[:, group], known)
            self.processes.append(GaussianProcess(points, scores[:, group], known))
        self.tree = cKDTree(coordinates(x)) if not usable.all() else None
        self._comparison = None

    def predict(self, x):
        """Means and variances (n, component) of the components at points (n, parameter)."""
        points = self.coordinates(x)
        means, variances = [], []
        for process in self.processes:
            mean, variance = process.predict(points)
            means.append(mean)
            variances.append(variance[:, None] * process.variance)
        return np.concatenate(means, axis=1), np.concatenate(variances, axis=1)

    def fails(self, x):
        """Whether a run would fail (n,): where the nearest one has."""
        bad = ~np.isfinite(x).all(axis=1)
        if self.tree is not None and not bad.all():
            _, nearest = self.tree.query(self.coordinates(x[~bad]))
            bad[~bad] = ~self.usable[nearest]
        return bad

    def compared(self, observed) -> Comparison:
        """The data (sensor, time) in terms of components; gaps, NaN, count as no misfit."""
        known = self._comparison
        if known is None or not np.array_equal(known.observed, observed, equal_nan=True):
            measured = ~np.isnan(observed)
            misfit = np.where(measured, observed - self.mean, 0.0)
            basis = (self.basis * measured).transpose(1, 0, 2)
            n = observed.shape[1]
            self._comparison = known = Comparison(
                observed,
                (misfit**2).sum(axis=1) / n,
                np.einsum("sct,st->sc", basis, misfit) / n,
                basis @ basis.transpose(0, 2, 1) / n,
                self.rest * measured.mean(axis=1),
            )
        return known

    @np.errstate(over="ignore", invalid="ignore")  # far out in a prior, where no density will be finite
    def discrepancies(self, z, variances, observed):
        """Expected e_j (n, sensor) of components with these means and variances (n, component)."""
        if not self.of_histories:
            basis = self.basis[:, :, 0]
            return np.exp(self.mean[:, 0] + z @ basis + 0.5 * (variances @ basis**2 + self.rest))
        data = self.compared(observed)
        e = data.constant + data.rest - 2.0 * z @ data.linear.T
        e += variances @ np.diagonal(data.quadratic, axis1=1, axis2=2).T
        for j, quadratic in enumerate(data.quadratic):
            e[:, j] += ((z @ quadratic) * z).sum(axis=1)
        return np.maximum(e, 1e-300)

    def slopes(self, x, by_mean, by_variance):
        """Gradient (n, parameter) of sum_c by_mean_c m_c + by_variance_c v_c, weights (n, component)."""
        points, gradient = self.coordinates(x), 0.0
        for group, process in zip(self.groups, self.processes, strict=True):
            by_unit = by_variance[:, group] @ process.variance
            gradient = gradient + process.slopes(points, by_mean[:, group], by_unit)
        return self.coordinates.pulled_back(gradient, x)

    def discrepancy_slopes(self, x, observed, weights):
        """Gradient (n, parameter) of sum_j weights_j E e_j, weights (n, sensor)."""
        z, variances = self.predict(x)
        if not self.of_histories:
            basis = self.basis[:, :, 0]
            by_log = weights * self.discrepancies(z, variances, observed)
            return self.slopes(x, by_log @ basis.T, 0.5 * by_log @ (basis**2).T)
        data = self.compared(observed)
        by_mean = -2.0 * weights @ data.linear
        for j, quadratic in enumerate(data.quadratic):
            by_mean += 2.0 * weights[:, j, None] * (z @ quadratic)
        return self.slopes(x, by_mean, weights @ np.diagonal(data.quadratic, axis1=1, axis2=2))

    def responses_of(self, z):
        """Histories (n, sensor, time) of components (n, component)."""
        return self.mean + np.einsum("nc,cst->nst", z, self.basis, optimize=True)
