"""Models that are not the structure, noise on the base, and how often intervals of a chain hold the truth."""

import functools

import numpy as np
import pymc as pm
import pytest

import pymc_features as pmf
from benchmarks import truth
from benchmarks.coverage.errors import LEVEL, measurements
from benchmarks.coverage.intervals import calibrated
from benchmarks.coverage.model_errors import FAMILIES, covers, other_masses, outcome, right
from pymc_features.calibration.maxima import climb_likelihood
from pymc_features.calibration.residuals import Predictions
from pymc_features.calibration.sandwich import Peak

DT, DURATION = 0.02, 11.98  # s: 600 samples at 50 Hz, whose transforms are quick
MASS, SPRINGS, DAMPING = np.ones(3), np.full(3, 1200.0), pmf.RayleighDamping(0.3, 5e-4)  # up to 9.9 Hz
CHAIN = truth.chain_matrices(MASS, SPRINGS, (0.3, 5e-4))


@functools.cache
def exact(rate):
    """Motion of the base, which is on its way at both ends, and floor accelerations (sensor, time)."""
    moved = truth.motion(rate, DURATION, 1, ends="moving")
    return moved, truth.response(CHAIN, moved)["absolute_acceleration"]


def declare(rate, **settings):
    """NORM with ln of three stiffness factors and of one of the damping, and the data `measured`."""
    moved, response = exact(rate)
    record = pmf.Record(moved.values()[0], 1.0 / rate, **settings)
    with pm.Model() as model:
        theta = pm.Normal("theta", 1.0, 0.25, shape=4)
        sigma = pm.LogNormal("sigma", 0.0, 2.0)
        damping = pmf.RayleighDamping(0.3 * theta[3], 5e-4 * theta[3])
        mu = pmf.response(pmf.SpringMassChain(MASS, SPRINGS * theta[:3], damping), record, dt=1.0 / rate)
        pm.Normal("y", mu, sigma, observed=pm.Data("measured", response))
    return model


def coverage(model, kind, rate, n_sets, model_error="bands"):
    """Share of the intervals of 90 % by CAL that contain the truth, by parameter (4,)."""
    response, predictions, hits = exact(rate)[1], Predictions(model), []
    frequency = truth.modes(CHAIN.mass, CHAIN.stiffness)[0][0] / (2.0 * np.pi)
    start = np.array([1.0, 1.0, 1.0, 1.0, np.log(LEVEL * np.sqrt(np.mean(response**2)))])
    for seed in range(n_sets):
        model["measured"].set_value(measurements(kind, response, 1.0 / rate, frequency, seed))
        cal = calibrated(predictions, start, 4, model_error)
        hits.append(np.abs(cal.point[:4] - 1.0) < 1.645 * np.sqrt(np.sum(cal.factor**2, axis=1)[:4]))
    return np.mean(hits, axis=0)


@pytest.mark.statistical
@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "rate", "n_sets", "lowest"),
    [
        ("AR(1), 0.05 s", 100.0, 100, 0.82),
        ("narrow-band", 50.0, 200, 0.8),
    ],
)
def test_coverage_of_a_chain(kind, rate, n_sets, lowest):
    """Mean of three springs and the damping.

    Of 200 data sets it scatters by 1.1 (parameters independent) to 2.1 % (all alike) from seed to seed, so
    that a false alarm is one in 100 or less where 88 to 94 % are right; seeds are fixed. Of 100, by 1.5 to
    3 %: as rare where 90 % are right, and intervals a fifth too narrow, which contain 81 %, are seen in six
    of ten. Bands disagree about narrow-band errors though the model is right: intervals are then too wide.
    """
    found = coverage(declare(rate), kind, rate, n_sets).mean()
    assert lowest < found < (0.98 if kind != "narrow-band" else 1.0)


@pytest.mark.statistical
@pytest.mark.slow
def test_straight_lines_exclude_the_truth():
    """Control: where they join the samples, the damping is never within its interval, springs are seldom."""
    found = coverage(declare(50.0, interpolation="linear"), "white", 50.0, 20, None)
    assert found[3] < 0.1 and found.mean() < 0.7


@pytest.mark.statistical
@pytest.mark.slow
def test_a_wrong_distribution_of_masses():
    """Intervals of 24 events contain what fits all of them best; with the right model, in 12 events, they are
    not wider than 1.3 times those without corrections (mean).
    """
    wrong, fine = (
        [outcome(FAMILIES["braced frame"], respond, seed) for seed in range(n)]
        for respond, n in ((other_masses, 24), (right, 12))
    )
    plain, corrected = (share.mean() for share in covers(wrong))
    assert plain < 0.85 < 0.93 < corrected
    assert np.median([one.growth for one in wrong]) > 1.5
    assert 1.0 < np.mean([one.corrected / one.plain for one in fine]) < 1.3
    assert covers(fine)[1].mean() > 0.82


@pytest.mark.parametrize("kind", ["hysteretic", "sum"])
def test_natural_frequencies_behind_a_prediction(kind):
    """As the structure has them, whatever stands around the response."""
    record = pmf.Record(np.random.default_rng(1).normal(size=50), DT)
    chain = pmf.SpringMassChain(MASS, [900.0, 800.0, 700.0], DAMPING)
    with pm.Model() as model:
        k = pm.LogNormal("k") * 900.0
        structure = pmf.SpringMassChain(MASS, [k, 800.0, 700.0], DAMPING)
        if kind == "hysteretic":
            law = {"yield_displacement": 0.1, "post_yield_ratio": 0.1}
            structure = pmf.HystereticChain(MASS, [k, 800.0, 700.0], damping=DAMPING, **law)
        mu = pmf.response(structure, record)
        mu = mu + 0.1 * pm.Normal("bias") if kind == "sum" else mu
        pm.Normal("y", mu, 0.1, observed=np.zeros((3, 50)))
    predictions = Predictions(model)
    [found] = predictions.frequencies(0.0 * predictions.space.join(model.initial_point()))
    np.testing.assert_allclose(found, chain.modes().natural_frequencies, rtol=1e-9)


@pytest.mark.parametrize("likelihood", [pm.Normal, pmf.ExpFeature])
def test_a_step_that_is_data_of_the_model(likelihood):
    """It divides bands as it is now; data of any number of samples hide the response behind a broadcast."""
    record = pmf.Record(np.random.default_rng(2).normal(size=400), DT)
    with pm.Model() as model:
        step, data = pm.Data("step", DT), pm.Data("data", np.zeros((3, 400)))
        chain = pmf.SpringMassChain(MASS, [pm.LogNormal("k", np.log(900.0), 0.2), 800.0, 700.0], DAMPING)
        likelihood("y", pmf.response(chain, record, dt=step), pm.HalfNormal("sigma"), observed=data)
        pm.set_data({"step": 2 * DT, "data": np.ones((3, 200))})
    [value] = Predictions(model)(np.log([900.0, 1.0]))
    assert value.step == 2 * DT and value.mu.shape == (3, 200)


def mean_model():
    """A constant in noise: no structure."""
    with pm.Model() as model:
        data = np.random.default_rng(1).normal(size=(2, 50))
        pm.Normal("y", pm.Normal("a") * np.ones((2, 50)), 0.1, observed=data)
    return model


def test_what_needs_a_structure():
    """Without one there are no frequencies, nor a base whose noise could be known. Other words are errors."""
    predictions = Predictions(mean_model())
    assert predictions.frequencies(np.zeros(1)) == [None]
    with pytest.raises(ValueError, match="`base_noise` must be left out of a prediction that is no response"):
        Peak.at(climb_likelihood(predictions, np.zeros(1))).with_base_noise(predictions, 0.1)
    with pytest.raises(ValueError, match="`base_noise` must be positive, got -1.0. Pass m/s.2."):
        pmf.calibrate(None, model=predictions.model, base_noise=-1.0)
    with pytest.raises(ValueError, match="`model_error` must be one of bands, got 'windows'. Or pass None."):
        pmf.calibrate(None, model=predictions.model, model_error="windows")


@pytest.mark.slow
@pytest.mark.parametrize("interpolation", ["linear", "band-limited"])
def test_noise_of_the_base(interpolation):
    """Covariance of the score by 200 realisations, beside closed form by the response to one sample of it.

    To 30 %, five standard errors. The prediction is as it was afterwards; intervals are wider with the noise.
    """
    n, at, rng = 400, 100, np.random.default_rng(4)
    record = pmf.Record(rng.normal(size=n), DT, interpolation=interpolation)
    springs = np.array([900.0, 800.0, 700.0])
    exact = pmf.simulate(pmf.SpringMassChain(MASS, springs, DAMPING), record).values
    with pm.Model() as model:
        theta = pm.Normal("theta", 1.0, 0.2, shape=3)
        mu = pmf.response(pmf.SpringMassChain(MASS, springs * theta, DAMPING), record)
        pm.Normal("y", mu, pm.HalfNormal("sigma", 1.0), observed=exact + 0.05 * rng.normal(size=exact.shape))
    predictions = Predictions(model)
    fit = climb_likelihood(predictions, np.array([1.0, 1.0, 1.0, np.log(0.05)]))
    before = predictions(fit.z)[0].mu
    peak = Peak.at(fit)
    still = peak._replace(errors=1e-9 * peak.errors)  # by which next to nothing is known of other errors
    found = still.with_base_noise(predictions, 0.1).errors[:3, :3]
    np.testing.assert_array_equal(predictions(fit.z)[0].mu, before)
    impulse = pmf.Record(1.0 * (np.arange(n) == at), DT, interpolation=interpolation)
    h = pmf.simulate(pmf.SpringMassChain(MASS, springs * fit.w[:3], DAMPING), impulse).values
    h = np.roll(np.pad(h, ((0, 0), (0, n))), -at, axis=1)
    s = np.pad(fit.events[0].sensitivities[..., :3] / np.exp(fit.w[3]), ((0, 0), (0, n), (0, 0)))
    h, s = np.fft.rfft(h, axis=1), np.fft.rfft(s, axis=1)
    back = 0.1 * np.fft.irfft(np.einsum("sf,sfp->fp", h.conj(), s), 2 * n, axis=0)[:n]
    expected = back.T @ back
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found / scale, expected / scale, atol=0.3)
    together = peak.with_base_noise(predictions, 0.1).variability[:3, :3]
    for matrix in (peak.variability[:3, :3], found):
        assert np.linalg.eigvalsh(together - matrix).min() > -1e-9 * np.trace(together)
