"""The PyMC models of the study, one for each way to compare response and data."""

from collections.abc import Callable

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import xarray as xr

from pymc_features.likelihoods import DIMS, LIKELIHOODS, Comparison
from pymc_features.ops import response
from pymc_features.records import Record
from pymc_features.structures import Structure
from pymc_features.study import paper


def declare(
    kind: str,
    record: Record,
    data: xr.DataArray,
    *,
    structure: Callable[[pt.TensorVariable], Structure] = paper.chain,
    tolerance: float | None = None,
    scale: float | None = None,
) -> pm.Model:
    """Return the model of one structure, ``theta -> structure``, under one of the `LIKELIHOODS`.

    It has `theta`, `sigma` and `tau` where they are inferred, and `y`: floor accelerations (sensor, time)
    [m/s^2]. ABC has the `tolerance` delta [m^2/s^4], and CN knows the `scale` of the noise [m/s^2].
    Measurements, their step and the tolerance are data of the model: `set_measurements` changes them without
    compiling anything anew.
    """
    likelihood, times = LIKELIHOODS[kind], data["time"].values
    coords = {"sensor": data["sensor"].values, "time": times}
    with pm.Model(coords=coords) as model:
        theta = pm.Uniform("theta", *paper.THETA_RANGE)
        step = pm.Data("step", times[1] - times[0])
        measured = pm.Data("measured", data.values, dims=DIMS)
        delta = None if tolerance is None else pm.Data("tolerance", tolerance)
        mu = response(structure(theta), record, dt=step)
        tau, sigma = correlation_time(likelihood), noise_scale(likelihood, scale)
        likelihood.declare(Comparison(mu, measured, sigma, tau, epsilon=delta, dt=step))
    return model


def noise_scale(likelihood, scale):
    """sigma [m/s^2]: `scale` where it is known, else a variable."""
    if "sigma" not in likelihood.takes:
        return None
    known = "sigma" in likelihood.known
    return pt.as_tensor_variable(scale) if known else pm.Uniform("sigma", *paper.SIGMA_RANGE)


def correlation_time(likelihood):
    """tau [s]: that of the noise where it is known, else a variable."""
    if "correlation_time" not in likelihood.takes:
        return None
    if "correlation_time" in likelihood.known:
        return pt.as_tensor_variable(paper.CORRELATION_TIME)
    return pm.Deterministic("tau", pt.exp(pm.Uniform("log_tau", *np.log(paper.TAU_RANGE))))


def set_measurements(model: pm.Model, data: xr.DataArray, tolerance: float | None = None):
    """Give a model of `declare` other measurements, at another step."""
    times = data["time"].values
    with model:
        pm.set_data({"measured": data.values, "step": times[1] - times[0]}, coords={"time": times})
        if tolerance is not None:
            pm.set_data({"tolerance": tolerance})
