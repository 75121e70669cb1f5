"""Likelihoods of histories inside a model; their warnings; sigma and tolerance."""

import functools
import sys
import warnings

import arviz as az
import numpy as np
import pymc as pm
import pytensor
import pytest
import xarray as xr
from scipy import optimize, special

import pymc_features as pmf
from pymc_features.exceptions import FeatureLikelihoodWarning
from pymc_features.likelihoods import HISTORY_LIKELIHOODS
from support.graphs import LIGHT
from support.likelihoods import EVERY, EVERY_FEATURE, declare, equation, evaluate, random_data
from support.structures import noise_record, with_first_spring, with_noise


@pytest.fixture(scope="module")
def pulse():
    return noise_record(41)


@pytest.fixture(scope="module")
def measured(pulse):
    return with_noise(pmf.simulate(with_first_spring(1.0), pulse, dt=0.04), 0.3)


def build_model(likelihood, pulse, observed, *, sigma=None, theta=None, deterministic=False, **kwargs):
    """Three storeys, unknown first spring and sigma; the model does not know its "time"."""
    with pm.Model(coords={"sensor": ["low", "middle", "top"]}) as model:
        theta = pm.Uniform("theta", 0.5, 1.5) if theta is None else theta()
        sigma = pm.HalfNormal("sigma", 1.0) if sigma is None else sigma()
        mu = pmf.response(with_first_spring(theta), pulse, dt=0.04)
        mu = pm.Deterministic("mu", mu) if deterministic else mu
        declare(likelihood, "y", mu=mu, sigma=sigma, observed=observed, **kwargs)
    return model


@pytest.fixture(scope="module", params=HISTORY_LIKELIHOODS)
def updated(request, pulse, measured):
    """(likelihood, model with dims, four particles of a posterior)."""
    model = build_model(request.param, pulse, measured, dims=("sensor", "time"))
    particles = {"theta": np.array([[0.8, 1.0], [1.2, 0.9]]), "sigma": np.array([[0.3, 0.5], [1.0, 0.2]])}
    return request.param, model, az.from_dict({"posterior": particles})


@pytest.mark.parametrize("deterministic", [False, True])
def test_time_dimension_of_predictions_without_data(pulse, deterministic):
    model = build_model(
        pmf.ExpFeature, pulse, None, dims=("sensor", "seconds"), shape=(3, 21), deterministic=deterministic
    )
    np.testing.assert_allclose(model.coords["seconds"], np.arange(21) * 0.04, rtol=1e-14)


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
            mu = pmf.simulate(with_first_spring(theta), pulse, dt=0.04).values
            expected = equation(likelihood, measured, mu, sigma)
            np.testing.assert_allclose(values.values[c, d], expected, rtol=1e-10)


@pytest.mark.default_mode
@pytest.mark.parametrize("likelihood", [pmf.ExpFeature, pmf.CorrelatedNormal])
def test_model_log_probability(likelihood, pulse, measured):
    """`compile_logp` by Numba: the equation."""
    model = build_model(likelihood, pulse, measured)
    logp = model.compile_logp(vars=model.observed_RVs, jacobian=False)
    theta = 0.5 + special.expit(0.3)
    got = logp({"theta_interval__": 0.3, "sigma_log__": np.log(0.4)})
    mu = pmf.simulate(with_first_spring(theta), pulse, dt=0.04).values
    assert float(got) == pytest.approx(equation(likelihood, measured, mu, 0.4).sum(), rel=1e-10)


@EVERY
def test_bad_values_inside_the_graph(likelihood, pulse, measured):
    """A prior that allows a negative sigma or spring: -inf there, a number elsewhere."""
    priors = {name: (lambda name=name: pm.Normal(name)) for name in ("theta", "sigma")}
    model = build_model(likelihood, pulse, measured, **priors)
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
    assert model.named_vars_to_dims["y"] == ("sensor", "time")
    assert predictive.shape == (2, 2, 3, 21)
    np.testing.assert_allclose(predictive["time"], np.arange(21) * 0.04, rtol=1e-14)
    assert predictive["sensor"].values.tolist() == ["low", "middle", "top"]
    for c in range(2):
        for d in range(2):
            theta, sigma = (float(posterior["posterior"][k][c, d]) for k in ("theta", "sigma"))
            mu = pmf.simulate(with_first_spring(theta), pulse, dt=0.04).values
            z = np.sqrt(pmf.mean_square_discrepancy(mu, predictive.values[c, d])) / sigma
            assert (z < 5.0).all()
            assert len(np.unique(z)) == 3


POINT = {"theta_interval__": 0.1, "sigma_log__": -1.0}


@pytest.mark.parametrize("likelihood", [pmf.TruncNormalFeature, pmf.CorrelatedNormal])
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
        y = pmf.ExpFeature("y", np.zeros((2, 1)) * data, sigma=1.0, observed=data)
    observed = model.rvs_to_values[y]
    assert isinstance(observed, pytensor.compile.SharedVariable)
    np.testing.assert_array_equal(observed.get_value(), data)


WARNED = "posterior without a finite variance but the prior's under"
SILENT = None


@pytest.mark.parametrize(
    ("likelihood", "n_sensors", "per_sensor", "match"),
    [
        (pmf.TruncNormalFeature, 1, False, "^1 sensor with one sigma carry no information on the parameters"),
        (pmf.TruncNormalFeature, 2, False, f"^2 sensors with one sigma have a {WARNED} TruncNormalFeature"),
        (pmf.TruncNormalFeature, 4, False, WARNED),
        (pmf.TruncNormalFeature, 5, False, SILENT),
        (pmf.TruncNormalFeature, 9, True, "^9 sensors with a sigma for each sensor carry no information"),
        (pmf.ExpFeature, 1, False, f"^1 sensor with one sigma have a {WARNED} ExpFeature. Add sensors"),
        (pmf.ExpFeature, 3, False, SILENT),
        (pmf.ExpFeature, 3, True, "^3 sensors with a sigma for each sensor have a posterior without"),
        (pmf.ExpFeature, 4, True, SILENT),
        (functools.partial(pmf.GammaFeature, m=2.5), 1, False, WARNED),
        (functools.partial(pmf.GammaFeature, m=5.0), 1, False, SILENT),
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
    [(pmf.TruncNormalFeature, 4, 1.5), (pmf.ExpFeature, 3, 2.5)],
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
    assert finite_variance == (n_sensors > {pmf.TruncNormalFeature: 4, pmf.ExpFeature: 2}[likelihood])


@EVERY_FEATURE
def test_noise_free_data_are_warned_of(likelihood, pulse, monkeypatch):
    """At the model's initial point the response equals the data; with noise or a fixed sigma: silence.

    And for data that this process has not made, for which nothing is compiled.
    """
    chain = pmf.SpringMassChain(np.ones(6), 100.0, pmf.RayleighDamping(0.1, 1e-3))
    exact = pmf.simulate(chain, pulse).values

    def declared(data, sigma):
        with pm.Model(), warnings.catch_warnings():
            warnings.simplefilter("error", FeatureLikelihoodWarning)
            theta = pm.Uniform("theta", 0.5, 1.5)
            mu = pmf.response(chain.scale_stiffness(theta, [0]), pulse)
            declare(likelihood, "y", mu=mu, sigma=sigma or pm.HalfNormal("sigma"), observed=data)

    with pytest.raises(FeatureLikelihoodWarning, match="the data have no noise. The discrepancy can van"):
        declared(exact, None)
    declared(exact, 0.5)
    noisy = exact + 0.01 * np.random.default_rng(0).normal(size=exact.shape)
    declared(noisy, None)
    monkeypatch.setattr(sys.modules["pymc_features.ops.response"], "SIMULATED", set())
    declared(exact, None)


def test_sigma_mpv_is_the_mode_of_the_exp_likelihood():
    """Eq. (11) against a numerical maximum of Eq. (9)."""
    mu, data, _ = random_data(5, n_sensors=6)
    e = pmf.mean_square_discrepancy(mu, data)
    best = pmf.likelihoods.sigma_mpv(e)

    def loss(log_sigma):
        return -evaluate(pmf.ExpFeature, "feature", "logp", mu, np.exp(log_sigma), data).sum()

    around = np.log(best)
    found = optimize.minimize_scalar(loss, bounds=(around - 3, around + 3), options={"xatol": 1e-10})
    assert np.exp(found.x) == pytest.approx(best, rel=1e-6)
    assert best == pytest.approx(np.sqrt(e.sum() / (2 * 6)), rel=1e-14)
    assert isinstance(best, float)
    batch = pmf.likelihoods.sigma_mpv(np.stack([e, 4 * e]))
    np.testing.assert_allclose(batch, [best, 2 * best], rtol=1e-14)
    assert pmf.likelihoods.sigma_mpv([0.0, 0.0]) == 0.0


@pytest.mark.parametrize("e", [[-1.0, 2.0], [np.nan], [np.inf], [], 3.0])
def test_sigma_mpv_refuses(e):
    with pytest.raises(ValueError, match="`e` must be mean squares, finite and not negative, one for each"):
        pmf.likelihoods.sigma_mpv(e)


def test_abc_tolerance():
    """Eq. (16); at the most probable sigma the tolerance is the smallest discrepancy itself."""
    assert pmf.likelihoods.abc_tolerance(0.3, 7) == pytest.approx(2 * 7 * 0.09, rel=1e-15)
    e = np.array([0.2, 0.5, 0.1])
    assert pmf.likelihoods.abc_tolerance(pmf.likelihoods.sigma_mpv(e), 3) == pytest.approx(e.sum(), rel=1e-14)
    assert isinstance(pmf.likelihoods.abc_tolerance(np.float32(1.0), np.int64(2)), float)
    np.testing.assert_allclose(pmf.likelihoods.abc_tolerance([1.0, 2.0], 2), [4.0, 16.0])


def test_abc_tolerance_of_a_posterior():
    """The 90 % quantile over chains and draws, whichever way the draws come."""
    rng = np.random.default_rng(0)
    draws = xr.DataArray(rng.gamma(3.0, size=(2, 500)), dims=("chain", "draw"))
    expected = 2 * 7 * np.quantile(draws.values, 0.9) ** 2
    posterior = xr.Dataset({"sigma": draws, "theta": draws})
    for given in (draws, posterior, xr.DataTree.from_dict({"/posterior": posterior})):
        assert pmf.likelihoods.abc_tolerance(given, 7) == pytest.approx(expected, rel=1e-14)
    each = xr.DataArray(rng.gamma(3.0, size=(2, 500, 3)), dims=("chain", "draw", "sensor"))
    expected = 2 * 3 * np.quantile(each.values, 0.9, axis=(0, 1)) ** 2
    np.testing.assert_allclose(pmf.likelihoods.abc_tolerance(each, 3), expected, rtol=1e-14)


@pytest.mark.parametrize(
    ("sigma", "n_sensors", "error", "match"),
    [
        (0.0, 2, ValueError, "`sigma` must be positive and finite, got 0.0. Pass the 90 % quantile"),
        (np.nan, 2, ValueError, "`sigma` must be positive and finite, got nan"),
        (np.inf, 2, ValueError, "`sigma` must be positive and finite, got inf"),
        ([1.0, 2.0], 3, ValueError, r"one number or one for each of the 3 sensors, got shape \(2,\). Pass"),
        ("big", 2, TypeError, "`sigma` must be one number, got str. Pass a quantile"),
        (1.0, 0, ValueError, "`n_sensors` must be an integer of at least 1, got 0"),
        (1.0, True, ValueError, "`n_sensors` must be an integer of at least 1, got True"),
    ],
)
def test_abc_tolerance_refuses(sigma, n_sensors, error, match):
    with pytest.raises(error, match=match):
        pmf.likelihoods.abc_tolerance(sigma, n_sensors)


def test_names_in_print(updated):
    likelihood, model, _ = updated
    assert f"y ~ {likelihood.__name__}(f(theta), sigma" in model.str_repr()
    assert f"\\operatorname{{{likelihood.__name__}}}" in model.str_repr(formatting="latex")

    graphviz = pytest.importorskip("graphviz")
    graph = pm.model_to_graphviz(updated[1])
    assert isinstance(graph, graphviz.Digraph)
    assert updated[0].__name__ in graph.source
    assert all(f"{parent} -> y" in graph.source for parent in ("theta", "sigma"))
    assert "sensor (3) x time (21)" in graph.source.replace("×", "x")
