"""`PersistentSMC` at its two ends: whether a reference is good, and from what the last draws are taken."""

import functools

import numpy as np
import pymc as pm
import pytest
from scipy import stats

from pymc_features.smc import PersistentSMC
from pymc_features.smc.kernels import last_draws
from pymc_features.smc.proposals.pool import Pool
from pymc_features.smc.proposals.reference import Mode, Reference
from support.sampling import log_add

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


class LastStage(last_draws.LastDraws):
    """The end of `PersistentSMC` alone, with a posterior of two Student-t coordinates and a wide prior."""

    draws, n_parameters, stage_draws, last_stage = 200, 2, 100, 1
    bounded, reference, needs_fit, hamiltonian_share = None, None, True, 0.0

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
    monkeypatch.setattr(last_draws, "fit_twice_to", lambda *_: NormalFit())


@pytest.mark.statistical
def test_the_evidence_is_unbiased_by_the_rule_that_ends_the_draws(normal_fit, monkeypatch):
    """Where weights have no variance, a rule that looks at the draws that count ends too early.

    150 runs: the mean log evidence is off by 0.010 (standard error 0.002; 150 others 0.005), and by 0.023
    (0.003) where draws decide themselves.
    """

    def bias(heavy):
        monkeypatch.setattr(last_draws, "HEAVY_K", heavy)
        ends = [LastStage(seed) for seed in range(150)]
        for end in ends:
            end.complete()
        return np.mean([end.log_marginal_likelihood for end in ends])

    assert abs(bias(0.3)) < 0.015
    assert bias(np.inf) < -0.018
