"""Runs of `pm.sample_smc` with our kernels: what they report, refuse and save; and models with simulators."""

import os
import warnings

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest
import xarray as xr
from pymc.smc.kernels import IMH
from scipy import stats
from threadpoolctl import threadpool_info, threadpool_limits

import pymc_features as pmf
from pymc_features.exceptions import PopulationWarning
from pymc_features.smc import KERNELS
from support.sampling import SERIAL


def regression():
    """Named axes, a positive parameter and a deterministic one."""
    with pm.Model(coords={"place": ["a", "b", "c"]}) as model:
        x = pm.Normal("x", dims="place")
        s = pm.HalfNormal("s")
        pm.Deterministic("total", x.sum())
        pm.Normal("y", x, 0.01 + s, observed=[0.0, 1.0, 2.0], dims="place")
    return model


@pytest.fixture(scope="module")
def model():
    return regression()


# seeds: chains differ in stages
UNEQUAL = {IMH: 2, pmf.sampling.PopulationMH: 2, pmf.PersistentSMC: 0}


@pytest.mark.slow
@pytest.mark.parametrize("kernel", UNEQUAL, ids=lambda kernel: kernel.__module__ + "." + kernel.__name__)
def test_unequal_stages_are_padded_and_saved(kernel, model, tmp_path):
    """Of kernels of PyMC's and of ours; saved and loaded, everything is as it was."""
    idata = pmf.sample_smc(60, kernel, model=model, chains=3, random_seed=UNEQUAL[kernel], **SERIAL)
    found = idata.sample_stats
    assert dict(found.sizes) == {"chain": 3, "stage": found.sizes["stage"]}
    missing = np.isnan(found["beta"].values)
    assert len(set(missing.sum(axis=1))) > 1, "unequal numbers of stages are the subject"
    for row, gone in zip(found["beta"].values, missing, strict=True):
        assert (np.diff(gone.astype(int)) >= 0).all(), "padded at the end"
        assert row[~gone][-1] == 1.0
        assert (np.diff(row[~gone]) > 0).all()
    for name, values in found.data_vars.items():
        assert values.dtype == float, name
        if values.dims != ("chain",):
            np.testing.assert_array_equal(np.isnan(values.values), missing, err_msg=name)
    assert found["log_marginal_likelihood"].dims == ("chain",)
    assert np.isfinite(found["log_marginal_likelihood"]).all()
    assert len(np.unique(found["log_marginal_likelihood"])) == 3
    if kernel is pmf.PersistentSMC:
        for name in ("log_marginal_likelihood_se", "ess", "pareto_k", "largest_share"):
            assert found[name].dims == ("chain",)
        assert (found["log_marginal_likelihood_se"] > 0).all()
        assert (found["ess"] >= 60).all()
    idata.to_netcdf(tmp_path / "result.nc", engine="h5netcdf")
    with xr.open_datatree(tmp_path / "result.nc", engine="h5netcdf") as loaded:
        xr.testing.assert_equal(loaded.load(), idata)


def test_inside_a_model_and_as_many_chains_as_cores():
    with regression():
        idata = pmf.sample_smc(40, chains=None, random_seed=1, **SERIAL)
    assert idata.posterior.sizes == {"chain": 2, "draw": 40, "place": 3}


def test_multitrace_is_refused(model):
    with pytest.raises(ValueError, match="`return_inferencedata` must be True, got False. Use pm.sample_smc"):
        pmf.sample_smc(60, model=model, return_inferencedata=False)


class Counting:
    """An evaluation that counts for itself."""

    def __init__(self, logp):
        self.logp = logp
        self.evaluations = self.failed = 0

    def with_rng(self, rng):
        return self

    def __call__(self, particles):
        result = self.logp(particles)
        self.evaluations += len(particles)
        self.failed += result[2].sum()
        return result


@pytest.mark.parametrize("kernel", KERNELS)
def test_stages_report_what_they_did(kernel):
    """Evaluations and failures add up to those made, also in a second chain of the same kernel."""
    with pm.Model() as model:
        x = pm.Normal("x", shape=2)
        pm.Normal("y", x[1], 0.1, observed=1.0)
        pm.Potential("root", pt.sqrt(x[0]))
    one = kernel(60, model=model)
    for seed in (1, 2):
        one.logp = counted = Counting(getattr(one.logp, "logp", one.logp))
        one.initialize(None, np.random.default_rng(seed))
        stages = []
        while one.beta < 1:
            one.update_beta_and_weights()
            stages.append(one.step())
        rate = "mean_accept_rate" if kernel is pmf.sampling.PopulationMH else "accept_rate"
        for stage in stages:
            assert set(stage) == set(kernel.stats_dtypes_shapes)
            assert all(stage[name] > 0 for name in ("n_steps", "seconds", "evaluations", rate))
            assert stage[rate] <= 1
        assert sum(stage["evaluations"] for stage in stages) == counted.evaluations
        assert sum(stage["failed"] for stage in stages) == counted.failed > 10
        assert np.isnan([stage["log_marginal_likelihood"] for stage in stages[:-1]]).all()
        assert np.isfinite(stages[-1]["log_marginal_likelihood"])
        n_steps = np.array([stage["n_steps"] for stage in stages])
        evaluations = np.array([stage["evaluations"] for stage in stages])
        if kernel in (pmf.sampling.PopulationIMH, pmf.sampling.PopulationMH):
            np.testing.assert_array_equal(evaluations, 60 * (n_steps + (np.arange(len(stages)) == 0)))
        elif kernel is pmf.TMCMC:
            np.testing.assert_array_equal(evaluations, 60 * (1 + (np.arange(len(stages)) == 0)))
        assert len(one.tempered_posterior) == 60


@pytest.mark.parametrize(
    ("kernel", "settings", "match"),
    [
        (pmf.TMCMC, {"draws": 1}, "`draws` must be an integer of at least 2, got 1"),
        (pmf.sampling.PopulationMH, {"draws": 2.5}, "`draws` must be an integer of at least 2, got 2.5"),
        (pmf.PersistentSMC, {"draws": True}, "`draws` must be an integer of at least 2, got True"),
        (pmf.sampling.PopulationMH, {"threshold": 0.0}, "`threshold` must lie between 0 and 1, got 0.0"),
        (pmf.sampling.PopulationIMH, {"threshold": 1.0}, "`threshold` must lie between 0 and 1, got 1.0"),
        (pmf.PersistentSMC, {"threshold": np.nan}, "`threshold` must lie between 0 and 1, got nan"),
        (pmf.PersistentSMC, {"stage_draws": 19}, "`stage_draws` must be an integer of at least 20, got 19"),
        (pmf.TMCMC, {"scale": 0.0}, "`scale` must be positive, got 0.0. Leave it out for the source's"),
        (pmf.TMCMC, {"coefficient_of_variation": -1}, "`coefficient_of_variation` must be positive, got -1"),
    ],
)
def test_bad_settings_are_refused(model, kernel, settings, match):
    with pytest.raises(ValueError, match=match):
        kernel(**{"draws": 60, "model": model, **settings})


@pytest.mark.parametrize("kernel", KERNELS)
def test_an_impossible_model_is_refused(kernel):
    """No draw from the prior is possible: said at once, with what to look at."""
    with pm.Model() as model:
        pm.Potential("never", pm.Normal("x") + (np.nan if kernel is pmf.PersistentSMC else -np.inf))
    match = r"finite log-density somewhere, got none at \d+ draws from the prior \(\d+ failed .*point_logps"
    with pytest.raises(ValueError, match=match):
        pmf.sample_smc(40, kernel, model=model, chains=1, random_seed=1, **SERIAL)


@pytest.mark.parametrize("kernel", KERNELS)
def test_start_replaces_the_prior_draws(kernel, model):
    """Given points are where the chains begin."""
    one = kernel(40, model=model)
    rng = np.random.default_rng(0)
    start = {"x": rng.normal(size=(40, 3)), "s_log__": rng.normal(size=40)}
    one.initialize(start, rng)
    assert one.evaluations == 40
    idata = pmf.sample_smc(40, kernel, model=model, start=start, chains=2, random_seed=1, **SERIAL)
    assert idata.posterior.sizes["draw"] == 40


VALUES = np.random.default_rng(3).normal(0.7, 1.0, 20)
WIDTH = 0.3


def draws_of(rng, mean, size):
    """A simulator that takes any batch; PyMC passes parameters (particle, 1)."""
    return rng.normal(mean, 1.0, size=size)


def shelf(theta):
    """A response (..., sensor, time) for theta (...)."""
    return np.multiply.outer(np.asarray(theta), np.ones((2, 5))) * np.arange(5.0)


def simulator(function):
    with pm.Model() as model:
        mean = pm.Normal("mean")
        pm.Simulator("y", function, mean, epsilon=WIDTH, sum_stat="mean", observed=VALUES)
    return model


def discrepancy(function):
    with pm.Model() as model:
        theta = pm.Uniform("theta", 0.0, 2.0)
        pmf.DiscrepancySimulator("y", function, theta, epsilon=0.1, observed=shelf(0.9), kernel="exponential")
    return model


def marked(function):
    """The function, wrapped, with the mark of one that takes batches."""

    def batched(*args):
        return function(*args)

    batched.batched = True
    return batched


CASES = [(simulator, draws_of), (discrepancy, shelf)]


def test_a_plain_simulator_is_called_for_each_particle():
    """With one warning, which says what to do about it."""
    model = simulator(draws_of)
    with pytest.warns(
        PopulationWarning, match="takes one set of parameters at a time.*batched = True"
    ) as caught:
        kernel = pmf.sampling.PopulationIMH(50, model=model)
        pmf.PersistentSMC(50, model=model)
        pmf.sample_smc(50, pmf.sampling.PopulationMH, model=model, chains=1, **SERIAL)
    assert sum(issubclass(w.category, PopulationWarning) for w in caught) == 1
    assert not kernel.logp.batched


@pytest.mark.parametrize(("build", "function"), CASES)
def test_a_marked_simulator_is_called_for_all(build, function):
    """What the warning says does what it says, without a warning: the same draws from one call for all."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PopulationWarning)
        expected = pmf.sample_smc(50, model=build(function), chains=2, random_seed=1, **SERIAL)
    with warnings.catch_warnings():
        warnings.simplefilter("error", PopulationWarning)
        model = build(marked(function))
        found = pmf.sample_smc(50, model=model, chains=2, random_seed=1, **SERIAL)
    assert pmf.sampling.PopulationIMH(50, model=model).logp.batched
    xr.testing.assert_allclose(found["posterior"].dataset, expected["posterior"].dataset, rtol=1e-9)


@pytest.mark.statistical
@pytest.mark.parametrize("kernel", KERNELS)
def test_noisy_simulator_has_its_exact_posterior(kernel):
    """The mean of 20 draws within 0.3 of the data's, softly: Gaussian, with a closed-form evidence.

    Limits are five standard deviations over seeds of the mean, the spread and the log evidence of 2 x 500
    draws, the largest of all kernels (0.021, 0.011 and 0.050): a false alarm in 1e6 seeds for each.
    """
    variance = WIDTH**2 + 1 / 20
    idata = pmf.sample_smc(500, kernel, model=simulator(marked(draws_of)), chains=2, random_seed=1, **SERIAL)
    values = idata.posterior["mean"].values
    assert values.mean() == pytest.approx(VALUES.mean() / (1 + variance), abs=0.105)
    assert values.std() == pytest.approx(np.sqrt(variance / (1 + variance)), abs=0.055)
    evidence = stats.norm.logpdf(VALUES.mean(), 0.0, np.sqrt(1 + variance)) + np.log(
        np.sqrt(2 * np.pi) * WIDTH
    )
    assert float(idata.sample_stats["log_marginal_likelihood"].mean()) == pytest.approx(evidence, abs=0.25)


def threads_of_blas():
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_linear_algebra_takes_one_thread(monkeypatch):
    """While chains are sampled; afterwards what it had before."""
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    seen = []

    def draws(rng, mean, size):
        seen.append((threads_of_blas(), os.environ["OMP_NUM_THREADS"], os.environ["MKL_NUM_THREADS"]))
        return draws_of(rng, mean, size)

    with threadpool_limits(2, "blas"):
        before = threads_of_blas()
        pmf.sample_smc(
            20, pmf.sampling.PopulationIMH, model=simulator(marked(draws)), chains=1, random_seed=1, **SERIAL
        )
        assert threads_of_blas() == before
    assert before == {2} and {(frozenset(n), *rest) for n, *rest in seen} == {(frozenset({1}), "1", "1")}
    assert os.environ["OMP_NUM_THREADS"] == "2" and "MKL_NUM_THREADS" not in os.environ
