"""EXP on the logarithms of spectra: against expected spectra, differences and simulated noise."""

import numpy as np
import pymc as pm
import pytest
import xarray as xr
from scipy.special import polygamma

import pymc_features as pmf
from pymc_features.ambient.log_spectra import LogSpectra, LogSpectraGradient
from pymc_features.smc import population_logp

DT, N = 0.05, 12_000
BANDS = [[1.0, 2.5], [4.0, 6.0]]
STIFFNESS = 900.0


def building(theta):
    return pmf.SpringMassChain(np.ones(4), STIFFNESS * theta * np.ones(4), pmf.ModalDamping(0.02))


def channels(values):
    """Channels (sensor, time) with names and times."""
    coords = {"sensor": [f"s{i}" for i in range(len(values))], "time": DT * np.arange(values.shape[1])}
    return xr.DataArray(values, coords, ("sensor", "time"))


def simulated(seed):
    """Histories whose transforms in the bands have the spectral densities of the model."""
    with pm.Model() as model:
        response = pmf.spectral_response(building(1.0), 0.5, sensors=[1, 3])
        pmf.AmbientResponse("y", response, error=0.05, bands=BANDS, dt=DT, observed=np.zeros((2, N)))
    return pm.draw(model["y"], random_seed=seed)


def random_inputs(rng, integrals=0):
    """Three modes, four sensors, two forces; two bands, five and seven averages over three frequencies."""
    frequencies = np.sort(rng.uniform(0.8, 3.0, (12, 3)), axis=None).reshape(12, 3)
    return [
        rng.uniform(0.9, 2.8, 3),
        rng.uniform(0.01, 0.05, 3),
        rng.normal(size=(3, 4)),
        rng.normal(size=(2, 3, 2, 2)),
        rng.uniform(0.1, 1.0, (2, 4)),
        frequencies,
        np.repeat([0, 1], [5, 7]),
        np.int64(integrals),
    ]


@pytest.mark.parametrize("integrals", [0, 1, 2])
def test_logarithms_of_the_diagonal_of_covariance_matrices(integrals):
    inputs = random_inputs(np.random.default_rng(integrals), integrals)
    natural, ratios, shapes, factor, error, frequencies, band, _ = inputs
    [found] = LogSpectra().run(inputs)
    for c, row in enumerate(frequencies):
        power = np.zeros(4)
        for f in row:
            beta = natural / f
            h = (2j * np.pi * f) ** -integrals / (1.0 - beta**2 - 2j * ratios * beta)
            root = shapes.T @ np.diag(h) @ (factor[band[c], ..., 0] + 1j * factor[band[c], ..., 1])
            power += np.diag(root @ root.conj().T).real + error[band[c]]
        np.testing.assert_allclose(found[:, c], np.log(power / 3.0), rtol=1e-12)


def test_gradient_against_differences():
    rng = np.random.default_rng(5)
    inputs = random_inputs(rng, 1)
    cotangent = rng.normal(size=(4, 12))
    slopes = LogSpectraGradient().run([*inputs, cotangent])
    for number, slope in enumerate(slopes):
        direction = rng.normal(size=slope.shape)
        ends = []
        for sign in (1.0, -1.0):
            moved = [x + sign * 1e-6 * direction if i == number else x for i, x in enumerate(inputs)]
            ends.append((cotangent * LogSpectra().run(moved)[0]).sum())
        assert np.sum(slope * direction) == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-6)


def test_impossible_modes_have_no_spectrum():
    inputs = random_inputs(np.random.default_rng(0))
    inputs[0] = inputs[0] * np.nan
    assert np.isnan(LogSpectra().run(inputs)[0]).all()


def test_measured_logarithms_are_unbiased():
    """White noise of density 2: the mean of all averages within four standard errors, and their variance."""
    rng = np.random.default_rng(2)
    noise = channels(np.sqrt(0.5 * 2.0 / DT) * rng.standard_normal((4, 20_000)))
    for average in (1, 8):
        found = pmf.log_spectra(noise, [[1.0, 5.0]], average=average)
        variance = polygamma(1, average)
        error = np.sqrt(variance / found.size)
        assert abs(found.values.mean() - np.log(2.0)) < 4.0 * error
        assert found.values.var() == pytest.approx(variance, rel=0.15)
        assert abs(found.values.mean() + 0.5 / average - np.log(2.0)) > 4.0 * error  # as without the bias


@pytest.mark.slow
def test_the_expected_ones_are_those_measured():
    """Averages of forty records, whose scatter is 0.06 for each of the frequencies."""
    total = sum(pmf.log_spectra(channels(simulated(seed)), BANDS).values for seed in range(40)) / 40
    measured = pmf.log_spectra(channels(simulated(0)), BANDS)
    response = pmf.spectral_response(building(1.0), 0.5, sensors=[1, 3])
    expected = pmf.expected_log_spectra(response, 0.05, measured).eval()
    off = total - expected
    assert abs(off.mean()) < 0.02 and np.abs(off).max() < 0.3
    assert np.abs(total - np.roll(expected, 8, axis=1)).max() > 0.3


def declared(measured):
    """The factor of all springs, forces and errors under EXP on the logarithms."""
    with pm.Model() as model:
        theta = pm.LogNormal("theta", 0.0, 0.2)
        wind, error = pm.LogNormal("wind", 0.0, 1.0), pm.LogNormal("error", -3.0, 1.0)
        response = pmf.spectral_response(building(theta), wind, sensors=[1, 3])
        mu = pmf.expected_log_spectra(response, error, measured)
        pmf.ExpFeature("y", mu=mu, sigma=pm.HalfNormal("sigma", 1.0), observed=measured.values)
    return model


def test_populations_and_gradients():
    model = declared(pmf.log_spectra(channels(simulated(0)), BANDS))
    logp = population_logp(model, model.initial_point(), {})
    assert logp.batched
    rng, h = np.random.default_rng(5), 1e-5
    points = logp.start + 0.1 * rng.normal(size=(3, logp.start.shape[1]))
    _, likelihood, _, _, slope = logp.gradient(points)
    np.testing.assert_allclose(likelihood, [logp(x[None])[1][0] for x in points], rtol=1e-10)
    for i in range(points.shape[1]):
        step = h * np.eye(points.shape[1])[i]
        difference = (logp(points + step)[1] - logp(points - step)[1]) / (2.0 * h)
        np.testing.assert_allclose(slope[:, i], difference, rtol=2e-5, atol=2e-5)


@pytest.mark.slow
def test_posteriors_hold_the_truth_and_are_wide():
    """99 % intervals of the stiffness; tens of times wider than under `AmbientResponse`, for two sensors."""
    values = simulated(3)
    model = declared(pmf.log_spectra(channels(values), BANDS))
    theta = pmf.sample(300, model=model, chains=2, random_seed=1, cores=1, progressbar=False)["posterior"][
        "theta"
    ]
    low, high = theta.quantile([0.005, 0.995])
    assert low < 1.0 < high
    with pm.Model() as exact:
        factor = pm.LogNormal("theta", 0.0, 0.2)
        wind, error = pm.LogNormal("wind", 0.0, 1.0), pm.LogNormal("error", -3.0, 1.0)
        response = pmf.spectral_response(building(factor), wind, sensors=[1, 3])
        pmf.AmbientResponse("y", response, error=error, bands=BANDS, dt=DT, observed=values)
    gaussian = pmf.laplace(500, model=exact, random_seed=1)["posterior"]["theta"]
    assert 20.0 < theta.std() / gaussian.std() < 60.0


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"average": 0}, "`average` must be"),
        ({"average": 3000}, "`average` must be at most the 901 frequencies of each band"),
        ({"bands": [[2.0, 1.0]]}, "`bands` must be ascending pairs"),
        ({"channels": 3.0}, "`channels` must be an xarray.DataArray"),
        ({"channels": channels(np.zeros((2, N)))}, "`channels` must be channels that move in the bands"),
    ],
)
def test_bad_data_are_refused(change, says):
    given = {"channels": channels(simulated(0)), "bands": BANDS} | change
    with pytest.raises((ValueError, TypeError), match=says):
        pmf.log_spectra(given.pop("channels"), **given)


def test_bad_responses_are_refused():
    measured = pmf.log_spectra(channels(simulated(0)), BANDS)
    response = pmf.spectral_response(building(1.0), 0.5, sensors=[1, 3])
    with pytest.raises(TypeError, match="`response` must be what `spectral_response` returned"):
        pmf.expected_log_spectra(building(1.0), 0.05, measured)
    with pytest.raises(TypeError, match="`measured` must be what `log_spectra` returned"):
        pmf.expected_log_spectra(response, 0.05, measured.values)
    with pytest.raises(ValueError, match="`measured` must be of the 4 sensors of the response, got 2"):
        pmf.expected_log_spectra(pmf.spectral_response(building(1.0), 0.5), 0.05, measured)
    with pytest.raises(ValueError, match="`error` must be positive and finite"):
        pmf.expected_log_spectra(response, -0.05, measured)
