"""What the kernels return against exact posteriors and evidences, with wrong kernels as negative controls.

Seeds are fixed. Where a docstring states a false-alarm rate, it is that of another seed.
"""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
from scipy import stats
from scipy.special import logsumexp

from pymc_features import TMCMC, PersistentSMC, PopulationIMH, PopulationMH
from pymc_features.smc import KERNELS
from pymc_features.smc.kernels import persistent
from pymc_features.smc.proposals import proposal
from pymc_features.smc.proposals.mixture import Pool, bennett, next_beta
from pymc_features.smc.proposals.proposal import StudentMixture, StudentT, fit_mixture

SEEDS = range(12)


@pytest.fixture(scope="module", autouse=True)
def quick():
    """Compile for small examples."""
    with pytensor.config.change_flags(mode="FAST_COMPILE"):
        yield


def run(kernel, model, draws=1000, seed=0, **settings):
    """One chain: the kernel at its end, and the statistics of its stages."""
    one = kernel(draws, model=model, random_seed=seed, **settings)
    one.initialize(None, np.random.default_rng(seed))
    stages = []
    while one.beta < 1.0:
        one.update_beta_and_weights()
        stages.append(one.step())
    return SimpleNamespace(
        draws=one.tempered_posterior,
        evidence=one.log_marginal_likelihood,
        se=stages[-1].get("log_marginal_likelihood_se"),
        betas=[stage["beta"] for stage in stages],
        acceptance=stages[-1].get("accept_rate"),
    )


def student_limit(values, limit=4.0):
    """Whether the mean of values from independent seeds is within `limit` of its standard errors of zero."""
    return abs(np.mean(values)) < limit * np.std(values, ddof=1) / np.sqrt(len(values))


# --------------------------------------------------------------------------- conjugate Gaussians

CENTRE = 0.5
SD = {1: 0.1, 5: 0.1, 20: 0.3}  # of the likelihood, for each number of dimensions
N_DRAWS = {1: 1000, 5: 2000, 20: 4000}


@cache
def gaussian(d, shift=0.0):
    """Prior N(0, 1)^d, data 0.5 in every dimension."""
    with pm.Model() as model:
        x = pm.Normal("x", shape=d)
        pm.Normal("y", x, SD[d], observed=np.full(d, CENTRE))
        pm.Potential("shift", pt.constant(shift))
    return model


def faults(kernel, d, draws=None):
    """What is wrong with a kernel on a conjugate Gaussian, over twelve seeds.

    "evidence", "mean" and "spread" if their mean errors exceed four standard errors over seeds, of a Student
    t with 11 degrees of freedom: a false alarm in 480 each. (The spread may be wrong by 1 % besides, for it
    has a bias in 1 / draws.) "distribution" if the smallest Kolmogorov-Smirnov probability of the seeds, each
    with every tenth draw, is below 1e-3 / 12: a false alarm in 1000. "noise" if evidences scatter by more
    than 0.3.
    """
    runs = [run(kernel, gaussian(d), draws or N_DRAWS[d], seed) for seed in SEEDS]
    precision = 1.0 + 1.0 / SD[d] ** 2
    mean = CENTRE / SD[d] ** 2 / precision
    exact = stats.norm(0.0, np.sqrt(1.0 + SD[d] ** 2)).logpdf(CENTRE) * d
    errors = np.array([r.evidence - exact for r in runs])
    z = [(r.draws - mean) * np.sqrt(precision) for r in runs]
    spread = np.array([x.std() - 1.0 for x in z])
    checks = {
        "evidence": student_limit(errors),
        "noise": errors.std() < 0.3,
        "mean": student_limit([x.mean() for x in z]),
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
    for kernel in KERNELS
    for d in SD
]


@pytest.mark.parametrize(("kernel", "d"), CASES)
def test_conjugate_gaussian(kernel, d):
    """Evidence, mean, spread and distribution; the standard error that a kernel reports covers each run."""
    found, runs, errors = faults(kernel, d, {TMCMC: 10_000, PopulationMH: 2000}.get(kernel))
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

    def __init__(self, mixture):
        self.move = mixture.move

    def log_density(self, x):
        return np.zeros(len(x))


class WithoutDensity(PersistentSMC):
    """Ignores the density of its proposal mixture."""

    def tune(self):
        super().tune()
        self.moves.mixture = Flat(self.moves.mixture)


class WithoutMixture(PersistentSMC):
    """Weighs the pool as if all its points came from the prior."""

    def update_beta_and_weights(self):
        self.pool.log_mixture = lambda: np.zeros(len(self.pool.mass))
        super().update_beta_and_weights()


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


SHIFTS = (123.456, -5000.0)


def moves_with_a_shift(kernel, shift):
    """Whether a constant added to the log-likelihood changes particles, or the evidence by anything else."""
    plain, shifted = (run(kernel, gaussian(5, c), 500) for c in (0.0, shift))
    same = np.shape(plain.draws) == np.shape(shifted.draws) and np.allclose(
        plain.draws, shifted.draws, rtol=1e-7
    )
    return not (same and abs(shifted.evidence - plain.evidence - shift) < 1e-6)


@pytest.mark.parametrize("shift", SHIFTS)
@pytest.mark.parametrize("kernel", KERNELS)
def test_shift_invariance(kernel, shift):
    assert not moves_with_a_shift(kernel, shift)


@pytest.mark.parametrize("kernel", [OldTemperature, OldTemperatureTMCMC])
def test_shift_invariance_can_fail(kernel):
    """The published defect that it catches."""
    assert moves_with_a_shift(kernel, 123.456)


# --------------------------------------------------------------------------- other posteriors


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
    result = run(PersistentSMC, model, 2000)
    assert result.acceptance > 0.3
    assert len(np.unique(result.draws)) > 0.6 * 2000
    draws = result.draws[::5, 0]
    assert stats.kstest(draws, stats.norm(0.3, 1e-5).cdf).pvalue > 1e-3
    assert stats.kstest(result.draws[:, 0], stats.norm(0.3, 1.27e-5).cdf).pvalue < 1e-3
    assert abs(result.evidence - exact) < 4.0 * result.se
    assert result.betas[0] < 1e-7, "far below an absolute step of 1e-6"
    assert (np.diff(result.betas) > 0).all()
    assert run(PopulationIMH, model).acceptance < 0.1


@pytest.mark.parametrize("kernel", [PersistentSMC, TMCMC])
@pytest.mark.parametrize("scale", [1e-3, 1e-5, 1e-7])
def test_temperatures_follow_any_scale(kernel, scale):
    """Stages grow with the logarithm of the ratio of prior to posterior, and every seed arrives.

    The mean log evidence is within four standard errors over seeds: a false alarm in 480.
    """
    model, exact = narrow(scale)
    runs = [run(kernel, model, 500, seed) for seed in SEEDS]
    assert all(len(r.betas) < 4 + 2.5 * np.log10(1 / scale) for r in runs)
    assert student_limit([r.evidence - exact for r in runs])


def tolerance(share):
    """Likelihood 1 on a share of the prior and 0 elsewhere, as ABC has."""
    with pm.Model() as model:
        x = pm.Uniform("x", 0.0, 1.0)
        pm.Potential("likelihood", pt.switch(x < share, 0.0, -np.inf))
    return model


@pytest.mark.parametrize(
    ("share", "draws", "stage"), [(0.5, 1000, None), (0.01, 1000, None), (0.01, 100, 40)]
)
def test_hard_threshold(share, draws, stage):
    """Draws uniform on the set, evidence its prior probability, however few prior draws are inside.

    Kolmogorov-Smirnov at 1e-3 / 12 for each seed; mean log evidence within four standard errors over seeds
    plus its bias of 1 / (2 k) for the k = 16 points or more that are found: a false alarm in 300. In the last
    case nearly half of the batches of 80 prior draws hold no point inside, and count, too.
    """
    runs = [run(PersistentSMC, tolerance(share), draws, seed, stage_draws=stage) for seed in SEEDS]
    inside = [1.0 / (1.0 + np.exp(-r.draws[:, 0])) / share for r in runs]
    assert all(((x > 0) & (x < 1)).all() for x in inside)
    assert min(stats.kstest(x[::4], "uniform").pvalue for x in inside) > 1e-3 / len(SEEDS)
    errors = np.array([r.evidence - np.log(share) for r in runs])
    assert abs(errors.mean()) < 4.0 * errors.std(ddof=1) / np.sqrt(len(errors)) + 0.03
    assert np.std(errors) < 0.4


@pytest.mark.parametrize("kernel", KERNELS)
def test_weak_likelihood_takes_one_stage(kernel):
    """Reached at once, with the exact moments: mean and evidence within four standard errors over seeds."""
    with pm.Model() as model:
        x = pm.Normal("x")
        pm.Normal("y", x, 5.0, observed=1.0)
    runs = [run(kernel, model, 500, seed) for seed in SEEDS]
    assert all(r.betas == [1.0] for r in runs)
    assert student_limit([r.draws.mean() - 1 / 26 for r in runs])
    assert student_limit([r.evidence - stats.norm.logpdf(1.0, 0.0, np.sqrt(26)) for r in runs])


@pytest.mark.parametrize("kernel", KERNELS)
def test_impossible_prior_draws_count(kernel):
    """Likelihood zero on most of the prior: the evidence knows how many draws that was.

    Within four standard errors over seeds, a false alarm in 480; leaving them out would add 0.94.
    """
    with pm.Model() as model:
        x = pm.Normal("x", shape=2)
        pm.Normal("y", x, 0.3, observed=[0.5, 0.5])
        pm.Potential("half", pt.switch(x[0] > 0.4, 0.0, -np.inf))
    posterior = stats.norm(0.5 / 1.09, np.sqrt(0.09 / 1.09))
    exact = 2 * stats.norm.logpdf(0.5, 0.0, np.sqrt(1.09)) + posterior.logsf(0.4)
    runs = [run(kernel, model, 1000, seed) for seed in SEEDS]
    assert student_limit([r.evidence - exact for r in runs])
    assert np.std([r.evidence for r in runs]) < 0.2
    assert all((r.draws[:, 0] > 0.4).all() for r in runs)


def test_two_modes_keep_their_shares():
    """Masses 0.3 and 0.7 far apart: mean share and log evidence within four standard errors over seeds."""
    with pm.Model() as model:
        x = pm.Uniform("x", -5.0, 5.0, shape=2)
        low, high = (-0.5 * pt.sum((x - c) ** 2) / 0.2**2 for c in (-2.0, 2.0))
        pm.Potential("likelihood", pt.logaddexp(np.log(0.3) + low, np.log(0.7) + high))
    runs = [run(PersistentSMC, model, 1000, seed) for seed in SEEDS]
    shares = np.array([(r.draws[:, 0] > 0).mean() for r in runs])
    assert student_limit(shares - 0.7)
    assert shares.std() < 0.03
    assert student_limit([r.evidence - np.log(2 * np.pi * 0.2**2 / 100) for r in runs])


@pytest.mark.parametrize("kernel", [PersistentSMC, TMCMC, PopulationMH])
def test_a_discrete_variable_alone(kernel):
    """Two values only: probability and evidence within four standard errors over seeds.

    Not for PyMC's independent proposals: starting from integers on a real line, they are 0.02 off.
    """
    with pm.Model() as model:
        k = pm.Bernoulli("k", 0.3)
        pm.Normal("y", k, 0.5, observed=1.0)
    joint = np.array([0.7, 0.3]) * stats.norm.pdf(1.0, [0.0, 1.0], 0.5)
    runs = [run(kernel, model, 500, seed) for seed in SEEDS]
    assert student_limit([np.round(r.draws).mean() - joint[1] / joint.sum() for r in runs])
    assert student_limit([r.evidence - np.log(joint.sum()) for r in runs])


@pytest.mark.parametrize("kernel", [PersistentSMC, TMCMC])
def test_an_initial_value_is_no_prior(kernel):
    """PyMC starts all particles at an `initval`: taken for draws from the prior, they give any result.

    The evidence is right, within four standard errors over seeds, or the model is refused.
    """
    with pm.Model() as model:
        x = pm.Normal("x", initval=0.5)
        pm.Normal("y", x, 0.1, observed=0.6)
    try:
        runs = [run(kernel, model, 500, seed) for seed in SEEDS]
    except ValueError as error:
        assert "initval" in str(error) or "every parameter" in str(error)
        return
    exact = stats.norm.logpdf(0.6, 0.0, np.hypot(1.0, 0.1))
    assert student_limit([r.evidence - exact for r in runs])


@pytest.mark.parametrize("d", [1, 5])
def test_standard_error_is_calibrated(d):
    """Spread of 30 log evidences over the mean standard error reported, between 0.6 and 1.7.

    A false alarm in 1e3 for a true ratio between 0.9 and 1.2.
    """
    runs = [run(PersistentSMC, gaussian(d), 1000, seed) for seed in range(30)]
    ratio = np.std([r.evidence for r in runs], ddof=1) / np.mean([r.se for r in runs])
    assert 0.6 < ratio < 1.7


# --------------------------------------------------------------------------- the pool


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


# --------------------------------------------------------------------------- the proposal


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
    return changed, not all(student_limit(values) for values in flux if values.any())


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
