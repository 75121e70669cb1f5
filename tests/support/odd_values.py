"""Values that arguments are given by mistake, by name, and which of them count as what."""

import numpy as np
import pytensor.tensor as pt
import xarray as xr

ODD = {
    "None": None,
    "True": True,
    "text": "abc",
    "0": 0,
    "-1.0": -1.0,
    "1.5": 1.5,
    "nan": np.nan,
    "complex": 1.0 + 1.0j,
    "[]": [],
    "array with nan": np.array([1.0, np.nan]),
    "three dimensions": np.ones((2, 2, 2)),
    "DataArray": xr.DataArray([1.0, 2.0], dims="x"),
    "scalar variable": pt.dscalar("x"),
}

# what counts as what, and so is taken
POSITIVE = {"1.5"}
NOT_NEGATIVE = POSITIVE | {"0"}
NUMBERS = NOT_NEGATIVE | {"-1.0", "nan"}
PAIR = {"DataArray"}  # two numbers
TEXTS = {"text"}  # and paths
