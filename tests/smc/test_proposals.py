"""Proposals: Student-t mixtures, maps that unbend a posterior, maps fitted to gradients."""

import numpy as np
import pytest
from scipy import stats
from scipy.special import logsumexp

from pymc_features.smc.proposals import unbending
from pymc_features.smc.proposals.proposal import StudentMixture, StudentT, fit_mixture
from pymc_features.smc.proposals.reference import Mode, Reference
from pymc_features.smc.proposals.unbending import (
    FittedProposal,
    UnbendingMap,
    Unbent,
    fit_to,
    fit_unbent,
)
from support.sampling import mean_within_errors


def draws_from(mixture, n, rng):
    """Independent draws by the definition of a mixture of Student-t distributions."""
    chosen = rng.choice(len(mixture.weights), size=n, p=mixture.weights)
    x = np.empty((n, len(mixture.components[0].location)))
    for k, c in enumerate(mixture.components):
        members = (chosen == k).sum()
        noise = rng.standard_normal((members, x.shape[1])) @ c.factor.T
        x[chosen == k] = c.location + noise / np.sqrt(rng.chisquare(c.degrees, members) / c.degrees)[:, None]
    return x


MIXTURE = StudentMixture(
    [
        StudentT(np.array([0.0, 1.0]), np.array([[1.0, 0.0], [0.8, 0.5]]), 3.0),
        StudentT(np.array([3.0, -1.0]), np.array([[0.3, 0.0], [0.0, 1.5]]), 20.0),
    ],
    np.array([0.3, 0.7]),
)


class Independent(StudentT):
    """Draws the mixing variable without regard to x, which is wrong for a short step."""

    def move(self, x, scale, rng):
        root = 1.0 / np.sqrt(rng.chisquare(self.degrees, len(x)) / self.degrees)
        noise = rng.standard_normal(x.shape) @ self.factor.T
        return self.location + np.sqrt(1 - scale**2) * (x - self.location) + scale * root[:, None] * noise


def not_reversible(mixture, scale, n=40_000, moves=20):
    """Whether moves change the mixture, or its pairs before and after one are not exchangeable.

    Kolmogorov-Smirnov of four projections after all moves against independent draws, at 1e-3 / 4 each; and
    pairs (x, x') go as often from low to high density as back, within four standard errors (6e-5 each): a
    false alarm in 600.
    """
    rng = np.random.default_rng(5)
    x = y = draws_from(MIXTURE, n, rng)
    fresh = draws_from(MIXTURE, n, rng)
    levels = np.quantile(MIXTURE.log_density(fresh), [0.01, 0.05, 0.3, 0.6])
    first = mixture.move(x, scale, rng)
    a, b = (np.searchsorted(levels, MIXTURE.log_density(z)) for z in (x, first))
    flux = [(a == i) * (b == j) * 1.0 - (a == j) * (b == i) for i in range(5) for j in range(i)]
    for _ in range(moves):
        y = mixture.move(y, scale, rng)
    directions = np.array([[1.0, 0.0, 1.0, 1.0], [0.0, 1.0, 1.0, -1.0]])
    pairs = zip((y @ directions).T, (fresh @ directions).T, strict=True)
    changed = min(stats.ks_2samp(a, b).pvalue for a, b in pairs) < 1e-3 / 4
    return changed, not all(mean_within_errors(values) for values in flux if values.any())


@pytest.mark.parametrize("scale", [1.0, 0.3])
def test_move_leaves_the_mixture_invariant(scale):
    assert not_reversible(MIXTURE, scale) == (False, False)
    x = draws_from(MIXTURE, 1000, np.random.default_rng(0))
    y = MIXTURE.move(x, scale, np.random.default_rng(1))
    assert (abs(stats.spearmanr(x[:, 0], y[:, 0]).statistic) < 0.15) == (scale == 1.0)


def test_a_wrong_move_is_noticed():
    parts = [Independent(c.location, c.factor, c.degrees) for c in MIXTURE.components]
    assert not_reversible(StudentMixture(parts, MIXTURE.weights), 0.3) == (True, True)


def test_density_is_scipys():
    x = draws_from(MIXTURE, 50, np.random.default_rng(0))
    exact = [
        np.log(w) + stats.multivariate_t(c.location, c.factor @ c.factor.T, c.degrees).logpdf(x)
        for c, w in zip(MIXTURE.components, MIXTURE.weights, strict=True)
    ]
    np.testing.assert_allclose(MIXTURE.log_density(x), logsumexp(exact, axis=0), rtol=1e-10)


def fit(x):
    return fit_mixture(x, np.ones(len(x)), np.random.default_rng(0))


def test_fit_finds_two_components():
    """Density of a mixture within 0.02 of the truth on average: ten times the error of a fit of that size."""
    x = draws_from(MIXTURE, 4000, np.random.default_rng(3))
    check = draws_from(MIXTURE, 4000, np.random.default_rng(4))
    gap = MIXTURE.log_density(check) - fit(x).log_density(check)
    assert abs(gap.mean()) < 0.02


def test_fit_of_few_points():
    """Fewer points than parameters are fitted, however roughly; points without a spread are refused."""
    x = np.random.default_rng(0).normal(size=(15, 20))
    assert np.isfinite(fit(x).log_density(x)).all()
    with pytest.raises(
        ValueError, match="must differ in every parameter, got a variance of 0. Increase `draws`"
    ):
        fit(np.ones((10, 2)))


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
    monkeypatch.setattr(unbending, "affordable", lambda *_: unbending.PRODUCTS)
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


class Bananas:
    """Pairs (a, b) of a normal a and b = a^2 / 4 + noise, like two springs between neighbouring sensors."""

    def __init__(self, n_pairs, noise=0.3):
        self.n, self.noise = n_pairs, noise

    def values(self, x):
        return self.gradients(x)[0]

    def gradients(self, x):
        a, b = x[:, : self.n], x[:, self.n :]
        rest = (b - 0.25 * a**2) / self.noise
        value = -0.5 * (a**2 + rest**2).sum(axis=1) - x.shape[1] / 2 * np.log(2.0 * np.pi)
        slope = np.hstack([-a + 0.5 * a * rest / self.noise, -rest / self.noise])
        return value - self.n * np.log(self.noise), slope

    def reference(self) -> Reference:
        """Laplace's approximation at the mode 0."""
        factor = np.diag(np.repeat([1.0, self.noise], self.n))
        d = 2 * self.n
        return Reference([Mode(np.zeros(d), factor, 0.0, 1)], np.zeros(d), np.ones(d))


def efficiency(reference, target, n=4000):
    """Effective share of draws from what stands at the modes, and the evidence from them."""
    x = reference.mixture.draw(n, np.random.default_rng(6))
    log_weights = target.values(x) - reference.mixture.log_density(x)
    w = np.exp(log_weights - log_weights.max())
    return w.sum() ** 2 / (w @ w) / n, np.log(w.mean()) + log_weights.max()


def test_bananas_become_straight():
    """Laplace's approximation keeps a hundredth of 4,000 draws, the map a third; evidence within 0.1."""
    target = Bananas(10)
    laplace = target.reference()
    bent = laplace.bent(target, np.random.default_rng(7))
    before, _ = efficiency(laplace, target)
    after, evidence = efficiency(bent, target)
    assert before < 0.02 and after > 0.3, (before, after)
    assert abs(evidence) < 0.1


def test_slopes_of_the_reference():
    """Its gradient, which trajectories from it follow, against differences."""
    target, d = Bananas(8), 16
    reference = target.reference().bent(target, np.random.default_rng(7))
    assert reference.maps[0] is not None
    x = 0.3 * np.random.default_rng(8).normal(size=(20, d)) * np.repeat([1.0, target.noise], 8)

    def density(x):
        return reference.log_density(x, -0.5 * (x**2).sum(axis=1))

    h = 1e-6
    expected = np.stack([(density(x + h * e) - density(x - h * e)) / (2.0 * h) for e in np.eye(d)], axis=1)
    found = reference.gradient(x, -0.5 * (x**2).sum(axis=1), -x)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())
