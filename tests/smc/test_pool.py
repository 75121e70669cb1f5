"""The pool of `PersistentSMC`: weights, evidences, what they are worth; its reference and its last draws."""

import functools

import numpy as np
import pymc as pm
import pytest
from arviz_stats.base import array_stats
from scipy import stats
from scipy.special import logsumexp

from pymc_features.smc import PersistentSMC
from pymc_features.smc.kernels import persistent
from pymc_features.smc.proposals import pool as pool_module
from pymc_features.smc.proposals.pool import QUANTILES, Pool, pareto_tail
from pymc_features.smc.proposals.reference import Mode, Reference
from support.sampling import log_add


class Normal:
    """A proposal: independent normal coordinates."""

    def __init__(self, mean, sd):
        self.mean, self.sd = mean, sd

    def log_density(self, x):
        return stats.norm(self.mean, self.sd).logpdf(x).sum(axis=1)


def log_prior(x):
    return stats.norm.logpdf(x).sum(axis=1)


def log_likelihood(x):
    return -3.0 * ((x - 1.0) ** 2).sum(axis=1)


def pool_of(rng, n=200):
    """The prior with impossible draws, two temperatures with masses of chains, and a proposal."""
    x = rng.normal(size=(n, 2))
    ratio = log_likelihood(x)
    ratio[::4] = -np.inf
    pool = Pool(x, log_prior(x), ratio)
    for beta, log_z in ((0.2, -1.0), (0.7, -2.5)):
        pool.add_density(beta, log_z)
        y = rng.normal(1.0, 0.5, size=(80, 2))
        first = len(pool.visits)
        columns = (y, log_prior(y), log_likelihood(y), rng.random(80) + 0.3, np.arange(80))
        pool.add(*columns, len(pool.betas) - 1)
        pool.inflation[first:] = 2.5
    pool.add_proposal(Normal(0.8, 0.6))
    y = rng.normal(0.8, 0.6, size=(100, 2))
    pool.add_draws(y, log_prior(y), np.where(y[:, 0] > 2.0, -np.inf, log_likelihood(y)), 3)
    return pool


def brute_force(pool):
    """ln p_s over the reference (s, n), one point at a time."""
    proposal = Normal(0.8, 0.6).log_density(pool.particles) - log_prior(pool.particles)
    return np.array([proposal if np.isnan(b) else b * log_likelihood(pool.particles) for b in pool.betas])


def test_weights_and_evidence_are_the_formula():
    """Deterministic mixture of all densities, impossible draws counted, masses over the steps of a draw."""
    pool = pool_of(np.random.default_rng(0))
    masses = [pool.mass[pool.source == s].sum() for s in range(4)]
    np.testing.assert_allclose(pool.mass, pool.visits / np.where(np.isin(pool.source, (1, 2)), 2.5, 1.0))
    counts = [200.0, *masses[1:3], 100.0]
    np.testing.assert_allclose(pool.counts, counts)
    mixture = logsumexp(
        brute_force(pool) - np.array(pool.log_z)[:, None], axis=0, b=np.array(counts)[:, None]
    )
    for beta in (0.0, 0.1, 0.7, 1.0):
        weights = np.exp(beta * log_likelihood(pool.particles) - mixture) * sum(counts)
        np.testing.assert_allclose(np.exp(pool.log_weights(beta)), weights, rtol=1e-10)
        expected = np.log(np.dot(pool.mass, weights) / sum(counts))
        assert pool.log_evidence(pool.log_weights(beta)) == pytest.approx(expected, rel=1e-10)


def test_bennett_is_the_fixed_point():
    """Against rounds of Z_s = Z(beta_s) for the tempered densities until nothing changes."""
    pool = pool_of(np.random.default_rng(1))
    terms, log_z = brute_force(pool), np.zeros(4)
    change = 1.0
    while change > 1e-12:
        mixture = logsumexp(terms - log_z[:, None], axis=0, b=pool.counts[:, None])
        new = logsumexp(terms - mixture, axis=1, b=pool.mass)
        change, log_z[1:3] = np.abs(new - log_z)[1:3].max(), new[1:3]
    before = np.array(pool.log_z)
    pool.solve()
    np.testing.assert_allclose(pool.log_z, log_z, atol=1e-7)
    assert np.abs(log_z - before).max() > 0.1, "the first guess was another"


def fitted_pool(rng, d=4, n=80):
    """Draws of a reference twice as wide as a standard normal target, and of a normal fit to them."""
    x = rng.normal(0.0, 2.0, size=(n, d))
    reference = stats.norm(0.0, 2.0).logpdf(x).sum(axis=1)
    pool = Pool(x, reference, log_prior(x) - reference)
    weights = pool.normalised(pool.log_weights(1.0))
    fit = stats.multivariate_normal(weights @ x, 1.5 * np.cov(x.T, aweights=weights) + 0.1 * np.eye(d))
    fit.log_density = fit.logpdf
    pool.add_proposal(fit)
    y = fit.rvs(size=2 * n, random_state=rng)
    reference = stats.norm(0.0, 2.0).logpdf(y).sum(axis=1)
    pool.add_draws(y, reference, log_prior(y) - reference, 1)
    return pool


def test_evidence_is_that_of_draws_which_shaped_no_fit():
    """The mean of 300 evidences is one within four standard errors (6e-5); with the others it is low."""
    rng = np.random.default_rng(4)
    pools = [fitted_pool(rng) for _ in range(300)]
    for unseen, low in ((True, False), (False, True)):
        parts = [pool.unseen(np.array([0, 1])) if unseen else pool for pool in pools]
        evidences = np.exp([part.log_evidence(part.log_weights(1.0)) for part in parts])
        error = evidences.std() / np.sqrt(len(parts))
        assert (evidences.mean() < 1.0 - 4.0 * error) == low
        assert evidences.mean() < 1.0 + 4.0 * error


def importance_sample(rng, n=2000, width=2.0):
    """Draws wider than a standard normal target, as a pool whose reference is the proposal."""
    x = rng.normal(0.0, width, size=(n, 1))
    reference = stats.norm(0.0, width).logpdf(x[:, 0])
    return Pool(x, reference, stats.norm.logpdf(x[:, 0]) - reference)


def test_what_quantiles_are_worth():
    """Squared errors of weighted probabilities below the exact quantiles, over 300 pools, within 20 %.

    The mean of squares of 900 correlated numbers: its standard error is about 6 %. A plain count of the draws
    is wrong by more.
    """
    exact = stats.norm.ppf(QUANTILES)
    errors, worth = [], []
    for seed in range(300):
        pool = importance_sample(np.random.default_rng(seed), width=4.0)
        shares = pool.normalised(pool.log_weights(1.0))
        errors.append([shares @ (pool.particles[:, 0] <= q) for q in exact] - QUANTILES)
        worth.append(pool.effective_of_quantiles(pool.log_weights(1.0))[0])
    measured = 1.0 / np.mean(np.mean(np.square(errors), axis=0) / (QUANTILES * (1.0 - QUANTILES)))
    assert np.mean(worth) == pytest.approx(measured, rel=0.2)
    assert measured < 0.8 * 2000


@pytest.mark.parametrize("width", [2.0, 0.6])
def test_pareto_smoothing_is_arvizs(width):
    """Of weights that are fine, and of those of a proposal too narrow, whose variance is infinite."""
    pool = importance_sample(np.random.default_rng(3), width=width)
    log_weights = pool.log_weights(1.0)
    expected, shape = array_stats.psislw(-log_weights)
    assert pool.pareto_k() == pytest.approx(float(shape), abs=0.05)
    assert (pool.pareto_k() > 0.5) == (width < 1.0)
    smoothed = pool.posterior_log_weights()
    np.testing.assert_allclose(smoothed - logsumexp(smoothed), expected - logsumexp(expected), atol=0.02)
    assert (np.abs(smoothed - log_weights).max() > 0.1) == (width < 1.0)


@pytest.mark.statistical
def test_error_of_the_evidence_where_weights_have_no_variance(monkeypatch):
    """Of a proposal that is too narrow, 300 samples of 1,000 draws, and 300 others.

    Deviation 0.063 and 0.064, reported 0.060 (root mean square) in the first; by a jackknife of the weights
    as they are 0.039 in the median sample. Smoothed weights have a bias of -0.026 and -0.029, these of -0.009
    and -0.012.
    """
    log_z, errors, plain, smoothed = [], [], [], []
    for seed in range(300):
        pool = importance_sample(np.random.default_rng(seed), width=0.6, n=1000)
        found, error = pool.evidence()
        log_z.append(found)
        errors.append(error)
        smoothed.append(pool.log_evidence(pool.posterior_log_weights()))
        with monkeypatch.context() as patch:
            patch.setattr(pool_module, "pareto_smoothed", lambda log_weights: log_weights)
            plain.append(pool.jackknife())
    assert 0.7 < np.sqrt(np.mean(np.square(errors))) / np.std(log_z) < 1.3
    assert np.median(plain) / np.std(log_z) < 0.7
    assert np.mean(smoothed) < -0.02 < np.mean(log_z) < 0.0


def test_a_tail_of_hundreds_of_orders_raises_no_warning():
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        shape, scale = pareto_tail(np.exp(np.linspace(-690.0, 0.0, 4000)))
    assert shape > 1.0 and scale > 0.0


PRIOR_SD = 10.0


@functools.cache
def model_with_lump(d=3):
    """A standard normal likelihood with some of its mass `share` in a lump at (3.5, 0, ...)."""
    with pm.Model() as model:
        share = pm.Data("share", 0.05)
        x = pm.Normal("x", 0.0, PRIOR_SD, shape=d)
        bulk, lump = (-0.5 * ((x - place * np.eye(d)[0]) ** 2).sum() for place in (0.0, 3.5))
        pm.Potential("likelihood", log_add(pm.math.log1p(-share) + bulk, pm.math.log(share) + lump))
    return model


def reference_of_bulk(d=3):
    """What climbs to the mode at the origin alone would give."""
    mode = Mode(np.zeros(d), np.eye(d) / PRIOR_SD, 0.0, 1)
    return Reference([mode], np.zeros(d), np.full(d, PRIOR_SD))


def good_ones(share, seeds=40):
    """In how many of the seeds the reference is taken for good."""
    good = 0
    with model_with_lump() as model:
        pm.set_data({"share": share})
        for seed in range(seeds):
            kernel = PersistentSMC(1000, reference=reference_of_bulk(), model=model, random_seed=seed)
            kernel._initialize_kernel()
            good += kernel.reference is not None
    return good


@pytest.mark.statistical
def test_a_reference_that_misses_a_part_is_not_good():
    """Two of a thousand draws of it stand for 5 % of the posterior, and often none of the first 400.

    Judged by these, it is good in all seeds, as it is without the lump. Now it is in 8 (23 of 160):
    more than 12 come by chance once in 300 sets of 40.
    """
    assert good_ones(0.05) <= 12
    assert good_ones(1e-12, seeds=10) == 10


class NormalFit:
    """A fit that is what it is: independent normal coordinates; two where it is drawn from."""

    def __init__(self, sd=1.0):
        self.sd = sd

    def log_density(self, x):
        return stats.norm.logpdf(x, 0.0, self.sd).sum(axis=1)

    def draw(self, n, rng):
        return rng.normal(0.0, self.sd, size=(n, 2))


class LastStage(PersistentSMC):
    """The end of `PersistentSMC` alone, with a posterior of two Student-t coordinates and a wide prior."""

    draws, n_parameters, stage_draws, last_stage, beta = 200, 2, 100, 1, 1.0
    bounded, reference, reference_is_good, hamiltonian_share = None, None, False, 0.0

    def __init__(self, seed, degrees=5):
        self.rng, self.degrees, self.looks = np.random.default_rng(seed), degrees, []
        x = self.draw_reference(200)
        self.pool = Pool(x, *self.weigh(x))

    def draw_reference(self, n):
        return self.rng.normal(0.0, 30.0, size=(n, 2))

    def weigh(self, x):
        log_prior = stats.norm.logpdf(x, 0.0, 30.0).sum(axis=1)
        return log_prior, stats.t.logpdf(x, self.degrees).sum(axis=1) - log_prior

    def draw_more(self, n, source):
        self.looks.append((int(n), source))
        super().draw_more(n, source)


@pytest.fixture
def normal_fit(monkeypatch):
    monkeypatch.setattr(persistent, "fit_to", lambda *_, **__: NormalFit())


@pytest.mark.statistical
def test_the_evidence_is_unbiased_by_the_rule_that_ends_the_draws(normal_fit, monkeypatch):
    """Where weights have no variance, a rule that looks at the draws that count ends too early.

    150 runs: the mean log evidence is off by 0.010 (standard error 0.002; 150 others 0.005), and by 0.023
    (0.003) where draws decide themselves.
    """

    def bias(heavy):
        monkeypatch.setattr(persistent, "HEAVY_K", heavy)
        ends = [LastStage(seed) for seed in range(150)]
        for end in ends:
            end.complete()
        return np.mean([end.log_marginal_likelihood for end in ends])

    assert abs(bias(0.3)) < 0.015
    assert bias(np.inf) < -0.018
