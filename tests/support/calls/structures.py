"""Records, structures and their responses."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import xarray as xr

import pymc_features as pmf
from support.border import Call
from support.odd_values import NOT_NEGATIVE, NUMBERS, PAIR, POSITIVE, TEXTS

RECORD = pmf.Record([0.0, 1.0, 0.5], 0.1)
DAMPING = pmf.ModalDamping(0.02)
CHAIN = pmf.SpringMassChain([1.0, 1.0], 100.0, DAMPING)
YIELDING = pmf.DuffingChain([1.0, 1.0], 100.0, DAMPING, 5.0)
FRAME = pmf.LinearStructure([1.0, 1.0], stiffness=[3.0, 3.0], damping=DAMPING)
AFFINE = {
    "mass": [1.0, 1.0],
    "stiffness": [3.0, 3.0],
    "damping": DAMPING,
    "stiffness_terms": [[1.0, 1.0], None],
    "mass_terms": (),
    "damping_terms": (),
    "influence": None,
    "theta": [0.5, 0.5],
}


def springs_in_a_row(k):
    """M and K."""
    return np.eye(2), k * np.array([[2.0, -1.0], [-1.0, 1.0]])


FOLDER = TemporaryDirectory()
EXPORTS = Path(FOLDER.name)
np.savez(EXPORTS / "base.npz", M=np.eye(2), K=springs_in_a_row(1.0)[1])
np.savez(EXPORTS / "stiffer.npz", K=springs_in_a_row(2.0)[1])
CHANNELS = xr.DataArray(
    np.arange(10.0).reshape(2, 5) ** 2,
    dims=("sensor", "time"),
    coords={"sensor": ["base", "roof"], "time": 0.1 * np.arange(5)},
    attrs={"units": "m/s^2"},
)
HISTORY = {*PAIR, "array with nan"}
SCALARS = {"scalar variable"}
OF_TWO = PAIR  # positive
CHAIN_OF_TWO = {"mass": [1.0, 1.0], "stiffness": [100.0, 90.0], "damping": DAMPING}
SPRINGS = {
    "mass": POSITIVE | SCALARS | OF_TWO,
    "stiffness": POSITIVE | SCALARS | OF_TWO,
}
RATIO = POSITIVE | SCALARS | OF_TWO
UNIT = {*SCALARS}
YIELD = {"yield_displacement": 0.1, "post_yield_ratio": 0.1, "sharpness": 2.0, "beta": 0.5, "gamma": 0.5}
DIAGONALS = PAIR
INFLUENCE = PAIR | {"None"}
RESPONSE = {
    "structure": CHAIN,
    "record": RECORD,
    "dt": None,
    "sensors": None,
    "quantity": "relative_velocity",
    "n_modes": None,
    "outputs": None,
}
WHOLE = {"0"}
TAKEN = {
    "dt": {"None", "1.5"},
    "sensors": {"None", "0"},
    "quantity": {"None"},
    "n_modes": {"None"},
    "outputs": {"None"},
}

CALLS = {
    "Record": Call(
        pmf.Record,
        {"acceleration": [0.0, 1.0], "dt": 0.1, "name": "", "interpolation": "linear"},
        {
            "acceleration": PAIR,
            "dt": POSITIVE,
            "name": TEXTS | NUMBERS,
        },
    ),
    "Record.first": Call(RECORD.first, {"n_times": 2}, {}),
    "Record.from_channel": Call(
        pmf.Record.from_channel,
        {"channels": CHANNELS, "sensor": "base", "name": None, "interpolation": "linear"},
        {"name": {"None", *TEXTS, *NUMBERS}},
        {"channels": ["sensor"]},
    ),
    "Loading": Call(
        pmf.Loading,
        {
            "values": [0.0, 1.0],
            "dt": 0.1,
            "kind": "force",
            "matrix": None,
            "name": "",
            "interpolation": "linear",
        },
        {
            "values": PAIR,
            "dt": POSITIVE,
            "matrix": {"None"},
            "name": TEXTS | NUMBERS,
        },
    ),
    "Loading.first": Call(pmf.Loading([0.0, 1.0, 2.0], 0.1).first, {"n_times": 2}, {}),
    "CyclicTest": Call(
        pmf.CyclicTest,
        {"displacement": [0.0, 1.0], "dt": 0.1, "name": ""},
        {"displacement": PAIR, "dt": POSITIVE, "name": TEXTS | NUMBERS},
    ),
    "CyclicTest.first": Call(pmf.CyclicTest([0.0, 1.0, 2.0]).first, {"n_times": 2}, {}),
    "Degradation": Call(
        pmf.Degradation,
        {"strength": 0.1, "stiffness": 0.1},
        {"strength": NOT_NEGATIVE | SCALARS, "stiffness": NOT_NEGATIVE | SCALARS},
    ),
    "Pinching": Call(
        pmf.Pinching,
        {"slip": 0.5, "rate": 1.0, "initiation": 0.1, "spread": 0.2, "spread_rate": 0.0, "severity": 0.3},
        {name: NOT_NEGATIVE | SCALARS for name in ("rate", "initiation", "spread_rate")}
        | {name: POSITIVE | SCALARS for name in ("spread", "severity")}
        | {"slip": {"0"} | SCALARS},
    ),
    "HystereticSpecimen": Call(
        pmf.HystereticSpecimen,
        {"stiffness": 100.0} | YIELD | {"degradation": pmf.Degradation(), "pinching": pmf.Pinching(0.5)},
        {name: POSITIVE | SCALARS for name in ("stiffness", "yield_displacement")}
        | {"sharpness": POSITIVE | SCALARS, "beta": POSITIVE | SCALARS}
        | {"post_yield_ratio": {"0"} | SCALARS}
        | {"gamma": {"0"} | SCALARS}
        | {"degradation": {"None"}, "pinching": {"None"}},
    ),
    "RayleighDamping": Call(
        pmf.RayleighDamping,
        {"alpha": 0.1, "beta": 0.1},
        {"alpha": NOT_NEGATIVE | SCALARS, "beta": NOT_NEGATIVE | SCALARS},
    ),
    "RayleighDamping.from_ratios": Call(
        pmf.RayleighDamping.from_ratios,
        {"ratios": [0.02, 0.02], "natural_frequencies": [1.0, 2.0]},
        {"ratios": NOT_NEGATIVE | PAIR, "natural_frequencies": PAIR},
    ),
    "ModalDamping": Call(pmf.ModalDamping, {"ratios": 0.02}, {"ratios": NOT_NEGATIVE | SCALARS | OF_TWO}),
    "SpringMassChain": Call(pmf.SpringMassChain, CHAIN_OF_TWO, SPRINGS),
    "SpringMassChain.scale_stiffness": Call(
        CHAIN.scale_stiffness,
        {"factor": [0.5, 0.5], "springs": [0, 1]},
        {"factor": RATIO},
        {"springs": ["factor"]},
    ),
    "HystereticChain": Call(
        pmf.HystereticChain,
        CHAIN_OF_TWO | YIELD,
        SPRINGS
        | {
            "yield_displacement": RATIO,
            "post_yield_ratio": {"0", *UNIT},
            "sharpness": RATIO,
            "beta": RATIO,
            "gamma": {"0", *SCALARS},
        },
    ),
    "DuffingChain": Call(pmf.DuffingChain, CHAIN_OF_TWO | {"cubic": 5.0}, SPRINGS | {"cubic": RATIO | {"0"}}),
    "LinearStructure": Call(
        pmf.LinearStructure,
        {"mass": [1.0, 1.0], "stiffness": [3.0, 3.0], "damping": DAMPING, "influence": None},
        {
            "mass": DIAGONALS,
            "stiffness": DIAGONALS,
            "damping": DIAGONALS,
            "influence": INFLUENCE,
        },
    ),
    "LinearStructure.modes": Call(FRAME.modes, {"n_modes": 1}, {"n_modes": {"None"}}),
    "AffineStructure": Call(
        pmf.AffineStructure,
        AFFINE,
        {
            "mass": DIAGONALS,
            "stiffness": DIAGONALS,
            "damping": DIAGONALS,
            "stiffness_terms": {"three dimensions"},
            "mass_terms": {"[]", "three dimensions"},
            "damping_terms": {"[]"},
            "influence": INFLUENCE,
            "theta": {"None"} | PAIR,
        },
        {"stiffness_terms": ["theta"]},
    ),
    "AffineStructure.with_parameters": Call(
        pmf.AffineStructure(**AFFINE).with_parameters,
        {"theta": [0.5, 0.5]},
        {"theta": PAIR},
    ),
    "AffineStructure.from_matrices": Call(
        pmf.AffineStructure.from_matrices,
        {"build": springs_in_a_row, "parameters": {"k": 2.0}, "damping": DAMPING, "influence": None},
        {"damping": DIAGONALS, "influence": INFLUENCE},
        {"parameters": ["build"]},
    ),
    "AffineStructure.from_files": Call(
        pmf.AffineStructure.from_files,
        {
            "base": EXPORTS / "base.npz",
            "terms": {"k": (EXPORTS / "stiffer.npz", 2.0)},
            "damping": DAMPING,
            "direction": None,
            "units": None,
        },
        {"damping": DIAGONALS, "direction": {"None"}, "units": {"None"}},
    ),
    "LinearStructure.with_names": Call(FRAME.with_names, {"names": ["a", "b"]}, {}),
    "simulate": Call(pmf.simulate, RESPONSE, TAKEN),
    "response": Call(pmf.response, RESPONSE, TAKEN),
    "spring_forces": Call(
        pmf.spring_forces,
        {"structure": YIELDING, "record": RECORD, "dt": None},
        TAKEN | {"structure": set(), "quantity": set()},
    ),
    "integration_error": Call(
        pmf.integration_error,
        {"structure": YIELDING, "record": RECORD, "quantity": "relative_velocity"},
        TAKEN | {"structure": set(), "quantity": set()},
    ),
    "mean_square_discrepancy": Call(
        pmf.mean_square_discrepancy,
        {"mu": [[0.0, 1.0]], "observed": [[1.0, 1.0]]},
        {"mu": HISTORY, "observed": HISTORY},
    ),
}
