"""Discrete parameters that choose a place: nothing is evaluated where their prior is zero."""

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest
from scipy import stats

import pymc_features as pmf
from pymc_features.smc import KERNELS, PopulationLogp
from support.sampling import run_chain

MEANS = np.array([0.0, 1.0, 2.0])
CHANCES = np.array([[0.2, 0.3, 0.5], [0.6, 0.3, 0.1]])
MEASURED = np.array([0.9, 1.3, 0.6])


def place(index):
    """Which of three means, with one standard deviation for all."""
    with pm.Model() as model:
        s = pm.HalfNormal("s", 1.0)
        pm.Normal("y", pt.as_tensor(MEANS)[index() - 4], s + 0.1, observed=MEASURED)
    return model


PRIORS = {
    "binomial": (lambda: 4 + pm.Binomial("k", 2, 0.5), np.array([0.25, 0.5, 0.25])),
    "truncated": (
        lambda: pm.Truncated("k", pm.Poisson.dist(5.0), 4, 6),
        (w := stats.poisson(5.0).pmf([4, 5, 6])) / w.sum(),
    ),
    "a custom one": (
        lambda: pm.CustomDist(
            "k",
            logp=lambda k: pt.switch(pt.and_(k >= 4, k <= 6), -np.log(3.0), -np.inf),
            random=lambda rng=None, size=None: rng.integers(4, 7, size=size),
            dtype="int64",
        ),
        np.ones(3) / 3,
    ),
    "a rounded number": (
        lambda: pt.floor(pm.Uniform("k", 4.0, 7.0, default_transform=None, initval=5.0)).astype(int),
        np.ones(3) / 3,
    ),
}


def exact(prior):
    """P(place | y), by quadrature over s."""
    s = np.linspace(0.0, 12.0, 20_001)
    likelihood = stats.norm.pdf(MEASURED[:, None, None], MEANS[:, None], s + 0.1).prod(axis=0)
    weights = prior * np.trapezoid(likelihood * 2.0 * stats.norm.pdf(s), s, axis=1)
    return weights / weights.sum()


@pytest.mark.slow
@pytest.mark.parametrize("prior", PRIORS)
def test_the_place_has_the_probability_of_quadrature(prior):
    """Of 1000 draws, within four standard errors."""
    declare, weights = PRIORS[prior]
    idata = pmf.sample(500, chains=2, model=place(declare), cores=1, random_seed=1, progressbar=False)
    drawn = np.floor(idata.posterior["k"].values.ravel()) - (0 if prior == "binomial" else 4)
    found = np.array([np.mean(drawn == k) for k in range(3)])
    np.testing.assert_allclose(found, exact(weights), atol=0.06)


@pytest.mark.slow
@pytest.mark.parametrize("kernel", KERNELS)
def test_every_kernel_stays_inside(kernel):
    model = place(lambda: pm.Categorical("k", [0.0] * 4 + list(CHANCES[0])))
    found = run_chain(kernel, model, draws=1000)
    drawn = np.round(found.draws[:, 1]) - 4
    np.testing.assert_allclose([np.mean(drawn == k) for k in range(3)], exact(CHANCES[0]), atol=0.06)


def test_an_index_may_choose_the_prior_of_another_index_and_of_a_mean():
    """Against sums over what is possible, and -inf around it."""
    with pm.Model() as model:
        first = pm.DiscreteUniform("first", 0, 1)
        second = pm.Categorical("second", pt.as_tensor(CHANCES)[first], shape=(2,))
        x = pm.Normal("x", pt.as_tensor(MEANS)[second], 1.0)
        pm.Normal("y", x, pt.as_tensor(1.0 + MEANS)[second], observed=[0.5, 1.5])
    logp = PopulationLogp(model, model.initial_point(), {})
    grid = np.stack(np.meshgrid(*[np.arange(-2.0, 5.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    particles = np.hstack([grid + 0.3, np.tile([0.2, -0.4], (len(grid), 1))])
    prior, likelihood, failed = logp(particles)
    inside = (grid[:, 0] >= 0) & (grid[:, 0] <= 1) & ((grid[:, 1:] >= 0) & (grid[:, 1:] <= 2)).all(axis=1)
    assert logp.batched
    assert not failed.any()
    assert (prior[~inside] == -np.inf).all()
    one, two = grid[inside, 0].astype(int), grid[inside, 1:].astype(int)
    x = particles[inside, 3:]
    expected = np.log(0.5) + np.log(CHANCES[one[:, None], two]).sum(axis=1)
    expected += stats.norm.logpdf(x, MEANS[two]).sum(axis=1)
    np.testing.assert_allclose(prior[inside], expected, rtol=1e-8)  # an index has a prior of 32 bits
    np.testing.assert_allclose(
        likelihood[inside], stats.norm.logpdf([0.5, 1.5], x, 1.0 + MEANS[two]).sum(axis=1), rtol=1e-12
    )


@pytest.mark.filterwarnings("ignore:particles are evaluated one by one")
def test_discrete_vectors_with_one_density_and_simulators_stay_inside():
    with pm.Model() as model:
        counts = pm.Multinomial("counts", 2, [0.5, 0.5], initval=[1, 1])
        pm.Simulator("y", lambda rng, k, size=None: MEANS[k], counts, observed=[1.0, 1.0], epsilon=0.5)
    prior, likelihood, failed = PopulationLogp(model, model.initial_point(), {})(
        np.array([[1.0, 1.0], [2.0, 0.0], [5.0, -3.0], [5.0, 1.0]])
    )
    assert np.isfinite(prior).tolist() == [True, True, False, False]
    assert np.isfinite(likelihood).all()
    assert not failed.any()
