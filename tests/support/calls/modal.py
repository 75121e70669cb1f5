"""Identified modes: their files, their likelihood, and modes inside a model."""

from pathlib import Path

import numpy as np
import pymc as pm

import pymc_features as pmf
from support.border import Call, work
from support.calls.files import FOLDER, MEASURED, ODD_CHANNELS, SEVERAL, elsewhere
from support.calls.structures import CHAIN, SCALARS, TAKEN
from support.odd_values import NUMBERS, PAIR, POSITIVE, TEXTS

TABLE = Path(FOLDER.name) / "modes.csv"
TABLE.write_text("omega [rad/s],damping [%],roof\n6.2832,1.2,1.0\n18.85,0.9,-0.5\n")
SHAPES = [[0.6, 1.0], [1.0, -0.5]]
MODAL = pmf.ModalData([1.2, 3.5], SHAPES, ["floor", "roof"])
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
    "propose_bands": Call(
        pmf.propose_bands,
        {"channels": MEASURED, "highest": None},
        {"highest": {"None", *POSITIVE}, "channels": WITHOUT_GAPS},
        instead={"pymc_features.ambient.identify.averaged_spectra": work},
        more={"channels": ODD_CHANNELS},
    ),
    "plot_singular_values": Call(
        pmf.plot_singular_values,
        {"channels": MEASURED, "bands": [0.3, 2.0], "frequencies": [1.0], "fitted": None},
        {
            "bands": {"None"} | PAIR,
            "frequencies": {"None", "[]", *NUMERIC},
            "channels": WITHOUT_GAPS,
            "fitted": {"None"},
        },
        instead={"pymc_features.plots.spectra.checked_axes": work},
        more={"channels": ODD_CHANNELS},
    ),
    "ModalData": Call(
        pmf.ModalData,
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
    "merge_setups": Call(
        pmf.merge_setups,
        {
            "setups": [MODAL, MODAL],
            "references": ["floor", "roof"],
            "frequency_tolerance": 0.05,
            "least_mac": 0.8,
        },
        {
            "references": {"None"},
            "least_mac": FRACTIONS,
        },
        {"references": ["channels"]},
    ),
    "mac": Call(
        pmf.mac,
        {"shapes": SHAPES, "others": SHAPES},
    ),
    "match_modes": Call(
        pmf.match_modes,
        {"posterior": None, "name": None, "model": MODEL, "deviations": 3.0, "least_mac": 0.5},
        {
            "posterior": {"None"},
            "name": {"None"},
            "deviations": POSITIVE,
            "least_mac": FRACTIONS,
        },
        instead={
            "pymc_features.modal_features.feature.evaluate": work,
            "pymc_features.modal_features.feature.evaluate_draws": work,
            "pymc_features.modal_features.feature.match_of": str,
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
            "density": "EXP",
            "labels": None,
            "dims": None,
        },
        {
            "name": TEXTS,
            "observed": PAIR,
            "sigma_f": SCALE,
            "sigma_phi": SCALE,
            "density": SCALE,
            "labels": {"None"} | LABELS,
            "dims": {"None"},
        },
        {"observed": ["frequencies"]},
        coords={},
        instead={"pymc_features.modal_features.feature.warn_at_start": str},
    ),
    "modes": Call(
        pmf.modes,
        {"structure": CHAIN, "n_modes": None, "sensors": None, "outputs": None},
        TAKEN,
    ),
    "write_modal": Call(
        elsewhere(pmf.write_modal, FOLDER.name),
        {"modal": pmf.ModalData([1.0, 2.0]), "path": TABLE.with_name("written.csv")},
        {},
    ),
    "read_modal": Call(
        pmf.read_modal,
        {"source": TABLE, "names": None, "channels": None, "real": True},
        {"names": {"None"}, "channels": {"None"}, "real": {"True"}},
    ),
}
