"""Subset simulation against exact volumes, rejection and quadrature; wrong kernels are negative controls.

Seeds are fixed. Where a docstring states a false-alarm rate, it is that of another seed.
"""

import multiprocessing
import warnings
from functools import cache
from types import SimpleNamespace

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
import xarray as xr
from pymc.sampling.parallel import ParallelSamplingError
from scipy import stats
from scipy.special import expit, gamma

from pymc_features import (
    DiscrepancySimulator,
    ModalDamping,
    PopulationWarning,
    Record,
    SimulationWarning,
    SpringMassChain,
    SubsetSimulation,
    SubsetSimulationWarning,
    ToleranceNotReachedError,
    response,
    sample_smc,
    simulate,
)
from pymc_features.smc import subset
from pymc_features.smc.discrepancy import SimulatorNode
from pymc_features.smc.levels import Levels

QUIET = {"cores": 1, "progressbar": False, "compute_convergence_checks": False}
pytestmark = [
    pytest.mark.filterwarnings("ignore:SubsetSimulation draws from rho"),
    pytest.mark.filterwarnings("ignore:RandomVariable Ops will stop hiding"),
    pytest.mark.filterwarnings("ignore:Calling a RandomVariable without an explicit rng"),
]


@pytest.fixture(scope="module", autouse=True)
def quick():
    """Compile for small examples."""
    with pytensor.config.change_flags(mode="FAST_COMPILE"):
        yield


def batched(function):
    """Mark a function as one that takes all particles at once."""
    function.batched = True
    return function


def run(model, draws=500, seed=0, kernel=SubsetSimulation, **settings):
    """One chain: the kernel at its end, the statistics of its levels, and its first tolerance."""
    one = kernel(draws, model=model, random_seed=seed, **settings)
    one.initialize(None, np.random.default_rng(seed))
    levels = []
    while one.beta < 1.0:
        one.update_beta_and_weights()
        levels.append(one.step())
    return SimpleNamespace(
        x=one.tempered_posterior,
        rho=one.rho,
        evidence=one.log_marginal_likelihood,
        se=levels[-1]["log_marginal_likelihood_se"],
        simulations=one.simulations,
        levels=levels,
    )


def sample(model, draws=300, chains=1, **settings):
    return sample_smc(
        draws, SubsetSimulation, model=model, chains=chains, **{"random_seed": 1, **QUIET, **settings}
    )


# --------------------------------------------------------------------------- exact volumes


@batched
def itself(x):
    return x


@cache
def ball(d, epsilon):
    """|x|^2 <= epsilon in a cube of side 2: the exact volume and moments are known."""
    with pm.Model() as model:
        x = pm.Uniform("x", -1.0, 1.0, shape=d)
        DiscrepancySimulator("y", itself, x, epsilon=epsilon, observed=np.zeros(d))
    return model


def radius(d, probability):
    """Of the ball that holds this share of the cube."""
    return 2.0 * (probability * gamma(0.5 * d + 1)) ** (1 / d) / np.sqrt(np.pi)


PROBABILITY = {1: 1e-3, 2: 2.6e-4, 5: 1e-4}
N_RUNS = 40


@cache
def ball_runs(d, kernel=SubsetSimulation, n=N_RUNS):
    model = ball(d, radius(d, PROBABILITY[d]) ** 2)
    return [run(model, {1: 500, 2: 1000, 5: 1000}[d], seed, kernel) for seed in range(n)]


def cube(r):
    return 2.0 * expit(r.x) - 1.0


def few(values, expected=0.0, error=0.0, limit=4.0):
    """Whether the mean of values from independent runs is within `limit` of its standard errors."""
    spread = np.hypot(np.std(values, ddof=1) / np.sqrt(len(values)), error)
    return abs(np.mean(values) - expected) < limit * spread


@pytest.mark.parametrize("d", PROBABILITY)
def test_evidence_against_the_exact_volume(d):
    """Each of 40 runs, and the mean of the evidences."""
    runs = ball_runs(d)
    errors = np.array([r.evidence for r in runs]) - np.log(PROBABILITY[d])
    assert (np.abs(errors) < 4.0 * np.array([r.se for r in runs])).all()
    assert few(errors)


# --------------------------------------------------------------------------- against rejection


class TwoModes:
    """One parameter, two intervals of unequal share; seeds enough for a mixture of two."""

    epsilon = 1e-4
    stage_draws = 1000

    @staticmethod
    @batched
    def square(x):
        return x[:, None] ** 2

    def model(self):
        with pm.Model() as model:
            x = pm.Normal("x", 0.3, 1.0)
            DiscrepancySimulator("y", self.square, x, epsilon=self.epsilon, observed=np.ones(1))
        return model

    def prior(self, rng, n):
        return rng.normal(0.3, 1.0, (n, 1))

    def rho(self, x, rng):
        return (x[:, 0] ** 2 - 1.0) ** 2

    def natural(self, x):
        return x


class Banana:
    """Two parameters, one of them positive, on a bent strip."""

    epsilon = 1e-3
    stage_draws = None

    @staticmethod
    @batched
    def bent(a, b):
        return np.stack([a**2 + b, 0.3 * a], axis=1)

    def model(self):
        with pm.Model() as model:
            a, b = pm.Normal("a"), pm.Gamma("b", 2.0, 1.0)
            DiscrepancySimulator("y", self.bent, a, b, epsilon=self.epsilon, observed=[1.0, 0.06])
        return model

    def prior(self, rng, n):
        return np.column_stack([rng.normal(size=n), rng.gamma(2.0, size=n)])

    def rho(self, x, rng):
        a, b = x.T
        return (a**2 + b - 1.0) ** 2 + (0.3 * a - 0.06) ** 2

    def natural(self, x):
        return np.column_stack([x[:, 0], np.exp(x[:, 1])])


class Noisy:
    """Five parameters of a stock `pm.Simulator` with noise: one draw of it belongs to each state."""

    epsilon = 0.8
    stage_draws = None
    data = np.array([1.0, 0.5, 0.0, -0.5, -1.0])

    @staticmethod
    @batched
    def measure(rng, x, size):
        return x + 0.1 * rng.standard_normal(np.shape(x))

    def model(self):
        with pm.Model() as model:
            x = pm.Normal("x", shape=5)
            pm.Simulator(
                "y", self.measure, x, epsilon=self.epsilon, signature="(d)->(d)", observed=self.data
            )
        return model

    def prior(self, rng, n):
        return rng.standard_normal((n, 5))

    def rho(self, x, rng):
        return np.linalg.norm(x + 0.1 * rng.standard_normal(x.shape) - self.data, axis=1)

    def natural(self, x):
        return x


PROBLEMS = (TwoModes(), Banana(), Noisy())
problems = pytest.mark.parametrize("problem", PROBLEMS, ids=lambda p: type(p).__name__)
N_CHAINS = 16


@cache
def rejection(problem, n=2_000_000):
    """The slow reference: draws (m, d + 1) from the prior with rho <= epsilon, rho last; and their share."""
    rng = np.random.default_rng(2)
    kept = []
    for _ in range(10):
        x = problem.prior(rng, n // 10)
        rho = problem.rho(x, rng)
        kept.append(np.column_stack([x, rho])[rho <= problem.epsilon])
    kept = np.concatenate(kept)
    return kept, len(kept) / n


@cache
def model_of(problem):
    return problem.model()


@cache
def chains_of(problem, kernel=SubsetSimulation):
    model = model_of(problem)
    return [run(model, 500, seed, kernel, stage_draws=problem.stage_draws) for seed in range(N_CHAINS)]


def differences(problem, kernel=SubsetSimulation):
    """What differs from rejection, over 16 independent chains.

    "rho": a particle outside the tolerance. "distribution": two-sample Kolmogorov-Smirnov of a coordinate or
    rho, below 1e-3 / number of columns; of every tenth draw, since those of one chain are correlated (50 of
    500, at 1.3 to 2 draws for an effective one, are worth 45 or more). "mean" and "square" of a column, by
    the means of chains: beyond 4.5 standard errors, a Student t with 15 degrees of freedom, 4e-4 each.
    "evidence": beyond 4.5, too. In all a false alarm in 150 for five parameters, in 300 for one.
    """
    exact, share = rejection(problem)
    runs = chains_of(problem, kernel)
    columns = [np.column_stack([problem.natural(r.x), r.rho]) for r in runs]
    found = set()
    if max(c[:, -1].max() for c in columns) > problem.epsilon:
        found.add("rho")
    thinned = np.concatenate([c[::10] for c in columns])
    for k, known in enumerate(exact.T):
        if stats.ks_2samp(thinned[:, k], known).pvalue < 1e-3 / exact.shape[1]:
            found.add("distribution")
        for name, power in (("mean", 1), ("square", 2)):
            means = [np.mean(c[:, k] ** power) for c in columns]
            if not few(means, np.mean(known**power), np.std(known**power) / np.sqrt(len(known)), 4.5):
                found.add(name)
    if not few([r.evidence for r in runs], np.log(share), 1.0 / np.sqrt(len(exact)), 4.5):
        found.add("evidence")
    return found


@problems
def test_draws_are_those_of_rejection(problem):
    assert differences(problem) == set()
    assert rejection(problem)[1] < 0.01, "far more simulations than a run takes"


class WithoutTolerance(SubsetSimulation):
    """Accepts what the prior accepts."""

    def simulate(self, x):
        rho = super().simulate(x)
        return rho if self.iteration == 0 else np.minimum(rho, self.levels.tolerance)


class WithoutDensity(SubsetSimulation):
    """Ignores the density of its proposal mixture."""

    def tune(self):
        super().tune()
        self.moves.log_density = lambda x: np.zeros(len(x))


class WithoutPrior(SubsetSimulation):
    """Ignores the prior once it has begun."""

    def mutate(self):
        base = self.base
        self.base = lambda x: (np.zeros(len(x)), np.zeros(len(x)), np.zeros(len(x), dtype=bool))
        self.population[1] = np.zeros(len(self.population[1]))
        super().mutate()
        self.base = base


class LooserLevel(SubsetSimulation):
    """Returns the population of the level before the last."""

    def collect(self, states):
        if self.levels.is_last:
            chosen = self.rng.choice(len(self.population[0]), self.draws)
            self.tempered_posterior, _, self.rho = (a[chosen] for a in self.population)
        else:
            super().collect(states)


class SecondTry(SubsetSimulation):
    """Draws the noise of a proposal once more where the first did not please."""

    def simulate(self, x):
        return np.minimum(super().simulate(x), super().simulate(x)) if self.iteration else super().simulate(x)


class AllLocal(SubsetSimulation):
    """Takes all moves of the mixture for symmetric ones."""

    def tune(self):
        super().tune()
        propose = self.moves.propose
        self.moves.propose = lambda x, rng: (propose(x, rng)[0], np.ones(len(x), dtype=bool))


@pytest.mark.parametrize(
    ("kernel", "problem", "fault"),
    [
        (WithoutTolerance, PROBLEMS[1], "distribution"),
        (WithoutDensity, PROBLEMS[0], "distribution"),
        (WithoutDensity, PROBLEMS[2], "distribution"),
        (WithoutPrior, PROBLEMS[0], "distribution"),
        (LooserLevel, PROBLEMS[0], "rho"),
        (LooserLevel, PROBLEMS[2], "rho"),
        (SecondTry, PROBLEMS[2], "evidence"),
        (AllLocal, PROBLEMS[2], "distribution"),
    ],
    ids=lambda x: x if isinstance(x, str) else getattr(x, "__name__", type(x).__name__),
)
def test_wrong_kernels_are_noticed(kernel, problem, fault):
    """Negative controls of the test above."""
    assert fault in differences(problem, kernel)


class VeryNoisy(Noisy):
    """Noise as large as the tolerance for each of its entries."""

    @staticmethod
    @batched
    def measure(rng, x, size):
        return x + 0.3 * rng.standard_normal(np.shape(x))


@pytest.mark.xfail(
    strict=True,
    reason="moves are shortened until a third of them is accepted; where the noise alone rejects more than "
    "that, they shrink to nothing and the budget is spent. With moves of length one, 16 for each draw suffice",
)
@pytest.mark.filterwarnings("ignore:`max_simulations` were spent")
@pytest.mark.filterwarnings("ignore:a level took")
def test_noise_is_no_reason_for_short_moves():
    last = run(VeryNoisy().model())
    assert last.simulations < 40 * 500


# --------------------------------------------------------------------------- calibration and cost


@pytest.mark.parametrize("d", PROBABILITY)
def test_standard_error_is_calibrated(d):
    """Spread of 40 log evidences over the mean standard error reported, between 0.6 and 1.6.

    The spread itself is known to 11 %: a false alarm in 1e4 for a true ratio between 0.9 and 1.15 (measured:
    0.96 in one dimension, over 400 runs).
    """
    runs = ball_runs(d)
    ratio = np.std([r.evidence for r in runs], ddof=1) / np.mean([r.se for r in runs])
    assert 0.6 < ratio < 1.6


class LastLevelOnly(SubsetSimulation):
    """Reports the error of its last level for that of all."""

    def update_beta_and_weights(self):
        self.levels.variance = 0.0
        super().update_beta_and_weights()


def test_standard_error_calibration_can_fail():
    runs = ball_runs(2, LastLevelOnly)
    assert np.std([r.evidence for r in runs], ddof=1) / np.mean([r.se for r in runs]) > 1.6


def test_cost_of_small_probabilities():
    """At a prior acceptance of 2.6e-4 rejection takes 3800 simulations for each draw; here 4.4.

    Each run stays below 6, with 70 % of its draws distinct. For a draw that counts, by the variance of 40
    means of two coordinates around their exact zero, there are fewer than 25 (measured: 7; a chi-squared
    with 80 degrees of freedom, no false alarm in 1e9).
    """
    runs = ball_runs(2)
    n = len(runs[0].x)
    assert max(r.simulations for r in runs) <= 6 * n
    assert min(len(np.unique(r.x, axis=0)) for r in runs) >= 0.7 * n
    variance = radius(2, PROBABILITY[2]) ** 2 / 4
    effective = variance / np.mean([cube(r).mean(axis=0) ** 2 for r in runs])
    assert np.mean([r.simulations for r in runs]) <= 25 * effective


@pytest.mark.parametrize("d", PROBABILITY)
def test_simulations_are_what_the_function_saw(d):
    """Counted by the function itself; the compilation tries it once."""
    seen = []

    @batched
    def counting(x):
        seen.append(len(x))
        return x

    with pm.Model() as model:
        x = pm.Uniform("x", -1.0, 1.0, shape=d)
        DiscrepancySimulator("y", counting, x, epsilon=0.01, observed=np.zeros(d))
    model_run = run(model)
    assert sum(seen) - 1 == model_run.simulations
    assert sum(level["evaluations"] for level in model_run.levels) == model_run.simulations


# --------------------------------------------------------------------------- what a run reports


def test_report_of_a_run(tmp_path, monkeypatch):
    """Tolerances, evidence and settings of three chains; saved and loaded, everything is as it was."""
    problem, fractions = PROBLEMS[1], []
    lower = Levels.lower

    def recorded(levels, rho, chains):
        inside = lower(levels, rho, chains)
        fractions.append((levels.tolerance, np.mean(rho <= levels.tolerance)))
        assert len(inside) == np.sum(rho <= levels.tolerance)
        return inside

    monkeypatch.setattr(Levels, "lower", recorded)
    idata = sample(model_of(problem), chains=3, p0=0.25, stage_draws=240)
    a, b = (idata.posterior[name].values.ravel() for name in "ab")
    rho = problem.rho(np.column_stack([a, b]), None)
    assert rho.size == 900
    assert rho.max() <= problem.epsilon * (1 + 1e-9), "for the arithmetic of another route"
    assert rho.max() > 0.99 * problem.epsilon
    found = idata.sample_stats
    expected = iter(fractions)
    for k, tolerances in enumerate(found["tolerance"].values):
        tolerances = tolerances[~np.isnan(tolerances)]
        assert tolerances[-1] == problem.epsilon
        assert (np.diff(tolerances) < 0).all()
        assert len(tolerances) > 3
        shares = [next(expected) for _ in tolerances]
        np.testing.assert_array_equal([t for t, _ in shares], tolerances)
        logs = np.cumsum(np.log([share for _, share in shares]))
        np.testing.assert_allclose(found["log_probability"].values[k, : len(tolerances)], logs, rtol=1e-12)
        assert found["log_marginal_likelihood"].values[k] == pytest.approx(logs[-1], rel=1e-12)
        np.testing.assert_allclose([share for _, share in shares[:-1]], 0.25, atol=0.005)
    assert found["log_marginal_likelihood"].dims == found["log_marginal_likelihood_se"].dims == ("chain",)
    for name in set(SubsetSimulation.stats_dtypes_shapes) - {
        "log_marginal_likelihood",
        "log_marginal_likelihood_se",
    }:
        assert found[name].dims == ("chain", "stage"), name
        assert found[name].dtype == float, name
    expected = {"p0": 0.25, "stage_draws": 240, "epsilon": 1e-3, "max_simulations": 30_000, "_n_draws": 300}
    assert {name: found.attrs[name] for name in expected} == expected
    idata.to_netcdf(tmp_path / "result.nc", engine="h5netcdf")
    with xr.open_datatree(tmp_path / "result.nc", engine="h5netcdf") as loaded:
        xr.testing.assert_equal(loaded.load(), idata)


def test_edge_belongs_to_the_tolerance():
    """Whole numbers: rho = epsilon is inside, for stock distances, too, where a division would round."""
    with pm.Model() as model:
        k = pm.DiscreteUniform("k", 0, 60)
        pm.Simulator("y", lambda rng, k, size: np.full(49, k), k, ndim_supp=1, signature="()->(n)",
                     distance="laplace", epsilon=98.0, observed=np.zeros(49))  # fmt: skip
    with pytest.warns(PopulationWarning):
        idata = sample(model, 600)
    assert set(np.unique(idata.posterior["k"])) == {0, 1, 2}


def test_same_seed_same_result():
    model = ball(2, 0.01)
    one, same, other = (sample(model, random_seed=seed, chains=2) for seed in (1, 1, 2))
    xr.testing.assert_equal(one["posterior"].dataset, same["posterior"].dataset)
    assert not np.isin(one.posterior["x"], other.posterior["x"]).any()
    assert not np.isin(one.posterior["x"][0], one.posterior["x"][1]).any(), "chains are independent"


@pytest.mark.parametrize("mp_ctx", ["fork", "forkserver", "spawn"])
def test_parallel_chains_give_the_same_draws(mp_ctx):
    """With noise, too: its streams travel with the chains."""
    if mp_ctx not in multiprocessing.get_all_start_methods():
        pytest.skip(f"no {mp_ctx} on this system")
    model = structure(noise=0.1)
    expected = sample(model, 200, chains=2)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*use of fork", category=DeprecationWarning)
        found = sample(model, 200, chains=2, cores=2, mp_ctx=mp_ctx)
    np.testing.assert_allclose(found.posterior["theta"], expected.posterior["theta"], rtol=1e-12)
    np.testing.assert_allclose(found.sample_stats["tolerance"], expected.sample_stats["tolerance"])


PULSE = Record(np.random.default_rng(0).normal(size=100), 0.02)


def chain(theta):
    return SpringMassChain(np.ones(2), 400.0 * theta * np.ones(2), ModalDamping(0.05))


MEASURED = simulate(chain(1.0), PULSE).values + 0.2 * np.random.default_rng(1).normal(size=(2, 100))


def structure(epsilon=0.2, **settings):
    with pm.Model() as model:
        mu = response(chain(pm.Normal("theta", 1.0, 0.5)), PULSE)
        DiscrepancySimulator("y", mu, epsilon=epsilon, observed=MEASURED, **settings)
    return model


def test_structure_against_rejection():
    """A response node without a history: two-sample Kolmogorov-Smirnov at 1e-3 of every tenth draw.

    Half of the tolerance is the negative control.
    """
    rng = np.random.default_rng(0)
    grid = np.linspace(0.02, 3.0, 1500)
    rho = [np.square(simulate(chain(t), PULSE).values - MEASURED).mean(axis=1).sum() for t in grid]
    theta = rng.normal(1.0, 0.5, 300_000)
    theta = theta[(theta > 0.02) & (theta < 3.0)]
    rho = np.interp(theta, grid, rho)
    found = np.concatenate([run(structure(), seed=seed).x[::10, 0] for seed in range(6)])
    assert stats.ks_2samp(found, theta[rho <= 0.2]).pvalue > 1e-3
    assert stats.ks_2samp(found, theta[rho <= 0.1]).pvalue < 1e-3
    assert (run(structure(), seed=1).levels[0]["failed"]) > 0, "negative springs"
