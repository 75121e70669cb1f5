"""DiscrepancySimulator of modes: squared errors of ln f and 1 - MAC under a tolerance."""

import itertools

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest

import pymc_features as pmf
from pymc_features.smc import population_logp
from support.sampling import SERIAL

DATA = {
    "frequencies": np.array([2.5, 1.02, 1.9]),  # not in order
    "shapes": np.array([[0.7, -0.5, np.nan], [0.55, 0.9, 1.2], [np.nan, np.nan, 1.0]]),
}


def storeys(theta):
    """Three storeys of theta times 100 N/m."""
    return pmf.SpringMassChain(np.ones(3), 200.0 * theta, pmf.ModalDamping(0.0))


def build(data=DATA, *, shape=3, **kwargs):
    with pm.Model() as model:
        theta = pm.Uniform("theta", 0.5, 1.5, shape=shape)
        pmf.DiscrepancySimulator("y", pmf.modes(storeys(theta)), observed=data, **kwargs)
    return model


def errors(theta, data, epsilon):
    """e (entry,) by NumPy: the best of all assignments."""
    found = storeys(theta).modes()
    e_f = np.square(np.log(data["frequencies"])[:, None] - np.log(found.natural_frequencies))
    e_s = 1.0 - pmf.modal.mac(data["shapes"], found.mode_shapes.T)
    has = (~np.isnan(data["shapes"])).sum(axis=1) > 1
    options = []
    for r in itertools.permutations(range(3)):
        e = np.concatenate([e_f[range(3), r], e_s[range(3), r][has]])
        options.append((np.sum(e / epsilon), e))
    return min(options, key=lambda option: option[0])[1]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "epsilon"), [(float, 0.3), (complex, [0.01, 0.02, 0.03, 0.2, 0.1])])
def test_density_of_a_population_against_all_assignments(kind, epsilon):
    data = DATA | {"shapes": DATA["shapes"] * (1.0 if kind is float else 1.0 + 2.0j)}
    model = build(data, epsilon=epsilon, kernel="exponential")
    logp = population_logp(model, model.initial_point(), {})
    assert logp.batched
    points = np.random.default_rng(1).normal(size=(8, 3))
    _, got, failed = logp(points)
    thetas = 0.5 + 1.0 / (1.0 + np.exp(-points))
    e = np.array([errors(theta, data, epsilon) for theta in thetas])
    expected = -np.sum(np.log(np.broadcast_to(epsilon, 5)) + e / epsilon, axis=1)
    np.testing.assert_allclose(got, expected, rtol=1e-11)
    assert not failed.any() and logp.has_gradient


def test_draws_are_the_matched_modes():
    model = build(epsilon=0.3)
    theta = np.array([0.9, 1.1, 1.2])
    draw = pm.draw(pm.do(model, {"theta": theta})["y"], random_seed=1)
    found = storeys(theta).modes()
    np.testing.assert_allclose(draw[:, 0], found.natural_frequencies[[2, 0, 1]], rtol=1e-12)
    for i, r in ((0, 2), (1, 0)):
        known = ~np.isnan(DATA["shapes"][i])
        measured, own = DATA["shapes"][i, known], draw[i, 1:][known]
        assert pmf.modal.mac([own], [found.mode_shapes[known, r]])[0, 0] == pytest.approx(1.0)
        e = 1.0 - pmf.modal.mac([measured], [own])[0, 0]  # at the best scale
        assert np.sum((own - measured) ** 2) / np.sum(measured**2) == pytest.approx(e, rel=1e-9)
        assert not draw[i, 1:][~known].any()
    assert not draw[2, 1:].any()


@pytest.mark.slow
def test_every_draw_is_within_the_tolerance():
    data = DATA | {"frequencies": storeys(np.ones(3)).modes().natural_frequencies[[2, 0, 1]]}
    data["shapes"] = storeys(np.ones(3)).modes().mode_shapes.T[[2, 0, 1]]
    model = build(data, epsilon=2e-3)
    with model:
        idata = pmf.sample_smc(200, kernel=pmf.SubsetSimulation, random_seed=2, **SERIAL)
    thetas = idata.posterior["theta"].values.reshape(-1, 3)
    rho = np.array([errors(theta, data, np.ones(6)).sum() for theta in thetas])
    assert rho.max() <= 2e-3 * (1 + 1e-9)
    assert abs(thetas.mean(axis=0) - 1.0).max() < 0.1


def test_frequencies_alone():
    model = build({"frequencies": DATA["frequencies"]}, epsilon=0.3, kernel="gaussian")
    logp = population_logp(model, model.initial_point(), {})
    _, [got], _ = logp(np.zeros((1, 3)))
    f = storeys(np.ones(3)).modes().natural_frequencies
    rho = np.sum(np.log(np.sort(DATA["frequencies"]) / f) ** 2)
    assert got == pytest.approx(-0.5 * (rho / 0.3) ** 2)
    assert pm.draw(model["y"], random_seed=1).shape == (3, 1)


def test_what_modes_do_not_take():
    k = pt.scalar("k")
    found = pmf.modes(storeys(k), sensors=[0, 1])
    good = dict(observed=DATA | {"shapes": DATA["shapes"][:, :2]}, epsilon=0.3)
    with pm.Model():
        for change, said in (
            ({"noise": 0.1}, "`params` and `noise` must be left out"),
            ({"epsilon": [0.1, 0.2]}, "`epsilon` must be one number or one for each of the 5 squared errors"),
            ({"observed": DATA}, "`observed` must have shapes at the 2 sensors of `modes`, got 3"),
        ):
            with pytest.raises(ValueError, match=said):
                pmf.DiscrepancySimulator("y", found, **(good | change))
        with pytest.raises(
            ValueError, match="`modes` must have at least as many modes as were identified, 3"
        ):
            pmf.DiscrepancySimulator("y", pmf.modes(storeys(k), 2, sensors=[0, 1]), **good)
        with pytest.raises(TypeError, match="`mu` must be what `modes` returned, at `sensors`"):
            pmf.DiscrepancySimulator("y", found._replace(shapes=2.0 * found.shapes), **good)
