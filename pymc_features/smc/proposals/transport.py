"""A map that carries a standard normal distribution to what surrounds a mode, fitted to gradients.

Points of a posterior say where it is bent only once there are more of them than coefficients. A gradient says
as much as there are parameters, and wherever it is taken. With x(z) the map so far, the density that it
pulls back has the score s(z) = d/dz ln [p(x(z)) |dx/dz|], which is -z where the map is right. The residual
s + z is regressed on a constant, z, and products of two axes. Constant and linear terms are the step of
natural gradients to the closest Gaussian (Stein's lemma; Lin, Khan & Schmidt, 2019); the quadratic ones bend
each axis along the wider ones before it, which leaves volumes as they are. A step that does not bring the
Kullback-Leibler divergence down is shortened. At the end the normal distribution is widened by the scatter
of the residual before the last step: a posterior that lies now on one side of the map and now on the other is
wider than the map says.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

DRAWS_PER_PARAMETER, FEWEST_DRAWS = 10, 100  # of a step, with a gradient each
MOST_STEPS = 10
TRIALS = 50  # pairs of draws that compare lengths of a step
LENGTHS_OF_BEND = 1.0, 1.0, 0.5, 0.5, 0.0, 0.2  # of a step, that are compared
LENGTHS_OF_REST = 1.0, 0.0, 1.0, 0.5, 0.5, 0.2  # with these of its shift and stretch
SMALL_GAIN = 0.03  # in the divergence, of a step that is the last
GOOD_SPREAD = 0.7  # standard deviation of the log-density's ratio, below which nothing is left to do
BENT_AXES = 50  # axes at most that others are bent along: the widest
PENALTIES = (0.0, 10.0, 20.0)  # of constant, linear and quadratic terms, over the number of draws
LONGEST, STRETCH = 2.0, (0.3, 6.0)  # of a shift; range of a step's precisions
FAR_OFF, LEAST_WEIGHT = 0.2, -4.0  # draws much below the median count less: power, and its limit


class Stretch(NamedTuple):
    """x = shift + factor z."""

    shift: np.ndarray
    factor: np.ndarray

    def forward(self, x):
        """z (n, d)."""
        return np.linalg.solve(self.factor, (x - self.shift).T).T

    def inverse(self, z):
        """x (n, d)."""
        return self.shift + z @ self.factor.T

    def pull(self, slopes, z):
        """Slopes (n, d) by z of what has these by x(z)."""
        return slopes @ self.factor

    def push(self, slopes, z):
        """Slopes (n, d) by x(z) of what has these by z."""
        return np.linalg.solve(self.factor.T, slopes.T).T

    @property
    def log_volume(self) -> float:
        """ln |dx/dz|."""
        return float(np.linalg.slogdet(self.factor)[1])


class Bend(NamedTuple):
    """x_i = z_i + sum_{j <= k < i} b_ijk (z_j z_k - delta_jk); coefficients b (d, products) as in `products`.

    Volumes stay as they are.
    """

    coefficients: np.ndarray
    log_volume = 0.0

    @property
    def n_axes(self) -> int:
        """Axes that others are bent along."""
        return (int(np.sqrt(8 * self.coefficients.shape[1] + 1)) - 1) // 2

    def forward(self, x):
        """z (n, d), one bent axis after the other."""
        z, s = x.copy(), self.n_axes
        for i in range(1, s):
            known = i * (i + 1) // 2
            z[:, i] -= products(z, i) @ self.coefficients[i, :known]
        z[:, s:] -= products(z, s) @ self.coefficients[s:].T
        return z

    def inverse(self, z):
        """x (n, d)."""
        return z + products(z, self.n_axes) @ self.coefficients.T

    def pull(self, slopes, z):
        """Slopes (n, d) by z of what has these by x(z)."""
        return np.einsum("ni,nij->nj", slopes, self.jacobian(z))

    def push(self, slopes, z):
        """Slopes (n, d) by x(z) of what has these by z."""
        return np.linalg.solve(self.jacobian(z).transpose(0, 2, 1), slopes[:, :, None])[:, :, 0]

    def jacobian(self, z):
        """dx_i / dz_j (n, d, d)."""
        j, k = pairs(self.n_axes)
        result = np.repeat(np.eye(z.shape[1])[None], len(z), axis=0)
        for axis in range(self.n_axes):
            by_first, by_last = j == axis, k == axis
            result[:, :, axis] += z[:, k[by_first]] @ self.coefficients[:, by_first].T
            result[:, :, axis] += z[:, j[by_last]] @ self.coefficients[:, by_last].T
        return result


class Transport(NamedTuple):
    """Steps that follow each other from z to x, the first of them last: x = steps[0](steps[1](... z))."""

    steps: tuple

    def forward(self, x):
        """z (n, d), and ln |dz/dx| (n,)."""
        for step in self.steps:
            x = step.forward(x)
        return x, np.full(len(x), -self.log_volume)

    def inverse(self, z):
        """x (n, d)."""
        for step in reversed(self.steps):
            z = step.inverse(z)
        return z

    @property
    def log_volume(self) -> float:
        """ln |dx/dz|."""
        return sum(step.log_volume for step in self.steps)

    def pull(self, slopes, z):
        """Slopes (n, d) by z of what has these by x(z)."""
        for step, at in zip(self.steps, self.stations(z), strict=True):
            slopes = step.pull(slopes, at)
        return slopes

    def push(self, slopes, z):
        """Slopes (n, d) by x(z) of what has these by z."""
        for step, at in reversed(list(zip(self.steps, self.stations(z), strict=True))):
            slopes = step.push(slopes, at)
        return slopes

    def stations(self, z) -> list:
        """What each step is applied to, for points z (n, d)."""
        places = []
        for step in reversed(self.steps):
            places.append(z)
            z = step.inverse(z)
        return places[::-1]


def pairs(n: int) -> tuple[np.ndarray, np.ndarray]:
    """First and second axis of each product of two of the first n, j <= k, in the order of k."""
    k, j = np.tril_indices(n)
    return j, k


def products(z, n: int):
    """z_j z_k less its mean under a standard normal distribution, of the first n axes (points, products)."""
    j, k = pairs(n)
    return z[:, j] * z[:, k] - (j == k)


def fit_transport(values: Callable, gradient: Callable, start: Transport, rng) -> Transport:
    """Fit a map to gradients taken where it leads draws of a standard normal distribution.

    Parameters
    ----------
    values, gradient : callable
        Log-density (n,) at points (n, d), and that with its gradient (n, d).
    start : Transport
        The map of a Gaussian, its axes sorted by their widths, the widest first.
    rng : numpy.random.Generator

    Returns
    -------
    Transport
        `start` itself, if nothing brings it closer.
    """
    d = len(start.steps[0].shift)
    n = max(FEWEST_DRAWS, DRAWS_PER_PARAMETER * d)
    best, z, scatter = start, paired(TRIALS, d, rng), None
    if spread(values(best.inverse(z)), z) < GOOD_SPREAD:
        return start
    for _ in range(MOST_STEPS):
        z = paired(n // 2, d, rng)
        value, slopes = gradient(best.inverse(z))
        if spread(value, z) < GOOD_SPREAD:
            break
        possible = np.isfinite(value)
        if possible.sum() < n // 2:
            break
        z, ratio = z[possible], value[possible] + 0.5 * (z[possible] ** 2).sum(axis=1)
        weights = np.exp(np.clip(FAR_OFF * (ratio - np.median(ratio)), LEAST_WEIGHT, 0.0))
        residual = best.pull(slopes[possible], z) + z
        weights /= weights.sum()
        scatter = (weights[:, None] * residual).T @ residual
        bend, shift, precision = fit_residual(z, residual, weights)
        lengths = zip(LENGTHS_OF_BEND, LENGTHS_OF_REST, strict=True)
        candidates = [best] + [longer(best, bend, shift, precision, *both) for both in lengths]
        gains = divergence_gains(values, candidates, paired(TRIALS, d, rng))
        chosen = int(np.argmax(gains))
        best = candidates[chosen]
        if gains[chosen] < SMALL_GAIN:
            break
    if best is start:
        return start
    # where the map is a residual off, so is the posterior: its variance is larger by that of the residual
    return Transport((*best.steps, Stretch(np.zeros(d), np.linalg.cholesky(np.eye(d) + scatter))))


def spread(value, z) -> float:
    """Standard deviation of log-densities (n,) over those of the normal draws (n, d) that led there."""
    return float((value + 0.5 * (z**2).sum(axis=1)).std()) if np.isfinite(value).all() else np.inf


def paired(n: int, d: int, rng):
    """Draws of a standard normal distribution and their mirror images (2n, d)."""
    z = rng.standard_normal((n, d))
    return np.concatenate([z, -z])


def fit_residual(z, residual, weights) -> tuple[Bend, np.ndarray, np.ndarray]:
    """Ridge regression of the residual score (n, d): a bend, a shift (d,), and the precision (d, d).

    The bend of an axis is shrunk to the share of the squared residual that it predicts at points left out.
    """
    n, d = z.shape
    s = min(d, BENT_AXES)
    terms = np.hstack([np.ones((n, 1)), z, products(z, s)])
    of_shift, of_line, of_bend = PENALTIES
    penalty = np.repeat(np.array([of_shift, of_line, of_bend]) / n, (1, d, terms.shape[1] - d - 1))
    fit, errors = ridge(terms, residual, weights, penalty)
    straight, straight_errors = ridge(terms[:, : d + 1], residual, weights, penalty[: d + 1])
    gained = np.clip(1.0 - errors / np.maximum(straight_errors, 1e-300), 0.0, 1.0)
    before = pairs(s)[1] < np.arange(d)[:, None]
    linear = straight[1:]
    bend = Bend(np.where(before, gained[:, None] * fit[d + 1 :].T, 0.0))
    return bend, straight[0], np.eye(d) - 0.5 * (linear + linear.T)


def ridge(terms, values, weights, penalty):
    """Coefficients (p, d) of weighted least squares; mean squared errors (d,) at points left out in turn."""
    weighted = weights[:, None] * terms
    inverse = np.linalg.inv(weighted.T @ terms + np.diag(penalty))
    fit = inverse @ (weighted.T @ values)
    leverage = ((terms @ inverse) * weighted).sum(axis=1)
    errors = (values - terms @ fit) / np.maximum(1.0 - leverage, 1e-6)[:, None]
    return fit, weights @ errors**2


def longer(transport: Transport, bend: Bend, shift, precision, of_bend: float, of_rest: float) -> Transport:
    """The map with one more step, of these lengths."""
    eigenvalues, vectors = np.linalg.eigh(precision)
    eigenvalues = np.clip(eigenvalues, *STRETCH)
    move = vectors @ ((vectors.T @ shift) / eigenvalues)
    move *= of_rest * min(1.0, LONGEST / max(np.linalg.norm(move), 1e-300))
    # triangular as the bends are, so that axes stay bent along those before them
    factor = np.linalg.cholesky((vectors / (1.0 + of_rest * (eigenvalues - 1.0))) @ vectors.T)
    steps = (Bend(of_bend * bend.coefficients),) if of_bend else ()
    return Transport((*transport.steps, *steps, Stretch(move, factor)))


def divergence_gains(values, candidates, z) -> np.ndarray:
    """By how much the divergence of each map is smaller than that of the first; -inf where it is infinite."""
    n = len(z)
    points = np.concatenate([candidate.inverse(z) for candidate in candidates])
    reached = np.isfinite(points).all(axis=1)
    logp = np.full(len(points), -np.inf)
    logp[reached] = values(points[reached])
    means = logp.reshape(len(candidates), n).mean(axis=1) + [c.log_volume for c in candidates]
    if not np.isfinite(means[0]):
        return np.where(np.isfinite(means), means, -np.inf)
    return np.where(np.isfinite(means), means - means[0], -np.inf)
