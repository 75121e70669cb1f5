"""Errors correlated in time: density, fused Ops, gradients, draws, life inside a model, and every refusal."""

import functools

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
from pymc.logprob.utils import ParameterValueError
from pytensor.gradient import NullTypeGradError
from pytensor.graph.replace import vectorize_graph
from scipy import linalg, optimize, stats

from pymc_features import CorrelatedNormal, RayleighDamping, SpringMassChain, response, simulate
from pymc_features.ops import (
    PopulationGradient,
    PopulationMisfit,
    StructuralMisfit,
    StructuralResponse,
    misfit_statistics,
)
from pymc_features.simulators import QUANTITIES
from support.graphs import LIGHT, PLAIN, our_ops, our_ops_of
from support.refusals import refusals
from support.structures import noise_record, three_storeys, with_noise

DT = 0.02


def correlation(rate, n):
    """exp(-rate |k - l|) as a matrix (n, n)."""
    k = np.arange(n)
    return np.exp(-rate * np.abs(k - k[:, None]))


def dense(misfit, sigma, rate):
    """Log-density of one sensor's misfit (time,) by the Cholesky factor of its covariance."""
    factor = linalg.cholesky(sigma**2 * correlation(rate, misfit.size), lower=True)
    white = linalg.solve_triangular(factor, misfit, lower=True)
    return stats.norm.logpdf(white).sum() - np.log(np.diag(factor)).sum()


def recursive(misfit, sigma, rate):
    """The same, sample by sample; any number may be complex."""
    change, variance = -np.expm1(-rate), -np.expm1(-2.0 * rate)
    total = -0.5 * np.log(2 * np.pi) - np.log(sigma) - misfit[0] ** 2 / (2 * sigma**2)
    for before, now in zip(misfit[:-1], misfit[1:], strict=True):
        total += -0.5 * np.log(2 * np.pi * variance) - np.log(sigma)
        total -= (now - before + change * before) ** 2 / (2 * sigma**2 * variance)
    return total


@functools.cache
def compiled(mode):
    """Function (mu, sigma, tau, dt, value) of the package's log-density of each sensor."""
    inputs = [pt.matrix(), pt.vector(), pt.vector(), pt.scalar(), pt.matrix()]
    return pytensor.function(inputs, pm.logp(CorrelatedNormal.dist(*inputs[:4]), inputs[4]), mode=mode)


def evaluate(mu, sigma, tau, dt, value):
    n = len(value)
    spread = [np.broadcast_to(np.asarray(x, dtype=float), n) for x in (sigma, tau)]
    return compiled(PLAIN)(np.asarray(mu, dtype=float), *spread, dt, np.asarray(value, dtype=float))


def random_data(seed, n_sensors=3, n_times=40):
    rng = np.random.default_rng(seed)
    mu, data = 10.0 ** rng.uniform(-2, 2) * rng.normal(size=(2, n_sensors, n_times))
    return mu, data, 10.0 ** rng.uniform(-1, 1, n_sensors)


@pytest.mark.parametrize(("ratio", "n_times"), [(4.0, 1), (0.3, 2), (1e-3, 40), (4.0, 300), (1e3, 300)])
def test_density_against_a_dense_covariance(ratio, n_times):
    """tau / dt from white to nearly constant errors; another correlation time is the negative control."""
    mu, data, sigma = random_data(n_times, n_times=n_times)
    tau = ratio * DT * np.array([0.7, 1.0, 1.4])
    got = evaluate(mu, sigma, tau, DT, data)
    expected = [dense(r, s, DT / t) for r, s, t in zip(data - mu, sigma, tau, strict=True)]
    np.testing.assert_allclose(got, expected, rtol=1e-9)
    loops = [recursive(r, s, DT / t) for r, s, t in zip(data - mu, sigma, tau, strict=True)]
    np.testing.assert_allclose(got, loops, rtol=1e-10)
    if n_times > 1:
        other = [recursive(r, s, DT / (t + DT)) for r, s, t in zip(data - mu, sigma, tau, strict=True)]
        assert np.abs(got / other - 1.0).min() > 1e-6


def test_white_limit_is_the_conventional_likelihood():
    mu, data, sigma = random_data(1)
    norm = pm.logp(pm.Normal.dist(mu, sigma[:, None]), data).sum(axis=-1).eval(mode=PLAIN)
    for tau in (1e-4, 1e-12, 1e-200, 1e-320):
        np.testing.assert_allclose(evaluate(mu, sigma, tau, DT, data), norm, rtol=1e-14)


@pytest.mark.parametrize("ratio", [1e8, 1e12])
def test_nearly_constant_errors_keep_their_digits(ratio):
    """Negative control: sums of products, subtracted as the definition has them, have lost theirs."""
    r = 3.0 + 1e-3 * np.sin(np.arange(2000) / 200.0)
    got = evaluate(np.zeros((1, 2000)), 0.5, ratio * DT, DT, r[None])
    expected = recursive(r, 0.5, 1.0 / ratio)
    np.testing.assert_allclose(got, expected, rtol=1e-12)
    phi, variance = np.exp(-1.0 / ratio), -np.expm1(-2.0 / ratio)
    products = r[1:] @ r[1:] - 2 * phi * r[1:] @ r[:-1] + phi**2 * r[:-1] @ r[:-1]
    exact = np.sum((np.diff(r) - np.expm1(-1.0 / ratio) * r[:-1]) ** 2)
    assert abs((products - exact) / variance / (2 * 0.5**2)) > 1e-10 * abs(expected)


def test_failed_sensor_and_parameters_outside_the_support():
    """-inf for the one sensor; -inf or PyMC's refusal for sigma, tau and dt that are not positive."""
    mu, data = np.zeros((3, 4)), np.ones((3, 4))
    mu[0, 1], mu[1, 3] = np.nan, np.inf
    values = evaluate(mu, 1.0, 1.0, DT, data)
    assert (values[:2] == -np.inf).all() and np.isfinite(values[2])
    assert (evaluate(np.full((3, 4), 1e200), 1.0, 1.0, DT, data) == -np.inf).all()
    assert (evaluate(0 * data, 1.0, 1e300, 1e-300, data) == -np.inf).all()  # dt / tau is no number above 0
    assert (evaluate(0 * data, 1.0, np.inf, DT, data) == -np.inf).all()
    for sigma, tau, dt in [(0, 1, DT), (-1, 1, DT), (1, 0, DT), (1, -1, DT), (1, np.nan, DT), (1, 1, 0)]:
        with pytest.raises(ParameterValueError, match="sigma > 0, correlation_time > 0, dt > 0"):
            evaluate(0 * data, sigma, tau, dt, data)


def test_information_is_what_the_docstring_says():
    """On a constant error: T / (2 tau) + 1 samples in the limit; by white errors and inferred sigma, none."""
    duration, tau = 10.0, 0.2
    found, inferred = [], []
    for n in (1001, 4001, 16001):
        dt = duration / (n - 1)

        def misfit(offset, n=n):
            return np.full((1, n), offset)

        found.append(
            -2.0 * np.diff([evaluate(misfit(x), 1.0, tau, dt, misfit(0.0))[0] for x in (0.0, 1.0)])[0]
        )
        white = np.random.default_rng(n).normal(size=(1, n))
        best = optimize.minimize_scalar(
            lambda s, white=white, dt=dt: -evaluate(0 * white, np.exp(s), tau, dt, white)[0], (0.0, 2.0)
        )
        inferred.append(np.exp(best.x) / np.sqrt(tau / dt))
    assert found[2] == pytest.approx(duration / (2 * tau) + 1.0, rel=1e-4)
    assert abs(found[2] - found[1]) < abs(found[1] - found[0])
    np.testing.assert_allclose(inferred, 1.0, rtol=0.1)


@pytest.fixture(scope="module")
def pulse():
    return noise_record(150, DT)


@pytest.fixture(scope="module")
def measured(pulse):
    return with_noise(simulate(three_storeys(100.0), pulse))


def both_logps(pulse, measured, **settings):
    """Inputs, and the log-density by the fused Op and from the history."""
    stiffness, sigma, tau = (
        pt.vector("k", shape=(3,)),
        pt.vector("sigma", shape=(3,)),
        pt.vector("tau", shape=(3,)),
    )
    mu = response(three_storeys(stiffness), pulse, **settings)
    dt = settings.get("dt", DT)
    fused, unfused = (
        pm.logp(CorrelatedNormal.dist(m, sigma, tau, dt if i else None), measured)
        for i, m in enumerate((mu, 1.0 * mu))
    )
    return [stiffness, sigma, tau], fused, unfused


@pytest.mark.parametrize(
    ("mode", "settings"),
    [("NUMBA", {"dt": 0.04, "quantity": QUANTITIES[2]}), (PLAIN, {})],
    ids=["numba", "python"],
)
def test_fused_equals_unfused(mode, settings, pulse, measured):
    """Values, and gradients by all that may be random."""
    data = measured[:, :: 2 if settings else 1]
    inputs, *logps = both_logps(pulse, data, **settings)
    assert [our_ops([logp]) for logp in logps] == [{StructuralMisfit}, {StructuralResponse}]
    fused, unfused = (
        pytensor.function(inputs, [logp, *pt.grad(logp.sum(), inputs)], mode=way)
        for logp, way in zip(logps, (mode, PLAIN), strict=True)
    )
    for tau in (0.003, 0.1, 5.0):
        values = [100.0, 60.0, 140.0], [1.0, 0.5, 2.0], np.array([1.0, 0.7, 1.3]) * tau
        for a, b in zip(fused(*values), unfused(*values), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-10)


@pytest.mark.slow
def test_batches_become_populations(pulse, measured):
    """As one by one, an invalid row alone; gradients, too: what all share gets the sum, data none."""
    mass, stiffness, batch = pt.vector("m", shape=(3,)), pt.vector("k", shape=(3,)), pt.tensor3("batch")
    chain = SpringMassChain(mass, stiffness, RayleighDamping(0.1, 1e-3))
    data, c = pt.matrix("data", shape=(3, None)), np.random.default_rng(2).normal(size=(3, 4))
    one = misfit_statistics(response(chain, pulse), data)
    many = vectorize_graph(one, {stiffness: batch})
    assert our_ops([many]) == {PopulationMisfit}
    shape = pytensor.function([mass, batch, data], many.shape, mode=LIGHT, on_unused_input="ignore")
    assert tuple(shape(np.ones(3), np.ones((2, 5, 3)), measured)) == (2, 5, 3, 4)
    assert our_ops_of(shape) == set()
    slopes = pt.grad((c * one).sum(), [stiffness, mass])
    gradients = pt.grad((c * many).sum(), [batch, mass])
    assert our_ops(gradients) == {PopulationGradient, PopulationMisfit}  # no history
    with pytest.raises(NullTypeGradError, match="Differentiate one particle"):
        pt.grad(many.sum(), data)
    single = pytensor.function([mass, stiffness, data], [one, *slopes], mode="FAST_COMPILE")
    together = pytensor.function([mass, batch, data], [many, *gradients], mode="NUMBA")
    springs = np.random.default_rng(3).uniform(50.0, 150.0, (2, 3, 3))
    statistics, by_stiffness, *shared = together(np.ones(3), springs, measured)
    alone = [single(np.ones(3), k, measured) for k in springs.reshape(-1, 3)]
    np.testing.assert_allclose(statistics.reshape(-1, 3, 4), [x[0] for x in alone], rtol=1e-10)
    np.testing.assert_allclose(by_stiffness.reshape(-1, 3), [x[1] for x in alone], rtol=1e-9)
    for i, total in enumerate(shared):
        np.testing.assert_allclose(total, sum(x[2 + i] for x in alone), rtol=1e-9, atol=1e-12)
    springs[1, 1, 0] = -1.0
    failed = np.isnan(together(np.ones(3), springs, measured)[0]).all(axis=(2, 3))
    np.testing.assert_array_equal(failed, [[False] * 3, [False, True, False]])


def test_gradient_against_complex_steps_and_differences(pulse, measured):
    """Complex steps in sigma, tau and the data; central differences in the springs."""
    inputs, logp, _ = both_logps(pulse, measured)
    gradients = pytensor.function(inputs, pt.grad(logp.sum(), inputs), mode=PLAIN)
    k, sigma, tau = np.array([100.0, 60.0, 140.0]), np.array([1.0, 0.5, 2.0]), np.array([0.1, 0.01, 1.0])
    by_k, by_sigma, by_tau = gradients(k, sigma, tau)

    def total(k):
        r = measured - simulate(three_storeys(k), pulse).values
        return sum(recursive(*x) for x in zip(r, sigma, DT / tau, strict=True))

    r = measured - simulate(three_storeys(k), pulse).values
    for j in range(3):
        step = 1e-200j
        assert by_sigma[j] == pytest.approx(
            recursive(r[j], sigma[j] + step, DT / tau[j]).imag / 1e-200, rel=1e-9
        )
        assert by_tau[j] == pytest.approx(
            recursive(r[j], sigma[j], DT / (tau[j] + step)).imag / 1e-200, rel=1e-9
        )
        h = 1e-4 * np.eye(3)[j]
        assert by_k[j] == pytest.approx((total(k + h) - total(k - h)) / 2e-4, rel=1e-6)
    mu, data = pt.matrix("mu"), pt.matrix("data")
    logp = pm.logp(CorrelatedNormal.dist(mu, sigma, tau, DT), data).sum()
    by_data = pytensor.function([mu, data], pt.grad(logp, data), mode=PLAIN)(0 * r, r)
    for i in (0, 1, 77, 149):
        moved = r[0] + 1e-200j * np.eye(150)[i]
        assert by_data[0, i] == pytest.approx(recursive(moved, sigma[0], DT / tau[0]).imag / 1e-200, rel=1e-9)


def worst(draws, expected):
    """Largest deviation of a sample covariance (n, n) of unit normals, in its standard errors."""
    found = draws.T @ draws / len(draws)
    return (np.abs(found - expected) / np.sqrt((1.0 + expected**2) / len(draws))).max()


@pytest.mark.statistical
@pytest.mark.parametrize("n_times", [1, 7, 16])
def test_covariance_of_draws(n_times):
    """20000 draws, blocks that are full and not: five standard errors for up to 136 entries and four
    sensors, a false alarm in 3000 seeds; a correlation time larger by a fifth is rejected.
    """
    mu, sigma = np.random.default_rng(0).normal(size=(4, n_times)), np.array([1.0, 0.1, 3.0, 1.0])
    tau = DT * np.array([0.5, 2.0, 10.0, 1e-9])
    y = CorrelatedNormal.dist(mu, sigma, tau, DT, size=(20_000, 4))
    draws = pm.draw(y, random_seed=1, mode=PLAIN)
    unit = (draws - mu) / sigma[:, None]
    for j in range(4):
        assert worst(unit[:, j], correlation(DT / tau[j], n_times)) < 5.0
    if n_times > 2:
        assert worst(unit[:, 2], correlation(DT / (1.2 * tau[2]), n_times)) > 5.0
        assert worst(np.concatenate([unit[:, 0], unit[:, 1]], axis=1)[:, ::n_times], np.eye(2)) < 5.0


def test_long_draws_are_the_recursion():
    """Their innovations are independent standard normals (KS at 1e-3); of another tau they are not."""
    n, tau = 20_000, 0.5
    mu = pt.matrix("mu")  # no length is known
    y = CorrelatedNormal.dist(mu, 2.0, tau, DT)
    [e] = pm.draw(y, random_seed=3, mode=PLAIN, givens={mu: np.ones((1, n))}) - 1.0

    def innovations(tau):
        phi = np.exp(-DT / tau)
        return np.append(e[0], (e[1:] - phi * e[:-1]) / np.sqrt(1 - phi**2)) / 2.0

    white = innovations(tau)
    assert stats.kstest(white, stats.norm.cdf).pvalue > 1e-3
    for lag in (1, 2, 141, 142):  # blocks have 142 samples
        assert abs(white[lag:] @ white[:-lag]) < 4.0 * np.sqrt(n)
    assert stats.kstest(innovations(0.8 * tau), stats.norm.cdf).pvalue < 1e-9


def test_step_as_data(pulse, measured):
    """The output step is then no constant: dt is asked for, and may be the same data."""
    with pm.Model() as model:
        step, data = pm.Data("step", DT), pm.Data("data", measured)
        mu = response(three_storeys(100.0 * pm.HalfNormal("theta")), pulse, dt=step)
        with pytest.raises(
            ValueError, match="`dt` must be given where `mu` is not a response of fixed output"
        ):
            CorrelatedNormal("y", mu, 1.0, 0.1, observed=data)
        CorrelatedNormal("y", mu, 1.0, 0.1, step, observed=data)
    logp = model.compile_logp(vars=model.observed_RVs, jacobian=False, mode=LIGHT)
    for stride in (1, 2):
        with model:
            pm.set_data({"step": stride * DT, "data": measured[:, ::stride]})
        r = measured[:, ::stride] - simulate(three_storeys(100.0), pulse, dt=stride * DT).values
        expected = sum(recursive(x, 1.0, 10 * stride * DT) for x in r)
        assert float(logp({"theta_log__": 0.0})) == pytest.approx(expected, rel=1e-10)


BAD_PARAMETERS = {  # what is said: what is given
    "`correlation_time` must be positive and finite, got 0.0. Pass the time": {"correlation_time": 0.0},
    r"`correlation_time` must be positive .* got \[1.0, -1.0, 1.0\]": {"correlation_time": [1.0, -1.0, 1.0]},
    "`correlation_time` must be a scalar or have one value for each": {"correlation_time": [1.0, 2.0]},
    "`dt` must be positive and finite, got 0.0. Pass the sampling interval in seconds": {"dt": 0.0},
    "`dt` must be one number, got 1 dimensions. Pass the sampling interval": {"dt": [0.1, 0.2]},
    "`dt` must be given where `mu` is not a response .* got None. Pass the sampling interval": {"dt": None},
}


@refusals("kwargs", BAD_PARAMETERS)
def test_bad_parameters(kwargs, match):
    arguments = {"mu": np.zeros((3, 5)), "sigma": 1.0, "correlation_time": 1.0, "dt": 0.1} | kwargs
    with pytest.raises(ValueError, match=match):
        CorrelatedNormal.dist(**arguments)
    with pm.Model(), pytest.raises(ValueError, match=match):
        CorrelatedNormal("y", **arguments)


def test_step_must_be_that_of_the_response(pulse):
    mu = response(three_storeys(100.0), pulse)
    with pytest.raises(
        ValueError, match="`dt` must be the output step of the response, 0.02 s, got 0.05. Leave it"
    ):
        CorrelatedNormal.dist(mu, 1.0, 1.0, 0.05)
    a, b = (
        pm.logp(CorrelatedNormal.dist(mu, 1.0, 1.0, dt), np.zeros((3, 150))).eval(mode=PLAIN)
        for dt in (None, DT)
    )
    np.testing.assert_array_equal(a, b)
