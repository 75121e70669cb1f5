r"""An emulator of a whole response: Gaussian processes of its principal components.

Responses g (sensor, time) of the runs so far are scaled by the spread of each sensor and decomposed,

    g(x) = g_0 + sum_c z_c(x) phi_c + rest,

with orthonormal phi_c (singular value decomposition). Each z_c is a Gaussian process of the parameters x;
the rest, beyond the last component that is kept, counts as an error of constant variance for each sensor.
With mean m_c and variance v_c of z_c the expected e_j of Eq. (3) is, exactly,

    E e_j = |y_j - g_0j - sum_c m_c phi_cj|^2 / N + sum_c v_c |phi_cj|^2 / N + rest_j.

A simulator that returns e_j itself is emulated by its logarithm; the expected e_j is that of a log-normal.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from pymc_features.emulation.gaussian_process import GaussianProcess, fit_hyperparameters

NEGLECTED = 1e-7  # share of the variance of all runs that components left out may have
MOST_COMPONENTS = 60
GROUPS = (1, 1, 1, 1, 2, 2, 4, 8, 16, 32)  # components that share a kernel, the largest alone
PREDICTED_AT_ONCE = 2000
CONSTANT = 1e-12  # relative range within which a parameter does not vary
POSITIVE_SKEW = 0.5  # by how much less skewed a logarithm must be to take the place of its parameter


class Coordinates(NamedTuple):
    """Parameters in which the processes are stationary: some by their logarithms, all in spreads of a design.

    Attributes
    ----------
    varying : array of int
        Which parameters vary; the others are left out.
    logarithmic : array of bool (varying,)
    centre, scale : array (varying,)
    n_parameters : int
        Those that do not vary included.
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
    """Emulator of a response: what some runs tell about it elsewhere.

    Parameters
    ----------
    x : array (run, parameter)
    responses : array (run, sensor, time) or (run, sensor)
        NaN where a run failed.
    coordinates : Coordinates
    before : Emulator, optional
        An emulator of fewer runs, whose hyperparameters are the first guess.
    refit : bool
        Or the hyperparameters of `before` are kept.

    Attributes
    ----------
    groups : list of slice
        Components of each process.
    inflation : float
        Multiplies all variances.
    """

    def __init__(self, x, responses, coordinates, before=None, refit=True):
        usable = np.isfinite(responses).reshape(len(x), -1).all(axis=1)
        self.x, self.responses, self.usable, self.coordinates = x, responses, usable, coordinates
        self.of_histories = responses.ndim == 3
        points, outputs = coordinates(x[usable]), responses[usable]
        outputs = outputs if self.of_histories else np.log(np.maximum(outputs, 1e-300))[:, :, None]
        self.shape, self.inflation = outputs.shape[1:], 1.0
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
            variances.append(self.inflation * variance[:, None] * process.variance)
        return np.concatenate(means, axis=1), np.concatenate(variances, axis=1)

    def fails(self, x):
        """Whether a run would fail (n,): where the nearest one has."""
        bad = ~np.isfinite(x).all(axis=1)
        if self.tree is not None and not bad.all():
            _, nearest = self.tree.query(self.coordinates(x[~bad]))
            bad[~bad] = ~self.usable[nearest]
        return bad

    def scores(self, responses):
        """Components (n, component) of responses (n, sensor, time) or (n, sensor)."""
        outputs = responses if self.of_histories else np.log(np.maximum(responses, 1e-300))[:, :, None]
        flat = ((outputs - self.mean) / self.sensor_scale).reshape(len(outputs), -1)
        return flat @ (self.basis / self.sensor_scale).reshape(len(self.basis), -1).T

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
            by_unit = self.inflation * by_variance[:, group] @ process.variance
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
