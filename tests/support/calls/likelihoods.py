"""Likelihoods and simulator nodes, tolerances and scales."""

import numpy as np
import pytensor.tensor as pt

import pymc_features as pmf
from support.border import Call, work
from support.odd_values import NOT_NEGATIVE, ONE, POSITIVE, TEXTS

COORDS = {"sensor": range(2)}
MU = np.zeros((2, 3))
DATA = np.arange(6.0).reshape(2, 3)
SCALARS = {"scalar variable", "integer variable", "constant variable", "random variable"}
VARIABLES = {"vector variable", "shared variable", "list of variables"}
NUMERIC = {
    "array of 16 bits",
    "array that is read-only",
    "array of every second",
    "Series",
    "DataArray",
}
VECTORS = VARIABLES | NUMERIC

ARRAYS = VECTORS - VARIABLES | {
    "range",
    "list of huge integers",
    "array with nan",
    "array with inf",
    "negative array",
    "matrix in Fortran's order",
}
SCALE = POSITIVE | SCALARS | VECTORS
NAMED = {"name": "y", "mu": MU, "sigma": 1.0, "observed": DATA, "dims": ("sensor", "time")}
NUMBERS = {
    *("0", "-1.0", "nan", "inf", "-inf", "10**400", "10**5000", "[]", "()", "empty array", "empty matrix"),
    *("three dimensions", "DataFrame", "matrix variable"),
}
NOT_FINITE = {"list of huge integers", "array with nan", "array with inf"}
TAKEN = {
    "name": TEXTS - {"empty text", "text with a null"},
    "mu": {"matrix variable"},
    "sigma": SCALE,
    "observed": {"None"},
    "dims": {"None"},
    "m": SCALE,
    "correlation_time": SCALE,
    "dt": POSITIVE | SCALARS,
}
BATCHES = {"three dimensions", "DataFrame", "matrix variable"}
OF_DIST = TAKEN | {name: SCALE | BATCHES for name in ("sigma", "m", "correlation_time")}
OF_DIST |= {"mu": ARRAYS | {"three dimensions", "DataFrame", "matrix variable", *VARIABLES}}


def simulate(theta):
    return theta * DATA


CHAIN = pmf.SpringMassChain([1.0, 1.0], [9.0, 9.0], pmf.ModalDamping(0.02))
RESPONSE = pmf.spectral_response(CHAIN, 1.0)

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
            "error": POSITIVE | SCALARS | {"vector variable", "shared variable", "matrix variable"},
            "bands": NUMERIC,
            "mu": {"None", "matrix variable"},
            "dims": {"None"},
        },
        {"dt": ["bands"], "observed": ["bands"]},
        coords=COORDS | {"time": range(100)},
        instead={"pymc_features.ambient.response.warn_at_start": work},
    ),
    "spectral_response": Call(
        pmf.spectral_response,
        {
            "structure": CHAIN,
            "excitation": 1.0,
            "forces": "dofs",
            "sensors": None,
            "outputs": None,
            "n_modes": None,
            "quantity": "acceleration",
        },
        {
            "excitation": SCALE | BATCHES,
            "structure": {"structure"},
            "forces": {"matrix in Fortran's order", "DataFrame"},
            "sensors": {"None", "range", "0"},
            "outputs": {"None", "matrix in Fortran's order", "sparse matrix"},
            "n_modes": {"None", "NumPy's 2", "1.0 of 16 bits", "array without dimensions"},
        },
    ),
    "TruncNormalFeature": Call(pmf.TruncNormalFeature, NAMED | {"density": "data"}, TAKEN, coords=COORDS),
    "ExpFeature": Call(pmf.ExpFeature, NAMED | {"density": "data"}, TAKEN, coords=COORDS),
    "GammaFeature": Call(pmf.GammaFeature, NAMED | {"m": 3.0, "density": "data"}, TAKEN, coords=COORDS),
    "CorrelatedNormal": Call(
        pmf.CorrelatedNormal, NAMED | {"correlation_time": 1.0, "dt": 0.1}, TAKEN, coords=COORDS
    ),
    "TruncNormalFeature.dist": Call(
        pmf.TruncNormalFeature.dist, {"mu": MU, "sigma": 1.0, "density": "data"}, OF_DIST
    ),
    "GammaFeature.dist": Call(
        pmf.GammaFeature.dist, {"mu": MU, "sigma": 1.0, "m": 3.0, "density": "data"}, OF_DIST
    ),
    "CorrelatedNormal.dist": Call(
        pmf.CorrelatedNormal.dist, {"mu": MU, "sigma": 1.0, "correlation_time": 1.0, "dt": 0.1}, OF_DIST
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
            "mu": {"function", "class", "class of structures"},
            "params": SCALE | ARRAYS | NUMBERS,
            "epsilon": SCALE - {"random variable"},
            "observed": (ARRAYS | {"DataFrame", "shared variable"}) - NOT_FINITE,
            "noise": {"None", "range"} | SCALE | NOT_NEGATIVE,
        },
        positional=("name", "mu", "params"),
        coords=COORDS,
    ),
    "sigma_mpv": Call(
        pmf.sigma_mpv,
        {"e": [1.0, 2.0]},
        {"e": {"range", "three dimensions", "DataFrame", *NUMERIC}},
    ),
    "abc_tolerance": Call(
        pmf.abc_tolerance,
        {"sigma": 1.0, "n_sensors": 2},
        {"sigma": POSITIVE | NUMERIC - {"DataArray"}, "n_sensors": ONE},
    ),
}
