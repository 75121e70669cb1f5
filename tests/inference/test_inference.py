"""Fisher information, Laplace's approximation, NUTS from particles: against closed forms and quadrature."""

import functools

import arviz as az
import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
import xarray as xr
from scipy import stats

import pymc_features as pmf
from pymc_features import likelihoods as catalogue
from pymc_features.inference import parameters
from pymc_features.study import paper
from pymc_features.study.exact import DiscrepancyCurve, exact_posterior
from pymc_features.study.settings import declare
from support import straight
from support.sampling import log_add

LIKELIHOODS = ["NORM", "TN", "EXP"]
QUIET = {"progressbar": False, "random_seed": 1}
ONE = {"cores": 1}  # a process for each chain takes longer to start than its chain


class Example:
    """The ten-storey example under each likelihood, its exact posteriors, and draws of NUTS."""

    def __init__(self, record):
        self.data = paper.decimate(paper.measurements(record, random_seed=0), record.dt)
        self.models = {kind: declare(kind, record, self.data) for kind in LIKELIHOODS}

        def total(theta):
            e = pmf.mean_square_discrepancy(pmf.simulate(paper.chain(theta), record).values, self.data.values)
            return float(e.sum())

        curve = DiscrepancyCurve(total, paper.THETA_RANGE, self.data.size)
        self.exact = {
            kind: exact_posterior(curve, entry.exponents(*self.data.shape), paper.SIGMA_RANGE)
            for kind, entry in catalogue.LIKELIHOODS.items()
            if kind in LIKELIHOODS
        }

    @functools.cached_property
    def nuts(self):
        """Under TN, whose tails are the longest."""
        smc = {"draws": 500, "chains": 1, "cores": 1, "check": None}
        with pytensor.config.change_flags(mode="Mode"):
            return pmf.sample_nuts(
                250, tune=200, chains=2, model=self.models["TN"], sample_settings=smc, **ONE, **QUIET
            )


@pytest.fixture(scope="module")
def record(record):
    """The first 4 s: an eighth of the work of each step of NUTS."""
    return straight.Record(record.acceleration[:201], record.dt)


@pytest.fixture(scope="module")
def example(record):
    return Example(record)


def quantile_scores(idata, name, quantile, off=0.0):
    """How many standard errors the draws below exact quantiles are too many, at 5, 50 and 95 %."""
    draws = idata["posterior"][name].values
    scores = []
    for p in (0.05, 0.5, 0.95):
        below = (draws < quantile(p) + off).astype(float)
        ess = float(az.ess(below, method="mean"))
        scores.append((below.mean() - p) / np.sqrt(p * (1.0 - p) / ess))
    return np.array(scores)


@pytest.mark.statistical
def test_nuts_is_the_exact_posterior(example, tmp_path):
    """Six quantiles within 4.5 standard errors: a false alarm in 24,000 runs."""
    exact, idata = example.exact["TN"], example.nuts
    for name in ("theta", "sigma"):
        marginal = exact.marginals[name]
        assert np.abs(quantile_scores(idata, name, marginal.quantile)).max() < 4.5
        off = 0.1 * (marginal.quantile(0.95) - marginal.quantile(0.05))  # negative control
        assert np.abs(quantile_scores(idata, name, marginal.quantile, off)).max() > 4.5
    r_hat = idata["posterior"].attrs["max_r_hat"]
    assert r_hat < 1.03 and idata["posterior"].attrs["chains_agree"] == (r_hat <= 1.01)
    assert int(idata["sample_stats"]["diverging"].sum()) < 20
    idata.to_netcdf(tmp_path / "nuts.nc")
    back = xr.open_datatree(tmp_path / "nuts.nc")
    xr.testing.assert_equal(back["posterior"]["theta"], idata["posterior"]["theta"])
    assert back["posterior"].attrs == idata["posterior"].attrs


def two_modes():
    with pm.Model() as model:
        x = pm.Normal("x", 0.0, 10.0)
        pm.Potential("peaks", log_add(-0.5 * (x - 6.0) ** 2, -0.5 * (x + 6.0) ** 2))
    return model


@pytest.mark.slow
def test_disagreeing_chains_are_said_and_the_particles_kept():
    match = r"R-hat: x .*use the draws that they started from, in the group"
    smc = {"draws": 500, "chains": 1, "cores": 1, "check": None}
    with pytest.warns(pmf.exceptions.ChainsDisagreeWarning, match=match):
        idata = pmf.sample_nuts(
            100, tune=100, chains=6, model=two_modes(), sample_settings=smc, **ONE, **QUIET
        )
    assert idata["posterior"].attrs["chains_agree"] == 0
    assert idata["posterior"].attrs["max_r_hat"] > 1.5
    share = float((idata["particles"]["x"] > 0).mean())
    assert 0.3 < share < 0.7
    ends = np.sign(idata["posterior"]["x"].values.mean(axis=1))
    assert set(ends) == {-1.0, 1.0}, "each chain is in the mode of its particle"


@pytest.mark.slow
def test_chains_of_nutpie_start_from_particles():
    """A chain that starts from the prior's mean would end in the near mode: the far one is never found."""
    with pm.Model() as model:
        x = pm.Normal("x", 0.0, 30.0)
        pm.Potential("peaks", log_add(-0.5 * (x - 2.0) ** 2, -0.5 * (x - 60.0) ** 2))
    places = np.array([[2.0, 60.0] * 50])
    particles = xr.DataTree.from_dict({"posterior": xr.Dataset({"x": (("chain", "draw"), places)})})
    settings = {"tune": 200, "chains": 6, "particles": particles, "nuts_sampler": "nutpie", **QUIET}
    with pytest.warns(pmf.exceptions.ChainsDisagreeWarning):
        ends = pmf.sample_nuts(100, model=model, **settings)["posterior"]["x"].mean("draw").values
    assert (np.abs(ends - 2.0) < 1.0).any()
    assert (np.abs(ends - 60.0) < 1.0).any()


def test_what_cannot_work_is_refused_before_any_sampling(example, record):
    model = example.models["TN"]
    with pytest.raises(TypeError, match=r"`particles` must be a DataTree .*, got \{'theta': 1.0\}"):
        pmf.sample_nuts(model=model, particles={"theta": 1.0})
    other = xr.DataTree.from_dict({"posterior": xr.Dataset({"theta": (("chain", "draw"), [[1.0]])})})
    with pytest.raises(ValueError, match="every free parameter of `model`, got none of sigma"):
        pmf.sample_nuts(model=model, particles=other)
    match = r"start each chain at its own particle, .*got 'stan'. Call pm.sample"
    with pytest.raises(ValueError, match=match):
        pmf.sample_nuts(model=model, nuts_sampler="stan")
    match = r"sample_nuts\(\) must be .* got 'target_acept'. Did you mean 'target_acc"
    with pytest.raises(TypeError, match=match):
        pmf.sample_nuts(model=model, target_acept=0.9)
    threshold = declare("ABC", record, example.data, tolerance=1.0)
    with pytest.raises(pmf.exceptions.NotDifferentiableError, match="hard threshold of DiscrepancySimulator"):
        pmf.sample_nuts(model=threshold)


@pytest.mark.parametrize("function", [pmf.sample_nuts, pmf.laplace, pmf.fisher_information])
def test_discrete_parameters_are_refused(function):
    with pm.Model() as model:
        n = pm.Poisson("n", 3.0)
        pm.Normal("y", n, 1.0, observed=1.0)
    with pytest.raises(ValueError, match=r"continuous free parameters .*discrete ones: n. Use sample_smc"):
        function(model=model)


def test_unconstrained_draws_are_pymcs():
    """Transforms of scalars, vectors and simplexes, and those that depend on another variable."""
    with pm.Model() as model:
        a = pm.Uniform("a", 0.0, 1.0)
        pm.Uniform("b", 0.0, a, shape=2)
        pm.Dirichlet("w", np.ones(3))
        pm.Normal("free")
        prior = pm.sample_prior_predictive(5, random_seed=1).prior.to_dataset()
    flat = parameters.to_unconstrained(model, prior)
    assert flat.shape == (1, 5, 6)
    back = parameters.Unconstrained(model).variables(flat[0])
    for name in prior.data_vars:
        np.testing.assert_allclose(back[name], prior[name][0], rtol=1e-12)


def regression():
    """Linear model with Gaussian prior and noise, and its exact evidence, mean and covariance."""
    rng = np.random.default_rng(5)
    design = rng.normal(size=(20, 3)) * [1.0, 1e3, 1e-3]
    y = design @ [0.5, 1e-3, 300.0] + 0.3 * rng.normal(size=20)
    prior = np.array([2.0, 1e-2, 1e3])
    with pm.Model() as model:
        b = pm.Normal("b", 0.0, prior, shape=3)
        pm.Normal("y", pt.dot(design, b), 0.3, observed=y)
    precision = design.T @ design / 0.09 + np.diag(prior**-2.0)
    covariance = np.linalg.inv(precision)
    marginal = 0.09 * np.eye(20) + (design * prior**2) @ design.T
    evidence = stats.multivariate_normal(np.zeros(20), marginal).logpdf(y)
    return model, evidence, covariance @ design.T @ y / 0.09, covariance, design.T @ design / 0.09


def test_laplace_is_exact_for_a_gaussian():
    model, evidence, mean, covariance, _ = regression()
    idata = pmf.laplace(4000, model=model, random_seed=1)
    found = idata["sample_stats"]
    np.testing.assert_allclose(found["log_marginal_likelihood"].values, [evidence], rtol=1e-9)
    np.testing.assert_allclose(found["log_marginal_likelihood_is"].values, [evidence], rtol=1e-8)
    assert found["efficiency"].values[0] == pytest.approx(1.0, abs=1e-6)
    assert found["largest_error"].values[0] < 0.002
    np.testing.assert_allclose(idata["modes"]["b"].values, [mean], rtol=1e-6)
    draws = idata["posterior"]["b"].values[0]
    scores = (draws - mean) @ np.linalg.inv(np.linalg.cholesky(covariance)).T
    assert stats.kstest(scores.ravel(), "norm").pvalue > 1e-4
    assert np.abs(np.corrcoef(scores.T) - np.eye(3)).max() < 4.5 / np.sqrt(4000)


def test_laplace_says_by_how_much_it_is_off():
    """A half-normal prior: a Gaussian of log s at s = 1, of variance one half, for s exp(-s^2 / 2)."""
    with pm.Model() as model:
        pm.HalfNormal("scale")
        pm.Normal("x")
    with pytest.warns(
        pmf.exceptions.LaplaceWarning, match=r"a quantile of scale is off by 6. % of the 5-95 % width"
    ):
        found = pmf.laplace(4000, model=model, random_seed=1)["sample_stats"]
    exact = stats.halfnorm.ppf([0.05, 0.5, 0.95])
    own = np.exp(stats.norm.ppf([0.05, 0.5, 0.95]) / np.sqrt(2.0))
    error = np.abs(own - exact).max() / (exact[-1] - exact[0])
    assert float(found["largest_error"][0]) == pytest.approx(error, abs=0.1)
    assert found.attrs["worst_parameter"] == "scale"


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "formula"), [("NORM", 0.002), ("TN", 0.2), ("EXP", 0.1)])
def test_laplace_evidence_against_quadrature(kind, formula, example):
    """The formula is asymptotic: right for NORM, near for the feature likelihoods, whose sigma has a tail.

    Importance sampling puts it right: within 4.5 standard errors of the exact evidence.
    """
    idata = pmf.laplace(4000, model=example.models[kind], random_seed=2)
    found = idata["sample_stats"].to_dataset().isel(chain=0)
    exact = example.exact[kind].log_evidence
    assert float(found["log_marginal_likelihood"]) == pytest.approx(exact, abs=formula)
    if kind != "NORM":
        assert abs(float(found["log_marginal_likelihood"]) - exact) > 0.02  # negative control
    error = 4.5 * float(found["log_marginal_likelihood_is_se"]) + 1e-6
    assert abs(float(found["log_marginal_likelihood_is"]) - exact) < error
    assert float(found["efficiency"]) > {"NORM": 0.99, "EXP": 0.3, "TN": 0.02}[kind]
    assert float(idata["modes"]["theta"][0]) == pytest.approx(example.exact[kind].map[0], abs=1e-4)


def test_laplace_finds_and_weighs_two_modes():
    with pm.Model() as model:
        x = pm.Normal("x", 0.0, 10.0)
        peaks = [np.log(w) - 0.5 * ((x - m) / s) ** 2 for w, m, s in [(0.3, -6.0, 0.5), (1.0, 5.0, 1.0)]]
        pm.Potential("peaks", log_add(*peaks))
    idata = pmf.laplace(2000, model=model, random_seed=1)
    grid = np.linspace(-40, 40, 400001)
    density = stats.norm(0, 10).pdf(grid) * (
        0.3 * np.exp(-2 * (grid + 6) ** 2) + np.exp(-0.5 * (grid - 5) ** 2)
    )
    below = np.trapezoid(density[grid < 0], grid[grid < 0]) / np.trapezoid(density, grid)
    assert idata["modes"].sizes["mode"] == 2
    assert float(idata["modes"]["weight"].min()) == pytest.approx(below, rel=0.01)
    assert float((idata["posterior"]["x"] < 0).mean()) == pytest.approx(below, abs=0.002)
    evidence = float(idata["sample_stats"]["log_marginal_likelihood"][0])
    assert evidence == pytest.approx(np.log(np.trapezoid(density, grid)), abs=0.01)


def test_laplace_keeps_dims_and_deterministics_and_starts_where_told():
    with pm.Model(coords={"storey": ["a", "b"], "mode": [1, 2, 3]}) as model:
        k = pm.Lognormal("k", dims="storey")
        pm.Lognormal("zeta", -4.0, 0.5, dims="mode")
        pm.Deterministic("total", k.sum())
        pm.Normal("y", pm.math.log(k), 0.1, observed=[0.0, 1.0])
    idata = pmf.laplace(50, model=model, start={"k": [2.0, 2.0]}, random_seed=1)
    assert idata["posterior"]["k"].dims == ("chain", "draw", "storey")
    np.testing.assert_allclose(idata["posterior"]["total"], idata["posterior"]["k"].sum("storey"), rtol=1e-12)
    assert idata["modes"]["k"].dims == ("posterior_mode", "storey")
    assert idata["modes"]["zeta"].dims == ("posterior_mode", "mode")
    assert idata["modes"]["weight"].dims == ("posterior_mode",)


def test_laplace_says_where_it_fails():
    with pm.Model() as flat:
        x, z = pm.Flat("x"), pm.Normal("z")
        pm.Normal("y", z + 0.0 * x, 1.0, observed=1.0)
    with pytest.raises(
        ValueError, match=r"maximum with positive curvature, found none from `start`.*fisher_information"
    ):
        pmf.laplace(model=flat, start={"x": 0.5})
    with pm.Model() as banana:
        a = pm.Normal("a", 0.0, 5.0)
        pm.Normal("b", a**2, 0.05)
    with pytest.warns(
        pmf.exceptions.LaplaceWarning,
        match=r"are worth .* % of as many from the posterior, and a quantile of [ab] is off by .* % of the",
    ):
        pmf.laplace(500, model=banana, random_seed=1)
    with pytest.raises(ValueError, match="`draws` must be an integer of at least 1, got 0"):
        pmf.laplace(0, model=banana)


def test_fisher_of_a_regression_is_exact():
    model, *_, information = regression()
    found = pmf.fisher_information(model)
    np.testing.assert_allclose(found["information"], information, rtol=1e-10)
    np.testing.assert_allclose(
        found["standard_deviation"], np.sqrt(np.diag(np.linalg.inv(information))), rtol=1e-6
    )
    assert list(found["parameter"].values) == ["b[0]", "b[1]", "b[2]"]


@pytest.mark.parametrize("kind", LIKELIHOODS)
def test_fisher_of_a_structure(kind, record, example):
    """Against differences of the simulated response, and the closed forms of the information on sigma."""
    found = pmf.fisher_information(example.models[kind], {"theta": 1.1, "sigma": 0.2})
    n_sensors, n_times = example.data.shape
    h = 1e-5
    slope = (
        pmf.simulate(paper.chain(1.1 + h), record).values - pmf.simulate(paper.chain(1.1 - h), record).values
    ) / (2.0 * h)
    samples = {"NORM": 1.0, "TN": 1.0 / n_times, "EXP": 1.0 / n_times}[kind]
    on_theta = samples * (slope**2).sum() / 0.2**2
    on_sigma = {"NORM": 2 * n_sensors * n_times, "TN": 2 * n_sensors, "EXP": 4 * n_sensors}[kind] / 0.2**2
    np.testing.assert_allclose(
        found["information"], np.diag([on_theta, on_sigma]), rtol=1e-6, atol=1e-6 * on_sigma
    )


def test_fisher_names_what_cannot_be_identified(record):
    """Mass and stiffness by a common factor leave the response unchanged."""
    with pm.Model() as model:
        m, k = pm.Lognormal("m"), pm.Lognormal("k")
        chain = pmf.SpringMassChain(np.ones(3) * m, 1000.0 * k * np.ones(3), pmf.ModalDamping(0.02))
        pmf.TruncNormalFeature(
            "y", mu=pmf.response(chain, record), sigma=0.1, observed=np.ones((3, record.n_times))
        )
    found = pmf.fisher_information(model)
    assert np.isinf(found["standard_deviation"].values).all()
    direction = found["direction_vector"].values[-1]
    assert abs(direction[0] - direction[1]) < 1e-6, "both by the same share"
    assert found["eigenvalue"].values[0] > 1.0
    assert found["eigenvalue"].values[1] < 1e-9 * found["eigenvalue"].values[0]


def test_fisher_of_correlated_errors_is_that_of_the_dense_covariance(record):
    """J' C^-1 J for the stiffness and tr(C^-1 C_i C^-1 C_j) / 2 for sigma and the correlation time."""
    short = straight.Record(record.acceleration[:61], record.dt)
    at = {"theta": 1.1, "sigma": 0.3, "tau": 0.07}
    with pm.Model() as model:
        theta, sigma, tau = pm.Uniform("theta", 0.5, 1.5), pm.HalfNormal("sigma"), pm.HalfNormal("tau")
        mu = pmf.response(paper.chain(theta), short, sensors=[0, 9])
        pmf.CorrelatedNormal("y", mu, sigma, tau, observed=np.ones((2, 61)))
    found = pmf.fisher_information(model, at)["information"].values

    lags = np.abs(np.subtract.outer(short.time, short.time))
    correlation = np.exp(-lags / at["tau"])
    by_sigma, by_tau = 2.0 * correlation / at["sigma"], correlation * lags / at["tau"] ** 2
    h = 1e-4
    high, low = (
        pmf.simulate(paper.chain(at["theta"] + s * h), short, sensors=[0, 9]).values for s in (1, -1)
    )
    slope = (high - low) / (2 * h)
    expected = np.zeros((3, 3))
    expected[0, 0] = np.sum(slope * np.linalg.solve(correlation, slope.T).T) / at["sigma"] ** 2
    parts = [np.linalg.solve(correlation, c) for c in (by_sigma, by_tau)]
    for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
        expected[1 + i, 1 + j] = 2 * 0.5 * np.trace(parts[i] @ parts[j])  # two sensors
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * expected.max())


def test_fisher_refuses_what_it_does_not_know(example):
    with pm.Model() as model:
        x = pm.Normal("x")
        pm.StudentT("y", nu=3.0, mu=x, sigma=1.0, observed=[1.0])
    with pytest.raises(
        TypeError, match=r"must have Normal, CorrelatedNormal, Trunc.* or ExpFeature .*got StudentT"
    ):
        pmf.fisher_information(model)
    with pytest.raises(ValueError, match=r"free parameters only \(theta, sigma\), got \['k'\]"):
        pmf.fisher_information(example.models["TN"], {"k": 1.0})
    with pm.Model() as model:
        x = pm.Normal("x")
        pmf.TruncNormalFeature(
            "y", mu=pt.zeros((6, 20)) + x, sigma=1.0, density="data", observed=np.ones((6, 20))
        )
    with pytest.raises(ValueError, match="density='feature', got 'data'"):
        pmf.fisher_information(model)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_laplace_of_a_mode_whose_weight_underflows():
    with pm.Model() as model:
        x = pm.Normal("x", 0.0, 10.0)
        peaks = [height - 12.5 * (x - m) ** 2 for height, m in [(0.0, -6.0), (1000.0, 5.0)]]
        pm.Potential("peaks", log_add(*peaks))
    idata = pmf.laplace(200, model=model, random_seed=1)
    assert idata["modes"]["weight"].values.max() == 1.0
    assert float(idata["posterior"]["x"].min()) > 0.0
