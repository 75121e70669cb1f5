"""Several events: as far as the arguments are checked."""

import pymc as pm
import xarray as xr

import pymc_features as pmf
from support.border import Call, work
from support.calls.samplers import MODEL, ODD_TREES, POSTERIOR
from support.odd_values import PAIR, POSITIVE, TEXTS

ONE_SEED = {"None", "0"}

with pm.Model() as POPULATION:
    pm.Normal("x", pm.Normal("mean"), 1.0)

with pm.Model() as PLACES:
    pm.Normal("y", pm.Normal("x"), 1.0, observed=[[1.0], [2.0]])
STATS = {"log_evidence": -1.0, "log_evidence_se": 0.01, "likelihoods": '{"y": "data"}'}
SAMPLED = xr.DataTree.from_dict(
    {
        "posterior": POSTERIOR,
        "sample_stats": xr.Dataset(attrs=STATS),
        "observed_data": xr.Dataset({"y": ("time", [1.0, 2.0])}),
    }
)

CALLS = {
    "compare": Call(
        pmf.compare,
        {
            "models": {"a": SAMPLED, "b": SAMPLED},
            "prior": {"a": 1.0, "b": 2.0},
            "checks": None,
            "held_out": {"a": [1.0], "b": [2.0]},
            "predictions": {"a": POSTERIOR, "b": POSTERIOR},
            "random_seed": 1,
        },
        {name: {"None"} for name in ("prior", "checks", "held_out", "predictions")}
        | {"random_seed": ONE_SEED},
        more={"models": {name: {"a": SAMPLED, "b": tree} for name, tree in ODD_TREES.items()}},
    ),
    "sample_in_sequence": Call(
        pmf.events.sample_in_sequence,
        {
            "events": [MODEL, MODEL],
            "model": None,
            "out": None,
            "draws": 100,
            "chains": 2,
            "random_seed": 1,
        },
        {
            "model": {"None"},
            "out": {"None", *TEXTS},
            "random_seed": ONE_SEED,
        },
        {"model": ["events"]},
        instead={"pymc_features.events.sequence.PartStore": work},
    ),
    "sensor_placement": Call(
        pmf.sensor_placement,
        {
            "model": PLACES,
            "candidates": [0, 1],
            "n": 1,
            "criterion": "D",
            "positions": [0.0, 1.0],
            "correlation_length": 1.0,
            "idata": None,
        },
        {
            "candidates": {"None"},
            "positions": {"None", *PAIR},
            "correlation_length": POSITIVE,
            "idata": {"None"},
        },
        {"candidates": ["positions", "n"]},
        instead={"pymc_features.prediction.sensors.gram_matrices": work},
        more={"idata": ODD_TREES},
    ),
}
