"""A mixture of Student-t distributions fitted to weighted points, and moves that leave it invariant."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import brentq
from scipy.special import digamma, gammaln

from pymc_features.exceptions import NoSpreadError

RELATIVE_JITTER = 1e-9
DEGREES = (2.5, 200.0)  # range of the degrees of freedom; the upper end is as good as a Gaussian
ITERATIONS = 40
MAX_COMPONENTS = 4
POINTS_PER_PARAMETER = 10  # of a component: location, scatter, weight


def log_sum(terms: np.ndarray) -> np.ndarray:
    """ln sum exp over the first axis, without SciPy's overhead."""
    top = terms.max(axis=0)
    return top + np.log(np.exp(terms - top).sum(axis=0))


@dataclass(frozen=True, eq=False)
class StudentT:
    """Location (d,), lower Cholesky factor (d, d) of the scatter matrix, and degrees of freedom."""

    location: np.ndarray
    factor: np.ndarray
    degrees: float

    @cached_property
    def inverse_factor(self) -> np.ndarray:
        """Inverse of the factor, transposed: one small matrix product is faster than solving each time."""
        return np.linalg.inv(self.factor).T

    def squared_distance(self, x) -> np.ndarray:
        """(x - mu)' Sigma^-1 (x - mu) of points (n, d), shape (n,)."""
        return (((x - self.location) @ self.inverse_factor) ** 2).sum(axis=1)

    def log_density(self, x) -> np.ndarray:
        """Log-density at points (n, d), shape (n,)."""
        d, v = len(self.location), self.degrees
        constant = gammaln(0.5 * (v + d)) - gammaln(0.5 * v) - 0.5 * d * np.log(v * np.pi)
        constant -= np.log(np.diag(self.factor)).sum()
        return constant - 0.5 * (v + d) * np.log1p(self.squared_distance(x) / v)

    def gradient(self, x) -> np.ndarray:
        """Gradient of the log-density at points (n, d), shape (n, d)."""
        scaled = (x - self.location) @ self.inverse_factor
        shrunk = (self.degrees + x.shape[1]) / (self.degrees + (scaled**2).sum(axis=1))
        return -shrunk[:, None] * (scaled @ self.inverse_factor.T)

    def move(self, x, scale: float, rng: np.random.Generator) -> np.ndarray:
        """Points (n, d) such that pairs (x, x') are exchangeable where x has this distribution.

        Given the mixing variable Z of the t distribution, x and
        x' = mu + sqrt(1 - rho^2) (x - mu) + rho sqrt(Z) xi are a stationary Gaussian pair: t-preconditioned
        Crank-Nicolson (Grumitt, Karamanis & Seljak, 2024). With rho = 1, Z is drawn independently as well.
        """
        n, d = x.shape
        if scale < 1.0:
            shape, rate = 0.5 * (self.degrees + d), 0.5 * (self.degrees + self.squared_distance(x))
        else:
            shape = rate = 0.5 * self.degrees
        root = np.sqrt(rate / rng.gamma(shape, size=n))
        noise = rng.standard_normal((n, d)) @ self.factor.T
        kept = np.sqrt(1.0 - scale**2)
        return self.location + kept * (x - self.location) + scale * root[:, None] * noise


@dataclass(frozen=True, eq=False)
class Mixture:
    """Densities that can be evaluated and moved in, and their weights (k,)."""

    components: list
    weights: np.ndarray

    def terms(self, x) -> np.ndarray:
        """Log of weight times density of each component, shape (k, n)."""
        return np.array([c.log_density(x) for c in self.components]) + np.log(self.weights)[:, None]

    def log_density(self, x) -> np.ndarray:
        """Log-density at points (n, d), shape (n,)."""
        return log_sum(self.terms(x))

    def gradient(self, x) -> np.ndarray:
        """Gradient of the log-density at points (n, d), shape (n, d): the components', by their shares."""
        terms = self.terms(x)
        share = np.exp(terms - log_sum(terms))
        return sum(s[:, None] * c.gradient(x) for s, c in zip(share, self.components, strict=True))

    def move(self, x, scale: float, rng: np.random.Generator) -> np.ndarray:
        """Propose points whose acceptance needs this mixture's density at both ends only.

        A component is drawn given x, and x moves within it, which leaves the mixture invariant. With scale
        1 the component does not depend on x either: the proposal is an independent draw.
        """
        if scale < 1.0:
            terms = self.terms(x)
            share = np.exp(terms - log_sum(terms))
        else:
            share = np.broadcast_to(self.weights[:, None], (len(self.weights), len(x)))
        chosen = (rng.random(len(x)) > np.cumsum(share, axis=0)[:-1]).sum(axis=0)
        proposal = np.empty_like(x)
        for k, component in enumerate(self.components):
            members = chosen == k
            proposal[members] = component.move(x[members], scale, rng)
        return proposal

    @property
    def location(self) -> np.ndarray:
        """A point (d,) inside: that of the last component."""
        return self.components[-1].location

    def draw(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Independent draws (n, d)."""
        return self.move(np.repeat(self.location[None], n, axis=0), 1.0, rng)


class StudentMixture(Mixture):
    """A mixture of `StudentT` distributions."""


def distinct(points):
    """Distinct points of equally weighted ones (n, d), and how often each is there.

    In the order of their coming, not sorted by value, lest a fit depend on it.
    """
    points, first, counts = np.unique(points, axis=0, return_index=True, return_counts=True)
    order = np.argsort(first)
    return points[order], counts[order]


def fit_mixture(x, weights, rng: np.random.Generator) -> StudentMixture:
    """Maximum-likelihood fit to distinct points (n, d) with weights (n,), by expectation and maximisation.

    As many components, up to four, as the number of points allows; one that shrinks to a few points is
    given up. Scatter matrices are regularised relative to their own diagonals, for posteriors may be
    narrow.
    """
    n, d = x.shape
    weights = weights / weights.sum()
    size = 1 + d + d * (d + 1) // 2
    n_components = int(np.clip(n // (POINTS_PER_PARAMETER * size), 1, MAX_COMPONENTS))
    share = weights * first_shares(x, n_components, rng)
    components = [StudentT(*moments(x, r, r), degrees=10.0) for r in share]
    mixture = StudentMixture(components, share.sum(axis=1))
    last = -np.inf
    for _ in range(ITERATIONS):
        terms = mixture.terms(x)
        total = log_sum(terms)
        share = weights * np.exp(terms - total)
        carried = share.sum(axis=1) ** 2 / (share**2).sum(axis=1)
        kept = [k for k in range(len(share)) if carried[k] >= 2 * (d + 1)] or [int(carried.argmax())]
        components = [updated(mixture.components[k], x, share[k]) for k in kept]
        amounts = share[kept].sum(axis=1)
        mixture = StudentMixture(components, amounts / amounts.sum())
        mean = weights @ total
        if len(kept) == len(share) and mean - last < 1e-3:
            break
        last = mean
    return mixture


def first_shares(x, n_components, rng):
    """Each point's share of each component (k, n): nearest of centres that are far from each other."""
    spread = x.std(axis=0)
    scaled = (x - x.mean(axis=0)) / np.where(spread > 0, spread, 1.0)
    centres = scaled[[rng.integers(len(x))]]
    for _ in range(n_components - 1):
        distance = ((scaled[:, None] - centres) ** 2).sum(axis=2).min(axis=1)
        if not distance.any():
            break
        centres = np.vstack([centres, scaled[rng.choice(len(x), p=distance / distance.sum())]])
    nearest = ((scaled[:, None] - centres) ** 2).sum(axis=2).argmin(axis=1)
    share = np.full((len(centres), len(x)), 0.1 / len(centres))
    share[nearest, np.arange(len(x))] += 0.9
    return share


def updated(component, x, share) -> StudentT:
    """One step of expectation and maximisation for a component that has these shares (n,) of the points."""
    d = x.shape[1]
    weights = share / share.sum()
    u = (component.degrees + d) / (component.degrees + component.squared_distance(x))
    location, factor = moments(x, weights, weights * u)
    return StudentT(location, factor, best_degrees(weights, u, component.degrees, d))


def moments(x, weights, scatter_weights):
    """Location (d,) and the Cholesky factor of the scatter (d, d), kept positive definite."""
    location = scatter_weights @ x / scatter_weights.sum()
    centred = x - location
    scatter = (scatter_weights[:, None] * centred).T @ centred / weights.sum()
    variances = np.diag(scatter).copy()
    if not (np.isfinite(variances).all() and (variances > 0).all()):
        raise NoSpreadError(
            "the particles of a stage must differ in every parameter, got a variance of "
            f"{variances.min():g}. Increase `draws` or `stage_draws`: too few were inside the posterior."
        )
    jitter = RELATIVE_JITTER
    while True:
        try:
            return location, np.linalg.cholesky(scatter + jitter * np.diag(variances))
        except np.linalg.LinAlgError:  # fewer points than parameters
            jitter *= 100.0


def best_degrees(weights, u, degrees, d):
    """Degrees of freedom that maximise the expected log-likelihood, given the last ones and their u."""
    constant = 1.0 + weights @ (np.log(u) - u) + digamma(0.5 * (degrees + d)) - np.log(0.5 * (degrees + d))

    def slope(v):
        return np.log(0.5 * v) - digamma(0.5 * v) + constant

    low, high = DEGREES
    if slope(low) <= 0:
        return low
    if slope(high) >= 0:
        return high
    return brentq(slope, low, high, xtol=1e-2)
