"""The map that unbends a posterior, and proposals behind it."""

import numpy as np
import pytest
from scipy import stats

from pymc_features.smc.proposals import polynomials, unbending
from pymc_features.smc.proposals.fitted import (
    WIDER,
    FittedProposal,
    Unbent,
    fit_proposal,
    fit_to,
    fit_twice_to,
    fit_unbent,
)
from pymc_features.smc.proposals.proposal import fit_mixture
from pymc_features.smc.proposals.scores import NormalScores
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


@pytest.mark.parametrize("rotated", [True, False])
@shapes
def test_inverse_and_jacobian(shape, rotated):
    """There and back, and the determinant of the derivative by differences."""
    mapping, x = fitted_map(shape, rotated)
    x = x[:50]
    z, log_jacobian = mapping.forward(x)
    np.testing.assert_allclose(mapping.inverse(z), x, rtol=1e-8, atol=1e-8)
    step = 1e-6
    derivative = np.array(
        [
            (mapping.forward(x + step * e)[0] - mapping.forward(x - step * e)[0]) / (2.0 * step)
            for e in np.eye(len(x.T))
        ]
    )
    exact = np.linalg.slogdet(derivative.transpose(1, 2, 0))[1]
    smooth = np.abs(log_jacobian - exact) < 1e-4
    assert smooth.mean() > 0.9, "but for points at the edges of the clipped polynomials"


@pytest.mark.parametrize("n_points", [12.0, 30.0, 60.0, 1000.0])
def test_polynomials_of_all_axes_at_once(n_points):
    """The same as axis by axis with `monomials`, from linear ones to powers, and back again."""
    rng, d, n = np.random.default_rng(4), 5, unbending.BATCH + 7
    axes = []
    for k in range(d):
        kind = polynomials.affordable(k, n_points)
        n_terms = [polynomials.monomials(np.zeros((1, k)), of).shape[1] for of in (kind, polynomials.SQUARES)]
        axes.append(polynomials.Axis(kind, *(0.2 * rng.standard_normal(m) for m in n_terms), 0.1 * k))
    of_all, t = polynomials.Polynomials(axes), 2.0 * rng.standard_normal((n, d))
    shift, log_scale = of_all.of_all(t.T)
    for k, axis in enumerate(axes):
        slope = polynomials.monomials(t[:, :k], polynomials.SQUARES) @ axis.slope
        limit = polynomials.MAX_LOG_SCALE
        np.testing.assert_allclose(log_scale[k], axis.level + np.clip(slope, -limit, limit), atol=1e-12)
        np.testing.assert_allclose(
            shift[k], polynomials.monomials(t[:, :k], axis.kind) @ axis.shift, atol=1e-10
        )
    z = (t.T - shift) * np.exp(-log_scale)
    np.testing.assert_allclose(of_all.solved(z), t.T, atol=1e-9)


@shapes
def test_it_unbends(shape):
    """The mapped coordinates of other draws are less dependent, by three measures on their ranks.

    Correlations, and those of squares, are less than half of those of the plain coordinates.
    """
    mapping, _ = fitted_map(shape, rotated=shape == "banana")
    fresh = SHAPES[shape](np.random.default_rng(1), 3000)
    z, _ = mapping.forward(fresh)

    def bent(y):
        y = stats.rankdata(y, axis=0) / len(y) - 0.5
        pairs = [(i, j) for i in range(y.shape[1]) for j in range(y.shape[1]) if i != j]
        linear = max(abs(stats.pearsonr(y[:, i], y[:, j]).statistic) for i, j in pairs)
        square = max(abs(stats.pearsonr(y[:, i] ** 2, y[:, j]).statistic) for i, j in pairs)
        scale = max(abs(stats.pearsonr(np.abs(y[:, i]), np.abs(y[:, j])).statistic) for i, j in pairs)
        return max(linear, square, scale)

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


def test_a_second_map_without_powers():
    """Beside the same first map, which has them; none for one parameter, or where nothing is bent."""
    rng = np.random.default_rng(0)
    x = stats.multivariate_t(np.zeros(5), np.eye(5), df=5).rvs(800, random_state=rng)
    for k in range(1, 5):
        x[:, k] += 0.3 * x[:, k - 1] ** 2
    once, twice = (fit(x, np.random.default_rng(1)) for fit in (fit_to, fit_twice_to))
    first, second, safeguard = twice.components
    np.testing.assert_array_equal(first.log_density(x), once.components[0].log_density(x))
    np.testing.assert_array_equal(safeguard.log_density(x), once.components[1].log_density(x))
    kinds = [{axis.kind for axis in part.map.axes[1:]} for part in (first, second)]
    assert polynomials.POWERS in kinds[0] and polynomials.POWERS not in kinds[1]
    assert first.map.rotated == second.map.rotated and twice.weights.sum() == pytest.approx(1.0)
    bare = fit_twice_to(x[:, :1] ** 3, np.random.default_rng(0))
    assert bare.map is not None and len(bare.components) == 2
    straight = fit_twice_to(rng.standard_normal((60, 5)), np.random.default_rng(0))
    assert straight.map is None and len(straight.components) == 2


def test_points_far_apart_make_a_map():
    """Of eight coordinates, each with the square of the one before, rounding leaves some axes no variance."""
    for seed in range(8):
        x = stats.multivariate_t(np.zeros(8), np.eye(8), df=5).rvs(1600, random_state=seed)
        for k in range(1, 8):
            x[:, k] += 0.2 * x[:, k - 1] ** 2
        z, log_jacobian = UnbendingMap(x, np.ones(1600)).forward(x)
        assert np.isfinite(z).all() and np.isfinite(log_jacobian).all()


@shapes
def test_the_map_is_used_where_it_is_better(shape):
    """Other draws have a higher density behind the map than without."""
    x = SHAPES[shape](np.random.default_rng(0), 3000)
    proposal = fit_proposal(x, np.ones(len(x)), np.random.default_rng(2))
    assert proposal.map is not None
    fresh = SHAPES[shape](np.random.default_rng(1), 3000)
    plain = fit_mixture(x, np.ones(len(x)), np.random.default_rng(2))
    wider = len(x.T) * np.log(WIDER)  # density that its greater width costs at most
    assert proposal.components[0].log_density(fresh).mean() > plain.log_density(fresh).mean() - wider


def test_a_gaussian_needs_no_map():
    """The choice by held-out points may go either way where both are right, by a small difference."""
    x = np.random.default_rng(0).standard_normal((2000, 3)) @ np.array(
        [[1.0, 0.9, 0], [0, 0.4, 0], [0, 0, 2.0]]
    )
    proposal = fit_proposal(x, np.ones(len(x)), np.random.default_rng(2))
    exact = stats.multivariate_normal(np.zeros(3), np.cov(x.T)).logpdf(x)
    assert proposal.log_density(x).mean() > exact.mean() - 0.12


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
@pytest.mark.parametrize("scale", [1.0, 0.5, 0.2])
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


def test_normal_scores():
    """Against SciPy's logistic and normal distributions, far out as well, with the slope by differences."""
    scores = NormalScores([True, False])
    x = np.array([[-700.0, 1.0], [-40.0, 2.0], [-3.0, 3.0], [0.0, 4.0], [5.0, 5.0], [800.0, 6.0]])
    u, log_jacobian = scores.forward(x)
    near = slice(1, 5)
    np.testing.assert_allclose(u[near, 0], stats.norm.ppf(stats.logistic.cdf(x[near, 0])), atol=1e-12)
    np.testing.assert_array_equal(u[:, 1], x[:, 1])
    np.testing.assert_allclose(scores.inverse(u), x, rtol=1e-12)
    slope = (scores.forward(x + 1e-4)[0] - scores.forward(x - 1e-4)[0])[:, 0] / 2e-4
    np.testing.assert_allclose(np.exp(log_jacobian), slope, rtol=1e-5)


def test_far_points_have_no_density_and_stay():
    """What overflows on the way through the map is neither a number that misleads nor an error."""
    x = funnel(np.random.default_rng(0))
    unbent = fit_unbent(x, np.ones(len(x)), np.random.default_rng(2))
    far = np.array([[1e300, 0.0, 0.0, 0.0, 0.0], [0.0, 1e300, -1e300, 0.0, 0.0]])
    assert not (unbent.log_density(far) > -100.0).any()
    moved = unbent.move(far, 0.2, np.random.default_rng(3))
    assert np.isfinite(moved).all()


def test_thin_bends_in_ten_dimensions():
    """Five pairs b = a^2 + 0.1 noise: the map along the parameters finds which of them others follow.

    Behind it half and 95 % of fresh draws lie where those of a normal distribution do, to ten standard errors
    of fits to 2500 points. With the axes in another order they do not.
    """
    rng = np.random.default_rng(0)

    def draws(n):
        a = 1.0 + rng.standard_normal((n, 5))
        return np.hstack([a, a**2 + 0.1 * rng.standard_normal((n, 5))])

    mapping = UnbendingMap(draws(2500), np.ones(2500), rotated=False)
    z, _ = mapping.forward(draws(5000))
    half, most = np.quantile(np.abs(z - np.median(z, axis=0)), [0.5, 0.95], axis=0)
    assert (np.abs(half - 0.674) < 0.1).all()
    assert (np.abs(most - 1.960) < 0.3).all()
    assert set(mapping.vectors.argmax(axis=0)[:5]) == set(range(5))
