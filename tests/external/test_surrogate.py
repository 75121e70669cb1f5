"""The surrogate of expensive simulators, against the posterior that simulations alone give."""

import pickle
from concurrent.futures import Future

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
from pytensor.graph.replace import vectorize_graph
from scipy import optimize, spatial, special, stats
from scipy.integrate import quad

from pymc_features import (
    ExpFeature,
    ExternalSimulator,
    Record,
    Surrogate,
    TruncNormalFeature,
    mean_square_discrepancy,
    paper,
    response,
    sample_smc,
    simulate,
)
from pymc_features.external.surrogate import learner, surrogate
from pymc_features.external.surrogate.gaussian_process import GaussianProcess, unit_kernel
from pymc_features.processes.calls import Outcome

GROUPS = ([0, 1, 2], [3, 4, 5], [6, 7, 8, 9])  # springs that share a factor
LEVELS = (0.05, 0.5, 0.95)
LOW, HIGH, SIGMA = 0.8, 1.2, 0.5  # uniform priors of the factors, and of sigma from zero [m/s^2]


def ten_storeys(factors):
    """The example of the source with three unknown stiffness factors."""
    structure = paper.chain(1.0)
    for i, springs in enumerate(GROUPS):
        structure = structure.scale_stiffness(factors[i], springs=springs)
    return structure


@pytest.fixture(scope="module")
def example(record):
    """Data (sensor, time) of the strong part of the record, and the exact e_j of many factors (p, 3)."""
    strong = Record(record.acceleration[:400], record.dt)
    exact = simulate(ten_storeys(np.ones(3)), strong)
    noise = paper.noise_scale(exact)[:, None] * np.random.default_rng(0).standard_normal(exact.shape)
    data = exact.values + noise
    x = pt.vector("x", shape=(3,))
    e = mean_square_discrepancy(response(ten_storeys(x), strong), data)
    many = pt.matrix("many", shape=(None, 3))
    return data, pytensor.function([many], vectorize_graph(e, {x: many}), mode="FAST_COMPILE")


class AtOnce:
    """An executor that asks a function for e_j, without a process; counts."""

    def __init__(self, discrepancy):
        self.discrepancy, self.runs = discrepancy, 0

    def submit(self, function, digest, arguments, *_):
        """The result, done."""
        self.runs += 1
        future = Future()
        future.set_result(Outcome("ok", self.discrepancy(np.array([arguments]))[0]))
        return future


class Remembering(Surrogate):
    """Keeps what it answered."""

    def evaluate(self, x, run, data=""):
        """As always."""
        e = super().evaluate(x, run, data)
        self.answers = [*getattr(self, "answers", []), np.column_stack([x, e.sum(axis=1)])]
        return e


def error_of_answers(draws, answers, discrepancy, factor=1):
    """Largest change of a quantile, over the width, when draws (draw, x and sigma) get their true weights.

    `factor` is what the likelihood multiplies e_j / (2 sigma^2) by. The draws are the same, so that this is
    the surrogate's error and not the sampler's.
    """
    answers = np.concatenate(answers)
    distance, place = spatial.cKDTree(answers[:, :3]).query(draws[:, :3])
    assert distance.max() < 1e-9  # the sampler transforms parameters
    excess = discrepancy(draws[:, :3]).sum(axis=1) - answers[place, 3]
    log_weights = -factor * excess / (2.0 * draws[:, 3] ** 2)
    weights = np.exp(log_weights - log_weights.max())
    worst = 0.0
    for column in draws.T:
        before, after = (weighted_quantiles(column, w) for w in (np.ones(len(draws)), weights))
        worst = max(worst, np.max(np.abs(before - after)) / (after[2] - after[0]))
    return worst


def weighted_quantiles(x, weights):
    """Quantiles (level,) of weighted points (point,)."""
    order = np.argsort(x)
    return np.interp(LEVELS, (np.cumsum(weights[order]) - 0.5 * weights[order]) / weights.sum(), x[order])


def sampled(example, likelihood, surrogate, draws):
    """Draws of factors and sigma (draw, 4), evaluations of the likelihood, and simulations."""
    data, discrepancy = example
    executor = AtOnce(discrepancy)
    simulator = ExternalSimulator(
        ten_storeys, data.shape, executor=executor, surrogate=surrogate, progress=False, version="1"
    )
    with pm.Model():
        factors = [pm.Uniform(f"x{i}", LOW, HIGH) for i in range(3)]
        sigma = pm.Uniform("sigma", 0.0, SIGMA)
        likelihood("y", mu=simulator(*factors), sigma=sigma, observed=data)
        result = sample_smc(draws, chains=1, random_seed=1, progressbar=False)
    names = ("x0", "x1", "x2", "sigma")
    x = np.stack([result["posterior"][name].values.ravel() for name in names], axis=1)
    return x, int(result["sample_stats"]["evaluations"].sum()), executor.runs


@pytest.fixture(scope="module")
def exact(example):
    """Exact quantiles (3, level) under TN, M = 10, by importance sampling about the best fit."""
    total = lambda x: example[1](np.atleast_2d(x)).sum(axis=1)  # noqa: E731
    best = optimize.minimize(lambda x: total(x)[0], np.ones(3), method="Nelder-Mead", tol=1e-10)
    steps = 2e-3 * np.eye(3)
    hessian = [
        [
            np.dot([1, -1, -1, 1], [total(best.x + i * a + j * b)[0] for i in (1, -1) for j in (1, -1)])
            for a in steps
        ]
        for b in steps
    ]
    spread = np.linalg.inv(np.array(hessian) / (2 * 2e-3) ** 2) * best.fun
    mixture = [stats.multivariate_t(best.x, spread * scale, df=4, seed=7) for scale in (0.15, 0.5, 3.0)]
    x = np.concatenate([part.rvs(5_000) for part in mixture])
    x = x[((x > LOW) & (x < HIGH)).all(axis=1)]
    s = np.concatenate([total(part) for part in np.array_split(x, 10)])
    a = 0.5 * (10 - 1)
    weights = (s / best.fun) ** -a * special.gammaincc(a, s / (2.0 * SIGMA**2))  # sigma integrated out
    weights /= sum(part.pdf(x) for part in mixture)
    assert weights.sum() ** 2 / (weights**2).sum() > 2_500
    return np.array([weighted_quantiles(column, weights) for column in x.T])


def worst_error(x, exact):
    """Largest error of a quantile, over the exact 5-95 % width."""
    found = np.quantile(x[:, :3], LEVELS, axis=0).T
    return np.max(np.abs(found - exact) / (exact[:, 2:] - exact[:, :1]))


@pytest.mark.statistical
def test_five_times_fewer_runs_and_the_same_posterior(example, exact):
    """Under TN; under EXP, whose tails are shorter, fewer still."""
    predicting = Remembering(1, random_seed=0)
    x, evaluations, runs = sampled(example, TruncNormalFeature, predicting, 1000)
    report = predicting.report()
    assert report["runs"] == runs
    assert report["runs"] + report["predicted"] >= evaluations
    assert 5 * runs < evaluations
    assert error_of_answers(x, predicting.answers, example[1]) < 0.05
    assert worst_error(x, exact) < 0.12  # of 1000 draws: the sampler's error, mostly
    assert report["checked"] > 50
    assert report["error"] < 0.3
    assert report["excess"] < 1.0


@pytest.mark.statistical
def test_the_conventional_likelihood_has_many_degrees_of_freedom(example):
    """A surrogate that is told of them is good enough for it, with a third of the runs."""

    def normal(name, mu, sigma, observed):
        return pm.Normal(name, mu=mu, sigma=sigma, observed=observed)

    n_times = example[0].shape[1]
    predicting = Remembering(n_times, random_seed=0)
    x, evaluations, runs = sampled(example, normal, predicting, 200)
    assert 3 * runs < evaluations
    assert error_of_answers(x, predicting.answers, example[1], n_times) < 0.05


@pytest.mark.statistical
def test_a_useless_surrogate_gives_itself_away(example):
    """Negative control: nothing is demanded of the predictions."""
    careless = Remembering(2, tolerance=1e6, check_fraction=0.005, random_seed=0)
    x, evaluations, runs = sampled(example, ExpFeature, careless, 400)
    assert runs < 0.05 * evaluations
    assert careless.report()["error"] > 1.0


def bowl(x):
    """e_j (point, 4), with a minimum."""
    x = np.atleast_2d(x)
    return 0.1 + np.sum((x - 0.4) ** 2, axis=1, keepdims=True) * np.array([1.0, 2.0, 0.5, 1.0])


def fed(predicting, function=bowl, n_batches=4, data="", batch=60):
    """Results of some populations, one after the other, and the populations."""
    rng = np.random.default_rng(1)
    xs = [0.4 + rng.uniform(-0.4, 0.6, (batch, 2)) / (1 + k) for k in range(n_batches)]
    return np.concatenate([predicting.evaluate(x, lambda rows, x=x: function(x[rows]), data) for x in xs]), xs


@pytest.mark.slow
def test_predictions_are_close_and_runs_are_exact():
    predicting = Surrogate(1, tolerance=0.02, random_seed=0)
    e, xs = fed(predicting)
    true = bowl(np.concatenate(xs))
    report = predicting.report()
    np.testing.assert_allclose(e, true, rtol=0.05)
    assert (e == true).all(axis=1).sum() == report["runs"] == 240 - report["predicted"]
    assert report["runs"] < 80
    everything = Surrogate(1, check_fraction=1.0)
    assert np.array_equal(fed(everything)[0], true)
    assert everything.report()["checked"] > 150


def error_near_the_best(degrees_of_freedom, **settings):
    """Runs, and root-mean-square error of predictions near the best fit [nats of NORM with 400 samples].

    Populations that close in on the minimum of a bowl with ripples, of four sensors: nothing depends on a
    sampler.
    """

    def rippled(x):
        return bowl(x) * (1.0 + 0.05 * np.sin(9.0 * x[:, :1]))

    predicting, rng = Surrogate(degrees_of_freedom, **settings), np.random.default_rng(1)
    xs = [0.4 + rng.uniform(-0.4, 0.6, (80, 2)) * 0.4**k for k in range(5)]
    found = [predicting.evaluate(x, lambda rows, x=x: rippled(x[rows])).sum(axis=1) for x in xs]
    exact = rippled(np.concatenate(xs)).sum(axis=1)
    error = 800.0 * np.log(np.concatenate(found) / exact)
    near = (800.0 * np.log(exact / exact.min()) < 10.0) & (error != 0.0)
    assert near.sum() > 100
    return predicting.report()["runs"], np.sqrt(np.mean(error[near] ** 2))


@pytest.mark.parametrize("seed", range(3))
def test_degrees_of_freedom_say_how_exact_predictions_must_be(seed):
    """Of one that is told of all 400; one that is told of a single one, or of nothing, is 10 times worse."""
    runs, error = error_near_the_best(400, random_seed=seed)
    assert error < 0.005
    for settings in ({"degrees_of_freedom": 1}, {"degrees_of_freedom": 400, "tolerance": 1e6}):
        fewer, worse = error_near_the_best(**settings, random_seed=seed)
        assert fewer < runs
        assert worse > 0.05


def test_failures_are_run_and_told():
    def fails(x):
        e = bowl(x)
        e[x[:, 0] > 0.6] = np.nan
        return e

    predicting = Surrogate(1, random_seed=0)
    e, xs = fed(predicting, fails)
    true = fails(np.concatenate(xs))
    failed = np.isnan(true).any(axis=1)
    found = np.isnan(e).any(axis=1)
    assert failed.sum() > 20
    # only at the very border may one be taken for a success
    assert (failed & ~found).sum() <= 0.1 * failed.sum()
    assert not (found & ~failed).any()
    assert predicting.report()["failed"] == found.sum()
    assert predicting.report()["predicted"] > 50
    nothing = Surrogate(1, random_seed=0)
    assert np.isnan(fed(nothing, lambda x: np.full((len(x), 4), np.nan))[0]).all()
    assert nothing.report()["runs"] == nothing.report()["failed"] == 240


@pytest.mark.parametrize("error", [np.linalg.LinAlgError, ValueError])
def test_what_cannot_be_fitted_is_run(monkeypatch, error):
    def refuse(*arguments):
        raise error("singular")

    monkeypatch.setattr(learner, "fit_lengths", refuse)
    predicting = Surrogate(1, random_seed=0)
    e, xs = fed(predicting)
    assert np.array_equal(e, bowl(np.concatenate(xs)))
    assert predicting.report()["predicted"] == 0


def test_constant_results_and_a_constant_parameter_do_no_harm():
    def flat(x):
        return np.full((len(x), 4), 2.0)

    np.testing.assert_allclose(fed(Surrogate(1, random_seed=0), flat)[0], 2.0)
    predicting = Surrogate(1, random_seed=0)
    for _ in range(3):
        x = np.column_stack([np.random.default_rng(5).uniform(size=60), np.ones(60)])
        e = predicting.evaluate(x, lambda rows, x=x: bowl(x[rows]))
        np.testing.assert_allclose(e, bowl(x), rtol=0.05)


def test_results_depend_on_nothing_but_the_populations():
    def discrepancy(a, b):
        return 0.1 + ((a - 0.4) ** 2 + (b - 0.4) ** 2) * np.array([1.0, 2.0, 0.5, 1.0])

    results = []
    for executor in (1, 3, AtOnce(bowl)):
        with ExternalSimulator(
            discrepancy,
            (4, 9),
            returns="mean_square",
            executor=executor,
            surrogate=Surrogate(1, random_seed=0),
            progress=False,
        ) as simulator:
            directly, xs = fed(Surrogate(1, random_seed=0))
            results.append(np.concatenate([simulator.discrepancies(*x.T, observed=None) for x in xs]))
    assert np.array_equal(results[0], results[1])
    np.testing.assert_allclose(results[0], results[2], rtol=1e-9)
    np.testing.assert_allclose(results[0], directly, rtol=1e-9)
    first, travelled = Surrogate(1, random_seed=0), Surrogate(1, random_seed=0)
    fed(first, n_batches=2)
    fed(travelled, n_batches=2)
    travelled = pickle.loads(pickle.dumps(travelled))
    assert np.array_equal(fed(first)[0], fed(travelled)[0])
    assert not np.array_equal(fed(Surrogate(1, random_seed=0))[0], fed(Surrogate(1, random_seed=1))[0])


def test_data_sets_are_learnt_apart():
    predicting = Surrogate(1, random_seed=0)
    alone = fed(Surrogate(1, random_seed=0))[0]
    assert np.array_equal(fed(predicting, data="a")[0], alone)
    assert np.array_equal(fed(predicting, lambda x: 7.0 * bowl(x), data="b")[0] > alone, np.ones_like(alone))
    assert np.array_equal(fed(Surrogate(1, random_seed=0), lambda x: 7.0 * bowl(x))[0].shape, alone.shape)
    assert len(predicting.learners) == 2


def test_gaussian_process_is_kriging():
    """Against the bordered system of ordinary kriging, and a further point against starting anew."""
    rng = np.random.default_rng(0)
    x, y, new = rng.uniform(size=(12, 2)), rng.normal(size=(12, 3)), rng.uniform(size=(5, 2))
    lengths = np.array([0.5, 0.8])
    kernel = unit_kernel(lengths)
    process = GaussianProcess(x, y, lengths, 1e-3)
    predicted = process.predict(new)
    ones = np.ones((12, 1))
    bordered = np.block([[kernel(x) + (1e-3 + 1e-9) * np.eye(12), ones], [ones.T, np.zeros((1, 1))]])
    right = np.vstack([kernel(x, new), np.ones((1, 5))])
    solved = np.linalg.solve(bordered, right)
    np.testing.assert_allclose(predicted.mean, solved[:12].T @ y, rtol=1e-9)
    np.testing.assert_allclose(predicted.variance, 1.0 - np.sum(right * solved, axis=0), rtol=1e-8)
    predicted.learn(3)
    variance = predicted.learn(1)
    exactly = GaussianProcess(x, y, lengths, 0.0).predict(new)
    exactly.learn(3)
    exactly.learn(1)
    more = GaussianProcess(np.vstack([x, new[[3, 1]]]), np.vstack([y, y[:2]]), lengths, 0.0)
    np.testing.assert_allclose(exactly.variance, more.predict(new).variance, atol=1e-7)
    assert exactly.variance.max() > 1e-4
    assert variance[1] < 1e-12
    assert (variance <= predicted.variance).all()


@pytest.mark.parametrize(("m", "n_parameters"), [(10, 3), (20, 3), (8, 1)])
def test_share_of_the_posterior_beyond_a_depth(m, n_parameters):
    def density(r):
        return r ** (n_parameters - 1) * (1.0 + r**2) ** (-0.5 * (m - 1))

    for depth in (0.5, 2.0, 6.0):
        edge = np.sqrt(np.expm1(2.0 * depth / m))
        share = quad(density, edge, np.inf)[0] / quad(density, 0.0, np.inf)[0]
        assert learner.posterior_beyond(depth, m, n_parameters) == pytest.approx(share, rel=1e-6)
    assert learner.posterior_beyond(-3.0, m, n_parameters) == 1.0
    assert np.isfinite(learner.posterior_beyond(2.0, 1, 3))


def test_scikit_learn_is_asked_for(monkeypatch):
    monkeypatch.setattr(surrogate, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match="needs scikit-learn, which is not installed. Install it with: pip"):
        Surrogate(1, random_seed=0)


def test_settings_are_checked():
    for settings, message in [
        ({"tolerance": 0.0}, "`tolerance` must be positive and finite, got 0.0"),
        ({"tolerance": "small"}, "`tolerance` must be positive"),
        ({"degrees_of_freedom": -1}, "`degrees_of_freedom` must be positive"),
        ({"n_initial": 2}, "`n_initial` must be an integer of at least 5, got 2"),
        ({"max_points": 30.5}, "`max_points` must be an integer"),
        ({"check_fraction": 2.0}, "`check_fraction` must lie between 0 and 1, got 2.0"),
        ({"random_seed": -1}, "`random_seed` must be an integer of at least 0"),
    ]:
        with pytest.raises(ValueError, match=message):
            Surrogate(**{"degrees_of_freedom": 1, **settings})
    with pytest.raises(TypeError, match="`surrogate` must be a Surrogate, got bool. Pass pmf.Surrogate"):
        ExternalSimulator(bowl, (4, 9), surrogate=True)


def test_checkpoints_tell_surrogates_apart():
    def identity(surrogate):
        return ExternalSimulator(bowl, (4, 9), surrogate=surrogate, version="1").identity

    assert identity(Surrogate(1, random_seed=0)) == identity(Surrogate(1, random_seed=0))
    others = None, Surrogate(1, random_seed=0), Surrogate(1, tolerance=0.2, random_seed=0)
    assert len({identity(surrogate) for surrogate in others}) == 3
