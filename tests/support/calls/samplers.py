"""Samplers, their kernels, and what stands on them: as far as the arguments are checked."""

from types import SimpleNamespace

import numpy as np
import pymc as pm
import xarray as xr

import pymc_features as pmf
from support.border import Call, work
from support.odd_values import POSITIVE, TEXTS

with pm.Model() as MODEL:
    X = pm.Normal("x")
    pm.Normal("y", X, 1.0, observed=[1.0])
with pm.Model() as SIMULATED:
    THETA = pm.Normal("x")
    pmf.DiscrepancySimulator("y", lambda x: x * np.ones((1, 3)), THETA, epsilon=1.0, observed=np.ones((1, 3)))

DRAWS = np.random.default_rng(1).standard_normal((2, 50))
POSTERIOR = xr.Dataset({"x": (("chain", "draw"), DRAWS)}, {"chain": [0, 1], "draw": np.arange(50)})
IDATA = xr.DataTree.from_dict({"posterior": POSTERIOR})
ODD_TREES = {
    "posterior without draws": xr.DataTree.from_dict({"posterior": POSTERIOR.isel(draw=slice(0))}),
    "posterior without chains": xr.DataTree.from_dict({"posterior": POSTERIOR.isel(chain=0, drop=True)}),
    "posterior of texts": xr.DataTree.from_dict({"posterior": POSTERIOR.astype(str)}),
    "posterior of complex": xr.DataTree.from_dict({"posterior": POSTERIOR.astype(complex)}),
    "posterior of NaN": xr.DataTree.from_dict({"posterior": POSTERIOR * np.nan}),
    "posterior of others": xr.DataTree.from_dict({"posterior": POSTERIOR.rename(x="z")}),
    "empty posterior": xr.DataTree.from_dict({"posterior": xr.Dataset()}),
    "dict of a posterior": {"posterior": POSTERIOR},
}
SEEDS = {"None", "0"}


def no_prior(model, from_prior):
    """In place of the function that draws from the prior."""
    return lambda n, rng: {v.name: np.zeros((n, *np.shape(v.type.shape))) for v in model.value_vars}


def no_density(*args):
    """In place of compiled log-probabilities."""
    return SimpleNamespace(compile_gradient=lambda: None)


KERNEL = {
    "draws": 100,
    "threshold": 0.5,
    "start": None,
    "model": MODEL,
    "random_seed": 1,
    "compile_kwargs": None,
    "checkpoint": None,
}
INSTEAD = {
    "pymc_features.smc.kernels.base.model_fingerprint": work,
    "pymc_features.smc.kernels.base.prior_draws": no_prior,
    "pymc_features.smc.kernels.base.population_logp": no_density,
    "pymc_features.smc.kernels.subset.population_logp": no_density,
}
DICTS = {"None"}
TAKEN = {
    "start": {"None"},
    "random_seed": SEEDS,
    "compile_kwargs": DICTS,
    "correlation_threshold": POSITIVE,
    "scale": POSITIVE,
    "coefficient_of_variation": POSITIVE,
    "stage_draws": {"None"},
    "gradients": {"True"},
    "reference": {"None"},
    "epsilon": {"None", *POSITIVE},
    "max_simulations": {"None"},
    "chains": {"None"},
    "cores": {"None"},
    "executor": {"None", *TEXTS},
    "tune": {"0"},
    "progressbar": {"True"},
    "point": DICTS,
    "sample_settings": DICTS,
    "particles": {"None"},
    "checkpoint": {"None", *TEXTS},
    "var_names": {"None"},
}


def kernel(of, **more):
    """A call of a kernel's class."""
    model = {"model": SIMULATED} if of is pmf.SubsetSimulation else {}
    given = {name: value for name, value in {**KERNEL, **model, **more}.items() if value is not Ellipsis}
    return Call(of, given, TAKEN, instead=INSTEAD)


RUN = {"draws": 100, "chains": 2, "cores": 1, "random_seed": 1, "checkpoint": None, "progressbar": False}
RUN |= {"executor": None}
WORKERS = {"pymc_features.smc.workers.open_executor": work}

CALLS = {
    "PersistentSMC": kernel(pmf.PersistentSMC, reference=None, gradients=False, stage_draws=None),
    "sample_smc": Call(
        pmf.sample_smc,
        {**RUN, "kernel": pmf.PersistentSMC, "model": MODEL},
        TAKEN,
        instead={"pymc.sample_smc": work, "pymc_features.smc.sample.remembered": work, **WORKERS},
    ),
    "sample": Call(
        pmf.sample,
        {**RUN, "model": MODEL, "compile_kwargs": None, "check": None},
        TAKEN | {"check": {"None"}},
        instead={
            "pymc_features.inference.sample.Unconstrained": work,
            "pymc_features.inference.sample.remembered": work,
        },
    ),
    "laplace": Call(
        pmf.laplace,
        {"draws": 100, "model": MODEL, "start": {"x": 1.0}, "random_seed": 1, "compile_kwargs": None},
        TAKEN | {"start": DICTS},
        instead={"pymc_features.inference.laplace.Unconstrained": work},
    ),
    "emulate": Call(
        pmf.emulate,
        {
            "runs": 100,
            "model": MODEL,
            "draws": 100,
            "chains": 2,
            "batch": 8,
            "tolerance": 0.02,
            "random_seed": 1,
            "progressbar": False,
        },
        TAKEN | {"batch": {"None"}},
        instead={"pymc_features.external.emulation.replaced": work},
    ),
    "calibrate": Call(
        pmf.calibrate,
        {
            "idata": IDATA,
            "model": MODEL,
            "draws": 100,
            "chains": 2,
            "random_seed": 1,
            "progressbar": False,
            "model_error": "bands",
            "base_noise": 0.1,
        },
        TAKEN | {"draws": {"None"}, "model_error": {"None"}, "base_noise": {"None", *POSITIVE}},
        instead={"pymc_features.calibration.calibrate.Predictions": work},
        more={"idata": ODD_TREES},
    ),
}
