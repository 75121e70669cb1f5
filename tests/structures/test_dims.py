"""Parameters declared with `dims` of a model: lengths, log-probabilities, gradients, refusals."""

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest

from pymc_features import (
    AffineStructure,
    ExpFeature,
    HystereticChain,
    LinearStructure,
    ModalDamping,
    RayleighDamping,
    SpringMassChain,
    response,
)
from pymc_features.smc import PopulationLogp
from pymc_features.structures.base import computed_length
from support.graphs import LIGHT
from support.structures import noise_record

PULSE = noise_record(40)
MEASURED = np.random.default_rng(2).normal(size=(3, 40))
LIGHTLY_DAMPED = ModalDamping(0.02)
TERMS = [np.outer(drift, drift) for drift in np.diff(np.eye(3), axis=0, prepend=0.0)]

BUILDS = {  # from stiffnesses, damping ratios and masses, all of unknown length in their types
    "mass of data": lambda k, z, m: SpringMassChain(m, k[0], LIGHTLY_DAMPED),
    "computed": lambda k, z, m: SpringMassChain(1.0, pt.concatenate([k[:1], 2.0 * k[1:]]), LIGHTLY_DAMPED),
    "modal ratios": lambda k, z, m: SpringMassChain(1.0, k, ModalDamping(z)),
    "Rayleigh": lambda k, z, m: SpringMassChain(1.0, k, RayleighDamping(z[0], 0.001 * z[1])),
    "factors": lambda k, z, m: SpringMassChain(m, 100.0, LIGHTLY_DAMPED).scale_stiffness(k / 80, [2, 0, 1]),
    "by matrices": lambda k, z, m: SpringMassChain(1.0, k, ModalDamping(z)).as_linear(),
    "linear": lambda k, z, m: LinearStructure(
        np.ones(3), stiffness=100.0 * sum(TERMS), damping=ModalDamping(z)
    ),
    "affine": lambda k, z, m: AffineStructure(
        np.ones(3), stiffness=0.0 * TERMS[0], damping=ModalDamping(z), stiffness_terms=TERMS, theta=k
    ),
    "hysteretic": lambda k, z, m: HystereticChain(
        1.0, k, LIGHTLY_DAMPED, yield_displacement=z, post_yield_ratio=5.0 * z
    ),
    "array of variables": lambda k, z, m: SpringMassChain(1.0, np.array([k[1], k[0], 90.0]), LIGHTLY_DAMPED),
}


def declared(build, **given):
    """A model with the vectors declared by `given`, dims or shape."""
    with pm.Model(coords={"storey": ["ground", "first", "second"]}) as model:
        k = pm.LogNormal("k", np.log([80.0, 100.0, 120.0]), 0.2, **given)
        z = pm.LogNormal("z", np.log(0.02), 0.3, **given)
        m = pm.Data("m", [1.0, 2.0, 1.5], shape=given.get("shape"), dims=given.get("dims"))
        mu = response(build(k, z, m), PULSE)
        ExpFeature("y", mu, 1.0, observed=MEASURED)
    return model


@pytest.mark.slow
@pytest.mark.parametrize("name", BUILDS)
def test_dims_and_shape_are_the_same_model(name):
    """Log-probabilities and gradients, at a point that is not the initial one; of particles together."""
    found, together = [], []
    for given in ({"dims": "storey"}, {"shape": (3,)}):
        model = declared(BUILDS[name], **given)
        point = {v: x + [0.1, -0.2, 0.3] for v, x in model.initial_point().items()}
        compiled = model.compile_fn([model.logp(), model.dlogp()], mode=LIGHT, point_fn=True)
        found.append(compiled(point))
        if name in ("modal ratios", "affine"):
            evaluation = PopulationLogp(model, model.initial_point(), {})
            assert evaluation.batched
            particles = evaluation.start + 0.1 * np.random.default_rng(0).normal(size=(5, 6))
            together.append(evaluation(particles))
    (value, gradient), (expected, expected_gradient) = found
    assert np.isfinite(value) and np.count_nonzero(gradient) == 6
    np.testing.assert_allclose(value, expected, rtol=1e-13)
    np.testing.assert_allclose(gradient, expected_gradient, rtol=1e-10)
    for ours, theirs in zip(*together or [(), ()], strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-12)


def test_lengths_that_only_a_draw_decides_are_unknown():
    with pm.Model(coords={"storey": range(3)}):
        k = pm.LogNormal("k", dims="storey")
        count = pm.Poisson("count", 2.0)
    assert computed_length(k[:count]) is None
    assert computed_length(2.0 * k) == 3


def test_other_coordinates_are_refused_when_they_no_longer_fit():
    """The number of storeys is that of the structure; coordinates that change later are not followed."""
    with pm.Model(coords={"storey": range(3)}) as model:
        k = pm.LogNormal("k", dims="storey")
        mu = response(SpringMassChain(1.0, k, LIGHTLY_DAMPED), PULSE)
    model.set_dim("storey", 4, range(4))
    with pytest.raises(AssertionError, match=r"Got shape \(4,\), expected \(3,\)"):
        pm.draw(mu, mode=LIGHT)


REFUSED = {  # what is said: what is built of a vector `k` of three storeys, and one of unknown length
    "`ratios` must have one value or one for each of the 4 modes, got 3": lambda k, u: SpringMassChain(
        np.ones(4), 100.0, ModalDamping(k)
    ),
    "`factor` must have one value or one for each of the 2 springs, got 3": lambda k, u: SpringMassChain(
        1.0, k, LIGHTLY_DAMPED
    ).scale_stiffness(k, [0, 1]),
    r"`theta` must be 2 finite values, one for each parameter, got a tensor of shape \(3,\)": lambda k, u: (
        AffineStructure(
            np.ones(3),
            stiffness=sum(TERMS),
            damping=LIGHTLY_DAMPED,
            stiffness_terms=TERMS[:2],
            theta=k,
        )
    ),
    "`mass` must be a list of scalars, got a vector among them. Pass a vector by itself": lambda k, u: (
        SpringMassChain([k, 1.0], 100.0, LIGHTLY_DAMPED)
    ),
    "must have a known length, got none. Pass one of them as an array of n values, or "
    "declare it with shape=n, or with dims that the model has coords for.": lambda k, u: SpringMassChain(
        1.0, u, LIGHTLY_DAMPED
    ),
}


def test_random_ratios_of_rayleigh_damping_are_refused_with_another_way():
    with pm.Model(coords={"storey": range(2)}):
        zeta = pm.LogNormal("zeta", -4.0, 0.2, dims="storey")
        with pytest.raises(TypeError, match=r"must be numbers, got PyTensor .* For a random ratio zeta pass"):
            RayleighDamping.from_ratios(zeta, (1.0, 4.0))
    unit = RayleighDamping.from_ratios(1.0, (1.0, 4.0))
    expected = RayleighDamping.from_ratios(0.03, (1.0, 4.0))
    np.testing.assert_allclose([0.03 * unit.alpha, 0.03 * unit.beta], [expected.alpha, expected.beta])


@pytest.mark.parametrize("message", REFUSED)
def test_lengths_that_do_not_fit(message):
    with pm.Model(coords={"storey": range(3)}):
        k = pm.LogNormal("k", dims="storey")
        with pytest.raises(ValueError, match=message):
            REFUSED[message](k, pt.vector("u"))
