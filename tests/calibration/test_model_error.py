"""Frequency bands that disagree about the parameters, and what a fit takes out of its residuals."""

import numpy as np
import pymc as pm
import pytest

import pymc_features as pmf
from benchmarks.coverage.model_errors import FAMILIES, covers, other_masses, outcome, right
from calibration.test_spectrum import N_TIMES, errors_of, event_of, regression
from pymc_features.calibration.climb import climb_likelihood
from pymc_features.calibration.fit import Predictions
from pymc_features.calibration.peaks import Peak, of_base_noise
from pymc_features.calibration.sandwich import edges_of, sandwich, sentence
from pymc_features.calibration.spectrum import taken

DT = 0.02


def event_of_waves(errors, frequencies):
    """Residuals of a fit of two waves, of 1 and 3.1 Hz, to errors (sensor, time)."""
    s = regression()
    flat = s.reshape(-1, 2)
    off = np.linalg.solve(flat.T @ flat, flat.T @ errors.ravel())
    return event_of(errors - s @ off, s, s.sum(axis=-1), frequencies)


@pytest.mark.statistical
@pytest.mark.slow
def test_bands_of_a_right_model_agree():
    """Mean of the factor that widths grow by, of 100 data sets: below 1.2. Control: with waves that none of
    the two parameters explains, alike in all sensors, bands disagree more often.
    """
    rng, bands, factors, wrong = np.random.default_rng(5), np.array([1.0, 3.1, 6.0]), [], []
    t = DT * np.arange(N_TIMES)
    for _ in range(100):
        errors = errors_of("white", rng, regression())
        factors.append(sandwich([event_of_waves(errors, bands)]).factor)
        errors += 2.0 * np.sin(2.0 * np.pi * 1.03 * t + rng.uniform(0.0, 6.3)) * np.exp(-0.3 * t)
        wrong.append(sandwich([event_of_waves(errors, bands)]).growth)
    assert 1.0 < np.mean(factors) < 1.2
    assert np.mean(np.array(wrong) > 1.0) > np.mean(np.array(factors) > 1.0)


@pytest.mark.statistical
@pytest.mark.slow
def test_a_wrong_distribution_of_masses():
    """Intervals of 24 events contain what fits all of them best; with the right model they are not wider
    than 1.3 times those without corrections (mean).
    """
    family = FAMILIES["braced frame"]
    wrong, fine = (
        [outcome(family, respond, seed) for seed in range(24)] for respond in (other_masses, right)
    )
    plain, corrected = (share.mean() for share in covers(wrong))
    assert plain < 0.85 < 0.93 < corrected
    assert np.median([one.growth for one in wrong]) > 1.5
    assert 1.0 < np.mean([one.corrected / one.plain for one in fine]) < 1.3
    assert covers(fine)[1].mean() > 0.82


def test_without_bands_nothing_grows():
    """Without natural frequencies, or a step, or if it is not wanted. Control: with three bands it can."""
    t = DT * np.arange(N_TIMES)
    errors = errors_of("white", np.random.default_rng(1), regression())
    errors += 2.0 * np.sin(2.0 * np.pi * 1.03 * t + 1.0) * np.exp(-0.3 * t)
    event = event_of_waves(errors, np.array([1.0, 3.1]))
    found = sandwich([event])
    assert found.growth > 1.0
    for one, how in (
        (event._replace(frequencies=None), "bands"),
        (event._replace(value=event.value._replace(step=np.nan)), "bands"),
        (event._replace(frequencies=np.array([1.0])), "bands"),
        (event, None),
    ):
        other = sandwich([one], how)
        assert np.isnan(other.growth) and other.factor == 1.0
        np.testing.assert_allclose(found.variability, found.factor**2 * other.variability, rtol=1e-9)


def test_edges_of_bands():
    """Half-way between natural frequencies, four at most, none of frequencies that samples do not show."""
    event = event_of_waves(np.ones((4, N_TIMES)), np.array([3.0, 1.0, 24.0]))
    np.testing.assert_allclose(edges_of(event) / DT, [2.0])
    many = event._replace(frequencies=1.0 + np.arange(8.0))
    np.testing.assert_allclose(edges_of(many) / DT, [1.5, 2.5, 3.5, 4.5])


def test_the_sentence():
    assert sentence(1.2) == sentence(np.nan) == ""
    assert "by a factor of 2.4 more than its residuals allow" in sentence(2.4)
    assert "Intervals are 2 times wider" in sentence(2.4)
    assert "Intervals are 1.7 times wider" in sentence(1.7)


def test_what_a_fit_takes():
    """Of a wave on two lines of the spectrum, each line decides half: its residual is doubled.

    One that a single line decides is multiplied by ten at most; orthogonal residuals stay as they are.
    """
    n = 200
    t = 2.0 * np.pi * np.arange(n) / n
    wave = np.cos(5.0 * t) + np.cos(9.0 * t)
    unit = (wave / np.linalg.norm(wave))[None, :, None]
    errors = np.cos(5.0 * t)[None] + 0.3 * np.sin(5.0 * t) + 0.2 * np.cos(30.0 * t)
    np.testing.assert_allclose(taken(errors, unit)[0], np.cos(5.0 * t), atol=1e-12)
    alone = np.cos(5.0 * t)[None, :, None] * np.sqrt(2.0 / n)
    np.testing.assert_allclose(taken(errors, alone)[0], 10.0 * np.cos(5.0 * t), atol=1e-12)


@pytest.mark.parametrize("kind", ["chain", "hysteretic", "matrices", "sum"])
def test_natural_frequencies_behind_a_prediction(kind):
    """As the structure has them; none where there is no structure."""
    record = pmf.Record(np.random.default_rng(1).normal(size=50), DT)
    mass, damping = np.ones(3), pmf.RayleighDamping(0.3, 5e-4)
    chain = pmf.SpringMassChain(mass, [900.0, 800.0, 700.0], damping)
    with pm.Model() as model:
        k = pm.LogNormal("k") * 900.0
        if kind == "matrices":
            first = np.diag([1.0, 0.0, 0.0])
            rest = chain.as_linear().stiffness - 900.0 * first
            structure = pmf.AffineStructure(
                mass, stiffness=rest, damping=damping, stiffness_terms=[first], theta=pm.math.stack([k])
            )
        elif kind == "hysteretic":
            structure = pmf.HystereticChain(
                mass, [k, 800.0, 700.0], damping=damping, yield_displacement=0.1, post_yield_ratio=0.1
            )
        else:
            structure = pmf.SpringMassChain(mass, [k, 800.0, 700.0], damping)
        mu = pmf.response(structure, record)
        mu = mu + 0.1 * pm.Normal("bias") if kind == "sum" else mu
        pm.Normal("y", mu, 0.1, observed=np.zeros((3, 50)))
    predictions = Predictions(model)
    z = predictions.space.join(model.initial_point()) * 0.0
    [found] = predictions.frequencies(z)
    np.testing.assert_allclose(found, chain.modes().natural_frequencies, rtol=1e-9)


@pytest.mark.parametrize("is_data", [False, True])
def test_bands_where_the_step_is_data(is_data):
    """A step that is data of the model divides bands as a number does, as it is now."""
    record, observed = pmf.Record(np.random.default_rng(2).normal(size=400), DT), np.ones((3, 200))
    with pm.Model() as model:
        k = pm.LogNormal("k", np.log(900.0), 0.2)
        step, data = 2 * DT, observed
        if is_data:
            step, data = pm.Data("step", DT), pm.Data("data", np.zeros((3, 400)))
        chain = pmf.SpringMassChain(np.ones(3), [k, 800.0, 700.0], pmf.RayleighDamping(0.3, 5e-4))
        pm.Normal("y", pmf.response(chain, record, dt=step), 1.0, observed=data)
        if is_data:
            pm.set_data({"step": 2 * DT, "data": observed})
    predictions = Predictions(model)
    z = np.log([900.0])
    [value], [frequencies] = predictions(z), predictions.frequencies(z)
    event = event_of(value.residuals, np.ones((3, 200, 1)), np.ones((3, 200)), frequencies)
    edges = edges_of(event._replace(value=value))
    np.testing.assert_allclose(edges, 2 * DT * 0.5 * (frequencies[1:] + frequencies[:-1]))


def test_no_structure_no_frequencies():
    with pm.Model() as model:
        pm.Normal("y", pm.Normal("a") * np.ones((2, 50)), 0.1, observed=np.zeros((2, 50)))
    assert Predictions(model).frequencies(np.zeros(1)) == [None]


def test_other_words_are_refused():
    with pm.Model() as model:
        pm.Normal("y", pm.Normal("a") * np.ones((2, 50)), 0.1, observed=np.zeros((2, 50)))
    with pytest.raises(ValueError, match="`model_error` must be one of bands, got 'windows'. Or pass None."):
        pmf.calibrate(None, model=model, model_error="windows")


@pytest.mark.slow
@pytest.mark.parametrize("interpolation", ["linear", "band-limited"])
def test_noise_of_the_base(interpolation):
    """Covariance of the score by 200 realisations, beside closed form by the response to one sample of it.

    To 30 %, five standard errors. The prediction is as it was afterwards; intervals are wider with the noise.
    """
    n, at, rng = 400, 100, np.random.default_rng(4)
    record = pmf.Record(rng.normal(size=n), DT, interpolation=interpolation)
    mass, damping, springs = np.ones(3), pmf.RayleighDamping(0.3, 5e-4), np.array([900.0, 800.0, 700.0])
    exact = pmf.simulate(pmf.SpringMassChain(mass, springs, damping), record).values
    with pm.Model() as model:
        theta = pm.Normal("theta", 1.0, 0.2, shape=3)
        mu = pmf.response(pmf.SpringMassChain(mass, springs * theta, damping), record)
        pm.Normal("y", mu, pm.HalfNormal("sigma", 1.0), observed=exact + 0.05 * rng.normal(size=exact.shape))
    predictions = Predictions(model)
    fit = climb_likelihood(predictions, np.array([1.0, 1.0, 1.0, np.log(0.05)]))
    before = predictions(fit.z)[0][0]
    found = of_base_noise(predictions, fit, 0.1)[:3, :3]
    np.testing.assert_array_equal(predictions(fit.z)[0][0], before)
    impulse = pmf.Record(1.0 * (np.arange(n) == at), DT, interpolation=interpolation)
    h = pmf.simulate(pmf.SpringMassChain(mass, springs * fit.w[:3], damping), impulse).values
    h = np.roll(np.pad(h, ((0, 0), (0, n))), -at, axis=1)
    s = np.pad(fit.events[0].sensitivities[..., :3] / np.exp(fit.w[3]), ((0, 0), (0, n), (0, 0)))
    h, s = np.fft.rfft(h, axis=1), np.fft.rfft(s, axis=1)
    back = 0.1 * np.fft.irfft(np.einsum("sf,sfp->fp", h.conj(), s), 2 * n, axis=0)[:n]
    expected = back.T @ back
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found / scale, expected / scale, atol=0.3)
    peak = Peak(fit, sandwich(fit.events))
    together = peak.with_base_noise(predictions, 0.1).sandwich.variability[:3, :3]
    for matrix in (peak.sandwich.variability[:3, :3], found):
        assert np.linalg.eigvalsh(together - matrix).min() > -1e-9 * np.trace(together)


def test_noise_of_a_base_needs_a_base():
    with pm.Model() as model:
        data = np.random.default_rng(1).normal(size=(2, 50))
        pm.Normal("y", pm.Normal("a") * np.ones((2, 50)), 0.1, observed=data)
    predictions = Predictions(model)
    fit = climb_likelihood(predictions, np.zeros(1))
    with pytest.raises(ValueError, match="`base_noise` must be left out of a prediction that is no response"):
        of_base_noise(predictions, fit, 0.1)
    with pytest.raises(ValueError, match="`base_noise` must be positive, got -1.0. Pass m/s.2."):
        pmf.calibrate(None, model=model, base_noise=-1.0)
