"""External simulators: results, densities and gradients."""

import functools
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pymc as pm
import pytensor
import pytest

from pymc_features import (
    ExternalSimulator,
    RayleighDamping,
    SpringMassChain,
    response,
)
from pymc_features.exceptions import NotDifferentiableError, UnusableSimulatorError
from pymc_features.smc import population_logp
from support import external_functions as functions
from support.external_functions import DATA, SHAPE, beam
from support.external_models import LIKELIHOODS, BrokenElsewhere, model_of
from support.sampling import QUIET
from support.straight import Record


def test_responses_and_discrepancies(simulator):
    s = simulator(executor=2)
    k = np.array([1.0, 2.0, 4.0, 2.0])
    np.testing.assert_array_equal(s.responses(k), [beam(x) for x in k])
    assert s.counts["ok"] == 3  # equal parameters run once
    e = s.discrepancies(k, observed=DATA)
    np.testing.assert_array_equal(e, [np.mean((DATA - beam(x)) ** 2, axis=1) for x in k])
    squares = simulator(functions.beam_squares, returns="mean_square")
    np.testing.assert_array_equal(squares.discrepancies(k, observed=DATA), e)
    with pytest.raises(ValueError, match="must return responses for this"):
        squares.responses(k)
    with pytest.raises(ValueError, match="a row for each particle"):
        s.responses(1.0)
    with pytest.raises(ValueError, match="`observed` must have shape"):
        s.discrepancies(k, observed=DATA[0])
    assert repr(s) == "ExternalSimulator(beam, shape=(2, 5))"
    with pytest.raises(ValueError, match="must be called with parameters, got none"):
        s()
    with pytest.raises(ValueError, match=r"`observed` must have shape .* Transpose it"):
        model_of("TN", s, DATA.T)
    np.testing.assert_array_equal(s(2.0).eval(), beam(2.0))


@pytest.fixture(scope="module")
def chain_case():
    """A small chain of the package, and the same by matrix exponentials in other processes."""
    record = Record(np.random.default_rng(0).normal(size=60), 0.02, name="pulse")
    function = functools.partial(
        functions.chain_response, acceleration=np.array(record.acceleration), dt=record.dt
    )
    observed = function(1.0) + 0.05 * np.random.default_rng(1).normal(size=(3, 60))

    def internal(theta):
        base = SpringMassChain(np.ones(3), 100.0, RayleighDamping(0.1, 1e-3))
        return response(base.scale_stiffness(theta, springs=[0]), record)

    with ExternalSimulator(function, (3, 60), executor=2, progress=False) as external:
        yield internal, external, observed


@pytest.mark.slow
@pytest.mark.parametrize("likelihood", LIKELIHOODS)
def test_densities_are_those_of_the_response(likelihood, chain_case):
    internal, external, observed = chain_case
    values, steps = [], []
    particles = np.random.default_rng(2).normal(size=(6, 2))
    for mu_of in (internal, external):
        model = model_of(likelihood, mu_of, observed)
        logp = population_logp(model, model.initial_point(), {})
        assert logp.batched
        values.append(logp(particles))
        steps.append(model.compile_logp()({"theta_interval__": 0.3, "sigma_interval__": -0.2}))
    np.testing.assert_allclose(values[1][0], values[0][0], rtol=1e-12)
    np.testing.assert_allclose(values[1][1], values[0][1], rtol=1e-8)
    np.testing.assert_allclose(steps[1], steps[0], rtol=1e-8)
    assert not values[1][2].any()


@pytest.mark.slow
@pytest.mark.parametrize("likelihood", ["TN", "ABC"])
def test_mean_squares_do_as_well_as_responses(likelihood, simulator):
    point = {"theta_interval__": 0.3, "sigma_interval__": -0.2}
    kinds = (simulator(), simulator(functions.beam_squares, returns="mean_square"))
    a, b = (model_of(likelihood, s, DATA).compile_logp()(point) for s in kinds)
    np.testing.assert_allclose(b, a, rtol=1e-12)
    with pytest.raises(ValueError, match="`mu` must be a history here"):
        model_of("correlated", kinds[1], DATA).compile_logp()
    with pytest.raises(ValueError, match="must return responses for this"):
        model_of("NORM", kinds[1], DATA).compile_logp()(point)


def test_failures_are_impossible_and_counted(simulator):
    s = simulator(functions.ways_to_fail)
    for likelihood in LIKELIHOODS:
        with pm.Model() as model:
            k = pm.Normal("k", 0.0, 9.0)
            LIKELIHOODS[likelihood](s(k), 1.0, DATA)
        prior, values, failed = population_logp(model, model.initial_point(), {})(np.array([[1.0], [1.5]]))
        assert failed.tolist() == [True, False]
        assert values[0] == -np.inf and np.isfinite([*prior, values[1]]).all()
        assert {f.parameters for f in s.failures} == {(1.0,)}


def test_predictive_draws(simulator):
    s = simulator()
    model = model_of("ABC", s, DATA)
    with model:
        prior = pm.sample_prior_predictive(4, random_seed=1)
    theta = prior.prior["theta"].values.ravel()
    y = prior.prior_predictive["y"].values.reshape(4, *SHAPE)
    np.testing.assert_allclose(y, [beam(t) for t in theta])
    with model_of("TN", s, DATA):
        posterior = pm.sample_posterior_predictive(prior.prior, progressbar=False, random_seed=1)
    y = posterior.posterior_predictive["y"].values.reshape(4, *SHAPE)
    sigma = prior.prior["sigma"].values.ravel()
    mean_squares = np.mean((y - [beam(t) for t in theta]) ** 2, axis=2) / sigma[:, None] ** 2
    assert (mean_squares < 16.0).all() and mean_squares.std() > 0.1  # chi-square of one degree of freedom


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind, likelihood",
    [("response", "NORM"), ("response", "ABC"), ("mean_square", "TN")],
)
def test_gradient_against_differences(kind, likelihood, simulator):
    if kind == "mean_square":
        squares, gradient = functions.beam_squares, functions.beam_squares_gradient
        s = simulator(squares, returns=kind, gradient=gradient)
    else:
        s = simulator(gradient=functions.beam_gradient)
    model = model_of(likelihood, s, DATA)
    logp = model.compile_logp()

    def at(theta):
        return logp({"theta_interval__": theta, "sigma_interval__": 0.4})

    [slope, _] = model.compile_dlogp()({"theta_interval__": 0.2, "sigma_interval__": 0.4})
    h = 1e-3
    near, far = at(0.2 + h) - at(0.2 - h), at(0.2 + 2 * h) - at(0.2 - 2 * h)
    np.testing.assert_allclose(slope, (8.0 * near - far) / (12.0 * h), rtol=1e-7)


@pytest.mark.slow
def test_in_machine_code(simulator):
    """PyTensor's usual mode: no warnings, and errors come through."""
    point = {"theta_interval__": np.array(0.2), "sigma_interval__": np.array(0.4)}
    with ThreadPoolExecutor(1) as pool:  # cannot be pickled
        model = model_of("TN", simulator(gradient=functions.beam_gradient, executor=pool), DATA)
        expected = model.compile_dlogp()(point)
        with pytensor.config.change_flags(mode="Mode"), warnings.catch_warnings():
            warnings.simplefilter("error")
            np.testing.assert_allclose(model.compile_dlogp()(point), expected, rtol=1e-12)
            logp = population_logp(model, point, {"mode": "NUMBA"})
            assert logp(np.zeros((3, 2)))[1].shape == (3,)
    model = model_of("TN", simulator(BrokenElsewhere()), DATA)
    with (
        pytensor.config.change_flags(mode="Mode"),
        pytest.raises(UnusableSimulatorError, match="no module named solver"),
    ):
        model.compile_logp()(point)


def test_nuts_with_a_gradient_and_none_without(simulator):
    with model_of("TN", simulator(gradient=functions.beam_gradient), DATA):
        idata = pm.sample(
            10,
            tune=10,
            chains=1,
            cores=1,
            random_seed=1,
            nuts_sampler="pymc",
            nuts={"max_treedepth": 3},
            **QUIET,
        )
    assert "tree_depth" in idata.sample_stats
    assert np.unique(idata.posterior["theta"].values).size > 3
    with model_of("TN", simulator(), DATA), pytest.raises(NotDifferentiableError, match="without `gradient`"):
        pm.sample(5, tune=5, chains=1, cores=1, **QUIET)
