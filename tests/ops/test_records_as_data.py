"""A record whose samples are `pm.Data`: the model after `pm.set_data` is the one with that record."""

import numpy as np
import pymc as pm
import pytest

import pymc_features as pmf
from pymc_features.smc import population_logp

SAMPLES = [0.1 * np.random.default_rng(n).standard_normal(n).cumsum() for n in (120, 190)]  # m/s^2
DRIFTS = np.eye(3) - np.eye(3, k=-1)
POINTS = np.random.default_rng(1).normal(0.0, 0.1, (5, 2))


def chain(factor):
    return pmf.SpringMassChain(np.ones(3), 900.0 * factor, pmf.ModalDamping(0.03))


def affine(factor):
    terms = [900.0 * np.outer(drift, drift) for drift in DRIFTS]
    return pmf.AffineStructure(
        np.eye(3),
        stiffness=np.zeros((3, 3)),
        damping=pmf.ModalDamping(0.03),
        stiffness_terms=terms,
        theta=factor * np.ones(3),
    )


def hysteretic(factor):
    springs = {"yield_displacement": 2e-3, "post_yield_ratio": 0.1, "sharpness": 2.0}
    return pmf.HystereticChain(np.ones(3), 900.0 * factor, pmf.RayleighDamping(0.3, 1e-3), **springs)


def model_of(build, samples, measured, interpolation, as_data):
    with pm.Model() as model:
        factor, sigma = pm.LogNormal("factor", 0.0, 0.1), pm.HalfNormal("sigma", 1.0)
        if as_data:
            samples, measured = pm.Data("samples", samples), pm.Data("measured", measured)
        record = pmf.Record(samples, 0.02, interpolation=interpolation)
        pmf.ExpFeature("y", pmf.response(build(factor), record), sigma, observed=measured)
    return model


@pytest.mark.slow
@pytest.mark.parametrize(
    ("build", "interpolation"),
    [(chain, "linear"), *((build, "band-limited") for build in (chain, affine, hysteretic))],
)
def test_a_motion_of_another_length(build, interpolation):
    rng, noise = np.random.default_rng(2), 0.1
    records = [pmf.Record(samples, 0.02, interpolation=interpolation) for samples in SAMPLES]
    measured = [pmf.simulate(build(1.1), record).values for record in records]
    measured = [y + noise * rng.standard_normal(y.shape) for y in measured]
    model = model_of(build, SAMPLES[0], measured[0], interpolation, True)
    density = model.compile_fn([model.logp(), model.dlogp()])
    population = population_logp(model, model.initial_point(), {})
    before, _ = density(model.initial_point())
    for samples, y in zip(SAMPLES, measured, strict=True):
        with model:
            pm.set_data({"samples": samples, "measured": y})
        known = model_of(build, samples, y, interpolation, False)
        point = known.initial_point()
        of_known = known.compile_fn([known.logp(), known.dlogp()])
        for found, one in zip(density(point), of_known(point), strict=True):
            np.testing.assert_allclose(found, one, rtol=1e-12)
        expected = population_logp(known, point, {})
        for found, one in zip(population.gradient(POINTS), expected.gradient(POINTS), strict=True):
            np.testing.assert_allclose(found, one, rtol=1e-12)
    assert abs(density(point)[0] / before - 1.0) > 1e-3


def test_what_is_made_of_it_is_of_the_samples_as_they_were():
    with pm.Model():
        data = pm.Data("samples", SAMPLES[0])
        record = pmf.Record(data, 0.02)
        pm.set_data({"samples": SAMPLES[1]})
    assert record.data is data and record.first(50).data is None
    np.testing.assert_array_equal(record.acceleration, SAMPLES[0])
    with pm.Model(), pytest.raises(ValueError, match="`acceleration` must be finite"):
        pmf.Record(pm.Data("samples", np.array([0.0, np.inf])), 0.02)
