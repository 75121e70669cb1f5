"""Identified modes: their files, their likelihood, and modes inside a model."""

from pathlib import Path

import numpy as np
import pymc as pm

import pymc_features as pmf
from support.border import Call, work
from support.calls.files import FOLDER, MEASURED, ODD_CHANNELS, SEVERAL
from support.calls.structures import SCALARS
from support.odd_values import NUMBERS, PAIR, POSITIVE, TEXTS

TABLE = Path(FOLDER.name) / "modes.csv"
TABLE.write_text("omega [rad/s],damping [%],roof\n6.2832,1.2,1.0\n18.85,0.9,-0.5\n")
SHAPES = [[0.6, 1.0], [1.0, -0.5]]
MODAL = pmf.modal.ModalData([1.2, 3.5], SHAPES, ["floor", "roof"])
MODES = (np.array([1.2, 3.5, 5.0]), np.array([*SHAPES, [1.0, 1.0]]))
with pm.Model() as MODEL:
    pmf.ModalFeature("y", (pm.LogNormal("f", shape=3), MODES[1]), observed=MODAL, sigma_f=0.1, sigma_phi=0.1)
FRACTIONS = {"0"}
LABELS = PAIR - {"DataArray"} | {"array with nan"}
SCALE = POSITIVE | SCALARS | PAIR

NUMERIC = {"DataArray"}
WITHOUT_GAPS = SEVERAL - {"channels with NaN"}

CALLS = {
    "identify_modes": Call(
        pmf.identify_modes,
        {"channels": MEASURED, "bands": [0.3, 2.0], "n_modes": None, "quantity": "acceleration"},
        {"bands": NUMERIC, "n_modes": {"None"}, "channels": WITHOUT_GAPS},
        instead={"pymc_features.ambient.identify.of_band": work},
        more={"channels": ODD_CHANNELS},
    ),
    "ModalData": Call(
        pmf.modal.ModalData,
        {
            "frequencies": [1.2, 3.5],
            "shapes": SHAPES,
            "channels": ["floor", "roof"],
            "frequency_sd": None,
            "damping_ratios": None,
            "damping_sd": None,
            "shape_sd": None,
            "labels": None,
            "name": "",
        },
        {
            "frequencies": PAIR,
            "channels": LABELS,
            "frequency_sd": {"None", *PAIR},
            "damping_ratios": {"None"},
            "damping_sd": {"None", "array with nan", *PAIR},
            "shape_sd": {"None"},
            "labels": {"None"} | LABELS | (PAIR - {"DataArray"}),
            "name": TEXTS | NUMBERS,
        },
        {"shapes": ["channels"], "channels": ["shapes"]},
    ),
    "match_modes": Call(
        pmf.modal.match_modes,
        {"posterior": None, "name": None, "model": MODEL, "deviations": 3.0, "least_mac": 0.5},
        {
            "posterior": {"None"},
            "name": {"None"},
            "deviations": POSITIVE,
            "least_mac": FRACTIONS,
        },
        instead={
            "pymc_features.modal.feature.evaluate": work,
            "pymc_features.modal.feature.values_at_start": work,
            "pymc_features.modal.feature.match_of": str,
        },
    ),
    "ModalFeature": Call(
        pmf.ModalFeature,
        {
            "name": "y",
            "modes": MODES,
            "observed": MODAL,
            "sigma_f": 0.1,
            "sigma_phi": 0.1,
            "sigma_zeta": None,
            "density": "EXP",
            "labels": None,
            "dims": None,
        },
        {
            "name": TEXTS,
            "observed": PAIR,
            "sigma_f": SCALE,
            "sigma_phi": SCALE,
            "sigma_zeta": {"None"},
            "density": SCALE,
            "labels": {"None"} | LABELS,
            "dims": {"None"},
        },
        {"observed": ["frequencies"]},
        coords={},
        instead={"pymc_features.modal.feature.warn_at_start": str},
    ),
}
