"""`GammaFeature(..., m="residuals")` and `fill_degrees`: closed forms, and what happens before m is known."""

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest

from pymc_features import ExpFeature, GammaFeature, effective_samples, sample, sample_smc
from pymc_features.calibration import fill_degrees
from pymc_features.exceptions import CalibrationWarning, FeatureLikelihoodWarning

N_SENSORS, N_TIMES, N_FEW = 4, 2000, 400
PHASES, TIME = np.arange(N_SENSORS)[:, None], np.arange(N_TIMES)
CONSTANT = np.ones((N_SENSORS, N_TIMES))
WAVES = np.sin(0.3 * TIME * np.exp(-TIME / 4000.0) + PHASES)  # of many frequencies


@pytest.fixture(scope="module")
def model():
    """y = a design + errors; both are data, so that it is compiled once."""
    with pm.Model(coords={"sensor": list("abcd")}) as model:
        mu = pm.Normal("a", 0.0, 10.0) * pm.Data("design", WAVES)
        sigma, y = pm.LogNormal("sigma", -2.0, 3.0), pm.Data("data", WAVES)
        GammaFeature("y", mu, sigma, "residuals", observed=y, dims=("sensor", "time"))
    return model


def declare(model, design, errors):
    """Set the data, and m to what it is before it is filled."""
    pm.set_data({"design": design, "data": design + errors, "y_m": np.zeros(N_SENSORS)}, model=model)
    return model


@pytest.mark.slow
def test_white_noise_gives_the_conventional_likelihood(model):
    """m is about the number of samples (15 % in each sensor), the posterior of a, by quadrature, NORM's."""
    errors = 0.5 * np.random.default_rng(4).standard_normal((N_SENSORS, N_TIMES))
    found = fill_degrees(declare(model, WAVES, errors), random_seed=1)
    m = model["y_m"].get_value()
    np.testing.assert_array_equal(m, found["n_eff"])
    assert m.mean() == pytest.approx(N_TIMES, rel=0.1)
    again = effective_samples(model, random_seed=2)  # claims m, and supports it
    np.testing.assert_allclose(again["claimed"], m)
    np.testing.assert_allclose(again["n_eff"], m, rtol=1e-3)
    logp = model.compile_logp(jacobian=True, mode="FAST_COMPILE")
    power = np.sum(WAVES**2)
    a_hat = 1.0 + np.sum(errors * WAVES) / power
    s_min = np.sum((errors - (a_hat - 1.0) * WAVES) ** 2)
    width = np.sqrt(s_min / (power * N_SENSORS * N_TIMES))  # of Student's t with so many degrees: normal
    a = a_hat + width * np.linspace(-4.0, 4.0, 33)
    centre = 0.5 * np.log(s_min / N_TIMES / m.sum())
    log_sigma = centre + np.linspace(-0.05, 0.05, 33)
    density = np.array([[logp({"a": x, "sigma_log__": s}) for s in log_sigma] for x in a])
    weight = np.exp(density - density.max()).sum(axis=1)
    mean = np.average(a, weights=weight)
    assert mean == pytest.approx(a_hat, abs=0.01 * width)
    assert np.sqrt(np.average((a - mean) ** 2, weights=weight)) == pytest.approx(width, rel=0.05)


def test_a_sensor_that_knows_nothing_gets_the_mean_of_the_others(model):
    """If all know nothing, there is no m."""
    blind = WAVES[:, :N_FEW] * np.array([1.0, 1.0, 1.0, 0.0])[:, None]
    errors = np.random.default_rng(5).standard_normal((N_SENSORS, N_FEW))
    fill_degrees(declare(model, blind, errors), random_seed=1)
    m = model["y_m"].get_value()
    assert m[3] == pytest.approx(m[:3].mean())
    with pytest.raises(ValueError, match="parameters that change the response of y, got none"):
        fill_degrees(declare(model, 0.0 * errors, errors), random_seed=1)


def test_few_observations_are_warned_of(model):
    """Errors that last as long as the record."""
    shape = N_SENSORS, N_FEW
    errors = 0.01 * np.random.default_rng(6).standard_normal(shape) + PHASES - 1.5
    errors += np.cumsum(np.random.default_rng(7).standard_normal(shape), axis=1)
    short = pytest.warns(CalibrationWarning, match="the errors of y persist")
    with short, pytest.warns(FeatureLikelihoodWarning, match="4 sensors with one sigma .* GammaFeature"):
        fill_degrees(declare(model, CONSTANT[:, :N_FEW], errors), random_seed=1)
    assert model["y_m"].get_value().sum() < 4.0


def test_a_fit_that_fails_leaves_m_unknown(model):
    """And nothing is computed before it is known."""
    with pytest.raises(ValueError, match="the residuals of y must not vanish"):
        fill_degrees(declare(model, WAVES[:, :N_FEW], 0.0), random_seed=1)
    np.testing.assert_array_equal(model["y_m"].get_value(), 0.0)
    run = {"model": model, "chains": 1, "cores": 1, "progressbar": False}
    for call in (
        lambda: sample(20, **run),
        lambda: sample_smc(20, **run),
        lambda: effective_samples(model),
        lambda: model.compile_logp(mode="FAST_COMPILE")(model.initial_point()),
        lambda: pm.draw(model["y"], mode="FAST_COMPILE"),
    ):
        with pytest.raises(ValueError, match=r"taken from the residuals .* Call calibration.fill_deg"):
            call()


def test_what_has_no_degrees_to_fill_is_refused():
    mu = np.zeros((3, 5))
    with pytest.raises(ValueError, match="`m` must be positive numbers or, .* got 'residual'"):
        GammaFeature.dist(mu, 1.0, "residual")
    with pytest.raises(ValueError, match="`m` must be .* got 'residuals'. Only a likelihood of a model"):
        GammaFeature.dist(mu, 1.0, "residuals")
    with pm.Model(), pytest.raises(ValueError, match="`observed` must be given with m='residuals', got None"):
        GammaFeature("y", mu, 1.0, "residuals")
    with pm.Model(), pytest.raises(ValueError, match="`observed` must have a known number of sensors"):
        GammaFeature("y", mu, 1.0, "residuals", observed=pt.matrix())
    with pm.Model() as model:
        ExpFeature("y", pm.Normal("a") * mu, 1.0, observed=1.0 + mu)
    with pytest.raises(ValueError, match="`model` must have a GammaFeature with m='residuals', got y"):
        fill_degrees(model)
