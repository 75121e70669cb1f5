"""Climbs to the modes of a density, and the first guess of a posterior that stands there."""

import numpy as np
import pytest
from scipy import optimize, stats

from pymc_features.smc.proposals import reference
from pymc_features.smc.proposals.proposal import log_sum
from pymc_features.smc.proposals.reference import curvature, find_reference


def rosenbrock(x):
    """Minus the function, and its gradient, of points (n, d)."""
    return -np.array([optimize.rosen(p) for p in x]), -np.array([optimize.rosen_der(p) for p in x])


def test_curvature_is_the_hessian():
    """Of scales six orders apart, to 1e-4 of each element's own."""
    deviations = np.array([1e-3, 1.0, 0.05])
    hessian = np.linalg.inv(np.diag(deviations) @ (np.eye(3) + 0.5) @ np.diag(deviations))

    def density(x):
        value = -0.5 * np.einsum("ni,ij,nj->n", x, hessian, x) + x[:, 0] ** 4
        return value, -x @ hessian + np.array([4.0, 0.0, 0.0]) * x**3

    found = curvature(density, np.zeros(3))
    np.testing.assert_allclose(found, hessian, rtol=1e-4, atol=1e-4 * np.abs(hessian).max() * 1e-3)


class Target:
    """Two Gaussians of given weights under a wide normal prior, in d dimensions."""

    n_gradients = 0

    def __init__(self, weights=(0.1, 0.9), d=3, sd=0.3):
        self.weights, self.d, self.sd = np.log(weights), d, sd
        self.centres = np.array([np.full(d, -2.0), np.full(d, 2.0)])
        self.rng = np.random.default_rng(7)

    def log_prior(self, x):
        return stats.norm(0.0, 3.0).logpdf(x).sum(axis=1)

    def values(self, x):
        return self.gradients(x)[0]

    def gradients(self, x):
        self.n_gradients += len(x)
        parts = stats.norm(self.centres[:, None], self.sd).logpdf(x).sum(axis=2)
        value = log_sum(terms := self.weights[:, None] + parts)
        slopes = np.exp(terms - value)[..., None] * (self.centres[:, None] - x) / self.sd**2
        return value, slopes.sum(axis=0)

    def draw_prior(self, n):
        return 3.0 * self.rng.standard_normal((n, self.d))

    def reference(self):
        return find_reference(self, 1000)


def test_both_modes_are_found_with_their_evidences():
    """Of separate Gaussians Laplace's formula is exact: their weights, to 1 % of a logarithm.

    The reference's evidence is one, within four standard errors (6e-5); more than a third of its draws count.
    """
    target = Target()
    found = target.reference()
    modes = sorted(found.modes, key=lambda mode: mode.log_evidence)
    assert len(modes) == 2
    assert modes[1].log_evidence - modes[0].log_evidence == pytest.approx(np.log(9.0), abs=0.01)
    np.testing.assert_allclose(np.sort(found.peaks[:, 0]), [-2.0, 2.0], atol=0.05)
    assert sum(mode.n_climbs for mode in modes) >= 2 * reference.CLIMBS_PER_MODE
    evidence, error, efficiency = evidence_and_efficiency(found, target)
    assert abs(evidence) < 4.0 * error < 0.05
    assert efficiency > 0.35


def evidence_and_efficiency(found, target, n=20_000):
    """Log evidence by importance sampling, its standard error, and the effective share of the draws."""
    rng = np.random.default_rng(3)
    x = found.draw(n, target.draw_prior, rng)
    weights = np.exp(target.values(x) - found.log_density(x, target.log_prior(x)))
    mean = weights.mean()
    return np.log(mean), weights.std() / mean / np.sqrt(n), weights.sum() ** 2 / (weights**2).sum() / n


def test_the_prior_has_its_share(monkeypatch):
    """It draws from a mode that no climb has found; without it the evidence is wrong."""
    target = Target(weights=(0.5, 0.5), d=1, sd=0.05)
    found = target.reference()
    one = reference.Reference(found.modes[:1], found.centre, found.scale)
    evidence, error, _ = evidence_and_efficiency(one, target, 200_000)
    assert abs(evidence) < 4.0 * error < 0.3
    monkeypatch.setattr(reference, "PRIOR_SHARE", 1e-12)
    evidence, _, _ = evidence_and_efficiency(one, target, 200_000)
    assert evidence < -0.4


class Spike(Target):
    """Eight values x ~ N(0, e^v) around zero, v logistic: the density grows without bound as v falls."""

    def __init__(self):
        self.d, self.rng = 9, np.random.default_rng(2)

    def gradients(self, points):
        v, x = points[:, 0], points[:, 1:]
        squares = (x**2).sum(axis=1) * np.exp(-2.0 * v)
        value = -0.5 * squares - 8.0 * v + v - 2.0 * np.logaddexp(0.0, v)
        slope = squares - 7.0 - 2.0 / (1.0 + np.exp(-v))
        return value, np.column_stack([slope, -x * np.exp(-2.0 * v)[:, None]])

    def draw_prior(self, n):
        v = self.rng.logistic(size=n)
        return np.column_stack([v, np.exp(v)[:, None] * self.rng.standard_normal((n, 8))])


def test_ends_in_a_spike_are_no_maxima():
    found = Spike().reference()
    assert len(found.modes) > 0
    assert not any(mode.is_maximum for mode in found.modes)


class Valley(Target):
    """Rosenbrock's function: climbs stop along the bent ridge, all of which lead to one maximum."""

    def __init__(self):
        self.d, self.rng = 2, np.random.default_rng(2)

    def gradients(self, x):
        self.n_gradients += len(x)
        return rosenbrock(x)


def test_ends_along_a_ridge_are_counted_at_the_maximum_that_they_lead_to():
    found = Valley().reference()
    maxima = [mode for mode in found.modes if mode.is_maximum]
    assert len(found.modes) > len(maxima) == 1
    np.testing.assert_allclose(found.centre + found.scale * maxima[0].x, [1.0, 1.0], atol=0.05)
    assert maxima[0].n_climbs > 1.5 * reference.WAVE
