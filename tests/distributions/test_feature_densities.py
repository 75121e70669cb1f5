"""Likelihoods of histories by themselves: densities, draws, calibration, refusals."""

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
from pymc.logprob.utils import ParameterValueError
from scipy import special, stats

from pymc_features import ExpFeature, GammaFeature, TruncNormalFeature, mean_square_discrepancy
from pymc_features.likelihoods import FEATURE_LIKELIHOODS
from support.graphs import LIGHT, PLAIN
from support.likelihoods import EVERY, EVERY_FEATURE, OTHER, RMS_LAW, declare, equation, evaluate, random_data

DEGREES = {TruncNormalFeature: 1, ExpFeature: 2, GammaFeature: 3}


def scipy_feature(likelihood, e, sigma):
    """The same by SciPy: half-normal in the root mean square, exponential in the mean square.

    With three degrees of freedom a Maxwell root mean square r, and v = r^3.
    """
    if likelihood is GammaFeature:
        return stats.maxwell(scale=sigma).logpdf(np.sqrt(e)) - np.log(3.0 * e)
    if likelihood is TruncNormalFeature:
        return stats.halfnorm(scale=sigma).logpdf(np.sqrt(e))
    return stats.expon(scale=2 * np.square(sigma)).logpdf(e)


def scipy_data(likelihood, e, sigma, n):
    """Density of the data: the radius R = sqrt(n e) by SciPy, over the area of its sphere."""
    log_radius = RMS_LAW[likelihood](scale=sigma * np.sqrt(n)).logpdf(np.sqrt(n * e))
    log_area = np.log(2.0) + n / 2 * np.log(np.pi) - special.gammaln(n / 2)
    return log_radius - log_area - (n - 1) / 2 * np.log(n * e)


@EVERY_FEATURE
@pytest.mark.parametrize("per_sensor", [False, True])
def test_log_likelihood_against_the_equations_and_scipy(likelihood, per_sensor):
    mu, data, sigma = random_data(int(per_sensor))
    sigma = sigma if per_sensor else sigma[0]
    ours = evaluate(likelihood, "feature", "logp", mu, sigma, data).squeeze()
    assert ours.shape == (4,)
    np.testing.assert_allclose(ours, equation(likelihood, data, mu, sigma), rtol=1e-10)
    e = np.mean((data - mu) ** 2, axis=-1)
    np.testing.assert_allclose(ours, scipy_feature(likelihood, e, sigma), rtol=1e-10)
    control = equation(OTHER[likelihood], data, mu, sigma)
    assert np.abs(ours - control).min() > 1e-3


@EVERY_FEATURE
@pytest.mark.parametrize("n_times", [1, 3, 3000])
def test_density_of_the_data_against_scipy(likelihood, n_times):
    mu, data, sigma = random_data(n_times, n_times=n_times)
    ours = evaluate(likelihood, "data", "logp", mu, sigma, data).squeeze()
    e = np.mean((data - mu) ** 2, axis=-1)
    np.testing.assert_allclose(ours, scipy_data(likelihood, e, sigma, n_times), rtol=1e-10)


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
@pytest.mark.parametrize("density", ["feature", "data"])
def test_failed_response_and_scale_give_minus_infinity(likelihood, density):
    """Sensor by sensor: one failed sensor leaves the others alone."""
    mu = np.zeros((2, 3))
    mu[0, 1] = np.nan
    values = evaluate(likelihood, density, "logp", mu, 1.0, np.ones((2, 3))).ravel()
    assert values[0] == -np.inf
    assert np.isfinite(values[1])
    for shape in ((1, 1), (1, 3)):
        for far in (np.inf, 1e200):
            mu = np.full(shape, far)
            assert evaluate(likelihood, density, "logp", mu, 1.0, np.zeros(shape)) == -np.inf
    for sigma in (0.0, -1.0):
        with pytest.raises(ParameterValueError, match="sigma > 0"):
            evaluate(likelihood, density, "logp", np.zeros((2, 3)), sigma, np.ones((2, 3)))


@pytest.mark.parametrize(
    ("likelihood", "n_times", "expected"),
    [
        (TruncNormalFeature, 3, np.inf),
        (TruncNormalFeature, 1, -0.5 * np.log(2 * np.pi)),
        (ExpFeature, 1, -np.inf),
        (ExpFeature, 2, -np.log(4 * np.pi)),
        (ExpFeature, 3, np.inf),
        (GammaFeature, 3, -1.5 * np.log(6 * np.pi)),
        (GammaFeature, 4, np.inf),
    ],
)
def test_density_of_the_data_at_no_discrepancy(likelihood, n_times, expected):
    """The limit of R -> 0, where PyMC starts if the data are a free variable."""
    zero = np.zeros((1, n_times))
    got = evaluate(likelihood, "data", "logp", zero, 1.0, zero).item()
    assert got == pytest.approx(expected, rel=1e-12)


def test_degrees_of_freedom_of_the_others():
    """m = 1 is TN, m = 2 is EXP, and m = N_D with sigma / sqrt(N_D) is `pm.Normal`; control: m = 1.01."""
    mu, data, sigma = random_data(0)

    def logp(m, density, sigma=sigma):
        return pm.logp(GammaFeature.dist(mu, sigma, m, density=density), data).eval(mode=PLAIN)

    for m, other in ((1, TruncNormalFeature), (2, ExpFeature)):
        for density in ("feature", "data"):
            expected = evaluate(other, density, "logp", mu, sigma, data)
            np.testing.assert_allclose(logp(m, density), expected, rtol=1e-12)
            assert np.abs(logp(m + 0.01, density) / expected - 1).min() > 1e-9
    n = data.shape[1]
    normal = pm.logp(pm.Normal.dist(mu, sigma[:, None]), data).eval(mode=PLAIN).sum(axis=1)
    np.testing.assert_allclose(logp(n, "data", sigma / np.sqrt(n)), normal, rtol=1e-12)
    constant = 0.5 * n * np.log(np.pi / n) - special.gammaln(0.5 * n + 1)
    np.testing.assert_allclose(
        logp(n, "feature", sigma / np.sqrt(n)),
        normal + n * np.log(n) / 2 + constant + 0.5 * n * np.log(n),
        rtol=1e-12,
    )


def test_degrees_of_freedom_with_a_prior():
    """The density of the data is of the same quantity for every m: its posterior is that by SciPy's."""
    mu, data, _ = random_data(5)
    with pm.Model() as model:
        m = pm.LogNormal("m")
        GammaFeature("y", mu, 1.0, m, density="data", observed=data)
    e = np.mean((data - mu) ** 2, axis=-1)
    n = data.shape[1]
    for x in (0.3, 4.0):
        radius = stats.chi(x, scale=np.sqrt(n)).logpdf(np.sqrt(n * e))
        area = np.log(2.0) + n / 2 * np.log(np.pi) - special.gammaln(n / 2) + (n - 1) / 2 * np.log(n * e)
        got = model.compile_logp(model.observed_RVs, mode=LIGHT)({"m_log__": np.log(x)})
        assert float(got) == pytest.approx((radius - area).sum(), rel=1e-10)
    with pm.Model(), pytest.raises(ValueError, match=r"`m` must be numbers .*Pass density='data'"):
        GammaFeature("y", mu, 1.0, pm.LogNormal("m"), observed=data)

    for bad in (0.0, -1.0, np.nan, [1.0, 2.0]):
        with pytest.raises(ValueError, match=r"`m` must be (positive|a scalar or have one value for each)"):
            GammaFeature.dist(np.zeros((3, 5)), 1.0, bad)


def draw(variable, draws=1, seed=0):
    return pm.draw(variable, draws=draws, random_seed=seed, mode=PLAIN)


@pytest.fixture(scope="module", params=FEATURE_LIKELIHOODS)
def sample(request):
    """20000 draws of two sensors with five samples each: (likelihood, mu, sigma, draws)."""
    mu = np.array([[1.0, -2.0, 0.0, 3.0, 0.5], [0.0, 0.0, 5.0, -1.0, 2.0]])
    sigma = np.array([0.5, 3.0])
    return request.param, mu, sigma, draw(declare(request.param, mu, sigma, size=(20_000, 2)))


@pytest.mark.slow
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


@pytest.mark.slow
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
        ((5,), (3,), {}, (3, 5)),
        ((3, 5), (4, 1), {}, (4, 3, 5)),
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


@pytest.mark.slow
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
    data = draw(declare(likelihood, mu, sigma), seed=22)
    offsets = np.sinh(np.linspace(-9.0, 9.0, 401)) / np.sinh(9.0) * 12.0  # dense at the mean of the data
    grid = offsets[:, None] + data.mean(axis=(1, 2))

    def ranks(law, density):
        levels = np.repeat(grid[:, :, None, None], n, axis=-1)
        logp = evaluate(law, density, "logp", levels, sigma, data[None]).sum(axis=-1)
        return grid_ranks(stats.norm.logpdf(grid) + logp, grid, truth)

    assert uniformity(ranks(likelihood, "data")) > 1e-3
    assert uniformity(ranks(OTHER[likelihood], "data")) < 1e-6
    assert uniformity(ranks(likelihood, "feature")) < 1e-6


@EVERY
@pytest.mark.parametrize(
    ("observed", "error", "match"),
    [
        (np.ones((5, 3)), ValueError, r"\(3, 5\) to match `mu`, got \(5, 3\). Transpose it: time is the"),
        (np.ones((3, 4)), ValueError, r"\(3, 5\) to match `mu`, got \(3, 4\). Give one row for each"),
        (np.ones(5), ValueError, r"must have 2 dimensions \(..., sensor, time\) .* got shape \(5,\)"),
        (np.full((3, 5), np.inf), ValueError, r"must be finite, got inf at index \(0, 0\)"),
        ([["a"] * 5] * 3, TypeError, "`observed` must be an array of numbers, got list"),
        (pytensor.shared(np.ones((5, 3))), ValueError, "Transpose it: time is the last axis"),
    ],
)
def test_bad_data(likelihood, observed, error, match):
    with pm.Model(), pytest.raises(error, match=match):
        declare(likelihood, "y", mu=np.zeros((3, 5)), sigma=1.0, observed=observed)


@EVERY
@pytest.mark.parametrize(
    ("kwargs", "match"),
    [
        ({"sigma": 0.0}, "`sigma` must be positive and finite, got 0.0. Pass the root-mean-square"),
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
        declare(likelihood, np.zeros((3, 5)), 1.0, density="features")


def test_sensors_and_draws_are_independent(sample):
    """Rank correlation of the radii, false-alarm rate 1e-3 each."""
    _, mu, _, draws = sample
    radius = np.linalg.norm(draws - mu, axis=-1)
    assert stats.spearmanr(radius[:, 0], radius[:, 1]).pvalue > 1e-3
    assert stats.spearmanr(radius[1:, 0], radius[:-1, 0]).pvalue > 1e-3
