"""Emulators of external simulators: against closed forms, and posteriors against quadrature."""

import warnings

import numpy as np
import pymc as pm
import pytest
from scipy.optimize import approx_fprime

from pymc_features import (
    CorrelatedNormal,
    ExpFeature,
    ExternalSimulator,
    compiled_logp,
    emulate,
    mean_square_discrepancy,
)
from pymc_features.exceptions import SamplingWarning
from pymc_features.external import emulator as gaussian_process
from pymc_features.external.emulation import largest_change, remaining
from pymc_features.external.emulator import (
    Coordinates,
    Emulator,
    GaussianProcess,
    Hyperparameters,
    fit_hyperparameters,
)
from pymc_features.external.replacement import replaced
from support.external_models import AtOnce

TIME = np.linspace(0.0, 3.0, 40)
LENGTHS = np.array([0.7, 1.3])


def oscillators(k, c):
    """Two sensors (2, 40) of decaying vibrations; fails where c is large."""
    if c > 0.9:
        raise RuntimeError("no equilibrium found")
    return np.array([np.exp(-c * TIME) * np.cos(k * TIME), k * np.exp(-2.0 * c * TIME) * np.sin(k * TIME)])


def simulator(function, shape, **settings):
    """An external simulator that runs here."""
    return ExternalSimulator(
        function, shape, executor=AtOnce(function), version="1", progress=False, **settings
    )


@pytest.mark.parametrize("kernel", gaussian_process.KERNELS)
def test_gaussian_process_is_universal_kriging(kernel):
    """Means and covariances against the bordered system, slopes against differences."""
    rng = np.random.default_rng(0)
    x, y, new = rng.uniform(size=(15, 2)), rng.normal(size=(15, 3)), rng.uniform(size=(4, 2))
    process = GaussianProcess(x, y, Hyperparameters(kernel, LENGTHS, 1e-3))
    basis, at_new = (np.column_stack([np.ones(len(p)), p, p[:, :1] * p, p[:, 1] ** 2]) for p in (x, new))
    known = process.kernel(x, x)[0] + (1e-3 + gaussian_process.JITTER) * np.eye(15)
    bordered = np.block([[known, basis], [basis.T, np.zeros((6, 6))]])
    right = np.vstack([process.kernel(x, new)[0], at_new.T])
    solved = np.linalg.solve(bordered, right)
    mean, variance = process.predict(new)
    np.testing.assert_allclose(mean, solved[:15].T @ y, rtol=1e-6)
    covariance = process.kernel(new, new)[0] - right.T @ solved
    np.testing.assert_allclose(process.covariance(new), covariance, atol=1e-9)
    np.testing.assert_allclose(variance, np.diag(covariance), atol=1e-9)
    by_mean, by_variance = rng.normal(size=(4, 3)), rng.normal(size=4)

    def weighted(point, i):
        mean, variance = process.predict(point[None])
        return mean[0] @ by_mean[i] + variance[0] * by_variance[i]

    slopes = process.slopes(new, by_mean, by_variance)
    numeric = [approx_fprime(new[i], weighted, 1e-6, i) for i in range(4)]
    np.testing.assert_allclose(slopes, numeric, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("kernel", gaussian_process.KERNELS)
def test_marginal_likelihood(kernel):
    """Against the density of contrasts that no trend changes, and its gradient against differences."""
    rng = np.random.default_rng(1)
    x, y = rng.uniform(size=(14, 2)), rng.normal(size=(14, 1))
    basis = gaussian_process.trend(x, 1)
    contrasts = np.linalg.svd(basis)[0][:, 3:]

    def value(p):
        return gaussian_process.objective(p, x, y, kernel, basis)[0]

    def direct(p):
        process = GaussianProcess(x, y, Hyperparameters(kernel, np.exp(p[:2]), np.exp(p[2])))
        noise = np.exp(p[2]) + gaussian_process.JITTER
        k = contrasts.T @ (process.kernel(x, x)[0] + noise * np.eye(14)) @ contrasts
        rest = contrasts.T @ y[:, 0]
        off = (p[:2] - gaussian_process.LENGTH_PRIOR[0]) / gaussian_process.LENGTH_PRIOR[1]
        return np.linalg.slogdet(k)[1] + 11 * np.log(rest @ np.linalg.solve(k, rest)) + off @ off

    points = np.array([[-0.5, 0.3, -4.0], [0.4, -0.2, -2.0], [0.0, 1.0, -6.0]])
    differences = [value(p) - direct(p) for p in points]
    np.testing.assert_allclose(differences, differences[0], atol=1e-6)  # up to a constant
    gradient = gaussian_process.objective(points[0], x, y, kernel, basis)[1]
    np.testing.assert_allclose(gradient, approx_fprime(points[0], value, 1e-6), rtol=1e-3, atol=1e-3)
    fitted = fit_hyperparameters(x, y)
    assert fitted.objective <= min(value(p) for p in points) + 1e-6


@pytest.fixture(scope="module")
def emulator():
    """Of thirty runs, one of which failed."""
    rng = np.random.default_rng(2)
    x = np.column_stack([np.exp(rng.uniform(0.0, 1.4, 30)), rng.uniform(0.1, 0.8, 30)])
    found = np.array([oscillators(*row) for row in x])
    found[7] = np.nan
    return Emulator(
        x, found, Coordinates.of(np.column_stack([rng.lognormal(0.7, 0.4, 500), rng.random(500)]))
    )


def test_expected_discrepancies(emulator):
    """An expectation of squares is exact by symmetric pairs of points, from whole histories with gaps."""
    assert emulator.coordinates.logarithmic.tolist() == [True, False]
    assert Coordinates.of(np.array([[0.3, 1.0], [0.1 + 0.2, 2.0]])).varying.tolist() == [1]
    data = oscillators(2.0, 0.3) + 0.1
    data[0, 3:9] = np.nan
    x = np.array([[1.5, 0.2], [2.5, 0.6]])
    z, variances = emulator.predict(x)
    variances = variances + 0.3

    def of(z):
        misfit = np.where(np.isnan(data), 0.0, data - emulator.responses_of(z))
        return (misfit**2).mean(axis=2)

    expected = of(z) + emulator.rest * (~np.isnan(data)).mean(axis=1)
    for c in range(z.shape[1]):
        step = np.zeros_like(z)
        step[:, c] = np.sqrt(variances[:, c])
        expected += 0.5 * (of(z + step) + of(z - step)) - of(z)
    np.testing.assert_allclose(emulator.discrepancies(z, variances, data), expected, rtol=1e-9)
    weights = np.array([[1.0, -2.0], [0.5, 3.0]])

    def weighted(point, i):
        return emulator.discrepancies(*emulator.predict(point[None]), data)[0] @ weights[i]

    numeric = [approx_fprime(x[i], weighted, 1e-6, i) for i in range(2)]
    np.testing.assert_allclose(emulator.discrepancy_slopes(x, data, weights), numeric, rtol=1e-3, atol=1e-4)


def test_predictions_are_close_and_as_uncertain_as_they_say(emulator):
    rng = np.random.default_rng(3)
    x = np.column_stack([rng.uniform(1.5, 3.0, 200), rng.uniform(0.2, 0.7, 200)])
    true = np.array([oscillators(*row) for row in x])
    z, variances = emulator.predict(x)
    assert np.sqrt(np.mean((emulator.responses_of(z) - true) ** 2)) < 0.02
    scaled = ((true - emulator.mean) / emulator.sensor_scale).reshape(200, -1)
    scores = scaled @ (emulator.basis / emulator.sensor_scale).reshape(z.shape[1], -1).T
    errors = (scores - z) / np.sqrt(variances)
    assert 0.05 < np.sqrt(np.mean(errors**2)) < 3.0
    assert emulator.fails(emulator.x).tolist() == [i == 7 for i in range(30)]


def test_remaining_error_on_a_toy():
    """A tilt of a normal posterior moves its mean by as much, exactly; what is learnt of it is taken away.

    Limits are of 4.5 standard errors. Without the weights, and with half of them learnt, it is seen.
    """
    rng = np.random.default_rng(4)
    theta, tilt = rng.standard_normal((20_000, 2)), np.array([0.3, 0.0])
    at = rng.choice(len(theta), 200, replace=False)
    ratios, none = theta @ tilt, np.zeros(len(theta))
    found = remaining(theta, at, ratios[at], none)
    assert np.all(np.abs(found.shift - tilt) < 4.5 * found.shift_se)
    assert found.shift[0] > 4.5 * found.shift_se[0]
    half = remaining(theta, at, ratios[at], 0.5 * ratios)
    assert np.abs(half.shift[0] - 0.15) < 4.5 * half.shift_se[0]
    learnt = remaining(theta, at, ratios[at], ratios)
    assert np.all(np.abs(learnt.shift) < 4.5 * learnt.shift_se)
    wider = remaining(theta, at, 0.1 * theta[at, 1] ** 2, none)  # variance 1 / (1 - 0.2)
    assert np.abs(wider.stretch[1] - 0.125) < 4.5 * wider.stretch_se[1]
    assert remaining(theta, at, none[at], none).largest < 1e-12
    assert largest_change(theta, ratios) == pytest.approx(0.3 / 3.29, abs=0.02)


@pytest.mark.slow
def test_gradients_of_emulated_models(emulator):
    """Of one point and of populations, for EXP and for a likelihood that needs the history."""
    data, model = oscillators(2.0, 0.3), pm.Model()
    with model:
        k, c = pm.Uniform("k", 1.0, 4.0), pm.Uniform("c", 0.1, 0.8)
        response = simulator(oscillators, (2, 40), dt=0.1)(k, c)
        ExpFeature("y", mu=response, sigma=0.2, observed=data)
        CorrelatedNormal("z", mu=response, sigma=0.2, correlation_time=0.3, dt=0.1, observed=data)
    model, [part] = replaced(model)
    part.stand_in.emulator = emulator
    density = compiled_logp(model)
    points = np.array([[0.2, -0.3], [-0.4, 0.5]])
    slopes = density(points, gradient=True).gradient
    numeric = [approx_fprime(point, density.log_posterior, 1e-6) for point in points]
    np.testing.assert_allclose(slopes, numeric, rtol=1e-3, atol=1e-3)
    alone = model.compile_dlogp()(dict(zip([v.name for v in model.value_vars], points[0], strict=True)))
    np.testing.assert_allclose(alone, slopes[0], rtol=1e-9)
    part.stand_in.emulator = None


def exact_quantiles(data, sigma, low, high):
    """Of k under a uniform prior and white noise, by quadrature."""
    k = np.linspace(low, high, 4001)
    e = np.array([mean_square_discrepancy(oscillators(value, 0.3), data).sum() for value in k])
    density = np.exp(-0.5 * data.shape[1] * (e - e.min()) / sigma**2)
    return np.interp([0.05, 0.5, 0.95], np.cumsum(density) / density.sum(), k)


@pytest.mark.slow
def test_emulate(tmp_path):
    """The posterior of quadrature from 24 runs; a second call finds them in the cache."""
    data = oscillators(2.0, 0.3) + 0.3 * np.random.default_rng(5).standard_normal((2, 40))
    exact, found = exact_quantiles(data, 0.3, 1.0, 4.0), []
    for _ in range(2):
        runner = simulator(oscillators, (2, 40), cache=tmp_path / "runs.sqlite")
        with pm.Model() as model:
            k = pm.Uniform("k", 1.0, 4.0)
            pm.Normal("y", runner(k, 0.3), 0.3, observed=data)
        found.append(emulate(24, model=model, draws=300, chains=2, random_seed=1, progressbar=False))
        counts = runner.counts
    assert (counts["ok"], counts["cached"]) == (0, found[0].idata["emulation"].attrs["runs"])
    draws = found[0].idata.posterior["k"]
    assert np.abs(np.quantile(draws, [0.05, 0.5, 0.95]) - exact).max() < 0.08 * (exact[2] - exact[0])
    assert found[0].idata["emulation"].attrs["converged"] == 1
    assert found[0].idata["emulation"].attrs["largest_error"] < 0.05
    assert np.array_equal(draws, found[1].idata.posterior["k"])
    with pytest.raises(ValueError, match="`model` must be that of the simulator, got one that emulate"):
        emulate(24, model=found[0].model)


@pytest.mark.slow
def test_two_responses_and_failures():
    """One response whose simulator computes e_j itself, and one that fails in a part of the prior."""
    data = oscillators(2.0, 0.3) + 0.3 * np.random.default_rng(5).standard_normal((2, 40))

    def misfit(k):
        return mean_square_discrepancy(oscillators(k, 0.3), data)

    with pm.Model() as model:
        k, c = pm.Uniform("k", 1.0, 4.0, initval=1.5), pm.Uniform("c", 0.1, 1.0)
        whole = simulator(oscillators, (2, 40))
        itself = simulator(misfit, (2, 40), returns="mean_square")
        pm.Normal("y", whole(k, c), 0.3, observed=data)
        pm.Normal("z", itself(k), 0.3, observed=data)
    found = emulate(48, model=model, draws=200, chains=2, batch=12, random_seed=1, progressbar=False)
    assert whole.counts["ok"] + whole.counts["error"] == itself.counts["ok"]
    assert found.idata["emulation"].attrs["failed"] == whole.counts["error"] > 0
    low, middle, high = exact_quantiles(data, 0.3, 1.0, 4.0)
    assert abs(found.idata.posterior["k"].mean() - middle) < 0.2 * (high - low)
    assert found.idata.posterior["c"].max() < 0.9
    assert [v.name for v in found.model.value_vars] == [v.name for v in model.value_vars]
    assert found.model.initial_point() == model.initial_point()


@pytest.mark.slow
def test_an_emulator_of_a_rough_response_gives_itself_away():
    """Negative control: nobody can tell the response from runs elsewhere."""

    def rough(k):
        return np.cos(k * TIME)[None] + 0.5 * np.sin(1e5 * k)

    data = rough(2.0) + 0.1 * np.random.default_rng(5).standard_normal((1, 40))
    with pm.Model() as model:
        pm.Normal("y", simulator(rough, (1, 40))(pm.Uniform("k", 1.0, 4.0)), 0.1, observed=data)
    with pytest.warns(
        SamplingWarning, match="the emulator was still learning after 24 runs.*Increase `runs`"
    ):
        found = emulate(24, model=model, draws=200, chains=2, batch=8, random_seed=1, progressbar=False)
    assert found.idata["emulation"].attrs["converged"] == 0
    assert found.idata["emulation"]["error"][-1] > 1.0


def test_what_cannot_be_emulated():
    with pm.Model() as model:
        pm.Normal("y", pm.Normal("x"), 1.0, observed=[1.0])
    with pytest.raises(ValueError, match="`model` must be a model with a response of an ExternalSimulator"):
        emulate(model=model)
    with pytest.raises(ValueError, match="`runs` must be an integer of at least 16, got 3"):
        emulate(3, model=model)

    def never(k):
        raise RuntimeError("no licence")

    with pm.Model() as model:
        pm.Normal("y", simulator(never, (1, 4))(pm.Normal("x")), 1.0, observed=np.zeros((1, 4)))
    with pytest.raises(RuntimeError, match="8 of 8 simulations failed, too many to go on: no licence"):
        emulate(model=model, progressbar=False)


def test_far_out_in_a_prior_it_says_nothing(emulator):
    """No warning of NumPy's, and no finite number that could be taken for a prediction."""
    x = np.array([[1.5, 0.2], [1e150, 1e150], [2.0, 1e300]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        e = emulator.discrepancies(*emulator.predict(x), oscillators(2.0, 0.3))
    assert np.isfinite(e[0]).all()
    assert not (e[1:] < 1e6).any()
