"""`effective_samples` and `calibrate` on models whose answers are known: linear in their parameters."""

import warnings

import numpy as np
import pymc as pm
import pytest
import xarray as xr
from scipy.stats import beta, kstest

import pymc_features as pmf
from calibration.test_sandwich import DT, N_TIMES, errors_of, first_order, regression
from pymc_features.calibration.stretched import Expansion, Stretched
from pymc_features.exceptions import CalibrationWarning

TAU = 0.3
SIGNALS = regression()
LIKELIHOODS = {
    "NORM": lambda mu, sigma, y: pm.Normal("y", mu, sigma, observed=y),
    "TN": lambda mu, sigma, y: pmf.TruncNormalFeature("y", mu, sigma, observed=y),
    "EXP": lambda mu, sigma, y: pmf.ExpFeature("y", mu, sigma, observed=y),
    "m": lambda mu, sigma, y: pmf.GammaFeature("y", mu, sigma, 7.5, observed=y),
    "CN": lambda mu, sigma, y: pmf.CorrelatedNormal("y", mu, sigma, correlation_time=TAU, dt=DT, observed=y),
}


def data(kind="persistent", seed=6):
    return SIGNALS @ [1.0, 2.0] + 0.1 * errors_of(kind, np.random.default_rng(seed), SIGNALS)


def declare(kind, y, prior=None):
    """y = S theta + errors, with theta normal or as wanted."""
    with pm.Model() as model:
        theta = prior() if prior else pm.Normal("theta", 0.0, 10.0, shape=2)
        sigma = pm.LogNormal("sigma", -2.0, 2.0)
        LIKELIHOODS[kind](pm.math.dot(SIGNALS, theta), sigma, y)
    return model


def at(*theta, sigma=0.1):
    """A posterior of a single draw."""
    values = {"theta": (("chain", "draw", "i"), [[theta]]), "sigma": (("chain", "draw"), [[sigma]])}
    return xr.DataTree.from_dict({"posterior": xr.Dataset(values)})


def calibrated(model, *theta, draws=500, seed=1, **settings):
    """The result of CAL, and its draws of theta (n, 2)."""
    settings = {"chains": 2, "random_seed": seed, "progressbar": False} | settings
    found = pmf.calibrate(at(*theta or (1.0, 2.0)), model=model, draws=draws, **settings)
    return found, found["posterior"]["theta"].values.reshape(-1, 2)


def assert_normal(theta, mean, covariance, atol):
    """Moments of draws (n, 2) in units of their standard deviations."""
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))
    np.testing.assert_allclose(whiten @ np.cov(theta.T) @ whiten.T, np.eye(2), atol=atol)
    np.testing.assert_allclose(whiten @ (theta.mean(axis=0) - mean), 0.0, atol=0.15)


@pytest.fixture(scope="module")
def y():
    return data()


@pytest.fixture(scope="module")
def least_squares(y):
    """Estimate of theta, and the covariances that the true errors and white ones give it."""
    flat = SIGNALS.reshape(-1, 2)
    claims = np.linalg.inv(flat.T @ flat)
    lag = np.arange(N_TIMES)
    correlation = 0.01 * np.exp(-np.abs(lag - lag[:, None]) * DT / TAU)
    score = sum(s.T @ correlation @ s for s in SIGNALS)
    return claims @ flat.T @ y.ravel(), claims @ score @ claims, 0.01 * claims


@pytest.mark.parametrize("kind", ["NORM", "TN", "EXP", "m"])
def test_every_likelihood_supports_the_same(kind, y, least_squares):
    """The estimate is that by least squares; the covariance that of the true errors, as 600 samples tell it.

    Control: what independent errors of the same size would give is far too small.
    """
    estimate, truth, white = least_squares
    found = pmf.effective_samples(at(0.9, 1.8), model=declare(kind, y))
    np.testing.assert_allclose(found["point"][:2], estimate, atol=1e-3 * np.sqrt(truth.diagonal().min()))
    widths = found["standard_deviation"].values[:2]
    np.testing.assert_allclose(widths, np.sqrt(np.diag(truth)), rtol=0.4)
    assert widths[0] > 2.0 * np.sqrt(white[0, 0])
    claims = white.diagonal() / 0.01 * np.mean((y - SIGNALS @ estimate) ** 2)  # by independent residuals
    np.testing.assert_allclose(found["n_eff_parameter"][:2], 4 * N_TIMES * claims / widths**2, rtol=0.02)
    reference = pmf.effective_samples(at(1.0, 2.0), model=declare("NORM", y))
    np.testing.assert_allclose(found["covariance"][:2, :2], reference["covariance"][:2, :2], rtol=0.01)
    np.testing.assert_allclose(found["n_eff"], reference["n_eff"], rtol=0.01)
    assert found["n_eff_direction"][0] < 0.25 * 4 * N_TIMES
    np.testing.assert_allclose(found["claimed"], {"NORM": N_TIMES, "TN": 1, "EXP": 2, "m": 7.5}[kind])


def test_a_right_likelihood_claims_what_it_knows(y):
    """Errors whose correlation is known: all samples count; those of NORM do not."""
    found = pmf.effective_samples(at(1.0, 2.0), model=declare("CN", y))
    assert found.attrs["n_eff"] == pytest.approx(4 * N_TIMES, rel=0.3)


def test_where_climbs_begin(y, least_squares):
    """Those from modes that sampling has found are shorter than from a draw and lead to the same, and so do
    those of a model without draws. Control: modes of another model are not used.
    """
    estimate, truth, _ = least_squares
    idata, model = at(0.9, 1.8), declare("EXP", y)
    alone = pmf.effective_samples(idata, model=model)
    idata["modes"] = xr.Dataset({"theta": (("mode", "i"), [[5.0, 5.0], estimate])})
    assert pmf.effective_samples(idata, model=model).n_evaluations == alone.n_evaluations
    sigma = float(np.exp(alone["point"][2]))
    idata["modes"] = xr.Dataset({**idata["modes"].data_vars, "sigma": ("mode", [0.1, sigma])})
    found = pmf.effective_samples(idata, model=model)
    assert found.n_evaluations < alone.n_evaluations
    for other in (found, pmf.effective_samples(model, random_seed=1)):
        atol = 1e-3 * np.sqrt(truth.diagonal().min())
        np.testing.assert_allclose(other["point"][:2], alone["point"][:2], atol=atol)
        np.testing.assert_allclose(other["covariance"][:2, :2], alone["covariance"][:2, :2], rtol=1e-3)


def test_shares_have_fewer_coordinates_than_values(y):
    """Those of a Dirichlet prior, beside a sigma that has a bound."""
    model = declare("NORM", y, lambda: 3.0 * pm.Dirichlet("theta", np.ones(2)))
    found = pmf.effective_samples(at(0.3, 0.7), model=model)
    assert found["parameter"].values.tolist() == ["theta[0]", "sigma"]
    assert found["changes_response"].values.tolist() == [True, False]


def test_records_in_one_model_add_up(y):
    """Two records with independent errors: A and B are sums."""
    with declare("NORM", y) as model:
        pm.Normal("z", pm.math.dot(SIGNALS, model["theta"]), model["sigma"], observed=data(seed=7))
    both = pmf.effective_samples(at(1.0, 2.0), model=model)
    one = pmf.effective_samples(at(1.0, 2.0), model=declare("NORM", y))
    assert both.sizes["sensor"] == 8
    ratio = one["standard_deviation"][:2] / both["standard_deviation"][:2]
    np.testing.assert_allclose(ratio, np.sqrt(2.0), rtol=0.25)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["NORM", "EXP"])
def test_posterior_has_the_covariance_that_the_residuals_support(kind, y):
    """In every direction, from likelihoods that claim 2400 and 8 observations."""
    found, theta = calibrated(declare(kind, y), draws=1000)
    expected = found["calibration"].to_dataset()
    assert_normal(theta, expected["point"].values[:2], expected["covariance"].values[:2, :2], 0.15)
    assert (found["sample_stats"].attrs["power"] > 1.0) == (kind == "EXP")


@pytest.mark.slow
def test_priors_keep_their_meaning(y, least_squares):
    """A bound is not crossed; an informative prior multiplies the calibrated likelihood, in closed form."""
    estimate, *_ = least_squares
    covariance = pmf.effective_samples(at(1.0, 2.0), model=declare("NORM", y))["covariance"].values[:2, :2]
    width = np.sqrt(covariance[0, 0])
    high = estimate[0] + 0.3 * width
    model = declare("NORM", y, lambda: pm.Uniform("theta", [-5.0, -5.0], [high, 5.0]))
    _, theta = calibrated(model, estimate[0] - width, 2.0)
    assert high - 0.2 * width < theta[:, 0].max() < high
    model = declare("NORM", y, lambda: pm.Normal("theta", estimate + 2.0 * width, width))
    _, theta = calibrated(model, draws=1000)
    precision = np.linalg.inv(covariance)
    expected = np.linalg.inv(precision + np.eye(2) / width**2)
    mean = expected @ (precision @ estimate + (estimate + 2.0 * width) / width**2)
    assert_normal(theta, mean, expected, 0.2)


@pytest.mark.slow
def test_draws_far_from_the_maximum_are_warned_of(y, least_squares):
    """Where the prior leads away from it. Control: no warning with a prior that agrees with the data."""
    estimate, truth, _ = least_squares
    sd = np.sqrt(np.diag(truth))
    for away in (0.0, 30.0):
        model = declare("NORM", y, lambda away=away: pm.Normal("theta", estimate + away * sd, 0.3 * sd))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            calibrated(model, draws=100)
        far = [w for w in caught if "% of the calibrated draws are far from" in str(w.message)]
        assert bool(far) == (away > 0.0)


@pytest.mark.slow
def test_what_a_checkpoint_keeps_is_not_evaluated_again(y, tmp_path, monkeypatch):
    """Killed after a part of the draws has been weighed, a run goes on and ends with the same draws."""
    parts, evaluate = [], Stretched.__call__

    def counted(self, z):
        if not isinstance(self.likelihood, Expansion):
            parts.append(len(z))
            if len(parts) == limit:
                raise KeyboardInterrupt
        return evaluate(self, z)

    monkeypatch.setattr(Stretched, "__call__", counted)
    model, limit = declare("NORM", y), 3
    with pytest.raises(KeyboardInterrupt):
        calibrated(model, draws=200, cores=1, checkpoint=tmp_path)
    limit = None
    _, again = calibrated(model, draws=200, cores=1, checkpoint=tmp_path)
    assert parts == [100] * 3 + [100] * 2
    np.testing.assert_array_equal(again, calibrated(model, draws=200, cores=1)[1])


def test_a_checkpoint_of_many_parameters(tmp_path, monkeypatch):
    """Whose likelihood is not expanded, but sampled: a second run ends with the same draws by the record."""
    rng = np.random.default_rng(3)
    design = rng.normal(size=(2, 200, 16))
    with pm.Model() as model:
        theta = pm.Normal("theta", 0.0, 3.0, shape=16)
        mu, sigma = pm.math.dot(design, theta), pm.HalfNormal("sigma", 1.0)
        pm.Normal("y", mu, sigma, observed=design.sum(axis=-1) + 0.3 * rng.normal(size=(2, 200)))
    settings = {"chains": 1, "cores": 1, "random_seed": 1, "progressbar": False, "checkpoint": tmp_path}
    first = pmf.calibrate(at(*np.ones(16), sigma=0.3), model=model, draws=50, **settings)
    monkeypatch.setattr(Stretched, "__call__", None)
    again = pmf.calibrate(at(*np.ones(16), sigma=0.3), model=model, draws=50, **settings)
    np.testing.assert_array_equal(again["posterior"]["theta"], first["posterior"]["theta"])


def test_every_mode_has_its_weight(y):
    """theta^2 is what the data know, so that two modes differ by the prior alone: 0.646 to 0.354."""
    with pm.Model() as model:
        root = pm.Normal("theta", 0.3, 1.0)
        pm.Normal("y", SIGNALS[..., 0] * root**2 + SIGNALS[..., 1] * 2.0, 0.1, observed=y)
    draws = np.random.default_rng(1).choice([1.0, -1.0], p=[0.9, 0.1], size=(2, 200))
    idata = xr.DataTree.from_dict({"posterior": xr.Dataset({"theta": (("chain", "draw"), draws)})})
    found = pmf.calibrate(idata, model=model, draws=500, random_seed=5, progressbar=False)
    theta, weight = found["posterior"]["theta"].values, found["calibration"]["weight"].values
    right = 1.0 / (1.0 + np.exp(-0.6))
    assert weight.max() == pytest.approx(right, abs=0.02)
    assert np.mean(theta > 0) == pytest.approx(right, abs=0.02)
    assert found["posterior"].sizes == {"chain": 2, "draw": 500}
    expected = found["calibration"]["standard_deviation"].values[0, 0]
    assert theta[theta > 0].std() == pytest.approx(expected, rel=0.15)
    of_draw, highest = found["sample_stats"]["mode"].values, int(found["calibration"]["point"][0, 0] < 0)
    assert np.all((theta > 0) == (of_draw == highest))
    assert found["sample_stats"].attrs["n_modes"] == 2


@pytest.mark.slow
def test_what_the_data_do_not_know_keeps_its_prior(y):
    """A parameter that no likelihood has: its draws are those of the prior, at a false-alarm rate of 1e-3."""
    with declare("EXP", y) as model:
        pm.Beta("idle", 2.0, 5.0)
    idata = at(1.0, 2.0)
    idata["posterior"]["idle"] = xr.DataArray([[0.3]], dims=("chain", "draw"))
    found = pmf.calibrate(idata, model=model, draws=500, chains=2, random_seed=7, progressbar=False)
    assert kstest(found["posterior"]["idle"].values.ravel(), beta(2.0, 5.0).cdf).pvalue > 1e-3
    assert np.isnan(found["calibration"]["standard_deviation"].values[-1])


def test_other_models_are_refused(y):
    with pm.Model() as model:
        pm.StudentT("y", 3.0, pm.Normal("theta"), observed=y)
    with pytest.raises(TypeError, match="must have Normal, CorrelatedNormal or feature .* got StudentT"):
        pmf.effective_samples(model)
    with pm.Model() as model:
        pm.Normal("theta")
    with pytest.raises(ValueError, match="`model` must have observed variables, got none"):
        pmf.effective_samples(model)
    with pytest.raises(TypeError, match="`idata` must be a DataTree with a group `posterior`, got"):
        pmf.calibrate(xr.Dataset(), model=declare("NORM", y))


def test_data_without_noise_are_refused(y):
    """All of them, and a dead channel: neither signal nor misfit."""
    with pytest.raises(ValueError, match="the residuals of y must not vanish"):
        pmf.effective_samples(at(1.0, 2.0), model=declare("NORM", SIGNALS @ [1.0, 2.0]))
    alive = np.array([[1.0], [0.0]])
    with pm.Model() as model:
        pm.Normal("y", pm.Normal("a") * SIGNALS[:2, :, 0] * alive, 1.0, observed=y[:2] * alive)
    posterior = xr.Dataset({"a": (("chain", "draw"), [[1.0]])})
    with pytest.raises(ValueError, match="the residuals of y must not vanish, got none at sensor 1"):
        pmf.effective_samples(xr.DataTree.from_dict({"posterior": posterior}), model=model)


def test_a_record_that_is_too_short_is_warned_of():
    """Errors that persist for half of the record. Control: white ones."""
    drift = first_order(np.random.default_rng(9), (4, N_TIMES), np.exp(-DT / 6.0))
    with pytest.warns(CalibrationWarning, match=r"the errors of y persist for .* s of a record of 12 s"):
        pmf.effective_samples(at(1.0, 2.0), model=declare("CN", SIGNALS @ [1.0, 2.0] + drift))
    with warnings.catch_warnings():
        warnings.simplefilter("error", CalibrationWarning)
        pmf.effective_samples(at(1.0, 2.0), model=declare("NORM", data("white")))
