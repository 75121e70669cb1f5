"""`sample`: what it returns and advises, that a run goes on, exact evidence and weights of modes."""

import functools
import warnings
from importlib import import_module

import numpy as np
import pymc as pm
import pytest
import xarray as xr
from scipy import stats

import pymc_features as pmf
from pymc_features.exceptions import NoSpreadError
from pymc_features.smc.density.evaluation import PopulationLogp
from support.pages import README, blocks
from support.populations import discrete
from support.sampling import log_add

module = import_module("pymc_features.inference.sample")
QUIET = {"progressbar": False, "random_seed": 1, "cores": 1}
ATTRIBUTES = {
    *("max_r_hat", "log_evidence", "log_evidence_se", "ess", "pareto_k", "heavy_share", "n_modes"),
    "reference_efficiency",
    *("search_evaluations", "search_gradients", "no_gradient", "undetermined", "laplace_error"),
    *("close_to_laplace", "advice"),
}


def quietly(*arguments, **settings):
    """`sample` without a look for what it missed, in which no warning is due."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", pmf.exceptions.SamplingWarning)
        return pmf.sample(*arguments, **{**QUIET, "check": None, **settings})


def two_modes():
    """Gaussians at -6 and 6 in two dimensions, of weights 0.9 and 0.1 to 1e-6, and their log evidence."""
    with pm.Model() as model:
        x = pm.Normal("x", 0.0, 10.0, shape=2)
        near = -0.5 * ((x - np.array([6.0, 0.0])) ** 2).sum()
        far = -0.5 * ((x + np.array([6.0, 0.0])) ** 2).sum()
        pm.Potential("peaks", log_add(np.log(0.1) + near, np.log(0.9) + far))
    # each peak times the prior: 2 pi times the normal density of its place, of variance 101
    place = stats.multivariate_normal(np.zeros(2), 101.0 * np.eye(2)).logpdf([6.0, 0.0])
    return model, np.log(2.0 * np.pi) + place


@functools.cache
def of_two_modes():
    model, _ = two_modes()
    return quietly(1000, model=model, chains=2)


@pytest.mark.slow
def test_two_modes_have_their_weights_and_evidence():
    """Within 0.03 of 0.1, four standard errors of the draws, and within 4.5 of the exact evidence."""
    idata, (_, exact) = of_two_modes(), two_modes()
    found = idata["sample_stats"].attrs
    assert float((idata["posterior"]["x"][..., 0] > 0).mean()) == pytest.approx(0.1, abs=0.03)
    assert found["n_modes"] == 2
    assert 0.0 < found["log_evidence_se"] < 0.05
    assert abs(found["log_evidence"] - exact) < 4.5 * found["log_evidence_se"]


def test_what_it_returns_and_saves(tmp_path):
    idata = of_two_modes()
    found = idata["sample_stats"].attrs
    assert set(found) >= ATTRIBUTES
    assert dict(idata["posterior"].sizes) == {"chain": 2, "draw": 1000, "x_dim_0": 2}
    assert not any(found[name] for name in ("advice", "undetermined", "no_gradient"))
    assert found["ess"] > 0.9 * 2000
    assert found["max_r_hat"] < 1.02
    assert found["search_evaluations"] > 0
    assert found["search_gradients"] > 0
    modes = idata["modes"]
    highest = int(modes["log_evidence"].argmax())
    np.testing.assert_allclose(modes["x"][highest], [-6.0 * 100.0 / 101.0, 0.0], atol=1e-3)
    # Gaussians at the modes are the posterior
    assert found["laplace_error"] < module.CLOSE
    assert found["close_to_laplace"].startswith("yes: quantiles of Gaussians at the modes are off by at most")

    idata.to_netcdf(tmp_path / "draws.nc")
    idata.to_zarr(tmp_path / "draws.zarr")
    for back in (
        xr.open_datatree(tmp_path / "draws.nc"),
        xr.open_datatree(tmp_path / "draws.zarr", engine="zarr"),
    ):
        for name in ("posterior", "sample_stats", "modes"):
            xr.testing.assert_equal(back[name].to_dataset(), idata[name].to_dataset())
        for name in ATTRIBUTES:
            assert back["sample_stats"].attrs[name] == idata["sample_stats"].attrs[name], name


def test_same_seed_same_draws():
    model, _ = two_modes()
    first, second, third = (
        quietly(100, model=model, chains=2, random_seed=seed)["posterior"]["x"].values for seed in (3, 3, 4)
    )
    np.testing.assert_array_equal(first, second)
    assert (first != third).any()


def sum_observed():
    """Only x1 + x2 is observed: their difference stays as wide as the prior."""
    with pm.Model() as model:
        x1, x2, x3 = (pm.Normal(name) for name in ("x1", "x2", "x3"))
        pm.Normal("y", x1 + x2, 0.1, observed=1.0)
        pm.Normal("z", x3, 0.1, observed=1.0)
    return model


def test_a_direction_that_the_data_do_not_determine_is_named():
    found = quietly(500, model=sum_observed(), chains=2)["sample_stats"].attrs
    assert found["undetermined"] == "x1 with x2"


@pytest.mark.slow
def test_more_modes_than_climbs_find_are_said():
    """Of 300 narrow peaks a few climbs find each another one."""
    places = np.random.default_rng(1).uniform(-50.0, 50.0, size=(300, 4))
    with pm.Model() as model:
        x = pm.Uniform("x", -50.0, 50.0, shape=4)
        squares = ((x - places) ** 2).sum(axis=1)
        pm.Potential("peaks", pm.math.logsumexp(-0.5 * squares / 0.1**2))
    with pytest.warns(
        pmf.exceptions.SamplingWarning, match=r"climbs found \d+ modes.*one that no other found"
    ):
        pmf.sample(200, model=model, chains=1, **QUIET)


def test_runs_that_disagree_and_heavy_weights_are_said():
    """The sentences, from numbers as they would be."""
    idata = of_two_modes()

    def said(differ=0.0, **changes):
        attrs = dict(idata["sample_stats"].attrs) | changes
        return module.advice(attrs, np.array([0.0, differ]), np.full(2, 0.01), idata)

    assert said() == said(pareto_k=0.9, heavy_share=0.004) == ""
    assert "independent runs disagree (R-hat 1.200)" in said(max_r_hat=1.2)
    assert "outweigh the rest (Pareto k 0.90)" in said(pareto_k=0.9, heavy_share=0.006)
    assert "differ by 1.00, more than" in said(differ=1.0)
    few = said(ess=20.0, undetermined="a with b")
    assert few.endswith("narrower priors to what the data do not determine (a with b).")


def simulator():
    with pm.Model() as model:
        x = pm.Normal("x")
        pm.Simulator("y", lambda rng, x, size=None: rng.normal(x, 1.0, size=size), x, observed=[0.5])
    return model


@pytest.mark.slow
@pytest.mark.parametrize("make", [discrete, simulator])
def test_without_gradients_it_falls_back_and_says_why(make):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        idata = pmf.sample(60, model=make(), chains=2, check=None, **QUIET)
    found = idata["sample_stats"].attrs
    assert found["no_gradient"] and found["close_to_laplace"] == ""
    assert found["search_gradients"] == found["n_modes"] == 0 and np.isnan(found["laplace_error"])
    assert "modes" not in idata.children
    assert idata["posterior"].sizes["draw"] == 60


@pytest.mark.slow
def test_a_killed_run_goes_on_to_the_same_draws(tmp_path, monkeypatch):
    """Stopped among the climbs, and among the draws of the second chain; nothing known is evaluated again."""
    model, _ = two_modes()
    run = functools.partial(quietly, 200, model=model, chains=2, check="standard")
    whole = run(checkpoint=tmp_path / "whole")
    values, slopes = PopulationLogp.__call__, PopulationLogp.gradient
    calls = []

    def counted(function, limit):
        def wrapper(self, particles):
            if len(calls) >= limit:
                raise KeyboardInterrupt
            calls.append(len(particles))
            return function(self, particles)

        return wrapper

    def limited(limit):
        calls.clear()
        monkeypatch.setattr(PopulationLogp, "__call__", counted(values, limit))
        monkeypatch.setattr(PopulationLogp, "gradient", counted(slopes, limit))

    limited(np.inf)
    plain = run(checkpoint=tmp_path / "plain")
    total = len(calls)
    done = 0
    for limit in (5, total - 8):
        limited(limit)
        with pytest.raises(KeyboardInterrupt):
            run(checkpoint=tmp_path / "killed")
        done += len(calls)
    limited(np.inf)
    continued = run(checkpoint=tmp_path / "killed")
    assert done + len(calls) == total
    for idata in (plain, continued):
        xr.testing.assert_equal(idata["posterior"].to_dataset(), whole["posterior"].to_dataset())
        xr.testing.assert_equal(idata["modes"].to_dataset(), whole["modes"].to_dataset())


def test_far_from_laplace_is_said():
    """A half-normal prior alone: the Gaussian at the mode of its logarithm is far from it."""
    with pm.Model() as model:
        pm.HalfNormal("scale")
        pm.Normal("x")
    found = quietly(1000, model=model, chains=2)["sample_stats"].attrs
    log_scale = stats.halfnorm.ppf([0.05, 0.5, 0.95])
    exact = np.log(log_scale)
    # of log s the density is s exp(-s^2 / 2), its mode s = 1, its curvature there 2
    gaussian = stats.norm.ppf([0.05, 0.5, 0.95]) / np.sqrt(2.0)
    error = np.abs(gaussian - exact).max() / (exact[-1] - exact[0])
    assert found["laplace_error"] == pytest.approx(error, abs=0.05)
    assert found["close_to_laplace"].startswith("no: ")
    assert found["close_to_laplace"].endswith("(scale)")


@pytest.mark.slow
def test_it_starts_again_with_larger_stages_where_all_particles_fell_on_one(monkeypatch):
    asked, run = [], module.sample_smc

    def fails_twice(*args, **settings):
        asked.append(settings["stage_draws"])
        if len(asked) < 3:
            raise NoSpreadError("the particles of a stage must differ in every parameter")
        return run(*args, **settings)

    monkeypatch.setattr(module, "sample_smc", fails_twice)
    idata = pmf.sample(100, model=discrete(), chains=2, check=None, **QUIET)
    assert asked == [None, 800, 3200]
    assert idata["posterior"].sizes["draw"] == 100


@pytest.mark.neighbours
def test_pathfinder_of_pymc_extras():
    """It underestimates the width of a bent posterior, but finds its place."""
    pmx = pytest.importorskip("pymc_extras")
    code = blocks(README, "python")[0]
    model, sampled = code.split("    idata = ")
    assert sampled.startswith("pmf.sample_smc(")
    names = {}
    exec(model, names)
    with names["model"]:
        idata = pmx.fit("pathfinder", random_seed=1, num_draws=500, num_paths=4)
    posterior = idata.posterior
    assert posterior["theta"].size == 500
    assert abs(float(posterior["theta"].mean()) - 0.9995) < 0.0045  # a standard deviation
    assert 0.143 < float(posterior["sigma"].mean()) < 0.251
