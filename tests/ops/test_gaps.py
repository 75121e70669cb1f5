"""Data with gaps, NaN: mean squares, likelihoods, gradients and draws against NumPy on what was measured."""

import functools
import warnings

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
from pytensor.gradient import pushforward
from pytensor.graph.replace import vectorize_graph
from pytensor.graph.traversal import ancestors
from scipy import stats

import pymc_features as pmf
from pymc_features import (
    CorrelatedNormal,
    DiscrepancySimulator,
    ExpFeature,
    GammaFeature,
    ModalDamping,
    SpringMassChain,
    TruncNormalFeature,
    mean_square_discrepancy,
    ops,
    response,
    simulate,
)
from pymc_features.likelihoods import LIKELIHOODS, Comparison
from pymc_features.likelihoods.simulator_functions import NoisySimulator
from pymc_features.smc import population_logp
from support.external_functions import DATA, SHAPE, beam, beam_gradient, beam_squares
from support.families import CASES, measured
from support.graphs import LIGHT, PLAIN, our_ops
from support.likelihoods import EVERY_FEATURE, MORE, declare, equation, evaluate, random_data
from support.reference import richardson
from support.straight import Record

X = np.array([[1.05, 0.9], [0.8, 1.2], [1.0, 1.0]])
DIRECTION = np.array([0.7, -0.4])
WEIGHTS = np.array([0.5, 2.0, -1.0])
OF_POPULATIONS = dict.fromkeys(("hysteretic", "duffing"), 3e-6)  # Taylor steps: another route


def with_gaps(data):
    """Copies of data (sensor, time) with gaps: long, single, at both ends, none; another in each sensor."""
    data = np.array(data)
    n = data.shape[1]
    data[0, n // 3 : n // 3 + max(3, n // 4)] = np.nan
    data[0, -1] = np.nan
    data[1, [0, 5, 6, n // 2]] = np.nan
    return data


def means(response, data):
    """Mean squares of what was measured, sample by sample."""
    result = []
    for y, g in zip(data, response, strict=True):
        squares = [(a - b) ** 2 for a, b in zip(y, g, strict=True) if not np.isnan(a)]
        result.append(sum(squares) / len(squares))
    return np.array(result)


@functools.cache
def graph(name):
    """x, data, e and what follows from it, of a structure of a family: no data known when it is built."""
    build, record = CASES[name]
    x, data, rows = pt.dvector("x"), pt.dmatrix("data"), pt.dmatrix("rows")
    e = mean_square_discrepancy(response(build(x), record), data)
    [moved] = pushforward([e], [x], [pt.constant(DIRECTION)])
    population = vectorize_graph(e, {x: rows})
    outputs = [e, pt.grad((WEIGHTS * e).sum(), x), moved]
    outputs += [population, pt.grad((WEIGHTS * population).sum(), rows)]
    assert ops.PopulationDiscrepancy in our_ops([population])
    return pytensor.function([x, data, rows], outputs, mode=PLAIN)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_mean_squares_and_derivatives_of_every_family(name):
    build, record = CASES[name]
    data = with_gaps(measured(name))
    e, gradient, moved, population, gradients = graph(name)(X[0], data, X)

    def expected(x):
        return means(simulate(build(x), record).values, data)

    np.testing.assert_allclose(e, expected(X[0]), rtol=OF_POPULATIONS.get(name, 1e-9))
    np.testing.assert_allclose(population, [expected(x) for x in X], rtol=OF_POPULATIONS.get(name, 1e-9))
    rough = 1e-5 if name in ("hysteretic", "duffing") else 1e-8
    slopes = np.array([[richardson(expected, x, d) for d in np.eye(2)] for x in X])  # (p, x, s)
    close = {"rtol": rough, "atol": rough * np.abs(slopes).max()}
    np.testing.assert_allclose(gradient, slopes[0] @ WEIGHTS, **close)
    np.testing.assert_allclose(moved, DIRECTION @ slopes[0], **close)
    np.testing.assert_allclose(gradients, slopes @ WEIGHTS, **close)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["chain", "sparse", "coupled damping", "duffing"])
def test_data_without_gaps_change_nothing(name):
    """To the last bit: where it is known that there are none, the factor is not even in the graph."""
    build, record = CASES[name]
    x, rows, data = pt.dvector("x"), pt.dmatrix("rows"), measured(name)
    e = mean_square_discrepancy(response(build(x), record), data)
    outputs = [e, pt.grad((WEIGHTS * e).sum(), x), vectorize_graph(e, {x: rows})]
    assert not any(v.owner and str(v.owner.op).startswith("Isnan") for v in ancestors(outputs))
    known = pytensor.function([x, rows], outputs, mode=PLAIN)(X[0], X)
    found = graph(name)(X[0], data, X)
    for got, same in zip((found[0], found[1], found[3]), known, strict=True):
        np.testing.assert_array_equal(got, same)
    # a response that is NaN is one where nothing was measured, too
    found = graph(name)(np.array([-5.0, 1.0]), with_gaps(data), np.array([[-5.0, 1.0], X[0]]))
    assert np.isnan(found[0]).all()
    assert np.isnan(found[3][0]).all() and np.isfinite(found[3][1]).all()


def long_chain(x):
    """Two masses, sensors on both, for a record of more than two blocks of the recursion."""
    return SpringMassChain(np.ones(2), 400.0 * x, ModalDamping(0.03))


@pytest.mark.parametrize(("n_times", "dt"), [(256, 0.02), (300, 0.01), (300, 0.04)])
def test_blocks_with_and_without_gaps(n_times, dt):
    """Gaps at the edges of blocks of 16 and of 128 samples, steps finer and coarser than the record's."""
    record = Record(np.random.default_rng(2).normal(size=n_times), 0.02)
    exact = simulate(long_chain(np.array([1.0, 1.0])), record, dt=dt).values
    data = exact + 0.3 * np.random.default_rng(3).normal(size=exact.shape)
    data[0, 16:32], data[0, 127], data[1, 128:131], data[1, -3:] = np.nan, np.nan, np.nan, np.nan
    x, rows, y = pt.dvector(), pt.dmatrix(), pt.dmatrix()
    e = mean_square_discrepancy(response(long_chain(x), record, dt=dt), y)
    many = np.random.default_rng(4).uniform(0.7, 1.3, (11, 2))
    alone, population = pytensor.function([x, rows, y], [e, vectorize_graph(e, {x: rows})], mode=PLAIN)(
        many[0], many, data
    )
    expected = [means(simulate(long_chain(one), record, dt=dt).values, data) for one in many]
    np.testing.assert_allclose(population, expected, rtol=1e-9)
    np.testing.assert_allclose(alone, expected[0], rtol=1e-9)


def test_a_sensor_without_data_is_nan():
    data = measured("chain").copy()
    data[2] = np.nan
    e = graph("chain")(X[0], data, X)[0]
    assert np.isfinite(e[:2]).all() and np.isnan(e[2])


def test_numpy_and_other_expressions():
    mu, data = np.random.default_rng(1).normal(size=(2, 3, 40))
    data = with_gaps(data)
    expected = means(mu, data)
    np.testing.assert_allclose(mean_square_discrepancy(mu, data), expected)
    np.testing.assert_allclose(mean_square_discrepancy(np.stack([mu, mu]), data), [expected, expected])
    tensor = pt.dmatrix()
    e = mean_square_discrepancy(2.0 * tensor, data)
    value, slope = pytensor.function([tensor], [e, pt.grad(e.sum(), tensor)], mode=PLAIN)(0.5 * mu)
    np.testing.assert_allclose(value, expected)
    n = (~np.isnan(data)).sum(axis=1, keepdims=True)
    np.testing.assert_allclose(slope, np.where(np.isnan(data), 0.0, -4.0 * (data - mu) / n), atol=1e-12)


@EVERY_FEATURE
@pytest.mark.parametrize("method", ["logp", "logcdf"])
@pytest.mark.parametrize("density", ["feature", "data"])
def test_as_of_the_samples_alone(likelihood, method, density):
    """Every sensor as one with the measured samples and no others."""
    mu, data, sigma = random_data(5, n_times=40)
    data = with_gaps(data)
    found = evaluate(likelihood, density, method, mu, sigma, data)
    for j in range(len(data)):
        kept = ~np.isnan(data[j])
        part = mu[None, j, kept], sigma[[j]], data[None, j, kept]
        np.testing.assert_allclose(found[j], evaluate(likelihood, density, method, *part)[0], rtol=1e-12)


def model_of(likelihood, name, data, **settings):
    """A structure of a family under a likelihood."""
    build, record = CASES[name]
    with pm.Model(coords={"sensor": [0, 1, 2]}) as model:
        x = pm.Normal("x", 1.0, 0.3, shape=2)
        sigma = pm.HalfNormal("sigma", 1.0)
        mu = response(build(x), record)
        declare(likelihood, "y", mu=mu, sigma=sigma, observed=data, dims=("sensor", "time"), **settings)
    return model


def density_of_what_was_measured(likelihood, data, exact, sigma):
    """Sum over the sensors, each with its measured samples alone."""
    return sum(
        equation(likelihood, y[None, k], g[None, k], sigma)[0]
        for y, g, k in zip(data, exact, ~np.isnan(data), strict=True)
    )


@EVERY_FEATURE
def test_a_model_has_no_variables_for_gaps(likelihood):
    data = with_gaps(measured("chain"))
    given = data if likelihood is ExpFeature else np.ma.masked_invalid(data)
    with warnings.catch_warnings():
        warnings.simplefilter("error", pm.exceptions.ImputationWarning)
        model = model_of(likelihood, "chain", given)
    assert [rv.name for rv in model.free_RVs] == ["x", "sigma"]
    build, record = CASES["chain"]
    exact = simulate(build(X[0]), record).values
    expected = density_of_what_was_measured(likelihood, data, exact, 0.7)
    point = {"x": X[0], "sigma_log__": np.log(0.7)}
    logp = model.compile_fn(model.datalogp, inputs=model.value_vars, mode=LIGHT, point_fn=False)
    np.testing.assert_allclose(logp(*point.values()), expected, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["chain", "hysteretic"])
def test_population_of_a_model(name):
    """Log-likelihoods of particles at once, and a draw of the data without gaps."""
    data = with_gaps(measured(name))
    model = model_of(ExpFeature, name, data)
    logp = population_logp(model, model.initial_point(), {})
    points = np.column_stack([X, np.log([0.4, 0.7, 1.1])])
    _, found, _ = logp(points)
    build, record = CASES[name]
    expected = [
        density_of_what_was_measured(ExpFeature, data, simulate(build(x), record).values, s)
        for x, s in zip(X, [0.4, 0.7, 1.1], strict=True)
    ]
    np.testing.assert_allclose(found, expected, rtol=OF_POPULATIONS.get(name, 1e-9))
    [drawn] = pm.draw([model["y"]], random_seed=1, mode=LIGHT)
    assert np.isfinite(drawn).all()


def test_data_that_are_set_later():
    data = measured("chain")
    build, record = CASES["chain"]
    with pm.Model() as model:
        y = pm.Data("data", data)
        TruncNormalFeature("y", response(build(X[0]), record), 0.5, observed=y)
    logp = model.compile_logp(mode=LIGHT)
    whole = logp({})
    with model:
        pm.set_data({"data": with_gaps(data)})
    exact = simulate(build(X[0]), record).values
    for values, found in ((data, whole), (with_gaps(data), logp({}))):
        e = means(exact, values)
        np.testing.assert_allclose(found, np.sum(0.5 * np.log(2 / np.pi) - np.log(0.5) - e / 0.5), rtol=1e-9)
    assert not np.isclose(logp({}), whole)


@pytest.mark.parametrize("sigma", [0.7, np.array([0.3, 0.7, 1.4])])
def test_conventional_likelihood_of_the_catalogue(sigma):
    """Independent Gaussian samples, of those measured."""
    data, (build, record) = with_gaps(measured("chain")), CASES["chain"]
    with pm.Model(coords={"sensor": range(3)}) as model:
        given = Comparison(response(build(X[0]), record), data, pt.as_tensor_variable(sigma))
        LIKELIHOODS["NORM"].declare(given)
    exact = simulate(build(X[0]), record).values
    expected = np.nansum(stats.norm(exact, np.broadcast_to(sigma, 3)[:, None]).logpdf(data))
    np.testing.assert_allclose(model.compile_logp(mode=LIGHT)({}), expected, rtol=1e-9)
    drawn = pm.draw(model["y"], 2000, random_seed=1, mode=LIGHT) - exact
    # relative error of a variance of 140,000 draws: 0.004; the limit is five times that
    np.testing.assert_allclose(drawn.var(axis=(0, 2)), np.broadcast_to(sigma, 3) ** 2, rtol=0.02)
    n = (~np.isnan(data)).sum(axis=1)
    assert LIKELIHOODS["NORM"].claimed(n) == n.sum()


def test_a_normal_with_nan_in_shared_data_stays_impossible():
    """PyMC leaves no sample out; the fused density must not either."""
    build, record = CASES["chain"]
    data = pytensor.shared(measured("chain"), shape=(3, 70))
    with pm.Model() as model:
        x = pm.Normal("x", 1.0, 0.3, shape=2)
        pm.Normal("y", response(build(x), record), 0.5, observed=data)
    logp = model.compile_fn(model.datalogp, inputs=model.value_vars, point_fn=False)
    assert np.isfinite(logp(X[0]))
    data.set_value(with_gaps(measured("chain")))
    assert not np.isfinite(logp(X[0]))


def test_fisher_information_knows_the_gaps():
    """J' W J of the measured samples alone, J by differences."""
    data, (build, record) = with_gaps(measured("affine")), CASES["affine"]
    with pm.Model() as model:
        x = pm.Normal("x", 1.0, 0.3, shape=2)
        TruncNormalFeature("y", response(build(x), record), 0.5, observed=data)
    found = pmf.fisher_information(model, {"x": X[0]})["information"].values
    slopes = np.array([richardson(lambda v: simulate(build(v), record).values, X[0], d) for d in np.eye(2)])
    kept = ~np.isnan(data)
    weights = kept / kept.sum(axis=1, keepdims=True) / 0.5**2
    np.testing.assert_allclose(found, np.einsum("ist,st,jst->ij", slopes, weights, slopes), rtol=1e-8)


@pytest.mark.parametrize("as_function", [False, True])
def test_tolerance_of_simulations(as_function):
    data, (build, record) = with_gaps(measured("chain")), CASES["chain"]
    with pm.Model() as model:
        x = pm.Normal("x", 1.0, 0.3, shape=2)
        if as_function:
            given = lambda v: simulate(build(v), record).values, x  # noqa: E731
        else:
            given = (response(build(x), record),)
        DiscrepancySimulator("y", *given, epsilon=2.0, observed=data, kernel="exponential")
    assert [rv.name for rv in model.free_RVs] == ["x"]
    logp = model.compile_fn(model.datalogp, inputs=model.value_vars, mode=LIGHT, point_fn=False)
    e = means(simulate(build(X[0]), record).values, data)
    np.testing.assert_allclose(logp(X[0]), -np.sum(np.log(2.0) + e / 2.0), rtol=1e-9)


def test_noise_of_simulations_is_that_of_the_samples_measured():
    """Mean and variance of noisy mean squares; 4,000 draws, limits at four standard errors."""
    data, (build, record) = with_gaps(measured("chain")), CASES["chain"]
    exact, sigma = simulate(build(X[0]), record).values, 0.8
    e, n = means(exact, data), (~np.isnan(data)).sum(axis=1)

    class Exact:
        ndims_params = ()

        def discrepancy(self, parameters, value):
            return pt.constant(e)

    drawn = NoisySimulator(Exact()).discrepancy([pt.constant(np.full(3, sigma))], pt.constant(data))
    [stream] = [v for v in ancestors([drawn]) if v.name == "noise"]
    function, values = pytensor.function([], drawn, mode=PLAIN), []
    for seed in range(4000):
        stream.set_value(np.random.default_rng(seed))
        values.append(function())
    values = np.array(values)
    variance = (4.0 * sigma**2 * e + 2.0 * sigma**4) / n
    assert (abs(values.mean(axis=0) - e - sigma**2) < 4.0 * np.sqrt(variance / 4000)).all()
    np.testing.assert_allclose(values.var(axis=0), variance, rtol=4.0 * np.sqrt(3.0 / 4000))


def test_external_simulations():
    data = np.random.default_rng(1).normal(size=SHAPE)
    data[:, 1::3] = np.nan
    settings = {"executor": 1, "progress": False}
    with pmf.ExternalSimulator(beam, SHAPE, gradient=beam_gradient, **settings) as simulator:
        k, rows = pt.dscalar(), pt.dvector()
        e = mean_square_discrepancy(simulator(k), data)
        outputs = [e, pt.grad(e.sum(), k), vectorize_graph(e, {k: rows})]
        found, slope, population = pytensor.function([k, rows], outputs, mode=PLAIN)(1.2, [1.2, 0.9])
    np.testing.assert_allclose(found, means(beam(1.2), data), rtol=1e-12)
    np.testing.assert_allclose(population, [means(beam(x), data) for x in (1.2, 0.9)], rtol=1e-12)
    np.testing.assert_allclose(slope, richardson(lambda x: means(beam(x), data).sum(), 1.2), rtol=1e-9)


def test_mean_squares_that_come_from_outside_are_taken_as_they_are():
    data = DATA.copy()
    data[:, 2] = np.nan
    settings = {"executor": 1, "progress": False, "returns": "mean_square"}
    with pmf.ExternalSimulator(beam_squares, SHAPE, **settings) as simulator:
        k = pt.dscalar()
        e = mean_square_discrepancy(simulator(k), data)
        found = pytensor.function([k], e, mode=PLAIN)(1.2)
    np.testing.assert_array_equal(found, beam_squares(1.2))


@pytest.mark.slow
def test_jax(quick_compilation):
    data = with_gaps(measured("chain"))
    build, record = CASES["chain"]
    x, rows, y = pt.dvector("x"), pt.dmatrix("rows"), pt.dmatrix("data")
    e = mean_square_discrepancy(response(build(x), record), y)
    [moved] = pushforward([e], [x], [pt.constant(DIRECTION)])
    outputs = [e, pt.grad((WEIGHTS * e).sum(), x), moved, vectorize_graph(e, {x: rows})]
    found = pytensor.function([x, y, rows], outputs, mode="JAX")(X[0], data, X)
    expected = graph("chain")(X[0], data, X)
    for got, same in zip(found, expected[:4], strict=True):
        np.testing.assert_allclose(got, same, rtol=1e-9, atol=1e-12)


def planted(value, index):
    data = np.ones((2, 5))
    data[index] = value
    return data


REFUSALS = {
    r"got NaN alone at sensor \[1\]. Leave it out": (ExpFeature, planted(np.nan, 1)),
    r"finite, got inf at index \(0, 2\) of \(sensor, time\). Pass NaN where": (
        GammaFeature,
        planted(np.inf, (0, 2)),
    ),
    r"finite, got nan at index \(0, 2\) of .*. Cut the record .* left out by TruncNormalFeature": (
        CorrelatedNormal,
        planted(np.nan, (0, 2)),
    ),
    "`observed` must be finite, got nan": (CorrelatedNormal, pytensor.shared(planted(np.nan, 0))),
    "must have no missing values, got a masked array. Cut the record to its complete part": (
        CorrelatedNormal,
        np.ma.masked_equal(planted(0.0, (0, 2)), 0.0),
    ),
    r"every sensor, got NaN alone at sensor \[0\]": (ExpFeature, pytensor.shared(planted(np.nan, 0))),
}


@pytest.mark.parametrize("match", REFUSALS)
def test_what_is_refused(match):
    likelihood, data = REFUSALS[match]
    with pm.Model(), pytest.raises(ValueError, match=match):
        likelihood("y", np.zeros((2, 5)), 1.0, observed=data, **MORE.get(likelihood, {}))


def test_refusals_of_simulators():
    x = pm.Normal.dist(size=2)
    for data, match in (
        (planted(np.nan, 1), "data of every sensor, .* got NaN alone at index 1. Leave it out"),
        (np.array([1.0, np.nan]), "every entry of a summary, got NaN alone at index 1"),
        (planted(np.inf, (0, 0)), "must be finite numbers of shape"),
    ):
        with pm.Model(), pytest.raises(ValueError, match=match):
            DiscrepancySimulator("y", lambda v: v, x, epsilon=1.0, observed=data)
