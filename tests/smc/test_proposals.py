"""The pool of `PersistentSMC` and its proposal: weights, evidences, fits, and moves that keep a mixture."""

import numpy as np
import pytest
from scipy import stats
from scipy.special import logsumexp

from pymc_features.smc.kernels import persistent
from pymc_features.smc.proposals import proposal
from pymc_features.smc.proposals.mixture import Pool, bennett, next_beta
from pymc_features.smc.proposals.proposal import StudentMixture, StudentT, fit_mixture
from support.sampling import mean_within_errors

pytestmark = pytest.mark.usefixtures("fast_compile")


def pool_of(rng, n=200, with_impossible=True):
    """A pool of three temperatures with masses, and log evidences that are a first guess."""
    x = rng.normal(size=(n, 2))
    likelihood = -3.0 * ((x - 1.0) ** 2).sum(axis=1)
    if with_impossible:
        likelihood[::4] = -np.inf
    pool = Pool(x, np.zeros(n), likelihood)
    for beta, log_z in ((0.2, -1.0), (0.7, -2.5)):
        pool.add_temperature(beta, log_z)
        y = rng.normal(1.0, 0.5, size=(80, 2))
        pool.add(
            y, np.zeros(80), -3.0 * ((y - 1.0) ** 2).sum(axis=1), rng.random(80) + 0.3, 1.0, np.arange(80)
        )
        pool.counts[-1] += 60.0
    return pool


def brute_weights(pool, beta):
    """The formula of the module, one point at a time."""
    shares = np.array(pool.counts) / sum(pool.counts)
    return [
        np.exp(beta * lik)
        / sum(s * np.exp(b * lik) / np.exp(z) for s, b, z in zip(shares, pool.betas, pool.log_z, strict=True))
        for lik in pool.log_likelihood
    ]


def test_weights_and_evidence_are_the_formula():
    pool = pool_of(np.random.default_rng(0))
    assert len(pool.mass) == 150 + 160 and pool.counts == [200.0, 60.0, 60.0]
    for beta in (0.0, 0.1, 0.7, 1.0):
        weights = brute_weights(pool, beta)
        np.testing.assert_allclose(np.exp(pool.log_weights(beta)), weights, rtol=1e-12)
        log_z = pool.log_evidence(pool.log_weights(beta))
        assert log_z == pytest.approx(np.log(np.dot(pool.mass, weights) / 320.0), rel=1e-12)


def test_bennett_is_the_fixed_point():
    """Against rounds of Z_s = Z(beta_s) until nothing changes, impossible points included as they are."""
    pool = pool_of(np.random.default_rng(1))
    likelihood = np.concatenate([pool.log_likelihood, np.full(50, -np.inf)])
    mass = np.concatenate([pool.mass, np.ones(50)])
    betas, counts, log_z = np.array(pool.betas), np.array(pool.counts), np.zeros(3)
    energies = np.where(betas[:, None] > 0, np.multiply.outer(np.maximum(betas, 1e-30), likelihood), 0.0)
    change = 1.0
    while change > 1e-12:
        mixture = logsumexp(energies - log_z[:, None], axis=0, b=counts[:, None])
        new = logsumexp(energies - mixture, axis=1, b=mass)
        change, log_z[1:] = np.abs(new - log_z)[1:].max(), new[1:]
    found = bennett(betas, pool.log_z, counts, pool.log_likelihood, pool.mass)
    np.testing.assert_allclose(found, log_z, atol=1e-7)
    pool.solve()
    np.testing.assert_allclose(pool.log_z, log_z, atol=1e-7)
    assert np.abs(log_z - [0.0, -1.0, -2.5]).max() > 0.1, "the first guess was another"


def test_next_beta_keeps_the_effective_number():
    """At the temperature found, Kish's number is the target; of likelihoods of any scale."""
    for scale in (1.0, 1e8, 1e-2):
        rng = np.random.default_rng(2)
        pool = Pool(rng.normal(size=(400, 1)), np.zeros(400), -scale * rng.exponential(size=400) ** 2 * 30)
        beta = next_beta(pool, 0.0, 150.0)
        weights = np.exp(beta * (pool.log_likelihood - pool.log_likelihood.max()))
        kish = weights.sum() ** 2 / (weights**2).sum()
        assert 0.0 < beta <= 1.0
        assert kish == pytest.approx(150.0, rel=1e-2) if beta < 1.0 else kish >= 150.0
    assert next_beta(pool, 0.0, 1.0) == 1.0
    flat = Pool(np.zeros((10, 1)), np.zeros(10), np.where(np.arange(10) < 2, -7.0, -np.inf))
    assert next_beta(flat, 0.0, 150.0) == 1.0


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


def test_fit_recovers_a_student_t(monkeypatch):
    """Location, scatter and degrees of freedom within five standard errors of 5000 draws."""
    monkeypatch.setattr(proposal, "MAX_COMPONENTS", 1)
    true = StudentT(np.array([2.0, -1.0, 0.5]), np.linalg.cholesky(np.eye(3) + 0.5), 5.0)
    x = draws_from(StudentMixture([true], np.ones(1)), 5000, np.random.default_rng(3))
    [found] = fit(x).components
    np.testing.assert_allclose(found.location, true.location, atol=5 * 1.4 / np.sqrt(5000))
    np.testing.assert_allclose(found.factor @ found.factor.T, np.eye(3) + 0.5, atol=5 * 2.5 / np.sqrt(5000))
    assert 3.9 < found.degrees < 6.5


def test_fit_finds_two_components():
    """Density of a mixture within 0.02 of the truth on average: ten times the error of a fit of that size."""
    x = draws_from(MIXTURE, 4000, np.random.default_rng(3))
    check = draws_from(MIXTURE, 4000, np.random.default_rng(4))
    gap = MIXTURE.log_density(check) - fit(x).log_density(check)
    assert abs(gap.mean()) < 0.02


def test_fit_has_no_scale_of_its_own():
    """In other units, and far narrower, the same fit."""
    x = draws_from(MIXTURE, 500, np.random.default_rng(3))
    units = np.array([1e-9, 1e4])
    expected = fit(x).log_density(x) - np.log(units).sum()
    np.testing.assert_allclose(fit(x * units).log_density(x * units), expected, rtol=1e-6)


def test_fit_of_few_points():
    """Fewer points than parameters are fitted, however roughly; points without a spread are refused."""
    x = np.random.default_rng(0).normal(size=(15, 20))
    assert np.isfinite(fit(x).log_density(x)).all()
    with pytest.raises(
        ValueError, match="must differ in every parameter, got a variance of 0. Increase `draws`"
    ):
        fit(np.ones((10, 2)))


def test_equal_draws_are_systematic():
    """Each position as often as its weight says, up to one; in random order."""
    weights = np.random.default_rng(0).dirichlet(np.ones(50))
    chosen = persistent.equal_draws(weights, 1000, np.random.default_rng(1))
    assert np.abs(np.bincount(chosen, minlength=50) - 1000 * weights).max() < 1.0
    assert abs(stats.spearmanr(np.arange(1000), chosen).statistic) < 0.15
