"""What the kernels return against exact posteriors and evidences, with wrong kernels as negative controls."""

from functools import cache

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest
from scipy import stats

from pymc_features import TMCMC, PersistentSMC
from pymc_features.sampling import PopulationIMH, PopulationMH
from pymc_features.smc import KERNELS
from support.sampling import log_add, mean_within_errors, run_chain

pytestmark = pytest.mark.statistical


SEEDS = range(8)
CENTRE = 0.5
SD = {1: 0.1, 5: 0.1, 10: 0.3}  # of the likelihood, for each number of dimensions


@cache
def gaussian(d, shift=0.0):
    """Prior N(0, 1)^d, data 0.5 in every dimension."""
    with pm.Model() as model:
        x = pm.Normal("x", shape=d)
        pm.Normal("y", x, SD[d], observed=np.full(d, CENTRE))
        pm.Potential("shift", pt.constant(shift))
    return model


@cache
def conjugate(kernel, d, draws, seed):
    return run_chain(kernel, gaussian(d), draws, seed)


def faults(kernel, d, draws=1000):
    """What is wrong with a kernel on a conjugate Gaussian, over eight seeds.

    "evidence", "mean" and "spread" if their mean errors exceed four standard errors over seeds, of a Student
    t with 7 degrees of freedom: a false alarm in 190 each. (The spread may be wrong by 1 % besides, for it
    has a bias in 1 / draws.) "distribution" if the smallest Kolmogorov-Smirnov
    probability of the seeds, each with every tenth draw, is below 1e-3 over their number: a false alarm in
    1000. "noise" if evidences scatter by more than 0.3.
    """
    runs = [conjugate(kernel, d, draws, seed) for seed in SEEDS]
    precision = 1.0 + 1.0 / SD[d] ** 2
    mean = CENTRE / SD[d] ** 2 / precision
    exact = stats.norm(0.0, np.sqrt(1.0 + SD[d] ** 2)).logpdf(CENTRE) * d
    errors = np.array([r.evidence - exact for r in runs])
    z = [(r.draws - mean) * np.sqrt(precision) for r in runs]
    spread = np.array([x.std() - 1.0 for x in z])
    checks = {
        "evidence": mean_within_errors(errors),
        "noise": errors.std() < 0.3,
        "mean": mean_within_errors([x.mean() for x in z]),
        "spread": abs(spread.mean()) < 4.0 * spread.std(ddof=1) / np.sqrt(len(SEEDS)) + 0.01,
        "distribution": min(stats.kstest(x[::10].ravel(), "norm").pvalue for x in z) > 1e-3 / len(SEEDS),
    }
    return [name for name, passed in checks.items() if not passed], runs, errors


BIASED = pytest.mark.xfail(
    strict=True,
    reason="TMCMC is biased at any number of draws: seeds of large weight move further than others. With "
    "10,000, the log evidence is off by -0.45 +- 0.09 in 5 dimensions (-0.35 +- 0.09 for a literal loop over "
    "the source's steps) and scatters by 1.5 in 20; draws fail Kolmogorov-Smirnov in both",
)


CASES = [
    pytest.param(kernel, d, marks=[BIASED] if kernel is TMCMC and d > 1 else [], id=f"{kernel.__name__}-{d}")
    for kernel, dimensions in {
        PersistentSMC: (5, 10),
        PopulationIMH: (5,),
        PopulationMH: (5,),
        TMCMC: (1, 5),
    }.items()
    for d in dimensions
]


@pytest.mark.parametrize(("kernel", "d"), CASES)
def test_conjugate_gaussian(kernel, d):
    """Evidence, mean, spread and distribution; the standard error that a kernel reports covers each run."""
    found, runs, errors = faults(kernel, d, {TMCMC: 4000, PopulationMH: 2000}.get(kernel, 1000))
    assert found == []
    if kernel is PersistentSMC:
        assert (np.abs(errors) < 4.0 * np.array([r.se for r in runs])).all()
    if kernel in (PersistentSMC, PopulationIMH):
        assert all(len(np.unique(r.draws[:, 0])) > 0.6 * len(r.draws) for r in runs), "distinct points"


class WithoutCorrection(PopulationIMH):
    """Accepts independent proposals as if they came from a symmetric walk."""

    def propose(self):
        return super().propose()[0], 0.0, 0.0


class Flat:
    """A proposal that says nothing of its density."""

    def __init__(self, proposal):
        self.move, self.draw, self.map = proposal.move, proposal.draw, None

    def log_density(self, x):
        return np.zeros(len(x))


class WithoutDensity(PersistentSMC):
    """Ignores the density of the proposals of its chains, and draws from the last of these."""

    def tune(self):
        super().tune()
        self.moves.proposal = Flat(self.moves.proposal)

    def draw_more(self, n, source):
        self.pool.proposals[source] = Flat(self.pool.proposals[source]) if source else None
        super().draw_more(n, source)


class WithoutMixture(PersistentSMC):
    """Weighs the independent draws as if all came from the prior."""

    def finish(self, *samples):
        for sample in samples:
            sample.log_mixture = lambda sample=sample: np.zeros(len(sample.mass))
        super().finish(*samples)


class OldTemperature(PopulationMH):
    """Leaves the log-posterior of resampled particles at the temperature of the stage before."""

    def update_beta_and_weights(self):
        self.old = self.beta
        super().update_beta_and_weights()

    def resample(self):
        super().resample()
        self.tempered_posterior_logp = self.prior_logp + self.old * self.likelihood_logp


class OldTemperatureTMCMC(TMCMC):
    """The same defect where a chain starts."""

    def update_beta_and_weights(self):
        self.old = self.beta
        super().update_beta_and_weights()

    def mutate(self):
        self.likelihood_logp = self.likelihood_logp * self.old / self.beta
        super().mutate()


@pytest.mark.parametrize("kernel", [WithoutCorrection, WithoutDensity, WithoutMixture, OldTemperatureTMCMC])
def test_wrong_kernels_are_noticed(kernel):
    """Negative control of the test above. (`OldTemperature` takes many steps: only a shift shows it.)"""
    assert faults(kernel, 1)[0] != []


def moves_with_a_shift(kernel, shift):
    """Whether a constant added to the log-likelihood changes particles, or the evidence by anything else."""
    plain, shifted = (run_chain(kernel, gaussian(5, c), 500) for c in (0.0, shift))
    same = np.shape(plain.draws) == np.shape(shifted.draws) and np.allclose(
        plain.draws, shifted.draws, rtol=1e-7
    )
    return not (same and abs(shifted.evidence - plain.evidence - shift) < 1e-6)


@pytest.mark.parametrize("kernel", KERNELS)
def test_shift_invariance(kernel):
    assert not moves_with_a_shift(kernel, -5000.0)


@pytest.mark.parametrize("kernel", [OldTemperature, OldTemperatureTMCMC])
def test_shift_invariance_can_fail(kernel):
    """The published defect that it catches."""
    assert moves_with_a_shift(kernel, 123.456)


def narrow(scale=1e-5):
    with pm.Model() as model:
        x = pm.Normal("x", 0.0, 1.0)
        pm.Potential("likelihood", -0.5 * ((x - 0.3) / scale) ** 2)
    return model, stats.norm.logpdf(0.3) + np.log(np.sqrt(2 * np.pi) * scale)


def test_narrow_posterior():
    """A hundred times narrower than PyMC's jitter of 1e-3, and 1e5 times narrower than the prior.

    Kolmogorov-Smirnov at a false-alarm rate of 1e-3 on every fifth draw; evidence within four of its standard
    errors (6e-5). A posterior 27 % too wide, and PyMC's proposal, which it starves, are the controls.
    """
    model, exact = narrow()
    result = run_chain(PersistentSMC, model, 2000)
    assert result.stages[-1]["accept_rate"] > 0.3
    assert len(np.unique(result.draws)) > 0.5 * 2000
    draws = result.draws[::5, 0]
    assert stats.kstest(draws, stats.norm(0.3, 1e-5).cdf).pvalue > 1e-3
    assert stats.kstest(result.draws[:, 0], stats.norm(0.3, 1.27e-5).cdf).pvalue < 1e-3
    assert abs(result.evidence - exact) < 4.0 * result.se
    betas = [stage["beta"] for stage in result.stages]
    assert betas[0] < 1e-7, "far below an absolute step of 1e-6"
    assert len(betas) < 4 + 2.5 * 5, "stages grow with the logarithm of the ratio of prior to posterior"
    assert (np.diff(betas) > 0).all()
    assert run_chain(PopulationIMH, model).stages[-1]["accept_rate"] < 0.1


def test_temperatures_follow_any_scale(kernel=TMCMC, scale=1e-7):
    """Stages grow with the logarithm of the ratio of prior to posterior, and every seed arrives.

    The mean log evidence is within four standard errors over seeds: a false alarm in 190.
    """
    model, exact = narrow(scale)
    runs = [run_chain(kernel, model, 500, seed) for seed in SEEDS]
    assert all(len(r.stages) < 4 + 2.5 * np.log10(1 / scale) for r in runs)
    assert mean_within_errors([r.evidence - exact for r in runs])


def tolerance(share):
    """Likelihood 1 on a share of the prior and 0 elsewhere, as ABC has."""
    with pm.Model() as model:
        x = pm.Uniform("x", 0.0, 1.0)
        pm.Potential("likelihood", pt.switch(x < share, 0.0, -np.inf))
    return model


def test_hard_threshold(share=0.01):
    """Draws uniform on the set, evidence its prior probability, however few prior draws are inside.

    Kolmogorov-Smirnov at 1e-3 / 8 for each seed; mean log evidence within four standard errors over seeds
    plus its bias of 1 / (2 k) for the k = 16 points or more that are found: a false alarm in 150. Nearly half
    of the batches of 80 prior draws hold no point inside, and count, too.
    """
    runs = [run_chain(PersistentSMC, tolerance(share), 100, seed, stage_draws=40) for seed in SEEDS]
    inside = [1.0 / (1.0 + np.exp(-r.draws[:, 0])) / share for r in runs]
    assert all(((x > 0) & (x < 1)).all() for x in inside)
    assert min(stats.kstest(x[::4], "uniform").pvalue for x in inside) > 1e-3 / len(SEEDS)
    errors = np.array([r.evidence - np.log(share) for r in runs])
    assert abs(errors.mean()) < 4.0 * errors.std(ddof=1) / np.sqrt(len(errors)) + 0.03
    assert np.std(errors) < 0.4


@pytest.mark.parametrize("kernel", KERNELS)
def test_impossible_prior_draws_count(kernel):
    """Likelihood zero on most of the prior: the evidence knows how many draws that was.

    Within four standard errors over seeds, a false alarm in 190; leaving them out would add 0.94.
    """
    with pm.Model() as model:
        x = pm.Normal("x", shape=2)
        pm.Normal("y", x, 0.3, observed=[0.5, 0.5])
        pm.Potential("half", pt.switch(x[0] > 0.4, 0.0, -np.inf))
    posterior = stats.norm(0.5 / 1.09, np.sqrt(0.09 / 1.09))
    exact = 2 * stats.norm.logpdf(0.5, 0.0, np.sqrt(1.09)) + posterior.logsf(0.4)
    runs = [run_chain(kernel, model, 500, seed) for seed in SEEDS]
    assert mean_within_errors([r.evidence - exact for r in runs])
    assert np.std([r.evidence for r in runs]) < 0.28
    assert all((r.draws[:, 0] > 0.4).all() for r in runs)


def test_two_modes_keep_their_shares():
    """Masses 0.3 and 0.7 far apart: mean share and log evidence within four standard errors over seeds."""
    with pm.Model() as model:
        x = pm.Uniform("x", -5.0, 5.0, shape=2)
        low, high = (-0.5 * pt.sum((x - c) ** 2) / 0.2**2 for c in (-2.0, 2.0))
        pm.Potential("likelihood", log_add(np.log(0.3) + low, np.log(0.7) + high))
    runs = [run_chain(PersistentSMC, model, 1000, seed) for seed in SEEDS]
    shares = np.array([(r.draws[:, 0] > 0).mean() for r in runs])
    assert mean_within_errors(shares - 0.7)
    assert shares.std() < 0.03
    assert mean_within_errors([r.evidence - np.log(2 * np.pi * 0.2**2 / 100) for r in runs])


def test_an_initial_value_is_no_prior():
    """PyMC starts all particles at an `initval`: taken for draws from the prior, they give any result.

    The evidence is right, within four standard errors over seeds.
    """
    with pm.Model() as model:
        x = pm.Normal("x", initval=0.5)
        pm.Normal("y", x, 0.1, observed=0.6)
    runs = [run_chain(PersistentSMC, model, 500, seed) for seed in SEEDS]
    exact = stats.norm.logpdf(0.6, 0.0, np.hypot(1.0, 0.1))
    assert mean_within_errors([r.evidence - exact for r in runs])


def test_standard_error_is_calibrated(d=5):
    """Spread of 16 log evidences over the mean standard error reported, between 0.45 and 1.8.

    The spread itself is known to 18 %, a chi variable with 15 degrees of freedom: a false alarm in 600 for a
    true ratio of 0.9 or of 1.15.
    """
    runs = [conjugate(PersistentSMC, d, 1000, seed) for seed in range(16)]
    ratio = np.std([r.evidence for r in runs], ddof=1) / np.mean([r.se for r in runs])
    assert 0.45 < ratio < 1.8
