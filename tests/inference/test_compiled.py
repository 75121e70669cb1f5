"""`compiled_logp`: densities, gradients and the unit cube, against PyMC, SciPy and differences."""

import pickle

import numpy as np
import pymc as pm
import pytest
from scipy import stats

import pymc_features as pmf


@pytest.fixture(scope="module")
def hierarchy():
    """Priors that depend on each other, bounds that depend on parameters, and an entry of each kind."""
    with pm.Model() as model:
        mu = pm.Normal("mu", 1.0, 2.0)
        tau = pm.HalfNormal("tau", 1.5)
        x = pm.LogNormal("x", mu, tau, shape=3)
        start = pm.Uniform("start", mu - 1.0, mu + 2.0)
        pm.Gamma("rate", 2.0, 3.0)
        pm.Normal("y", pm.math.log(x).sum() + start, 1.0, observed=[1.0, 2.0])
    return model


@pytest.fixture(scope="module")
def density(hierarchy):
    return pmf.compiled_logp(hierarchy)


@pytest.fixture(scope="module")
def cube():
    return np.random.default_rng(1).random((1000, 7))


@pytest.mark.slow
@pytest.mark.all_rewrites  # without them some constants are of single precision
def test_densities_and_gradients_are_those_of_pymc(hierarchy, density, cube):
    theta = density.from_unit_cube(cube[:4])
    found = density(theta, gradient=True)
    logp = hierarchy.compile_logp(sum=False)
    slope = hierarchy.compile_dlogp()
    for i, x in enumerate(theta):
        names = [v.name for v in hierarchy.value_vars]
        shapes = [np.shape(hierarchy.initial_point()[name]) for name in names]
        ends = np.cumsum([np.prod(shape, dtype=int) for shape in shapes])
        parts = np.split(x, ends[:-1])
        point = {n: p.reshape(s) for n, p, s in zip(names, parts, shapes, strict=True)}
        *prior, likelihood = (np.sum(term) for term in logp(point))
        np.testing.assert_allclose(found.prior[i], sum(prior), rtol=1e-10)
        np.testing.assert_allclose(found.likelihood[i], likelihood, rtol=1e-10)
        np.testing.assert_allclose(found.gradient[i], slope(point), rtol=1e-8, atol=1e-9)
    np.testing.assert_array_equal(density.log_posterior(theta), found.prior + found.likelihood)
    assert density.names == ["mu", "tau", "x[0]", "x[1]", "x[2]", "start", "rate"]


def test_the_unit_cube_is_the_prior(density, cube):
    """Each parameter by the distribution function that SciPy has of it, given those before."""
    p = density.parameters(density.from_unit_cube(cube))
    below = [
        stats.norm(1.0, 2.0).cdf(p["mu"]),
        stats.halfnorm(scale=1.5).cdf(p["tau"]),
        *(stats.norm(p["mu"], p["tau"]).cdf(np.log(x)) for x in p["x"].T),
        stats.uniform(p["mu"] - 1.0, 3.0).cdf(p["start"]),
        stats.gamma(2.0, scale=1.0 / 3.0).cdf(p["rate"]),
    ]
    np.testing.assert_allclose(np.transpose(below), cube, atol=1e-7)
    np.testing.assert_allclose(density.to_unit_cube(density.from_unit_cube(cube)), cube, atol=1e-7)


def test_one_point_and_many_and_a_copy_agree(density, cube):
    theta = density.from_unit_cube(cube[:3])
    one = density(theta[1], gradient=True)
    many = density(theta, gradient=True)
    copy = pickle.loads(pickle.dumps(density))(theta, gradient=True)
    np.testing.assert_allclose(one.prior, many.prior[1], rtol=1e-13)
    assert np.ndim(one.likelihood) == 0 and one.gradient.shape == (7,)
    np.testing.assert_array_equal(many.gradient, copy.gradient)
    assert density.parameters(theta[0])["x"].shape == (3,)
    assert density.from_unit_cube(cube[0]).shape == (7,)


def test_bad_points_and_models_are_refused(density):
    for call, error, says in (
        (lambda d: d(np.zeros(3)), ValueError, r"`theta` must be of shape \(7,\) or \(n, 7\), got \(3,\)"),
        (lambda d: d(["a"] * 7), TypeError, "`theta` must"),
        (lambda d: d.from_unit_cube(np.full(7, 1.5)), ValueError, "`u` must be between 0 and 1"),
        (lambda d: d(np.zeros(7), gradient="yes"), TypeError, "`gradient` must"),
    ):
        with pytest.raises(error, match=says):
            call(density)
    with pm.Model() as model:
        pm.MvNormal("z", np.zeros(2), np.eye(2))
        pm.Normal("free")
    density = pmf.compiled_logp(model)
    np.testing.assert_allclose(density(np.zeros(3)).prior, -1.5 * np.log(2.0 * np.pi))
    with pytest.raises(ValueError, match=r"`model` must .* cube, got z \(multivariate_normal\)\."):
        density.from_unit_cube(np.zeros(3))
    with pm.Model() as model:
        pm.Poisson("n", 3.0)
    with pytest.raises(ValueError, match=r"compiled_logp\(\), got discrete ones: n"):
        pmf.compiled_logp(model)
