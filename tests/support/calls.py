"""Calls of public functions, one for each kind of check, with what each argument takes besides."""

from contextlib import chdir
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import xarray as xr

import pymc_features as pmf
from support.border import Call, work

FOLDER = TemporaryDirectory()
PLACE = Path(FOLDER.name)
TEXT = {"text"}  # names and paths
NAME = {"name": TEXT}
ANY_NAME = {"name": {"text", "-1.0", "nan"}}
PATHS = dict.fromkeys(("checkpoint", "executor", "out", "scratch", "cache"), TEXT)

# structures and records
RECORD = pmf.Record([0.0, 1.0, 0.5], 0.1)
DAMPING = pmf.ModalDamping(0.02)
CHAIN = pmf.SpringMassChain([1.0, 1.0], 100.0, DAMPING)
CHAIN_OF_TWO = {"mass": [1.0, 1.0], "stiffness": [100.0, 90.0], "damping": DAMPING}
YIELD = {"yield_displacement": 0.1, "post_yield_ratio": 0.1, "sharpness": 2.0, "beta": 0.5, "gamma": 0.5}
PINCHING = {"slip": 0.5, "rate": 1.0, "initiation": 0.1, "spread": 0.2, "spread_rate": 0.0, "severity": 0.3}
for name, factor in (("base", 1.0), ("stiffer", 2.0)):
    np.savez(PLACE / f"{name}.npz", M=np.eye(2), K=factor * np.array([[2.0, -1.0], [-1.0, 1.0]]))
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
AFFINE_TAKES = {
    "stiffness_terms": {"three dimensions"},
    "mass_terms": {"[]", "three dimensions"},
    "damping_terms": {"[]"},
}
EXPORTS = {
    "base": PLACE / "base.npz",
    "terms": {"k": (PLACE / "stiffer.npz", 2.0)},
    "damping": DAMPING,
    "direction": None,
    "units": None,
}
OUTPUTS = {"dt": None, "sensors": None, "n_modes": None, "outputs": None}
STRUCTURES = {
    "Record": Call(
        pmf.Record,
        {"acceleration": [0.0, 1.0], "dt": 0.1, "name": "", "interpolation": "linear"},
        ANY_NAME,
    ),
    "Pinching": Call(pmf.structures.Pinching, PINCHING),
    "SpringMassChain": Call(pmf.SpringMassChain, CHAIN_OF_TWO),
    "HystereticChain": Call(pmf.HystereticChain, CHAIN_OF_TWO | YIELD),
    "AffineStructure": Call(pmf.AffineStructure, AFFINE, AFFINE_TAKES, {"stiffness_terms": ["theta"]}),
    "AffineStructure.from_files": Call(pmf.AffineStructure.from_files, EXPORTS),
    "simulate": Call(
        pmf.simulate, {"structure": CHAIN, "record": RECORD, "quantity": "relative_velocity", **OUTPUTS}
    ),
}

# likelihoods
MU = np.zeros((2, 3))
DATA = np.arange(6.0).reshape(2, 3)
NAMED = {"name": "y", "mu": MU, "sigma": 1.0, "observed": DATA, "dims": ("sensor", "time")}
AMBIENT = {
    "name": "y",
    "response": pmf.ambient.spectral_response(CHAIN, 1.0),
    "error": 1.0,
    "bands": [0.5, 2.0],
    "dt": 0.1,
    "observed": np.ones((2, 100)),
    "mu": None,
    "dims": ("sensor", "time"),
}
SIMULATED = {
    "name": "y",
    "mu": lambda theta: theta * DATA,
    "params": pt.dscalar("theta"),
    "epsilon": 1.0,
    "observed": DATA,
    "kernel": "uniform",
    "noise": None,
    "dims": None,
}
LIKELIHOODS = {
    "AmbientResponse": Call(
        pmf.AmbientResponse,
        AMBIENT,
        NAME,
        {"dt": ["bands"], "observed": ["bands"]},
        coords={"sensor": range(2), "time": range(100)},
        instead={"pymc_features.ambient.response.warn_at_start": work},
    ),
    "TruncNormalFeature": Call(
        pmf.TruncNormalFeature, NAMED | {"density": "data"}, NAME, coords={"sensor": range(2)}
    ),
    "CorrelatedNormal": Call(
        pmf.CorrelatedNormal,
        NAMED | {"correlation_time": 1.0, "dt": 0.1},
        NAME,
        coords={"sensor": range(2)},
    ),
    "DiscrepancySimulator": Call(
        pmf.DiscrepancySimulator,
        SIMULATED,
        NAME | {"params": {"-1.0", "[]", "nan", "three dimensions"}},
        positional=("name", "mu", "params"),
        coords={},
    ),
    "abc_tolerance": Call(pmf.likelihoods.abc_tolerance, {"sigma": 1.0, "n_sensors": 2}),
}

# files and signals
SHAKEN = PLACE / "shaken.csv"
SHAKEN.write_text("time,base,roof\n" + "".join(f"{0.1 * i:.1f},{i % 3},{i % 4}\n" for i in range(9)))
FUNCTIONS = PLACE / "beam.csv"
FUNCTIONS.write_text("f,re,im\n1,2,3\n2,3,4\n")
BLOWS = {"excitation": np.zeros((4, 64)), "response": np.random.default_rng(2).standard_normal((4, 1, 64))}
BLOWS["excitation"][:, 3:6] = 1.0, 3.0, 1.0


def channels(**changes):
    """A noisy sine at two sensors, or something odd like it."""
    time = 0.02 * np.arange(800)
    noise = np.random.default_rng(1).standard_normal((2, 800))
    values = np.sin(3.0 * time) * np.exp(-0.1 * time) * [[1.0], [1.1]] + 0.1 * noise
    coords = {"sensor": ["base", "roof"], "time": time}
    given = {"data": values, "dims": ("sensor", "time"), "coords": coords, "attrs": {"units": "m/s^2"}}
    return xr.DataArray(**given | changes)


MEASURED = channels()
DATES = {"time": np.datetime64("2020-01-01", "ns") + np.arange(800)}
ODD_CHANNELS = {
    "channels with time first": MEASURED.transpose(),
    "channels without times": MEASURED.drop_vars("time"),
    "channels at dates": MEASURED.assign_coords(DATES),
    "channels at uneven times": MEASURED.assign_coords(time=MEASURED.time**2),
    "complex channels": MEASURED.astype(complex),
    "channels of texts": MEASURED.astype(str),
    "channels with NaN": MEASURED.where(MEASURED.time != MEASURED.time[3]),
    "channels of one sample": MEASURED[:, :1],
    "channels without names": MEASURED.drop_vars("sensor"),
    "channels of one name": MEASURED.assign_coords(sensor=["roof", "roof"]),
    "one channel": MEASURED[0],
}
WITH_GAPS = {"channels with NaN"}
WITHOUT_NAMES = {"channels without names"}
ONE_OR_ALIKE = {"channels of one name", "one channel"}
MORE = {"channels": ODD_CHANNELS}


def write_channels(channels, path):
    """In a folder of its own, should it be written whatever the path."""
    with chdir(PLACE):
        return pmf.io.write_channels(channels, path)


READ = {
    "files": SHAKEN,
    "columns": None,
    "units": "g",
    "dt": None,
    "clock": None,
    "clock_units": None,
    "skip": 0,
    "wrapped": None,
    "resample": None,
}
EARTHQUAKE = {"duration": 1.0, "dt": 0.1, "random_seed": 1, "pga": 3.0, "spectrum": None, "envelope": None}
TABULATED = {
    "files": FUNCTIONS,
    "units": "m/N",
    "response": "2",
    "reference": "1",
    "columns": ["f", "re", "im"],
}
STRUCK = BLOWS | {"fs": 64.0, "method": "H1", "units": "m/N", "band": (2.0, 20.0), "decay": 0.1}
FILES = {
    "read_record": Call(
        pmf.read_record,
        {"path": SHAKEN, "units": "g", "dt": None, "column": "roof", "wrapped": None},
        called={"column": ["dt"], "wrapped": ["column"], "path": ["files", "column", "dt"]},
    ),
    "read_channels": Call(
        pmf.read_channels, READ, called={"clock_units": ["dt"], "wrapped": ["dt"], "files": ["dt"]}
    ),
    "write_channels": Call(
        write_channels,
        {"channels": MEASURED, "path": PLACE / "written.csv"},
        {"channels": WITH_GAPS},
        more=MORE,
    ),
    "synthetic_earthquake": Call(pmf.synthetic_earthquake, EARTHQUAKE),
    "signals.check_channels": Call(
        pmf.signals.check_channels,
        {"channels": MEASURED, "band": (0.5, 2.0), "base": None, "damping_ratio": 0.02},
        {"channels": WITH_GAPS | WITHOUT_NAMES},
        more=MORE,
    ),
    "read_frequency_response": Call(
        pmf.io.read_frequency_response,
        TABULATED,
        {"response": TEXT, "reference": TEXT, "columns": {"[]"}},
    ),
    "signals.frequency_response": Call(
        pmf.signals.frequency_response,
        STRUCK | {"leave_out": [("0", 1)]},
        {"leave_out": {"[]"}},
        {"excitation": ["channels"], "fs": ["dt", "band"]},
    ),
    "signals.trim": Call(
        pmf.signals.trim,
        {"channels": MEASURED, "start": 0.5, "stop": 9.0},
        {"channels": WITH_GAPS | WITHOUT_NAMES | ONE_OR_ALIKE},
        {"start": ["start, stop"], "stop": ["start, stop"]},
        more=MORE,
    ),
}

# modes
SHAPES = [[0.6, 1.0], [1.0, -0.5]]
IDENTIFIED = pmf.modal.ModalData([1.2, 3.5], SHAPES, ["floor", "roof"])
MODES = (np.array([1.2, 3.5, 5.0]), np.array([*SHAPES, [1.0, 1.0]]))
with pm.Model() as OF_MODES:
    pmf.ModalFeature(
        "y", (pm.LogNormal("f", shape=3), MODES[1]), observed=IDENTIFIED, sigma_f=0.1, sigma_phi=0.1
    )
MODAL_DATA = {
    "frequencies": [1.2, 3.5],
    "shapes": SHAPES,
    "channels": ["floor", "roof"],
    "frequency_sd": None,
    "damping_ratios": None,
    "damping_sd": None,
    "shape_sd": None,
    "labels": None,
    "name": "",
}
FEATURE = {
    "name": "y",
    "modes": MODES,
    "observed": IDENTIFIED,
    "sigma_f": 0.1,
    "sigma_phi": 0.1,
    "sigma_zeta": None,
    "density": "EXP",
    "labels": None,
    "dims": None,
}
MODAL = {
    "identify_modes": Call(
        pmf.identify_modes,
        {"channels": MEASURED, "bands": [0.3, 2.0], "n_modes": None, "quantity": "acceleration"},
        {"channels": WITHOUT_NAMES},
        instead={"pymc_features.ambient.identify.of_band": work},
        more=MORE,
    ),
    "ModalData": Call(
        pmf.modal.ModalData, MODAL_DATA, ANY_NAME, {"shapes": ["channels"], "channels": ["shapes"]}
    ),
    "match_modes": Call(
        pmf.modal.match_modes,
        {"posterior": None, "name": None, "model": OF_MODES, "deviations": 3.0, "least_mac": 0.5},
        instead={"pymc_features.modal.feature.partners_of": work},
    ),
    "ModalFeature": Call(
        pmf.ModalFeature,
        FEATURE,
        NAME,
        {"observed": ["frequencies"]},
        coords={},
        instead={"pymc_features.modal.feature.warn_at_start": str},
    ),
}

# samplers
with pm.Model() as MODEL:
    pm.Normal("y", pm.Normal("x"), 1.0, observed=[1.0])
DRAWS = np.random.default_rng(1).standard_normal((2, 50))
POSTERIOR = xr.Dataset({"x": (("chain", "draw"), DRAWS)}, {"chain": [0, 1], "draw": np.arange(50)})
ODD_POSTERIORS = {
    "posterior without draws": POSTERIOR.isel(draw=slice(0)),
    "posterior without chains": POSTERIOR.isel(chain=0, drop=True),
    "posterior of texts": POSTERIOR.astype(str),
    "posterior of complex": POSTERIOR.astype(complex),
    "posterior of NaN": POSTERIOR * np.nan,
    "posterior of others": POSTERIOR.rename(x="z"),
    "empty posterior": xr.Dataset(),
}
ODD_TREES = {name: xr.DataTree.from_dict({"posterior": odd}) for name, odd in ODD_POSTERIORS.items()}
ODD_TREES["dict of a posterior"] = {"posterior": POSTERIOR}
IDATA = xr.DataTree.from_dict({"posterior": POSTERIOR})
RUN = {"draws": 100, "chains": 2, "cores": 1, "random_seed": 1, "checkpoint": None, "progressbar": False}
RUN |= {"executor": None, "model": MODEL}
KERNEL = {"draws": 100, "threshold": 0.5, "start": None, "model": MODEL, "random_seed": 1}
KERNEL |= {"compile_kwargs": None, "checkpoint": None, "reference": None, "gradients": False}


def no_prior(model, from_prior):
    """In place of the function that draws from the prior."""
    return lambda n, rng: {v.name: np.zeros((n, *np.shape(v.type.shape))) for v in model.value_vars}


SAMPLERS = {
    "PersistentSMC": Call(
        pmf.PersistentSMC,
        KERNEL | {"stage_draws": None},
        PATHS | {"random_seed": {"None"}},
        instead={
            "pymc_features.smc.kernels.base.model_fingerprint": work,
            "pymc_features.smc.kernels.base.prior_draws": no_prior,
            "pymc_features.smc.kernels.base.population_logp": lambda *_: SimpleNamespace(
                compile_gradient=str
            ),
        },
    ),
    "sample_smc": Call(
        pmf.sample_smc,
        RUN | {"kernel": pmf.PersistentSMC},
        PATHS,
        instead={
            "pymc.sample_smc": work,
            "pymc_features.smc.sample.remembered": work,
            "pymc_features.smc.workers.open_executor": work,
        },
    ),
    "sample": Call(
        pmf.sample,
        RUN | {"compile_kwargs": None, "check": None},
        PATHS,
        instead={
            "pymc_features.inference.sample.Unconstrained": work,
            "pymc_features.inference.sample.remembered": work,
        },
    ),
    "laplace": Call(
        pmf.laplace,
        {"draws": 100, "model": MODEL, "start": {"x": 1.0}, "random_seed": 1, "compile_kwargs": None},
        instead={"pymc_features.inference.laplace.Unconstrained": work},
    ),
    "emulate": Call(
        pmf.emulate,
        {"runs": 100, "model": MODEL, "batch": 8, "tolerance": 0.02},
        instead={"pymc_features.external.emulation.replaced": work},
    ),
    "calibrate": Call(
        pmf.calibrate,
        {"idata": IDATA, "model": MODEL, "draws": 100, "model_error": "bands", "base_noise": 0.1},
        {"model_error": {"None"}},
        instead={"pymc_features.calibration.calibrate.Predictions": work},
        more={"idata": ODD_TREES},
    ),
}


# what stands on them
def built(x=1.0, z=1.0):
    """A structure of the parameter that was sampled, or of another."""
    return CHAIN


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
COMPARED = {
    "models": {"a": SAMPLED, "b": SAMPLED},
    "prior": {"a": 1.0, "b": 2.0},
    "checks": None,
    "held_out": {"a": [1.0], "b": [2.0]},
    "predictions": {"a": POSTERIOR, "b": POSTERIOR},
}
STUDY = {
    "record": RECORD,
    "structure": "linear",
    "noise": 0.05,
    "multipliers": [1.0],
    "likelihoods": ["TN"],
    "out": None,
    "progress": None,
    "noise_time": 0.0,
}
SIMULATOR = {
    "function": lambda x: np.ones((2, 3)) * x,
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
PROGRAM = {
    "command": ["run"],
    "parameters": ["k"],
    "inputs": {},
    "result": "out.txt",
    "columns": None,
    "transpose": True,
    "files": (),
}
RESULTS = {
    "compare": Call(
        pmf.compare,
        COMPARED,
        more={"models": {name: {"a": SAMPLED, "b": tree} for name, tree in ODD_TREES.items()}},
    ),
    "sample_in_sequence": Call(
        pmf.events.sample_in_sequence,
        {"events": [MODEL, MODEL], "model": None, "out": None},
        PATHS,
        {"model": ["events"]},
        instead={"pymc_features.events.sequence.PartStore": work},
    ),
    "sensor_placement": Call(
        pmf.sensor_placement,
        {"model": PLACES, "n": 1, "criterion": "D", "candidates": [0, 1], "idata": None}
        | {"positions": [0.0, 1.0], "correlation_length": 1.0},
        {"candidates": {"None"}},
        {"candidates": ["positions", "n"]},
        instead={"pymc_features.prediction.sensors.gram_matrices": work},
        more={"idata": ODD_TREES},
    ),
    "posterior_response": Call(
        pmf.prediction.posterior_response,
        {"idata": IDATA, "structure": built, "record": RECORD, "draws": 10, "random_seed": 1}
        | {**OUTPUTS, "quantities": "relative_velocity", "quantiles": [0.5]},
        {"idata": {f"posterior of {kind}" for kind in ("NaN", "texts", "complex", "others")}},
        more={"idata": ODD_TREES},
    ),
    "sampling_rate_study": Call(
        pmf.study.sampling_rate_study,
        STUDY,
        PATHS,
        instead={
            "pymc_features.study.sampling_rate.PartStore": work,
            "pymc_features.study.settings.check_measurements": lambda study: None,
            "pymc_features.study.sampling_rate.seed_in": lambda out: None,
        },
    ),
    "ExternalSimulator": Call(
        pmf.ExternalSimulator,
        SIMULATOR,
        PATHS | {"version": TEXT, "executor": {"None", "text"}},
        instead={"pymc_features.external.evaluator.EvaluationCache": str},
    ),
    "ProgramSimulator": Call(
        pmf.ProgramSimulator, PROGRAM, {"command": TEXT, "result": TEXT, "inputs": {"None"}, "files": {"[]"}}
    ),
    "plots.chains": Call(
        pmf.plots.chains,
        {"idata": IDATA, "kind": "rank", "var_names": None, "backend": "matplotlib"},
        {"idata": {"posterior of others"}},
        instead={f"{pmf.plots.chains.__module__}.checked_axes": work},
        more={"idata": ODD_TREES},
    ),
}

CALLS = STRUCTURES | LIKELIHOODS | FILES | MODAL | SAMPLERS | RESULTS
