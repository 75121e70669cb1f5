"""Runs of `SubsetSimulation`: what they report, budgets, refusals, simulators that fail, PyMC's own nodes."""

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest
from pymc.sampling.parallel import ParallelSamplingError
from scipy import stats

import pymc_features as pmf
from pymc_features.exceptions import (
    PopulationWarning,
    SimulationWarning,
    SubsetSimulationWarning,
    ToleranceNotReachedError,
)
from pymc_features.smc.kernels.subset import Levels
from support.refusals import refusals
from support.sampling import QUIET, mean_within_errors
from support.structures import noise_record, with_noise
from support.subset import Banana, ball, batched, cube, identity, itself, own, run, sample, stock, twice


def test_report_of_a_run(monkeypatch):
    """Tolerances, evidence and settings of three chains."""
    problem, fractions = Banana(), []
    lower = Levels.lower

    def recorded(levels, rho, chains):
        inside = lower(levels, rho, chains)
        fractions.append((levels.tolerance, np.mean(rho <= levels.tolerance)))
        assert len(inside) == np.sum(rho <= levels.tolerance)
        return inside

    monkeypatch.setattr(Levels, "lower", recorded)
    idata = sample(problem.model(), chains=3, p0=0.25, stage_draws=240)
    a, b = (idata.posterior[name].values.ravel() for name in "ab")
    rho = problem.rho(np.column_stack([a, b]), None)
    assert rho.size == 900
    assert rho.max() <= problem.epsilon * (1 + 1e-9), "for the arithmetic of another route"
    assert rho.max() > 0.99 * problem.epsilon
    found = idata.sample_stats
    expected = iter(fractions)
    for k, tolerances in enumerate(found["epsilon"].values):
        tolerances = tolerances[~np.isnan(tolerances)]
        assert tolerances[-1] == problem.epsilon
        assert (np.diff(tolerances) < 0).all()
        assert len(tolerances) > 3
        shares = [next(expected) for _ in tolerances]
        np.testing.assert_array_equal([t for t, _ in shares], tolerances)
        logs = np.cumsum(np.log([share for _, share in shares]))
        np.testing.assert_allclose(found["log_probability"].values[k, : len(tolerances)], logs, rtol=1e-12)
        assert found["log_marginal_likelihood"].values[k] == pytest.approx(logs[-1], rel=1e-12)
        assert all(0.25 <= share < 0.28 for _, share in shares[:-1]), "more only by repeated states"
    assert found["log_marginal_likelihood"].dims == found["log_marginal_likelihood_se"].dims == ("chain",)
    of_chains = {"log_marginal_likelihood", "log_marginal_likelihood_se"}
    for name in set(pmf.SubsetSimulation.stats_dtypes_shapes) - of_chains:
        assert found[name].dims == ("chain", "stage"), name
        assert found[name].dtype == float, name
    expected = {"p0": 0.25, "stage_draws": 240, "epsilon": 1e-3, "max_simulations": 30_000, "_n_draws": 300}
    assert {name: found.attrs[name] for name in expected} == expected


def test_edge_belongs_to_the_tolerance():
    """Whole numbers: rho = epsilon is inside, for stock distances, too, where a division would round."""
    with pm.Model() as model:
        k = pm.DiscreteUniform("k", 0, 60)
        pm.Simulator("y", lambda rng, k, size: np.full(21, k), k, signature="()->(21)",
                     distance="laplace", epsilon=42.0, observed=np.zeros(21))  # fmt: skip
    with pytest.warns(PopulationWarning):
        idata = sample(model, 600)
    assert set(np.unique(idata.posterior["k"])) == {0, 1, 2}


PULSE = noise_record(100)


def chain(theta):
    return pmf.SpringMassChain(np.ones(2), 400.0 * theta * np.ones(2), pmf.ModalDamping(0.05))


MEASURED = with_noise(pmf.simulate(chain(1.0), PULSE), 0.2)


@pytest.mark.slow
def test_structure_against_rejection():
    """A response node without a history: two-sample Kolmogorov-Smirnov at 1e-3 of every tenth draw.

    Half of the tolerance is the negative control.
    """
    rng = np.random.default_rng(0)
    grid = np.linspace(0.02, 3.0, 1500)
    rho = [np.square(pmf.simulate(chain(t), PULSE).values - MEASURED).mean(axis=1).sum() for t in grid]
    theta = rng.normal(1.0, 0.5, 300_000)
    theta = theta[(theta > 0.02) & (theta < 3.0)]
    rho = np.interp(theta, grid, rho)
    with pm.Model() as model:
        mu = pmf.response(chain(pm.Normal("theta", 1.0, 0.5)), PULSE)
        pmf.DiscrepancySimulator("y", mu, epsilon=0.2, observed=MEASURED)
    runs = [run(model, seed=seed) for seed in range(6)]
    found = np.concatenate([r.draws[::10, 0] for r in runs])
    assert stats.ks_2samp(found, theta[rho <= 0.2]).pvalue > 1e-3
    assert stats.ks_2samp(found, theta[rho <= 0.1]).pvalue < 1e-3
    assert runs[1].stages[0]["failed"] > 0, "negative springs"


@batched
def far(x):
    return np.abs(x) + 1.0


def unreachable():
    with pm.Model() as model:
        pmf.DiscrepancySimulator("y", far, pm.Normal("x", shape=2), epsilon=0.5, observed=np.zeros(2))
    return model


def test_unreachable_tolerance_stalls():
    """The smallest rho there is, 2, is named, and nearly reached."""
    match = (
        r"`epsilon` must be within reach of the simulator, got 0.5: after \d+ simulations the tolerance is "
        r"2\.00\d+ and the smallest rho 2\.00\d*. The last levels came no nearer: increase `epsilon`, or"
    )
    with pytest.raises(ToleranceNotReachedError, match=match):
        sample(unreachable())


@pytest.mark.processes
def test_unreachable_tolerance_in_processes():
    """PyMC wraps the error of a process; `sample_smc` raises it as it is."""
    settings = {"chains": 2, "cores": 2, **QUIET}
    with pytest.raises(ToleranceNotReachedError, match="`epsilon` must be within reach"):
        pmf.sample_smc(200, pmf.SubsetSimulation, model=unreachable(), **settings)
    with pytest.raises(ParallelSamplingError, match="failed with: `epsilon` must be within") as caught:
        pm.sample_smc(200, pmf.SubsetSimulation, model=unreachable(), **settings)
    assert isinstance(caught.value.__cause__, ToleranceNotReachedError)


def test_last_level_cut_short_warns():
    """The draws are inside, but correlated, and the budget holds."""
    model = ball(2, 0.01)
    needed = run(model, 2000, stage_draws=200)
    before = needed.simulations - needed.stages[-1]["evaluations"]
    with pytest.warns(SubsetSimulationWarning, match="`max_simulations` were spent before the chains had"):
        cut = run(model, 2000, stage_draws=200, max_simulations=before + 300)
    assert cut.simulations <= before + 300
    assert cut.draws.shape == (2000, 2)
    assert (np.square(cube(cut)).sum(axis=1) <= 0.01 * (1 + 1e-9)).all()
    with pytest.warns(SubsetSimulationWarning, match="`max_simulations` were spent"):
        none = run(model, 2000, stage_draws=200, max_simulations=before)
    assert none.simulations == before
    assert (np.square(cube(none)).sum(axis=1) <= 0.01 * (1 + 1e-9)).all()


def test_ties_do_not_stall():
    """Counts: most of the prior shares one rho. Evidence within four standard errors, exact shares.

    Shares of 4 x 500 draws, taken for independent, by chi-squared at 1e-4 of every fourth draw.
    """
    with pm.Model() as model:
        k = pm.Poisson("k", 12.0)
        pmf.DiscrepancySimulator(
            "y", lambda k: np.array([float(k // 6)]), k, epsilon=0.5, observed=np.zeros(1)
        )
    runs = [run(model, seed=seed) for seed in range(4)]
    exact = stats.poisson(12)
    for r in runs:
        assert abs(r.evidence - exact.logcdf(5)) < 4.0 * r.se
    found = np.concatenate([np.round(r.draws[::4, 0]) for r in runs])
    counts = np.array([(found <= 3).sum(), (found == 4).sum(), (found == 5).sum()])
    expected = np.array([exact.cdf(3), exact.pmf(4), exact.pmf(5)]) / exact.cdf(5) * len(found)
    assert counts.sum() == len(found)
    assert stats.chisquare(counts, expected * counts.sum() / expected.sum()).pvalue > 1e-4


@pytest.mark.slow
def test_potential_and_second_likelihood():
    """Importance weights of rejected prior draws: weighted moments, and the evidence of both together.

    Means of 16 chains within 4.5 standard errors of theirs and the reference's: 4e-4 each.
    """
    with pm.Model() as model:
        x = pm.Normal("x", shape=2)
        pm.Potential("bent", -pt.abs(x[0] - x[1]))
        pm.Normal("z", x[1], 0.5, observed=0.7)
        pmf.DiscrepancySimulator("y", itself, x, epsilon=0.02, observed=np.array([0.4, 0.1]))
    rng = np.random.default_rng(0)
    exact = rng.standard_normal((2_000_000, 2))
    exact = exact[((exact - [0.4, 0.1]) ** 2).sum(axis=1) <= 0.02]
    weights = np.exp(-np.abs(exact[:, 0] - exact[:, 1])) * stats.norm.pdf(0.7, exact[:, 1], 0.5)
    evidence = weights.sum() / 2_000_000
    runs = [run(model, seed=seed) for seed in range(16)]
    assert mean_within_errors([r.evidence for r in runs], np.log(evidence), 1.0 / np.sqrt(len(exact)), 4.5)
    for statistic in (lambda x: x[:, 0], lambda x: x[:, 1], lambda x: (x[:, 0] - x[:, 1]) ** 2):
        mean = np.average(statistic(exact), weights=weights)
        error = statistic(exact).std() / np.sqrt(len(exact))
        assert mean_within_errors([statistic(r.draws).mean() for r in runs], mean, error, 4.5)
    plain = statistic(exact).mean()
    assert not mean_within_errors([statistic(r.draws).mean() for r in runs], plain, error, 4.5), (
        "the weights matter"
    )


def test_potentials_that_leave_no_room_are_refused():
    with pm.Model() as model:
        x = pm.Normal("x", shape=2)
        pm.Potential("narrow", -5e4 * pt.sum(x**2))
        pmf.DiscrepancySimulator("y", itself, x, epsilon=0.02, observed=np.zeros(2))
    with pytest.raises(ValueError, match="must leave room for draws from the prior.*Put them into the prior"):
        sample(model)


def without_simulator():
    with pm.Model() as model:
        pm.Normal("z", pm.Normal("x"), 1.0, observed=0.0)
    return model


def with_two():
    model = own(itself)
    with model:
        pm.Simulator("z", identity, model["x"], observed=np.zeros(1))
    return model


def of_each():
    return stock(twice, observed=[0.0, 0.0], epsilon=np.array([0.1, 0.4]))


REFUSED = {  # what is said: what is given
    "`model` must have one pm.Simulator node, got none. Declare one with Disc": (without_simulator, {}),
    "`model` must have one pm.Simulator node, got y, z. Declare": (with_two, {}),
    "`p0` must lie between 0 and 1, got 0.0. The default is 0.2": (None, {"p0": 0.0}),
    "`p0` must lie between 0 and 1, got nan": (None, {"p0": np.nan}),
    "`draws` must be an integer of at least 2, got 1": (None, {"draws": 1}),
    "`stage_draws` must be an integer of at least 20, got 19": (None, {"stage_draws": 19}),
    "`stage_draws` must be an integer of at least 40, got 39": (None, {"stage_draws": 39, "p0": 0.1}),
    "`max_simulations` must allow for 400 draws from the prior, got": (None, {"max_simulations": 399}),
    "`max_simulations` must allow for 400 draws from the prior": (None, {"max_simulations": np.nan}),
    "`epsilon` must be positive and finite, got 0.0": (None, {"epsilon": 0.0}),
    "`epsilon` must be positive and finite, got inf": (None, {"epsilon": np.inf}),
    "`epsilon` must be left out where y has one for each sensor, got 0.1": (of_each, {"epsilon": 0.1}),
}


@refusals("build settings", REFUSED)
def test_refusals(build, settings, match):
    model = ball(2, 0.01) if build is None else build()
    with pytest.raises(ValueError, match=match):
        pmf.SubsetSimulation(**{"draws": 100, "model": model, **settings})


def raising(error):
    def function(x):
        if x < 0:
            raise error(f"no solution at {x}")
        return np.array([x])

    return function


@batched
def batched_raising(x):
    if (x < 0).any():
        raise np.linalg.LinAlgError("singular")
    return x[:, None]


@batched
def batched_nan(x):
    return np.where(x < 0, np.nan, x)[:, None]


def stock_raising(rng, x, size):
    if x < 0:
        raise KeyError("no solution")
    return x


@batched
def stock_batched_raising(rng, x, size):
    if (x < 0).any():
        raise TypeError("no solution")
    return identity(rng, x, size)


FAILING = {
    "RuntimeError": lambda: own(raising(RuntimeError)),
    "-inf": lambda: own(lambda x: np.array([-np.inf if x < 0 else x])),
    "batched error": lambda: own(batched_raising),
    "batched nan": lambda: own(batched_nan),
    "stock": lambda: stock(stock_raising, epsilon=0.01),
    "stock batched": lambda: stock(stock_batched_raising, epsilon=0.01),
}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:particles are evaluated one by one")
@pytest.mark.filterwarnings("ignore:the simulator failed")
@pytest.mark.parametrize("build", FAILING.values(), ids=FAILING)
def test_failed_simulations_are_counted_and_rejected(build):
    """Half of the prior fails: P = 0.01 / 2, within four of its standard errors (a false alarm in 1e4)."""
    idata = sample(build(), 200, stage_draws=200)
    x = idata.posterior["x"].values
    assert ((x >= 0) & (x <= 0.01)).all()
    stats_ = idata.sample_stats
    assert abs(stats_["failed"].values[0, 0] - 100) < 60, "of the first 200, and of the first level's moves"
    assert stats_["failed"].values[0, -1] < 100
    error = float(stats_["log_marginal_likelihood"][0]) - np.log(0.005)
    assert abs(error) < 4.0 * float(stats_["log_marginal_likelihood_se"][0])


def test_one_warning_for_each_type_of_exception():
    """Their texts differ each time; thousands of them would hide all else."""
    match = r"the simulator failed: RuntimeError: no solution at -\S+\. Parameters at which it does are"
    with pytest.warns(SimulationWarning, match=match) as caught:
        sample(own(raising(RuntimeError)), 200)
    assert sum(issubclass(w.category, SimulationWarning) for w in caught) == 1


@batched
def wrong_batch(x):
    return np.zeros(1)


def always(rng, x, size):
    raise OSError("no licence")


A_SIMULATOR_THAT_NEVER_SUCCEEDS_IS_REFUSED = {  # what is said: what is given
    r"\(400 failed simulations, the last with ZeroDivisionError: d": lambda: own(lambda x: 1 / 0),
    r"\(400 failed simulations, the last with OSError: no licence": lambda: stock(always, epsilon=1.0),
    r"\(400 failed simulations\)": lambda: own(lambda x: np.array([np.nan])),
    r"must return the shape of `observed`, \(1,\), got \(2,\)": lambda: own(lambda x: np.zeros(2)),
    r"must return the shape of `observed`, \(1, 1\), got \(1,\)": lambda: own(wrong_batch),
}


@pytest.mark.filterwarnings("ignore:particles are evaluated one by one")
@pytest.mark.filterwarnings("ignore:the simulator failed")
@refusals("build", A_SIMULATOR_THAT_NEVER_SUCCEEDS_IS_REFUSED)
def test_a_simulator_that_never_succeeds_is_refused(build, match):
    with pytest.raises(ValueError, match=match):
        sample(build(), 100, stage_draws=200)


def largest(model, **settings):
    return float(np.abs(sample(model, 400, **settings).posterior["x"]).max())


CUSTOM = {"distance": lambda epsilon, y, s: -pt.sqr(y - s) / epsilon}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "edge"),
    [
        ({"distance": "gaussian", "epsilon": 0.1}, 0.1 / np.sqrt(5)),
        ({**CUSTOM, "epsilon": 0.01}, np.sqrt(0.01 / 5)),
        ({"distance": "gaussian", "epsilon": 0.1, "sum_stat": "mean"}, 0.2),
        ({"distance": "laplace", "epsilon": np.array([0.1, 0.4])}, 1 / (1 / 0.1 + 2 / 0.4)),
    ],
    ids=["gaussian", "function", "mean", "laplace of each"],
)
def test_thresholds_of_stock_distances(settings, edge):
    """(x, -2 x) against zeros: the largest of 400 |x|, uniform up to the edge, is within 5 % of it.

    Draws count for 200 or more: a false alarm in 3e4.
    """
    found = largest(stock(twice, observed=[0.0, 0.0], **settings))
    assert 0.95 * edge < found <= edge * (1 + 1e-12)


def test_tolerance_may_be_data():
    """New data take effect in the next run, and an argument goes before them."""
    with pm.Model() as model:
        x = pm.Uniform("x", -1.0, 1.0)
        pm.Simulator("y", identity, x, epsilon=pm.Data("epsilon", 0.2), observed=np.zeros(1))
    for epsilon in (0.2, 0.02, 0.3):
        with model:
            pm.set_data({"epsilon": epsilon})
        assert 0.95 * epsilon < largest(model) <= epsilon
    assert 0.095 < largest(model, epsilon=0.1) <= 0.1
    with model:
        pm.set_data({"epsilon": -1.0})
    with pytest.raises(ValueError, match="`epsilon` must be positive and finite, got -1.0"):
        largest(model)


@pytest.mark.slow
@pytest.mark.filterwarnings("error:SubsetSimulation draws from rho")
@pytest.mark.parametrize("kernel", ["exponential", "stock"])
def test_soft_kernels_give_the_threshold_with_a_warning(kernel):
    def build(kernel):
        if kernel == "stock":
            return stock(identity, epsilon=0.1)
        with pm.Model() as model:
            x = pm.Uniform("x", -1.0, 1.0, shape=1)
            pmf.DiscrepancySimulator("y", itself, x, epsilon=0.01, observed=np.zeros(1), kernel=kernel)
        return model

    model = build(kernel)
    with pytest.warns(SubsetSimulationWarning, match="not with the soft kernel of y.*sample_smc") as caught:
        found = largest(model)
    [warning] = [w for w in caught if issubclass(w.category, SubsetSimulationWarning)]
    assert warning.filename == sample.__code__.co_filename, "it points to the user's line"
    assert 0.095 < found <= 0.1
    largest(build("uniform"))
