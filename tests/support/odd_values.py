"""Values that arguments are given by mistake, by name, and which of them count as what."""

import datetime
import io
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import numpy as np
import pandas as pd
import pymc as pm
import pytensor
import pytensor.tensor as pt
import xarray as xr
from pytensor.tensor.type_other import NoneConst
from scipy import sparse

from pymc_features import ModalDamping, Record, SpringMassChain


def frozen(array):
    array.setflags(write=False)
    return array


def list_in_itself():
    result = [1.0]
    result.append(result)
    return result


SCALARS = {
    "None": None,
    "True": True,
    "NumPy's True": np.True_,
    "text": "abc",
    "number as text": "1.0",
    "empty text": "",
    "bytes": b"1.0",
    "0": 0,
    "-1.0": -1.0,
    "1.5": 1.5,
    "nan": np.nan,
    "inf": np.inf,
    "-inf": -np.inf,
    "1e300": 1e300,
    "1e-300": 1e-300,
    "10**400": 10**400,
    "10**5000": 10**5000,
    "complex": 1.0 + 1.0j,
    "NumPy's complex": np.complex128(1.0),
    "NumPy's 2": np.int64(2),
    "1.0 of 16 bits": np.float16(1.0),
    "Fraction": Fraction(1, 2),
    "Decimal": Decimal("1.5"),
    "datetime": datetime.datetime(2020, 1, 1),
    "datetime64": np.datetime64("2020-01-01"),
    "timedelta64": np.timedelta64(1, "s"),
    "object": object(),
    "class": dict,
    "function": lambda: None,
    "slice": slice(2),
    "Ellipsis": ...,
}
CONTAINERS = {
    "[]": [],
    "()": (),
    "{}": {},
    "dict": {"a": 1.0},
    "set": {1.0},
    "range": range(2),
    "list of texts": ["a", "b"],
    "list of None": [None],
    "uneven list": [[1.0], [1.0, 2.0]],
    "mixed list": [1.0, "a", None],
    "list of huge integers": [10**400, 1],
    "list of booleans": [True, False],
    "list in itself": list_in_itself(),
}
ARRAYS = {
    "array without dimensions": np.array(1.0),
    "text without dimensions": np.array("1.0"),
    "None without dimensions": np.array(None),
    "masked array": np.ma.masked_array([1.0, 2.0], [False, True]),
    "masked": np.ma.masked,
    "array of booleans": np.array([True, False]),
    "array of complex": np.array([1.0 + 1.0j, 2.0]),
    "array of dates": np.array(["2020-01-01", "2020-01-02"], "datetime64[ns]"),
    "array of texts": np.array(["1.0", "2.0"]),
    "array of objects": np.array([1.0, None], dtype=object),
    "array of records": np.zeros(2, dtype=[("a", float)]),
    "empty array": np.zeros(0),
    "empty matrix": np.zeros((0, 2)),
    "array with nan": np.array([1.0, np.nan]),
    "array with inf": np.array([1.0, np.inf]),
    "negative array": np.array([-1.0, -2.0]),
    "three dimensions": np.ones((2, 2, 2)),
    "array of 16 bits": np.array([1.0, 2.0], dtype=np.float16),
    "array that is read-only": frozen(np.array([1.0, 2.0])),
    "array of every second": np.array([1.0, 9.0, 2.0])[::2],
    "matrix in Fortran's order": np.asfortranarray(np.array([[2.0, -1.0], [-1.0, 2.0]])),
}
LABELLED = {
    "DataFrame": pd.DataFrame({"a": [1.0, 2.0]}),
    "Series": pd.Series([1.0, 2.0]),
    "Timestamp": pd.Timestamp("2020-01-01"),
    "DataArray": xr.DataArray([1.0, 2.0], dims="x"),
    "DataArray of texts": xr.DataArray(["a", "b"], dims="x"),
    "Dataset": xr.Dataset({"a": ("x", [1.0, 2.0])}),
    "DataTree": xr.DataTree(xr.Dataset({"a": ("x", [1.0, 2.0])})),
    "sparse matrix": sparse.csc_array(np.array([[2.0, -1.0], [-1.0, 2.0]])),
}
VARIABLES = {
    "scalar variable": pt.dscalar("x"),
    "vector variable": pt.dvector("v"),
    "matrix variable": pt.dmatrix("m"),
    "integer variable": pt.lscalar("i"),
    "complex variable": pt.zvector("z"),
    "boolean variable": pt.bvector("b") > 0,
    "shared variable": pytensor.shared(np.array([1.0, 2.0]), name="s"),
    "constant variable": pt.constant(1.0),
    "random variable": pm.Normal.dist(),
    "constant None": NoneConst,
    "generator variable": pytensor.shared(np.random.default_rng(0)),
    "list of variables": [pt.dscalar("y"), 1.0],
    "list of a vector": [pt.dvector("w"), 1.0],
    "list of a variable and a text": [pt.dscalar("y"), "a"],
}
FILES = {
    "missing file": "nowhere.csv",
    "folder": Path("/"),
    "text with a null": "a\0b",
    "long name": "a" * 5000,
    "open file": io.StringIO("1.0\n2.0\n"),
}
OURS = {
    "Record": Record([0.0, 1.0, 0.5], 0.1),
    "structure": SpringMassChain([1.0, 1.0], 100.0, ModalDamping(0.02)),
    "damping": ModalDamping(0.02),
    "model": pm.Model(),
    "class of structures": SpringMassChain,
}
ODD = SCALARS | CONTAINERS | ARRAYS | LABELLED | VARIABLES | FILES | OURS

# what counts as what, and so is taken
ONE = {"NumPy's 2", "1.0 of 16 bits", "array without dimensions"}  # whole numbers above zero
POSITIVE = ONE | {"1.5", "1e300", "1e-300", "Fraction"}
NOT_NEGATIVE = POSITIVE | {"0"}
NUMBERS = NOT_NEGATIVE - {"array without dimensions"} | {"-1.0", "nan", "inf", "-inf", "10**400", "10**5000"}
PAIR = {
    "array of 16 bits",
    "array that is read-only",
    "array of every second",
    "range",
    "Series",
    "DataArray",
}  # two numbers
PATHS = {"text", "number as text", "missing file", "folder", "long name"}
TEXTS = {"text", "number as text", "empty text", "missing file", "text with a null", "long name"}
