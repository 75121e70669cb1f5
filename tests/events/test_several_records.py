"""Several records in one model: each is one call for the whole population, whatever its step and length."""

import numpy as np
import pymc as pm
import pytest

import pymc_features as pmf
from pymc_features.smc import population_logp

STEPS = ((0.02, 3.0), (0.01, 2.0), (0.04, 4.0))  # of each record [s], and its length [s]
RECORDS = [pmf.synthetic_earthquake(t, dt, random_seed=i) for i, (dt, t) in enumerate(STEPS)]


def structure(theta):
    return pmf.SpringMassChain(np.ones(3), 900.0 * theta, pmf.ModalDamping(0.03))


DATA = [1.1 * pmf.simulate(structure(1.0), record).values for record in RECORDS]


def likelihood(name, theta, sigma, i):
    pmf.ExpFeature(name, mu=pmf.response(structure(theta), RECORDS[i]), sigma=sigma, observed=DATA[i])


@pytest.mark.slow
@pytest.mark.parametrize("shared", [True, False])
def test_one_call_for_each_record(shared):
    """One factor for all events, or one each from a population: the sum of what events give alone."""
    with pm.Model() as joint:
        sigma, mean = pm.HalfNormal("sigma", 1.0), pm.Normal("mean", 1.0, 0.1)
        theta = [mean] * 3 if shared else pm.Normal("theta", mean, 0.05, shape=3)
        for i in range(3):
            likelihood(f"y{i}", theta[i], sigma, i)
    logp = population_logp(joint, joint.initial_point(), {})
    assert logp.batched
    ops = [type(node.op).__name__ for node in logp.function.maker.fgraph.apply_nodes]
    assert ops.count("PopulationDiscrepancy") == 3
    rng = np.random.default_rng(1)
    factors = rng.normal(1.0, 0.05, (5, 1 if shared else 4))
    points = np.hstack([rng.normal(-1.0, 0.3, (5, 1)), factors])
    alone = np.zeros(5)
    for i in range(3):
        with pm.Model() as one:
            sigma, factor = pm.HalfNormal("sigma", 1.0), pm.Normal("factor", 1.0, 0.1)
            likelihood("y", factor, sigma, i)
        columns = points[:, [0, 1 if shared else 2 + i]]
        alone += population_logp(one, one.initial_point(), {})(columns)[1]
    np.testing.assert_allclose(logp(points)[1], alone, rtol=1e-10)
