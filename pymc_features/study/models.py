"""The PyMC models of the study, one for each way to compare response and data."""

import pymc as pm
import xarray as xr

from pymc_features.distributions import ExpFeature, TruncNormalFeature
from pymc_features.likelihood_free import DiscrepancySimulator
from pymc_features.ops import response
from pymc_features.records import Record
from pymc_features.study import paper


def _norm(mu, sigma, data, tolerance):
    pm.Normal("y", mu=mu, sigma=sigma, observed=data, dims=("sensor", "time"))


def _tn(mu, sigma, data, tolerance):
    TruncNormalFeature("y", mu=mu, sigma=sigma, observed=data, dims=("sensor", "time"))


def _exp(mu, sigma, data, tolerance):
    ExpFeature("y", mu=mu, sigma=sigma, observed=data, dims=("sensor", "time"))


def _abc(mu, sigma, data, tolerance):
    DiscrepancySimulator("y", mu, epsilon=tolerance, observed=data, dims=("sensor", "time"))


# ABC comes last: its tolerance follows from the EXP posterior at the same sampling step.
LIKELIHOODS = {"NORM": _norm, "TN": _tn, "EXP": _exp, "ABC": _abc}


def declare(
    likelihood: str,
    record: Record,
    data: xr.DataArray,
    *,
    stiffness: float = paper.STIFFNESS,
    tolerance: float | None = None,
) -> pm.Model:
    """Return the model of the ten-storey example under one likelihood.

    Parameters
    ----------
    likelihood : {"NORM", "TN", "EXP", "ABC"}
        Eq. (2), (7), (9), or the simulator node of Eqs. (14)-(15).
    record : Record
        Ground acceleration.
    data : DataArray (sensor, time)
        Measured floor accelerations [m/s^2] with their times.
    stiffness : float
        Nominal spring stiffness [N/m].
    tolerance : float, optional
        delta of ABC [m^2/s^4].

    Returns
    -------
    pymc.Model
        With `theta`, `sigma` (but for ABC) and the data `y`. Measurements, their step and the tolerance are
        data of the model: `set_measurements` changes them without compiling anything anew.
    """
    times = data["time"].values
    coords = {"sensor": data["sensor"].values, "time": times}
    with pm.Model(coords=coords) as model:
        theta = pm.Uniform("theta", *paper.THETA_RANGE)
        sigma = pm.Uniform("sigma", *paper.SIGMA_RANGE) if likelihood != "ABC" else None
        step = pm.Data("step", times[1] - times[0])
        measured = pm.Data("measured", data.values, dims=("sensor", "time"))
        delta = None if tolerance is None else pm.Data("tolerance", tolerance)
        mu = response(paper.chain(theta, stiffness=stiffness), record, dt=step)
        LIKELIHOODS[likelihood](mu, sigma, measured, delta)
    return model


def set_measurements(model: pm.Model, data: xr.DataArray, tolerance: float | None = None):
    """Give a model of `declare` other measurements, at another step."""
    times = data["time"].values
    with model:
        pm.set_data({"measured": data.values, "step": times[1] - times[0]}, coords={"time": times})
        if tolerance is not None:
            pm.set_data({"tolerance": tolerance})
