"""Subset simulation of simulators that fail, and of PyMC's own nodes."""

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest

from pymc_features import DiscrepancySimulator
from pymc_features.exceptions import SimulationWarning, SubsetSimulationWarning
from support.refusals import refusals
from support.subset import batched, identity, itself, own, sample, stock, twice


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
            DiscrepancySimulator("y", itself, x, epsilon=0.01, observed=np.zeros(1), kernel=kernel)
        return model

    model = build(kernel)
    with pytest.warns(SubsetSimulationWarning, match="not with the soft kernel of y.*sample_smc") as caught:
        found = largest(model)
    [warning] = [w for w in caught if issubclass(w.category, SubsetSimulationWarning)]
    assert warning.filename == sample.__code__.co_filename, "it points to the user's line"
    assert 0.095 < found <= 0.1
    largest(build("uniform"))
