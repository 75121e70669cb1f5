"""Traces written in one call, against those that PyMC writes draw by draw."""

from collections import Counter
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pymc as pm
import pymc.smc.sampling
import pytensor.tensor as pt
import pytest
import xarray as xr
from pymc.smc.sampling import _build_trace_from_kernel_state as draw_by_draw
from pytensor.compile.executor import Function

from pymc_features import TruncNormalFeature, paper, response, sample_smc
from pymc_features.sampling import PopulationIMH
from pymc_features.smc.sample import trace_builder
from support.structures import noise_record


def transforms():
    with pm.Model(coords={"place": range(2)}) as model:
        a = pm.Uniform("a", -1.0, 2.0, dims="place")
        b = pm.Dirichlet("b", np.ones(3))
        pm.LogNormal("c", shape=(2, 2))
        pm.Deterministic("sum", a[:, None] + b)
        pm.Deterministic("largest", pt.max(a))
    return model


def whole_numbers():
    with pm.Model() as model:
        n = pm.Poisson("n", 3.0)
        b = pm.Bernoulli("b", 0.4, shape=3)
        pm.Deterministic("more", n + b)
        pm.Deterministic("always", pt.constant([1.0, 2.0]))
    return model


def history():
    with pm.Model() as model:
        theta = pm.Uniform("theta", 0.5, 1.5)
        pm.Deterministic("y", response(paper.chain(theta), noise_record(30)))
    return model


def not_in_one_call():
    def one(rng, x, size=None):
        return np.atleast_1d(x)

    with pm.Model() as model:
        x = pm.Normal("x")
        pm.Deterministic("y", 2.0 * pm.Simulator.dist(one, x))
    return model


def particles_of(model, count=7):
    """Positions (p, d) and their shapes, as a kernel keeps them."""
    point, rng = model.initial_point(), np.random.default_rng(0)
    shapes = {name: (np.shape(value), np.size(value)) for name, value in point.items()}
    start = np.concatenate([np.ravel(value) for value in point.values()])
    return start + rng.normal(0.0, 0.6, (count, start.size)), shapes


@pytest.mark.parametrize("build", [transforms, whole_numbers, history, not_in_one_call])
def test_same_as_draw_by_draw(build, monkeypatch):
    """Every variable to the last digits, in its own type; in batches of one, where they hold any."""
    if build is transforms:
        monkeypatch.setattr("pymc_features.smc.sample.BATCH_BYTES", 8)
    model = build()
    given = (*particles_of(model), model.value_vars, 3, model)
    expected = draw_by_draw(*given)
    found = trace_builder()(*given)
    assert found.varnames == expected.varnames and len(found) == len(expected) == 7 and found.chain == 3
    for name in expected.varnames:
        a, b = found.get_values(name), expected.get_values(name)
        assert a.dtype == b.dtype and a.shape == b.shape
        np.testing.assert_allclose(a, b, rtol=1e-13)
        np.testing.assert_allclose(found.point(4)[name], expected.point(4)[name], rtol=1e-13)


@pytest.mark.parametrize("at_once", [True, False])
def test_no_call_for_each_draw(at_once, monkeypatch):
    """Only that of the first particles is called for each; negative control: the traces of PyMC."""
    data = np.random.default_rng(1).normal(size=(10, 30))
    with pm.Model() as model:
        theta = pm.Uniform("theta", 0.5, 1.5)
        TruncNormalFeature("y", response(paper.chain(theta), noise_record(30)), 1.0, observed=data)
    calls, call = Counter(), Function.__call__

    def counted(self, *args, **kwargs):
        calls[id(self)] += 1
        return call(self, *args, **kwargs)

    monkeypatch.setattr(Function, "__call__", counted)
    if not at_once:
        monkeypatch.setattr("pymc_features.smc.sample.trace_builder", lambda: draw_by_draw)
    with model:
        idata = sample_smc(300, PopulationIMH, chains=2, cores=1, random_seed=1, progressbar=False)
    assert idata.posterior["theta"].shape == (2, 300)
    assert (np.abs(idata.posterior["theta"].values - 1.0) < 0.5).all()
    assert (sum(n >= 300 for n in calls.values()) == 1) == at_once


@pytest.mark.parametrize("executor", [None, 1])
def test_nothing_of_pymc_is_replaced_while_it_runs(executor):
    """So that runs in two threads do not meet."""
    names = "_build_trace_from_kernel_state", "_sample_smc_sequentially"
    before, seen = [getattr(pymc.smc.sampling, name) for name in names], []

    class Watching(PopulationIMH):
        def step(self):
            seen.append([getattr(pymc.smc.sampling, name) for name in names])
            return super().step()

    with pm.Model() as model:
        x = pm.Normal("x", shape=2)
        pm.Normal("y", x, 0.5, observed=[0.3, -0.2])

    def run(seed):
        settings = {"cores": 1, "executor": executor, "random_seed": seed, "progressbar": False}
        return sample_smc(100, Watching, chains=2, model=model, compute_convergence_checks=False, **settings)

    alone = [run(seed) for seed in range(2)]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(run, range(2)))
    for one, other in zip(alone, together, strict=True):
        xr.testing.assert_equal(one["posterior"].to_dataset(), other["posterior"].to_dataset())
    assert seen and all(found == before for found in seen)
