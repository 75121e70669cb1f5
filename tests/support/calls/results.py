"""Predictions, studies, figures, and simulators that run outside."""

import numpy as np
import xarray as xr

import pymc_features as pmf
from support.border import Call, work
from support.calls.samplers import IDATA, ODD_TREES, POSTERIOR, SEEDS
from support.calls.structures import RECORD
from support.calls.structures import TAKEN as OF_RESPONSE
from support.odd_values import NOT_NEGATIVE, PAIR, POSITIVE, TEXTS

TIME = 0.1 * np.arange(3)
BANDS = xr.Dataset(
    {
        "response": (("quantile", "sensor", "time"), np.zeros((3, 1, 3))),
        "normalised_error": ("sensor", [0.1]),
    },
    {"quantile": [0.05, 0.5, 0.95], "sensor": ["roof"], "time": TIME},
)
PLAIN = xr.DataTree.from_dict({"posterior": POSTERIOR})


def built(x=1.0, z=1.0):
    return pmf.SpringMassChain([1.0, 1.0], 100.0, pmf.ModalDamping(0.02))


def double(x):
    return np.ones((2, 3)) * x


def figure(name, **arguments):
    """A call of a function that draws, up to where it makes the axes."""
    function = getattr(pmf.plots, name)
    return Call(
        function,
        arguments,
        AXES | {"idata": {"posterior of others"} if name == "chains" else ()},
        {"result": ["quantity"]},
        instead={f"{function.__module__}.checked_axes": work},
        more={"idata": ODD_TREES},
    )


AXES = {
    "sensors": {"None"},
    "window": {"None"},
    "springs": {"None", "0"},
    "var_names": {"None"},
    "units": {"None"},
    "measured": {"None"},
    "parameters": {"None"},
}
PREDICT = {
    "idata": IDATA,
    "structure": built,
    "record": RECORD,
    "draws": 10,
    "random_seed": 1,
    "dt": None,
    "sensors": None,
    "n_modes": None,
    "outputs": None,
}
OF_PREDICTION = {
    **OF_RESPONSE,
    # of a function of other variables
    "idata": {"posterior of NaN", "posterior of texts", "posterior of complex", "posterior of others"},
    "structure": set(),
    "random_seed": SEEDS,
}
SIMULATOR = {
    "function": double,
    "shape": (2, 3),
    "returns": "response",
    "gradient": None,
    "version": None,
    "dt": None,
    "executor": 1,
    "timeout": None,
    "retries": 0,
    "scratch": False,
    "cache": None,
    "progress": False,
}
STUDY = {
    "record": RECORD,
    "structure": "linear",
    "noise": 0.05,
    "multipliers": [1.0],
    "likelihoods": ["TN"],
    "random_seed": 1,
    "out": None,
    "progress": None,
    "draws": 100,
    "chains": 2,
    "cores": 1,
    "progressbar": False,
    "noise_time": 0.0,
}

CALLS = {
    "posterior_response": Call(
        pmf.prediction.posterior_response,
        {**PREDICT, "quantities": "relative_velocity", "quantiles": [0.5]},
        {
            **OF_PREDICTION,
            "quantiles": {"0"},
        },
        more={"idata": ODD_TREES},
    ),
    "sampling_rate_study": Call(
        pmf.study.sampling_rate_study,
        STUDY,
        {
            "noise": POSITIVE,
            "noise_time": NOT_NEGATIVE,
            "random_seed": SEEDS,
            "out": {"None", *TEXTS},
            "progress": {"None"},
            "draws": {"None"},
            "chains": {"None"},
            "cores": {"None"},
            "progressbar": {"True"},
            "likelihoods": {"None"},
            "multipliers": PAIR,
        },
        instead={
            "pymc_features.study.sampling_rate.PartStore": work,
            "pymc_features.study.settings.check_measurements": lambda study: None,
            "pymc_features.study.sampling_rate.seed_in": lambda out: None,
        },
    ),
    "ExternalSimulator": Call(
        pmf.ExternalSimulator,
        SIMULATOR,
        {
            "version": {"None", *TEXTS},
            "gradient": {"None"},
            "shape": {"DataArray"},
            "dt": {"None", *POSITIVE},
            "executor": {"None", *TEXTS},
            "timeout": {"None", *POSITIVE},
            "retries": {"0"},
            "scratch": {"True", *TEXTS},
            "cache": {"None", *TEXTS},
            "progress": {"True"},
        },
        instead={"pymc_features.external.evaluator.EvaluationCache": str},
    ),
    "ProgramSimulator": Call(
        pmf.ProgramSimulator,
        {
            "command": ["run"],
            "parameters": ["k"],
            "inputs": {},
            "result": "out.txt",
            "columns": None,
            "transpose": True,
            "files": (),
        },
        {
            "command": TEXTS,
            "inputs": {"None"},
            "result": TEXTS,
            "columns": {"None"},
            "transpose": {"True"},
            "files": {"[]"},
        },
    ),
    "plots.chains": figure("chains", idata=PLAIN, kind="rank", var_names=None, backend="matplotlib"),
    "plots.response": figure("response", result=BANDS, quantity="response", sensors=None, measured=None),
}
