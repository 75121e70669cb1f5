"""Likelihoods and simulator nodes, tolerances and scales."""

import numpy as np
import pytensor.tensor as pt

import pymc_features as pmf
from support.border import Call, work
from support.odd_values import NOT_NEGATIVE, POSITIVE, TEXTS

COORDS = {"sensor": range(2)}
MU = np.zeros((2, 3))
DATA = np.arange(6.0).reshape(2, 3)
SCALARS = {"scalar variable"}
NUMERIC = {"DataArray"}
ARRAYS = {"DataArray", "array with nan"}
SCALE = POSITIVE | SCALARS | NUMERIC
NAMED = {"name": "y", "mu": MU, "sigma": 1.0, "observed": DATA, "dims": ("sensor", "time")}
NUMBERS = {"0", "-1.0", "nan", "[]", "three dimensions"}
TAKEN = {
    "name": TEXTS,
    "sigma": SCALE,
    "observed": {"None"},
    "dims": {"None"},
    "m": SCALE,
    "correlation_time": SCALE,
    "dt": POSITIVE | SCALARS,
}


def simulate(theta):
    return theta * DATA


CHAIN = pmf.SpringMassChain([1.0, 1.0], [9.0, 9.0], pmf.ModalDamping(0.02))
RESPONSE = pmf.ambient.spectral_response(CHAIN, 1.0)

CALLS = {
    "AmbientResponse": Call(
        pmf.AmbientResponse,
        {
            "name": "y",
            "response": RESPONSE,
            "error": 1.0,
            "bands": [0.5, 2.0],
            "dt": 0.1,
            "observed": np.ones((2, 100)),
            "mu": None,
            "dims": ("sensor", "time"),
        },
        {
            "name": TAKEN["name"],
            "error": POSITIVE | SCALARS,
            "bands": NUMERIC,
            "mu": {"None"},
            "dims": {"None"},
        },
        {"dt": ["bands"], "observed": ["bands"]},
        coords=COORDS | {"time": range(100)},
        instead={"pymc_features.ambient.response.warn_at_start": work},
    ),
    "TruncNormalFeature": Call(pmf.TruncNormalFeature, NAMED | {"density": "data"}, TAKEN, coords=COORDS),
    "CorrelatedNormal": Call(
        pmf.CorrelatedNormal, NAMED | {"correlation_time": 1.0, "dt": 0.1}, TAKEN, coords=COORDS
    ),
    "DiscrepancySimulator": Call(
        pmf.DiscrepancySimulator,
        {
            "name": "y",
            "mu": simulate,
            "params": pt.dscalar("theta"),
            "epsilon": 1.0,
            "observed": DATA,
            "kernel": "uniform",
            "noise": None,
            "dims": None,
        },
        TAKEN
        | {
            "params": SCALE | ARRAYS | NUMBERS,
            "epsilon": SCALE,
            "observed": NUMERIC,
            "noise": {"None"} | SCALE | NOT_NEGATIVE,
        },
        positional=("name", "mu", "params"),
        coords=COORDS,
    ),
    "abc_tolerance": Call(
        pmf.likelihoods.abc_tolerance,
        {"sigma": 1.0, "n_sensors": 2},
        {"sigma": POSITIVE | NUMERIC - {"DataArray"}},
    ),
}
