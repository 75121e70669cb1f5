"""Proposals: fits of Student-t mixtures, and moves that keep one."""

import numpy as np
import pytest
from scipy import stats
from scipy.special import logsumexp

from pymc_features.smc.proposals.proposal import StudentMixture, StudentT, fit_mixture
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
