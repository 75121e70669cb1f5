"""Likelihoods of histories: densities, draws, calibration, life inside a model, and every refusal."""

import functools
import warnings

import arviz as az
import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
import xarray as xr
from pymc.logprob.utils import ParameterValueError
from pymc.model_graph import ModelGraph
from pytensor.compile.mode import Mode
from scipy import optimize, special, stats

from pymc_features import (
    CorrelatedNormal,
    ExpFeature,
    RayleighDamping,
    Record,
    SpringMassChain,
    TruncNormalFeature,
    abc_tolerance,
    mean_square_discrepancy,
    response,
    sigma_mpv,
    simulate,
)
from pymc_features.distributions import FEATURE_LIKELIHOODS, LIKELIHOODS
from pymc_features.exceptions import FeatureLikelihoodWarning

PLAIN = Mode(linker="py", optimizer=None)
LIGHT = Mode(linker="py", optimizer="fast_compile")

# the law of sqrt(e), of e / sigma^2 = chi-square (degrees), and the paper's log-density written out
RMS_LAW = {TruncNormalFeature: stats.halfnorm, ExpFeature: stats.rayleigh}
DEGREES = {TruncNormalFeature: 1, ExpFeature: 2}
OTHER = {TruncNormalFeature: ExpFeature, ExpFeature: TruncNormalFeature}
MORE = {CorrelatedNormal: {"correlation_time": 0.1, "dt": 0.04}}  # arguments besides mu and sigma
EVERY = pytest.mark.parametrize("likelihood", LIKELIHOODS)
EVERY_FEATURE = pytest.mark.parametrize("likelihood", FEATURE_LIKELIHOODS)


def declare(likelihood, *args, **kwargs):
    """The likelihood's `dist`, or by a name the variable of a model, with what it needs besides."""
    make = likelihood if isinstance(args[0] if args else None, str) else likelihood.dist
    return make(*args, **MORE.get(likelihood, {}), **kwargs)


def equation(likelihood, data, mu, sigma):
    """Summands of Eqs. (7) and (9), sensor by sensor, in loops; correlated errors by their covariance."""
    sigma = np.broadcast_to(sigma, len(data))
    values = []
    if likelihood is CorrelatedNormal:
        k = np.arange(data.shape[1])
        covariance = np.exp(-np.abs(k - k[:, None]) * 0.04 / 0.1)
        return np.array(
            [
                stats.multivariate_normal(g, s**2 * covariance).logpdf(y)
                for y, g, s in zip(data, mu, sigma, strict=True)
            ]
        )
    for y, g, s in zip(data, mu, sigma, strict=True):
        e = sum((a - b) ** 2 for a, b in zip(y, g, strict=True)) / len(y)
        if likelihood is TruncNormalFeature:
            values.append(0.5 * np.log(2 / np.pi) - np.log(s) - e / (2 * s**2))
        else:
            values.append(-np.log(2.0) - 2 * np.log(s) - e / (2 * s**2))
    return np.array(values)


def scipy_feature(likelihood, e, sigma):
    """The same by SciPy: half-normal in the root mean square, exponential in the mean square."""
    if likelihood is TruncNormalFeature:
        return stats.halfnorm(scale=sigma).logpdf(np.sqrt(e))
    return stats.expon(scale=2 * np.square(sigma)).logpdf(e)


def scipy_data(likelihood, e, sigma, n):
    """Density of the data: the radius R = sqrt(n e) by SciPy, over the area of its sphere."""
    log_radius = RMS_LAW[likelihood](scale=sigma * np.sqrt(n)).logpdf(np.sqrt(n * e))
    log_area = np.log(2.0) + n / 2 * np.log(np.pi) - special.gammaln(n / 2)
    return log_radius - log_area - (n - 1) / 2 * np.log(n * e)


@functools.cache
def compiled(likelihood, density, method, *patterns):
    """Function (mu, sigma, value) -> log-density or log-cdf, for a pattern of lengths 1 and others."""
    mu, sigma, value = (pt.tensor(shape=pattern) for pattern in patterns)
    output = getattr(pm, method)(likelihood.dist(mu, sigma, density=density), value)
    return pytensor.function([mu, sigma, value], output, mode=PLAIN)


def evaluate(likelihood, density, method, mu, sigma, value):
    """Log-density ("logp") or log-cdf ("logcdf") of the package, one value for each sensor."""
    arrays = [np.asarray(x, dtype=float) for x in (mu, sigma, value)]
    patterns = (tuple(1 if n == 1 else None for n in x.shape) for x in arrays)
    return compiled(likelihood, density, method, *patterns)(*arrays)


def random_data(seed, n_sensors=4, n_times=7):
    rng = np.random.default_rng(seed)
    mu, data = 10.0 ** rng.uniform(-3, 3) * rng.normal(size=(2, n_sensors, n_times))
    return mu, data, 10.0 ** rng.uniform(-2, 2, n_sensors)


# --------------------------------------------------------------------------- densities


@EVERY_FEATURE
@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("per_sensor", [False, True])
def test_log_likelihood_against_the_equations_and_scipy(likelihood, seed, per_sensor):
    mu, data, sigma = random_data(seed)
    sigma = sigma if per_sensor else sigma[0]
    ours = evaluate(likelihood, "feature", "logp", mu, sigma, data).squeeze()
    assert ours.shape == (4,)
    np.testing.assert_allclose(ours, equation(likelihood, data, mu, sigma), rtol=1e-10)
    e = np.mean((data - mu) ** 2, axis=-1)
    np.testing.assert_allclose(ours, scipy_feature(likelihood, e, sigma), rtol=1e-10)
    control = equation(OTHER[likelihood], data, mu, sigma)
    assert np.abs(ours - control).min() > 1e-3


@EVERY_FEATURE
@pytest.mark.parametrize("n_times", [1, 2, 3, 50, 3000])
def test_density_of_the_data_against_scipy(likelihood, n_times):
    mu, data, sigma = random_data(n_times, n_times=n_times)
    ours = evaluate(likelihood, "data", "logp", mu, sigma, data).squeeze()
    e = np.mean((data - mu) ** 2, axis=-1)
    np.testing.assert_allclose(ours, scipy_data(likelihood, e, sigma, n_times), rtol=1e-10)


def gauss(low, high, points=200):
    """Gauss-Legendre nodes and weights on an interval."""
    x, w = np.polynomial.legendre.leggauss(points)
    return low + (high - low) * (x + 1) / 2, (high - low) * w / 2


@EVERY_FEATURE
@pytest.mark.parametrize("sigma", [0.3, 2.0])
def test_density_of_the_data_integrates_to_one(likelihood, sigma):
    """One and two samples over the line and the plane; more along a ray times the area of the sphere."""
    centre = np.array([0.7, -0.4])
    x, w = gauss(0.0, 16.0 * sigma)

    def density(points, kind="data"):
        mu = np.tile(centre, 25)[: points.shape[-1]]
        return np.exp(evaluate(likelihood, kind, "logp", mu[None], sigma, mu + points[:, None, :])).ravel()

    line = sum(w @ density(sign * x[:, None]) for sign in (1, -1))
    assert line == pytest.approx(1.0, abs=1e-8)

    # eight triangles 0 < y < x, mapped by y = x v, which takes the 1/R of TN away
    v, weight_v = gauss(0.0, 1.0, 60)
    plane = 0.0
    for sign_x in (1, -1):
        for sign_y in (1, -1):
            a = np.repeat(sign_x * x, v.size)
            b = sign_y * np.outer(x, v).ravel()
            weights = np.outer(w * x, weight_v).ravel()
            plane += weights @ (density(np.stack([a, b], axis=1)) + density(np.stack([b, a], axis=1)))
    assert plane == pytest.approx(1.0, abs=1e-8)

    for n in (3, 7, 50):
        direction = np.random.default_rng(n).normal(size=n)
        direction /= np.linalg.norm(direction)
        r, weight_r = gauss(0.0, 16.0 * sigma * np.sqrt(n))
        area = 2 * np.pi ** (n / 2) / special.gamma(n / 2) * r ** (n - 1)
        assert weight_r @ (area * density(r[:, None] * direction)) == pytest.approx(1.0, abs=1e-8)
    feature = sum(w @ density(sign * x[:, None], "feature") for sign in (1, -1))
    assert abs(feature - 1.0) > 0.3  # negative control: no density of the data


@EVERY_FEATURE
def test_logcdf_of_the_feature_with_its_tails(likelihood):
    """Against SciPy's cdf below the median and its survival function above."""
    z = np.concatenate([np.logspace(-30, 0, 40), np.linspace(1.0, 8.0, 40), [12.0, 37.0]])
    sigma = 1.7
    law = RMS_LAW[likelihood](scale=sigma)
    low = z < 1.0
    expected = np.empty_like(z)
    expected[low], expected[~low] = law.logcdf(z[low] * sigma), np.log1p(-law.sf(z[~low] * sigma))
    for density in ("feature", "data"):
        data = np.repeat(z[:, None] * sigma, 3, axis=1)
        ours = evaluate(likelihood, density, "logcdf", np.zeros((1, 3)), sigma, data).ravel()
        np.testing.assert_allclose(ours, expected, rtol=1e-10)
    assert evaluate(likelihood, "feature", "logcdf", np.zeros((1, 3)), sigma, np.zeros((1, 3))) == -np.inf


@EVERY_FEATURE
def test_logcdf_is_the_integral_of_the_feature_density(likelihood):
    """TN's feature is the root mean square, EXP's the mean square."""
    end = 1.3
    x, w = gauss(0.0, end)
    rms = x if likelihood is TruncNormalFeature else np.sqrt(x)
    probability = (
        w @ np.exp(evaluate(likelihood, "feature", "logp", np.zeros((1, 1)), 0.8, rms[:, None, None])).ravel()
    )
    top = end if likelihood is TruncNormalFeature else np.sqrt(end)
    logcdf = evaluate(likelihood, "feature", "logcdf", np.zeros((1, 1)), 0.8, np.full((1, 1), top))
    assert probability == pytest.approx(float(np.exp(logcdf).item()), rel=1e-10)


@pytest.mark.parametrize("n_times", [1, 6, 400])
def test_tn_is_the_conventional_likelihood_over_the_number_of_samples(n_times):
    """TN = NORM / N_D + ln 2, whatever theta and sigma; EXP = NORM 2 / N_D only without its sigma."""
    for seed in range(5):
        mu, data, sigma = random_data(seed, n_times=n_times)
        norm = stats.norm(mu, sigma[:, None]).logpdf(data).mean(axis=-1)
        ours = evaluate(TruncNormalFeature, "feature", "logp", mu, sigma, data).squeeze()
        np.testing.assert_allclose(ours, norm + np.log(2.0), rtol=1e-10)


@EVERY_FEATURE
@pytest.mark.parametrize("density", ["feature", "data"])
def test_failed_response_and_scale_give_minus_infinity(likelihood, density):
    """Sensor by sensor: one failed sensor leaves the others alone."""
    mu = np.zeros((2, 3))
    mu[0, 1] = np.nan
    values = evaluate(likelihood, density, "logp", mu, 1.0, np.ones((2, 3))).ravel()
    assert values[0] == -np.inf
    assert np.isfinite(values[1])
    for sigma in (0.0, -1.0):
        with pytest.raises(ParameterValueError, match="sigma > 0"):
            evaluate(likelihood, density, "logp", np.zeros((2, 3)), sigma, np.ones((2, 3)))


@pytest.mark.parametrize(
    ("likelihood", "density", "n_times"),
    [
        (TruncNormalFeature, "feature", 3),
        (ExpFeature, "feature", 3),
        (TruncNormalFeature, "data", 3),
        (TruncNormalFeature, "data", 1),
        (ExpFeature, "data", 1),
        (ExpFeature, "data", 3),
    ],
)
@pytest.mark.parametrize("far", [np.inf, 1e200])
def test_infinite_discrepancy_gives_minus_infinity(likelihood, density, n_times, far):
    mu = np.full((1, n_times), far)
    assert evaluate(likelihood, density, "logp", mu, 1.0, np.zeros((1, n_times))) == -np.inf


@pytest.mark.parametrize(
    ("likelihood", "n_times", "expected"),
    [
        (TruncNormalFeature, 3, np.inf),
        (TruncNormalFeature, 1, -0.5 * np.log(2 * np.pi)),
        (ExpFeature, 1, -np.inf),
        (ExpFeature, 2, -np.log(4 * np.pi)),
        (ExpFeature, 3, np.inf),
    ],
)
def test_density_of_the_data_at_no_discrepancy(likelihood, n_times, expected):
    """The limit of R -> 0, where PyMC starts if the data are a free variable."""
    zero = np.zeros((1, n_times))
    got = evaluate(likelihood, "data", "logp", zero, 1.0, zero).item()
    assert got == pytest.approx(expected, rel=1e-12)


# --------------------------------------------------------------------------- draws


def draw(variable, draws=1, seed=0):
    return pm.draw(variable, draws=draws, random_seed=seed, mode=PLAIN)


@pytest.fixture(scope="module", params=FEATURE_LIKELIHOODS)
def sample(request):
    """20000 draws of two sensors with five samples each: (likelihood, mu, sigma, draws)."""
    mu = np.array([[1.0, -2.0, 0.0, 3.0, 0.5], [0.0, 0.0, 5.0, -1.0, 2.0]])
    sigma = np.array([0.5, 3.0])
    return request.param, mu, sigma, draw(request.param.dist(mu, sigma), draws=20_000)


def test_feature_of_draws_has_its_law(sample):
    """Kolmogorov-Smirnov, a false alarm in 1000 seeds; the other law must be rejected."""
    likelihood, mu, sigma, draws = sample
    e = mean_square_discrepancy(draws, np.broadcast_to(mu, draws.shape))
    for j in range(2):
        rms = np.sqrt(e[:, j]) / sigma[j]
        assert stats.kstest(rms, RMS_LAW[likelihood].cdf).pvalue > 1e-3
        assert stats.kstest(rms, RMS_LAW[OTHER[likelihood]].cdf).pvalue < 1e-9
        assert stats.kstest(rms**2, stats.chi2(DEGREES[likelihood]).cdf).pvalue > 1e-3


def sphere_pvalues(misfit):
    """KS of each squared coordinate of the direction: Beta(1/2, (n - 1)/2) on a sphere of n."""
    n = misfit.shape[-1]
    direction = misfit / np.linalg.norm(misfit, axis=-1, keepdims=True)
    law = stats.beta(0.5, (n - 1) / 2).cdf
    return [stats.kstest(direction[:, k] ** 2, law).pvalue for k in range(n)]


def test_direction_of_draws_is_uniform_on_the_sphere(sample):
    """False-alarm rate 1e-3 for each coordinate; directions from a cube are the negative control."""
    _, mu, _, draws = sample
    for j in range(2):
        misfit = draws[:, j] - mu[j]
        assert min(sphere_pvalues(misfit)) > 1e-3
        unit = misfit / np.linalg.norm(misfit, axis=-1, keepdims=True)
        error = 5 / np.sqrt(len(unit))  # five standard errors
        np.testing.assert_allclose(unit.mean(axis=0), 0.0, atol=error / np.sqrt(5))
        np.testing.assert_allclose(unit.T @ unit / len(unit), np.eye(5) / 5, atol=error * 0.25)
        radius = np.linalg.norm(misfit, axis=-1)
        assert stats.spearmanr(radius, unit[:, 0]).pvalue > 1e-3
    cube = np.random.default_rng(1).uniform(-1, 1, (20_000, 5))
    assert min(sphere_pvalues(cube)) < 1e-9


def test_sensors_and_draws_are_independent(sample):
    """Rank correlation of the radii, false-alarm rate 1e-3 each."""
    _, mu, _, draws = sample
    radius = np.linalg.norm(draws - mu, axis=-1)
    assert stats.spearmanr(radius[:, 0], radius[:, 1]).pvalue > 1e-3
    assert stats.spearmanr(radius[1:, 0], radius[:-1, 0]).pvalue > 1e-3


@EVERY
def test_draws_are_reproducible_and_differ(likelihood):
    y = declare(likelihood, np.zeros((2, 4)), 1.0)
    one, again, other = draw(y, seed=3), draw(y, seed=3), draw(y, seed=4)
    np.testing.assert_array_equal(one, again)
    assert not np.isclose(one, other).any()
    two = draw([y, declare(likelihood, np.zeros((2, 4)), 1.0)], seed=3)
    assert not np.isclose(two[0], two[1]).any()


@EVERY
@pytest.mark.parametrize(
    ("mu", "sigma", "kwargs", "expected"),
    [
        ((5,), (), {}, (5,)),
        ((3, 5), (), {}, (3, 5)),
        ((3, 5), (3,), {}, (3, 5)),
        ((5,), (3,), {}, (3, 5)),
        ((3, 5), (4, 1), {}, (4, 3, 5)),
        ((4, 3, 5), (3,), {}, (4, 3, 5)),
        ((3, 5), (), {"size": (4, 3)}, (4, 3, 5)),
        ((3, 5), (3,), {"shape": (4, 3, 5)}, (4, 3, 5)),
        ((5,), (), {"size": (2,)}, (2, 5)),
    ],
)
def test_shapes_of_draws_and_log_likelihoods(likelihood, mu, sigma, kwargs, expected):
    """Support dimension is time, the last; everything before it is a batch, as in `size` and `shape`."""
    y = declare(likelihood, np.zeros(mu), np.ones(sigma), **kwargs)
    assert y.owner.op.ndim_supp == 1
    values = draw(y)
    assert values.shape == expected
    assert draw(y, draws=6).shape == (6, *expected)
    assert pm.logp(y, values).eval(mode=PLAIN).shape == expected[:-1]
    # rows are different draws, not copies of one
    rows = values.reshape(-1, expected[-1])
    assert len(np.unique(rows.round(12), axis=0)) == len(rows)


@EVERY
def test_support_point_is_the_response(likelihood):
    mu = np.arange(6.0).reshape(2, 3)
    with pm.Model() as model:
        declare(likelihood, "y", mu=mu, sigma=1.0, shape=(4, 2, 3))
    np.testing.assert_array_equal(model.initial_point()["y"], np.broadcast_to(mu, (4, 2, 3)))


# --------------------------------------------------------------------------- calibration


def uniformity(ranks):
    """Chi-square p-value of ranks in 0..1 against uniformity, 20 bins."""
    counts, _ = np.histogram(ranks, bins=20, range=(0.0, 1.0))
    assert counts.sum() == len(ranks)
    return stats.chisquare(counts).pvalue


def grid_ranks(log_density, grid, truth):
    """Posterior probability below the truth; `log_density` and `grid` (points, replications)."""
    density = np.exp(log_density - log_density.max(axis=0))
    steps = 0.5 * (density[1:] + density[:-1]) * np.diff(grid, axis=0)
    cumulative = np.vstack([np.zeros(density.shape[1]), np.cumsum(steps, axis=0)])
    return np.array([np.interp(t, g, c / c[-1]) for t, g, c in zip(truth, grid.T, cumulative.T, strict=True)])


REPLICATIONS = 2000


@EVERY_FEATURE
def test_calibration_of_sigma(likelihood):
    """Known response, unknown sigma: ranks uniform at a false-alarm rate of 1e-3; other law rejected."""
    rng = np.random.default_rng(11)
    mu = rng.normal(size=(3, 6))
    truth = np.exp(rng.normal(size=REPLICATIONS))
    data = draw(likelihood.dist(mu, truth[:, None]), seed=12)
    grid = np.exp(np.linspace(-6.0, 6.0, 400))
    prior = stats.lognorm(s=1.0).logpdf(grid)[:, None]

    def ranks(law):
        by_sensor = evaluate(law, "data", "logp", mu, grid[:, None, None], data[None])
        return grid_ranks(prior + by_sensor.sum(axis=-1), np.tile(grid[:, None], REPLICATIONS), truth)

    assert uniformity(ranks(likelihood)) > 1e-3
    assert uniformity(ranks(OTHER[likelihood])) < 1e-6


@EVERY_FEATURE
def test_calibration_of_a_response(likelihood):
    """Unknown level of the response, known sigma: calibrated with density="data" only.

    False-alarm rate 1e-3. Negative controls: the other law, and density="feature", which is a
    generalised posterior and wider than the draws warrant.
    """
    rng = np.random.default_rng(21)
    n, sigma = 4, 0.5
    truth = rng.normal(size=REPLICATIONS)
    mu = np.repeat(truth[:, None, None], n, axis=-1)
    data = draw(likelihood.dist(mu, sigma), seed=22)
    offsets = np.sinh(np.linspace(-9.0, 9.0, 401)) / np.sinh(9.0) * 12.0  # dense at the mean of the data
    grid = offsets[:, None] + data.mean(axis=(1, 2))

    def ranks(law, density):
        levels = np.repeat(grid[:, :, None, None], n, axis=-1)
        logp = evaluate(law, density, "logp", levels, sigma, data[None]).sum(axis=-1)
        return grid_ranks(stats.norm.logpdf(grid) + logp, grid, truth)

    assert uniformity(ranks(likelihood, "data")) > 1e-3
    assert uniformity(ranks(OTHER[likelihood], "data")) < 1e-6
    assert uniformity(ranks(likelihood, "feature")) < 1e-6


# --------------------------------------------------------------------------- inside a model


@pytest.fixture(scope="module")
def pulse():
    return Record(np.random.default_rng(0).normal(size=41), 0.02, name="pulse")


def chain_of(theta):
    base = SpringMassChain(np.ones(3), 100.0, RayleighDamping(0.1, 1e-3))
    return base.scale_stiffness(theta, springs=[0])


@pytest.fixture(scope="module")
def measured(pulse):
    exact = simulate(chain_of(1.0), pulse, dt=0.04).values
    return exact + 0.3 * np.random.default_rng(1).normal(size=exact.shape)


def build_model(likelihood, pulse, observed, *, sigma=None, theta=None, deterministic=False, **kwargs):
    """Three storeys, unknown first spring and sigma; the model does not know its "time"."""
    with pm.Model(coords={"sensor": ["low", "middle", "top"]}) as model:
        theta = pm.Uniform("theta", 0.5, 1.5) if theta is None else theta()
        sigma = pm.HalfNormal("sigma", 1.0) if sigma is None else sigma()
        mu = response(chain_of(theta), pulse, dt=0.04)
        mu = pm.Deterministic("mu", mu) if deterministic else mu
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FeatureLikelihoodWarning)
            declare(likelihood, "y", mu=mu, sigma=sigma, observed=observed, **kwargs)
    return model


@pytest.fixture(scope="module", params=LIKELIHOODS)
def updated(request, pulse, measured):
    """(likelihood, model with dims, four particles of a posterior)."""
    model = build_model(request.param, pulse, measured, dims=("sensor", "time"))
    particles = {"theta": np.array([[0.8, 1.0], [1.2, 0.9]]), "sigma": np.array([[0.3, 0.5], [1.0, 0.2]])}
    return request.param, model, az.from_dict({"posterior": particles})


def test_time_dimension_gets_its_seconds(updated, pulse, measured):
    _, model, _ = updated
    assert model.named_vars_to_dims["y"] == ("sensor", "time")
    np.testing.assert_allclose(model.coords["time"], np.arange(21) * 0.04, rtol=1e-14)


@pytest.mark.parametrize("deterministic", [False, True])
def test_time_dimension_of_predictions_without_data(pulse, deterministic):
    model = build_model(
        ExpFeature, pulse, None, dims=("sensor", "seconds"), shape=(3, 21), deterministic=deterministic
    )
    np.testing.assert_allclose(model.coords["seconds"], np.arange(21) * 0.04, rtol=1e-14)


def test_known_time_dimension_is_left_alone(pulse, measured):
    with pm.Model(coords={"sensor": range(3), "time": np.arange(21) * 40}) as model:
        TruncNormalFeature("y", measured, 1.0, observed=measured + 1.0, dims=("sensor", "time"))
    assert list(model.coords["time"]) == list(range(0, 840, 40))


def test_log_likelihood_of_each_sensor(updated, pulse, measured):
    """Group log_likelihood: one value for each sensor, equal to the equation."""
    likelihood, model, posterior = updated
    with model:
        result = pm.compute_log_likelihood(posterior.copy(), progressbar=False)
    values = result["log_likelihood"]["y"]
    assert values.dims == ("chain", "draw", "sensor")
    assert values["sensor"].values.tolist() == ["low", "middle", "top"]
    for c in range(2):
        for d in range(2):
            theta, sigma = (float(posterior["posterior"][k][c, d]) for k in ("theta", "sigma"))
            mu = simulate(chain_of(theta), pulse, dt=0.04).values
            expected = equation(likelihood, measured, mu, sigma)
            np.testing.assert_allclose(values.values[c, d], expected, rtol=1e-10)


def test_model_log_probability(updated, pulse, measured):
    """`compile_logp` by Numba: the equation, and -inf, not an exception, where nothing is valid."""
    likelihood, model, _ = updated
    logp = model.compile_logp(vars=model.observed_RVs, jacobian=False)
    theta = 0.5 + special.expit(0.3)
    got = logp({"theta_interval__": 0.3, "sigma_log__": np.log(0.4)})
    mu = simulate(chain_of(theta), pulse, dt=0.04).values
    assert float(got) == pytest.approx(equation(likelihood, measured, mu, 0.4).sum(), rel=1e-10)


@pytest.mark.parametrize(
    ("likelihood", "kwargs"),
    [
        *(
            (feature, {"density": density})
            for feature in FEATURE_LIKELIHOODS
            for density in ("feature", "data")
        ),
        (CorrelatedNormal, {}),
    ],
)
def test_bad_values_inside_the_graph(likelihood, kwargs, pulse, measured):
    """A prior that allows a negative sigma or spring: -inf there, a number elsewhere."""
    model = build_model(
        likelihood,
        pulse,
        measured,
        sigma=lambda: pm.Normal("sigma"),
        theta=lambda: pm.Normal("theta"),
        **kwargs,
    )
    logp = model.compile_logp(mode=LIGHT)
    assert np.isfinite(logp({"theta": 1.0, "sigma": 0.5}))
    for theta, sigma in [(1.0, 0.0), (1.0, -0.5), (-1.0, 0.5), (0.0, 0.5), (-1.0, -0.5)]:
        assert logp({"theta": theta, "sigma": sigma}) == -np.inf, (theta, sigma)


def test_prior_and_posterior_predictive(updated, pulse):
    """Histories with dimensions and coordinates; centred on the response of each particle."""
    _, model, posterior = updated
    with model:
        prior = pm.sample_prior_predictive(7, random_seed=1, compile_kwargs={"mode": LIGHT})
        predictive = pm.sample_posterior_predictive(
            posterior, random_seed=2, progressbar=False, compile_kwargs={"mode": LIGHT}
        )["posterior_predictive"]["y"]
    assert prior["prior_predictive"]["y"].dims == ("chain", "draw", "sensor", "time")
    assert prior["prior_predictive"]["y"].shape == (1, 7, 3, 21)
    assert prior["observed_data"]["y"].dims == ("sensor", "time")
    assert predictive.shape == (2, 2, 3, 21)
    np.testing.assert_allclose(predictive["time"], np.arange(21) * 0.04, rtol=1e-14)
    assert predictive["sensor"].values.tolist() == ["low", "middle", "top"]
    for c in range(2):
        for d in range(2):
            theta, sigma = (float(posterior["posterior"][k][c, d]) for k in ("theta", "sigma"))
            mu = simulate(chain_of(theta), pulse, dt=0.04).values
            z = np.sqrt(mean_square_discrepancy(mu, predictive.values[c, d])) / sigma
            assert (z < 5.0).all()
            assert len(np.unique(z)) == 3


@EVERY_FEATURE
def test_posterior_predictive_has_the_law_of_the_feature(likelihood, pulse):
    """4000 draws at one particle, KS at 1e-3; the other law is rejected."""
    model = build_model(likelihood, pulse, None, shape=(3, 21))
    theta, sigma = model["theta"], model["sigma"]
    fixed = pm.do(model, {theta: 0.9, sigma: 0.4})
    values = pm.draw(fixed["y"], draws=4000, random_seed=5, mode=LIGHT)
    mu = simulate(chain_of(0.9), pulse, dt=0.04).values
    rms = np.sqrt(mean_square_discrepancy(values, np.broadcast_to(mu, values.shape))) / 0.4
    assert stats.kstest(rms.ravel(), RMS_LAW[likelihood].cdf).pvalue > 1e-3
    assert stats.kstest(rms.ravel(), RMS_LAW[OTHER[likelihood]].cdf).pvalue < 1e-9


@EVERY_FEATURE
def test_draws_by_numba(likelihood):
    """The default backend has the same law as Python (KS at 1e-3)."""
    y = likelihood.dist(np.zeros((2, 5)), 1.0)
    values = pm.draw(y, draws=2000, random_seed=8)
    rms = np.sqrt(np.mean(values**2, axis=-1)).ravel()
    assert stats.kstest(rms, RMS_LAW[likelihood].cdf).pvalue > 1e-3
    assert stats.kstest(rms, RMS_LAW[OTHER[likelihood]].cdf).pvalue < 1e-9


POINT = {"theta_interval__": 0.1, "sigma_log__": -1.0}


def test_data_containers_can_be_exchanged(pulse, measured):
    with pm.Model() as model:
        theta, sigma = pm.Uniform("theta", 0.5, 1.5), pm.HalfNormal("sigma", 1.0)
        data = pm.Data("measured", measured)
        mu = response(chain_of(theta), pulse, dt=0.04)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FeatureLikelihoodWarning)
            ExpFeature("y", mu=mu, sigma=sigma, observed=data)
    logp = model.compile_logp(mode=LIGHT)
    for values in (measured, 2.0 * measured):
        with model:
            pm.set_data({"measured": values})
        literal = build_model(ExpFeature, pulse, values).compile_logp(mode=LIGHT)
        assert float(logp(POINT)) == pytest.approx(float(literal(POINT)), rel=1e-12)


@EVERY
def test_observe_and_do(likelihood, pulse, measured):
    free = build_model(likelihood, pulse, None, shape=(3, 21))
    assert [rv.name for rv in free.free_RVs] == ["theta", "sigma", "y"]
    observed = pm.observe(free, {"y": measured})
    direct = build_model(likelihood, pulse, measured)
    a, b = (m.compile_logp(mode=LIGHT)(POINT) for m in (observed, direct))
    assert a == pytest.approx(b, rel=1e-12)
    done = pm.do(direct, {"theta": 1.1})
    assert [rv.name for rv in done.free_RVs] == ["sigma"]
    expected = direct.compile_logp(vars=direct.observed_RVs, jacobian=False, mode=LIGHT)(
        {"theta_interval__": special.logit(0.6), "sigma_log__": -1.0}
    )
    got = done.compile_logp(vars=done.observed_RVs, mode=LIGHT)({"sigma_log__": -1.0})
    assert got == pytest.approx(expected, rel=1e-12)


def test_long_data_do_not_become_constants(pulse):
    """Constants over a megabyte keep Numba from using its disk cache."""
    data = np.random.default_rng(0).normal(size=(2, 70_000))
    with pm.Model() as model:
        y = ExpFeature("y", np.zeros((2, 1)) * data, sigma=1.0, observed=data)
    observed = model.rvs_to_values[y]
    assert isinstance(observed, pytensor.compile.SharedVariable)
    np.testing.assert_array_equal(observed.get_value(), data)


def test_names_in_print(updated):
    likelihood, model, _ = updated
    assert f"y ~ {likelihood.__name__}(f(theta), sigma" in model.str_repr()
    assert f"\\operatorname{{{likelihood.__name__}}}" in model.str_repr(formatting="latex")


def test_graphviz(updated):
    graphviz = pytest.importorskip("graphviz")
    graph = pm.model_to_graphviz(updated[1])
    assert isinstance(graph, graphviz.Digraph)
    assert updated[0].__name__ in graph.source
    assert "sensor (3) x time (21)" in graph.source.replace("×", "x")


def test_model_graph_knows_the_parents(updated):
    """What model_to_graphviz and model_to_networkx draw, without either."""
    edges = {frozenset(edge) for edge in ModelGraph(updated[1]).edges()}
    assert edges == {frozenset(("theta", "y")), frozenset(("sigma", "y"))}


# --------------------------------------------------------------------------- refusals


@EVERY
@pytest.mark.parametrize(
    ("observed", "error", "match"),
    [
        (np.ones((5, 3)), ValueError, r"\(3, 5\) to match `mu`, got \(5, 3\). Transpose it: time is the"),
        (np.ones((3, 4)), ValueError, r"\(3, 5\) to match `mu`, got \(3, 4\). Give one row for each"),
        (np.ones((2, 5)), ValueError, r"must have shape \(sensor, time\) = \(3, 5\) to match `mu`"),
        (np.ones(5), ValueError, r"must have 2 dimensions \(..., sensor, time\) .* got shape \(5,\)"),
        (np.ones((1, 3, 5)), ValueError, r"must have 2 dimensions .* got shape \(1, 3, 5\)"),
        (
            np.where(np.eye(3, 5) > 0, np.nan, 1.0)[::-1],
            ValueError,
            r"`observed` must be finite, got nan at index \(0, 2\) of \(sensor, time\). Cut the record",
        ),
        (np.full((3, 5), np.inf), ValueError, r"must be finite, got inf at index \(0, 0\)"),
        (
            np.ma.masked_array(np.ones((3, 5)), mask=np.eye(3, 5)),
            ValueError,
            "must have no missing values, got a masked array. Cut the record to its complete part",
        ),
        ([["a"] * 5] * 3, TypeError, "`observed` must be an array of numbers, got list"),
        (pytensor.shared(np.full((3, 5), np.nan)), ValueError, "`observed` must be finite, got nan"),
        (pytensor.shared(np.ones((5, 3))), ValueError, "Transpose it: time is the last axis"),
    ],
)
def test_bad_data(likelihood, observed, error, match):
    with pm.Model(), pytest.raises(error, match=match):
        declare(likelihood, "y", mu=np.zeros((3, 5)), sigma=1.0, observed=observed)


def test_masked_array_without_a_mask_is_data():
    with pm.Model() as model:
        ExpFeature("y", np.zeros((1, 2)), 1.0, observed=np.ma.masked_array([[1.0, 2.0]], mask=False))
    assert np.isfinite(model.compile_logp(mode=LIGHT)({}))


@EVERY
@pytest.mark.parametrize(
    ("kwargs", "match"),
    [
        ({"sigma": 0.0}, "`sigma` must be positive and finite, got 0.0. Pass the root-mean-square"),
        ({"sigma": -1}, "`sigma` must be positive and finite, got -1"),
        ({"sigma": np.nan}, "`sigma` must be positive and finite, got nan"),
        ({"sigma": np.inf}, "`sigma` must be positive and finite, got inf"),
        ({"sigma": [1.0, 0.0, 1.0]}, r"`sigma` must be positive and finite, got \[1.0, 0.0, 1.0\]"),
        ({"sigma": [1.0, 2.0]}, "or have one value for each of the 3 sensors, got 2"),
        ({"sigma": pt.vector("s", shape=(4,))}, "one value for each of the 3 sensors, got 4"),
        ({"mu": 0.0}, r"`mu` must be \(..., sensor, time\), got a scalar. Pass what `response` returned"),
    ],
)
def test_bad_parameters(likelihood, kwargs, match):
    arguments = {"mu": np.zeros((3, 5)), "sigma": 1.0} | kwargs
    with pytest.raises(ValueError, match=match):
        declare(likelihood, **arguments)
    with pm.Model(), pytest.raises(ValueError, match=match):
        declare(likelihood, "y", **arguments)


@EVERY_FEATURE
def test_unknown_density(likelihood):
    with pytest.raises(ValueError, match="`density` must be one of feature, data, got 'features'"):
        likelihood.dist(np.zeros((3, 5)), 1.0, density="features")


# --------------------------------------------------------------------------- warnings

WARNED = "posterior without a finite variance but the prior's under"
SILENT = None


@pytest.mark.parametrize(
    ("likelihood", "n_sensors", "per_sensor", "match"),
    [
        (TruncNormalFeature, 1, False, "^1 sensor with one sigma carry no information on the parameters"),
        (TruncNormalFeature, 2, False, f"^2 sensors with one sigma have a {WARNED} TruncNormalFeature"),
        (TruncNormalFeature, 4, False, WARNED),
        (TruncNormalFeature, 5, False, SILENT),
        (TruncNormalFeature, 9, True, "^9 sensors with a sigma for each sensor carry no information"),
        (ExpFeature, 1, False, f"^1 sensor with one sigma have a {WARNED} ExpFeature. Add sensors"),
        (ExpFeature, 2, False, WARNED),
        (ExpFeature, 3, False, SILENT),
        (ExpFeature, 3, True, "^3 sensors with a sigma for each sensor have a posterior without"),
        (ExpFeature, 4, True, SILENT),
    ],
)
def test_warning_of_too_few_sensors(likelihood, n_sensors, per_sensor, match):
    rng = np.random.default_rng(0)
    data = rng.normal(size=(n_sensors, 50))
    with pm.Model(), warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        theta = pm.Normal("theta")
        sigma = pm.HalfNormal("sigma", shape=(n_sensors,) if per_sensor else ())
        likelihood("y", mu=theta * np.ones_like(data), sigma=sigma, observed=data)
    caught = [w for w in caught if issubclass(w.category, FeatureLikelihoodWarning)]
    assert len(caught) == (match is not None)
    if match is not None:
        assert caught[0].filename == __file__  # points at the user's line
        with pytest.raises(FeatureLikelihoodWarning, match=match):
            raise caught[0].message


@pytest.mark.parametrize(
    ("likelihood", "n_sensors", "power"),
    [(TruncNormalFeature, 4, 1.5), (TruncNormalFeature, 5, 2.0), (ExpFeature, 2, 1.5), (ExpFeature, 3, 2.5)],
)
def test_the_number_of_sensors_that_is_enough(likelihood, n_sensors, power):
    """Why: sigma integrated out leaves S^(-(m - 1)/2); the variance exists for m - 1 > 3.

    Numerically: the marginal of theta at distances 1e3 and 1e6 falls by 10^(-3 (m - 1)).
    """
    grid = np.exp(np.linspace(-5.0, 25.0, 4000))
    data = np.random.default_rng(1).normal(size=(n_sensors, 8))
    marginal = []
    for distance in (1e3, 1e6):
        logp = evaluate(likelihood, "feature", "logp", data + distance, grid[:, None, None], data)
        total = logp.sum(axis=-1).ravel() + np.log(grid)
        marginal.append(special.logsumexp(total))
    slope = -(marginal[1] - marginal[0]) / np.log(1e6)  # in powers of S
    assert slope == pytest.approx(power, rel=1e-3)
    finite_variance = 2 * power > 3
    assert finite_variance == (n_sensors > {TruncNormalFeature: 4, ExpFeature: 2}[likelihood])


@EVERY_FEATURE
def test_noise_free_data_are_warned_of(likelihood, pulse):
    """At the model's initial point the response equals the data; with noise or a fixed sigma: silence."""
    chain = SpringMassChain(np.ones(6), 100.0, RayleighDamping(0.1, 1e-3))
    exact = simulate(chain, pulse).values

    def declare(data, sigma):
        with pm.Model(), warnings.catch_warnings():
            warnings.simplefilter("error", FeatureLikelihoodWarning)
            theta = pm.Uniform("theta", 0.5, 1.5)
            mu = response(chain.scale_stiffness(theta, [0]), pulse)
            likelihood("y", mu=mu, sigma=sigma or pm.HalfNormal("sigma"), observed=data)

    with pytest.raises(FeatureLikelihoodWarning, match="the data have no noise. The discrepancy can van"):
        declare(exact, None)
    declare(exact, 0.5)
    noisy = exact + 0.01 * np.random.default_rng(0).normal(size=exact.shape)
    declare(noisy, None)


def test_declaring_a_usual_model_is_silent(pulse, measured):
    with warnings.catch_warnings(), pm.Model():
        warnings.simplefilter("error")
        ExpFeature("y", np.zeros((3, 21)), pm.HalfNormal("sigma"), observed=measured)
        TruncNormalFeature("z", np.zeros((3, 21)), 1.0, observed=measured)


# --------------------------------------------------------------------------- sigma and tolerance


def test_sigma_mpv_is_the_mode_of_the_exp_likelihood():
    """Eq. (11) against a numerical maximum of Eq. (9)."""
    mu, data, _ = random_data(5, n_sensors=6)
    e = mean_square_discrepancy(mu, data)
    best = sigma_mpv(e)

    def loss(log_sigma):
        return -evaluate(ExpFeature, "feature", "logp", mu, np.exp(log_sigma), data).sum()

    around = np.log(best)
    found = optimize.minimize_scalar(loss, bounds=(around - 3, around + 3), options={"xatol": 1e-10})
    assert np.exp(found.x) == pytest.approx(best, rel=1e-6)
    assert best == pytest.approx(np.sqrt(e.sum() / (2 * 6)), rel=1e-14)
    assert isinstance(best, float)
    batch = sigma_mpv(np.stack([e, 4 * e]))
    np.testing.assert_allclose(batch, [best, 2 * best], rtol=1e-14)
    assert sigma_mpv([0.0, 0.0]) == 0.0


@pytest.mark.parametrize("e", [[-1.0, 2.0], [np.nan], [np.inf], [], 3.0])
def test_sigma_mpv_refuses(e):
    with pytest.raises(ValueError, match="`e` must be mean squares, finite and not negative, one for each"):
        sigma_mpv(e)


def test_abc_tolerance():
    """Eq. (16); at the most probable sigma the tolerance is the smallest discrepancy itself."""
    assert abc_tolerance(0.3, 7) == pytest.approx(2 * 7 * 0.09, rel=1e-15)
    e = np.array([0.2, 0.5, 0.1])
    assert abc_tolerance(sigma_mpv(e), 3) == pytest.approx(e.sum(), rel=1e-14)
    assert isinstance(abc_tolerance(np.float32(1.0), np.int64(2)), float)
    np.testing.assert_allclose(abc_tolerance([1.0, 2.0], 2), [4.0, 16.0])


def test_abc_tolerance_of_a_posterior():
    """The 90 % quantile over chains and draws, whichever way the draws come."""
    rng = np.random.default_rng(0)
    draws = xr.DataArray(rng.gamma(3.0, size=(2, 500)), dims=("chain", "draw"))
    expected = 2 * 7 * np.quantile(draws.values, 0.9) ** 2
    posterior = xr.Dataset({"sigma": draws, "theta": draws})
    for given in (draws, posterior, xr.DataTree.from_dict({"/posterior": posterior})):
        assert abc_tolerance(given, 7) == pytest.approx(expected, rel=1e-14)
    each = xr.DataArray(rng.gamma(3.0, size=(2, 500, 3)), dims=("chain", "draw", "sensor"))
    expected = 2 * 3 * np.quantile(each.values, 0.9, axis=(0, 1)) ** 2
    np.testing.assert_allclose(abc_tolerance(each, 3), expected, rtol=1e-14)


@pytest.mark.parametrize(
    ("given", "match"),
    [
        (xr.DataTree(), "must hold a posterior, got a DataTree without that group"),
        (xr.Dataset({"s": 1.0}), "must hold a variable of that name, got s. Pass its draws"),
        (xr.DataArray([1.0], dims="time"), r"must have the dimensions chain and draw, got \('time',\)"),
    ],
)
def test_abc_tolerance_refuses_what_is_no_posterior(given, match):
    with pytest.raises(ValueError, match=f"`sigma` {match}"):
        abc_tolerance(given, 2)


@pytest.mark.parametrize(
    ("sigma", "n_sensors", "error", "match"),
    [
        (0.0, 2, ValueError, "`sigma` must be positive and finite, got 0.0. Pass the 90 % quantile"),
        (-1.0, 2, ValueError, "`sigma` must be positive and finite, got -1.0"),
        (np.nan, 2, ValueError, "`sigma` must be positive and finite, got nan"),
        (np.inf, 2, ValueError, "`sigma` must be positive and finite, got inf"),
        ([1.0, 2.0], 3, ValueError, r"one number or one for each of the 3 sensors, got shape \(2,\). Pass"),
        ("big", 2, TypeError, "`sigma` must be one number, got str. Pass a quantile"),
        (1.0, 0, ValueError, "`n_sensors` must be an integer of at least 1, got 0"),
        (1.0, 1.5, ValueError, "`n_sensors` must be an integer of at least 1, got 1.5"),
        (1.0, True, ValueError, "`n_sensors` must be an integer of at least 1, got True"),
    ],
)
def test_abc_tolerance_refuses(sigma, n_sensors, error, match):
    with pytest.raises(error, match=match):
        abc_tolerance(sigma, n_sensors)
