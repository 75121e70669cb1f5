"""The map that unbends a posterior, and proposals behind it."""

import numpy as np
import pytest
from scipy import stats

from pymc_features.smc.proposals import polynomials, unbending
from pymc_features.smc.proposals.fitted import (
    FittedProposal,
    Unbent,
    fit_to,
    fit_unbent,
)
from pymc_features.smc.proposals.unbending import UnbendingMap


def banana(rng, n=3000):
    """a ~ N(1, 1), b = a^2 + noise."""
    a = 1.0 + rng.standard_normal(n)
    return np.column_stack([a, a**2 + 0.3 * rng.standard_normal(n)])


def funnel(rng, n=3000):
    """v ~ N(0, 1.5), and four coordinates with the standard deviation exp(v / 2)."""
    v = 1.5 * rng.standard_normal(n)
    return np.column_stack([v, *(np.exp(0.5 * v) * rng.standard_normal(n) for _ in range(4))])


def skewed(rng, n=3000):
    """A log-gamma variable beside a correlated normal one."""
    x = np.log(rng.gamma(1.5, size=n))
    return np.column_stack([x, 0.5 * x + rng.standard_normal(n)])


SHAPES = {f.__name__: f for f in (banana, funnel, skewed)}
shapes = pytest.mark.parametrize("shape", SHAPES)


def fitted_map(shape, rotated, n=3000):
    x = SHAPES[shape](np.random.default_rng(0), n)
    return UnbendingMap(x, np.ones(n), rotated), x


@shapes
def test_inverse_and_jacobian(shape):
    """There and back, and the determinant of the derivative by differences."""
    mapping, x = fitted_map(shape, rotated=shape != "funnel")
    x = x[:50]
    z, log_jacobian = mapping.forward(x)
    np.testing.assert_allclose(mapping.inverse(z), x, rtol=1e-8, atol=1e-8)
    step = 1e-6
    ends = ([mapping.forward(x + h * e)[0] for e in np.eye(len(x.T))] for h in (step, -step))
    derivative = np.subtract(*ends) / (2.0 * step)
    exact = np.linalg.slogdet(derivative.transpose(1, 2, 0))[1]
    smooth = np.abs(log_jacobian - exact) < 1e-4
    assert smooth.mean() > 0.9, "but for points at the edges of the clipped polynomials"


@shapes
def test_it_unbends(shape):
    """The mapped coordinates of other draws are less dependent, by three measures on their ranks.

    Correlations, and those of squares, are less than half of those of the plain coordinates.
    """
    mapping, _ = fitted_map(shape, rotated=shape == "banana")
    fresh = SHAPES[shape](np.random.default_rng(1), 3000)
    z, _ = mapping.forward(fresh)

    def bent(y):
        y, d = stats.rankdata(y, axis=0) / len(y) - 0.5, y.shape[1]
        between = np.corrcoef(np.hstack([y, y**2, np.abs(y)]).T)
        parts = [between[:d, :d], between[d : 2 * d, :d], between[2 * d :, 2 * d :]]
        return max(np.abs(part - np.diag(np.diag(part))).max() for part in parts)

    assert bent(z) < 0.3
    assert bent(z) < 0.5 * bent(fresh)


def test_a_parabola_between_logits(monkeypatch):
    """Three bananas of bounded parameters, on the scale that is sampled: how many of its draws a fit keeps.

    Parabolas of the logits, the negative control, keep a third of that at most.
    """
    boxes = np.array([[-6.0, 8.0]] * 3 + [[-5.0, 70.0]] * 3).T

    def to_logits(x):
        return np.log((x - boxes[0]) / (boxes[1] - x))

    def log_density(u):
        share = 1.0 / (1.0 + np.exp(-u))
        a, b = np.hsplit(boxes[0] + np.ptp(boxes, axis=0) * share, 2)
        slopes = np.log(np.ptp(boxes, axis=0) * share * (1.0 - share)).sum(axis=1)
        return stats.norm.logpdf(a, 1.0).sum(axis=1) + stats.norm.logpdf(b, a**2, 0.1).sum(axis=1) + slopes

    def share_kept():
        rng = np.random.default_rng(3)
        a = 1.0 + rng.standard_normal((1000, 3))
        proposal = fit_to(to_logits(np.hstack([a, a**2 + 0.1 * rng.standard_normal((1000, 3))])), rng)
        y = proposal.draw(20_000, rng)
        w = np.exp(log_density(y) - proposal.log_density(y))
        return w.sum() ** 2 / (w @ w) / len(w)

    kept = share_kept()
    monkeypatch.setattr(unbending, "affordable", lambda *_: polynomials.PRODUCTS)
    assert kept > 0.08 and kept > 3.0 * share_kept()


@shapes
def test_density_is_normalised(shape):
    """The mean of q / p over draws of a wide p is one within four standard errors (6e-5), by a known p."""
    x = SHAPES[shape](np.random.default_rng(0), 3000)
    proposal = fit_to(x, np.random.default_rng(2))
    wide = stats.multivariate_t(x.mean(axis=0), 4.0 * np.cov(x.T), df=2)
    draws = wide.rvs(200_000, random_state=np.random.default_rng(3))
    ratios = np.exp(proposal.log_density(draws) - wide.logpdf(draws))
    assert abs(ratios.mean() - 1.0) < 4.0 * ratios.std() / np.sqrt(len(ratios))
    assert ratios.std() / np.sqrt(len(ratios)) < 0.05


def changes(proposal, scale, n=30_000):
    """Whether ten moves change the distribution: Kolmogorov-Smirnov of each coordinate at 1e-3 / d."""
    rng = np.random.default_rng(5)
    x, fresh = proposal.draw(n, rng), proposal.draw(n, rng)
    for _ in range(10):
        x = proposal.move(x, scale, rng)
    pairs = zip(x.T, fresh.T, strict=True)
    return min(stats.ks_2samp(a, b).pvalue for a, b in pairs) < 1e-3 / x.shape[1]


class Shifted(Unbent):
    """Moves that come back from the map a little beside where they should."""

    def move(self, x, scale, rng):
        return super().move(x, scale, rng) + 0.05


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1.0, 0.2])
def test_moves_leave_the_proposal_invariant(scale):
    """A false alarm in 1000. The control is noticed where the next point depends on the last."""
    x = banana(np.random.default_rng(0))
    parts = [
        fit_unbent(x, np.ones(len(x)), np.random.default_rng(2)),
        fit_to(x, np.random.default_rng(3)).components[1],
    ]
    assert not changes(FittedProposal(parts, np.array([0.8, 0.2])), scale)
    parts[0] = Shifted(*parts[0])
    if scale < 1.0:
        assert changes(FittedProposal(parts, np.array([0.8, 0.2])), scale)
