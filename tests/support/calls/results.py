"""Predictions, studies, figures, and simulators that run outside."""

import numpy as np
import xarray as xr

import pymc_features as pmf
from pymc_features.study import paper
from pymc_features.study.structures import find_structure
from support.border import Call, work
from support.calls.samplers import IDATA, ODD_TREES, POSTERIOR, SEEDS
from support.calls.structures import RECORD, SCALARS
from support.calls.structures import TAKEN as OF_RESPONSE
from support.odd_values import NOT_NEGATIVE, NUMBERS, PAIR, POSITIVE, TEXTS

MODES = pmf.ModalData([1.0, 2.0], np.eye(2), ["a", "b"])
TIME = 0.1 * np.arange(3)
BANDS = xr.Dataset(
    {
        "response": (("quantile", "sensor", "time"), np.zeros((3, 1, 3))),
        "normalised_error": ("sensor", [0.1]),
    },
    {"quantile": [0.05, 0.5, 0.95], "sensor": ["roof"], "time": TIME},
)
OBSERVED = xr.Dataset({"y": (("sensor", "time"), np.zeros((1, 3)))}, {"sensor": ["roof"], "time": TIME})
LOOPS = xr.Dataset({"ductility": ("spring", [1.0, 2.0])}, {"spring": [0, 1]})
SUMMARY = xr.Dataset(
    {"exact": (("likelihood", "multiplier", "parameter", "statistic"), np.ones((1, 2, 2, 4)))},
    {
        "likelihood": ["TN"],
        "multiplier": [1.0, 2.0],
        "parameter": ["theta", "sigma"],
        "statistic": ["maximum", "q05", "q50", "q95"],
    },
)
SWEEP = xr.Dataset(
    {"x": (("epsilon", "quantile"), np.ones((2, 3)))}, {"epsilon": [2.0, 1.0], "quantile": [0.05, 0.5, 0.95]}
)
TREE = xr.DataTree.from_dict(
    {
        "posterior": POSTERIOR,
        "prior": POSTERIOR,
        "bands": BANDS,
        "observed_data": OBSERVED,
        "loops": LOOPS,
        "summary": SUMMARY,
        "data": xr.Dataset(
            {"gain": (("sensor", "frequency"), np.ones((1, 2)))},
            {"sensor": ["roof"], "frequency": [1.0, 2.0]},
        ),
        "sample_stats": xr.Dataset(
            {
                "beta": (("chain", "stage"), np.ones((1, 2))),
                "accept_rate": (("chain", "stage"), np.ones((1, 2))),
            },
            {"chain": [0]},
        ),
        "sequence": xr.Dataset(
            {
                "mean": (("event", "parameter"), np.ones((2, 1))),
                "standard_deviation": (("event", "parameter"), np.ones((2, 1))),
                "alarm": ("event", [0, 1]),
            },
            {"event": [0, 1], "parameter": ["x"]},
        ),
        "TN/modal": xr.Dataset({"natural_frequency": (("chain", "draw", "mode"), np.ones((1, 2, 1)))}),
    }
)
PLAIN = xr.DataTree.from_dict({"posterior": POSTERIOR})
GOOD = {"posterior of NaN", "posterior of complex", "posterior of texts", "posterior of others"}


def built(x=1.0, z=1.0):
    return pmf.SpringMassChain([1.0, 1.0], 100.0, pmf.ModalDamping(0.02))


def double(x):
    return np.ones((2, 3)) * x


def figure(name, **arguments):
    """A call of a function that draws, up to where it makes the axes."""
    function = getattr(pmf, f"plot_{name}")
    return Call(
        function,
        arguments,
        AXES | {"idata": {"posterior of others"} if name == "chains" else ()},
        {"result": ["quantity"]},
        instead={f"{function.__module__}.checked_axes": work},
        more={"idata": ODD_TREES},
    )


def of_shapes(name, **more):
    """A call of a figure of mode shapes, two at two channels."""
    call = figure(name, measured=MODES, shapes=np.eye(2), frequencies=[1.0, 2.0], partners=[0, 1], **more)
    call.takes = {
        "frequencies": PAIR | {"None", "array with nan"},
        "partners": {"None"},
        "sensors": {"None"},
        "nodes": {"None"},
    }
    call.called = {"shapes": ["frequencies"]}
    return call


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
OF_THREE = POSITIVE | SCALARS
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
ROWS = PAIR | {
    *("[]", "()", "list of huge integers", "empty array", "empty matrix", "array with nan", "array with inf"),
    *("negative array", "three dimensions", "matrix in Fortran's order", "DataFrame"),
}
ANY_NUMBERS = ROWS | {"0", "-1.0", "nan"}
RUN = pmf.ExternalSimulator(double, (2, 3), executor=1, progress=False)
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
        pmf.posterior_response,
        {**PREDICT, "quantities": "relative_velocity", "quantiles": [0.5]},
        {
            **OF_PREDICTION,
            "quantiles": {"0"},
        },
        more={"idata": ODD_TREES},
    ),
    "first_passage_probability": Call(
        pmf.first_passage_probability,
        {**PREDICT, "limit": 1.0, "quantity": "relative_velocity"},
        {**OF_PREDICTION, "limit": POSITIVE | PAIR, "quantity": set()},
        more={"idata": ODD_TREES},
    ),
    "paper.chain": Call(
        paper.chain,
        {"theta": 1.0, "stiffness": 1800.0},
        {"theta": OF_THREE, "stiffness": OF_THREE},
        {"theta": ["factor"], "stiffness": ["mass"]},
    ),
    "paper.measurements": Call(
        paper.measurements,
        {
            "record": RECORD,
            "theta": 1.0,
            "stiffness": 1800.0,
            "noise": 0.05,
            "noise_time": 0.0,
            "random_seed": 1,
            "multipliers": [1.0],
        },
        {
            "theta": POSITIVE,
            "stiffness": POSITIVE,
            "noise": NOT_NEGATIVE,
            "noise_time": NOT_NEGATIVE,
            "random_seed": SEEDS,
            "multipliers": PAIR,
        },
        {"theta": ["factor", "structure"], "stiffness": ["structure"]},
    ),
    "paper.decimate": Call(
        paper.decimate,
        {"finest": paper.measurements(RECORD, multipliers=[1.0]), "step": 0.1},
        {"step": {"1.5"}},
    ),
    "study.find_structure": Call(
        find_structure,
        {"name": "linear", "stiffness": 1800.0},
        {"stiffness": NUMBERS | POSITIVE},
        {"name": ["structure"]},
    ),
    "sampling_rate_study": Call(
        pmf.sampling_rate_study,
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
    "ExternalSimulator.__call__": Call(
        RUN,
        {"parameters": 1.0},
        {"parameters": ANY_NUMBERS | SCALARS | POSITIVE},
        positional=("parameters",),
    ),
    "ExternalSimulator.responses": Call(
        RUN.responses,
        {"parameters": [1.0, 2.0]},
        {"parameters": ROWS},
        positional=("parameters",),
        instead={"pymc_features.external.evaluator.Evaluator.run": work},
    ),
    "ExternalSimulator.discrepancies": Call(
        RUN.discrepancies,
        {"parameters": [1.0, 2.0], "observed": np.ones((2, 3))},
        {"parameters": ROWS},
        positional=("parameters",),
        instead={"pymc_features.external.evaluator.Evaluator.run": work},
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
    "plot_record": figure("record", record=RECORD),
    "plot_sensor_placement": figure(
        "sensor_placement",
        result=xr.Dataset(
            {"alone": ("candidate", [1.0]), "gain": ("order", [1.0]), "sensor": ("order", [0])},
            {"candidate": [0], "order": [1]},
            {"criterion": "D"},
        ),
    ),
    "plot_sequence": figure("sequence", idata=TREE, parameters=["x"]),
    "plot_chains": figure("chains", idata=PLAIN, kind="rank", var_names=None, backend="matplotlib"),
    "plot_channels": figure("channels", channels=OBSERVED["y"]),
    "plot_loops": figure("loops", result=TREE, springs=None, measured=None),
    "plot_natural_frequencies": figure("natural_frequencies", result=TREE, backend="matplotlib"),
    "plot_predictive": figure("predictive", idata=TREE, sensors=None, window=None),
    "plot_prior_posterior": figure(
        "prior_posterior", idata=TREE, var_names=None, units=None, backend="matplotlib"
    ),
    "plot_response_bands": figure(
        "response_bands", result=BANDS, quantity="response", sensors=None, measured=None
    ),
    "plot_sampling_rate": figure("sampling_rate", result=TREE, likelihoods="TN", parameters="theta"),
    "plot_tempering": figure("tempering", idata=TREE),
    "plot_tolerance": figure("tolerance", result=SWEEP),
    "plot_widths": figure("widths", result=TREE),
    "plot_mac": of_shapes("mac"),
    "plot_mode_shapes": of_shapes("mode_shapes", sensors=[0, 1], nodes=None),
    "axes of a figure": Call(pmf.plot_record, {"record": RECORD, "axes": None}, {"axes": {"None"}}),
}
