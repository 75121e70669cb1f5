"""Records, structures and their responses."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import pymc_features as pmf
from support.border import Call
from support.odd_values import NOT_NEGATIVE, NUMBERS, PAIR, POSITIVE, TEXTS

RECORD = pmf.Record([0.0, 1.0, 0.5], 0.1)
DAMPING = pmf.ModalDamping(0.02)
CHAIN = pmf.SpringMassChain([1.0, 1.0], 100.0, DAMPING)
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
    "Pinching": Call(
        pmf.structures.Pinching,
        {"slip": 0.5, "rate": 1.0, "initiation": 0.1, "spread": 0.2, "spread_rate": 0.0, "severity": 0.3},
        {name: NOT_NEGATIVE | SCALARS for name in ("rate", "initiation", "spread_rate")}
        | {name: POSITIVE | SCALARS for name in ("spread", "severity")}
        | {"slip": {"0"} | SCALARS},
    ),
    "SpringMassChain": Call(pmf.SpringMassChain, CHAIN_OF_TWO, SPRINGS),
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
    "simulate": Call(pmf.simulate, RESPONSE, TAKEN),
}
