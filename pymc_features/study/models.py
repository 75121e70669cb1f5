"""The PyMC models of the study, one for each way to compare response and data."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import xarray as xr

from pymc_features.distributions import CorrelatedNormal, ExpFeature, TruncNormalFeature
from pymc_features.likelihood_free import DiscrepancySimulator
from pymc_features.ops import response
from pymc_features.records import Record
from pymc_features.structures import Structure
from pymc_features.study import paper

DIMS = ("sensor", "time")


@dataclass
class Ingredients:
    """What the likelihoods of the study are made of.

    Attributes
    ----------
    mu : TensorVariable (sensor, time)
        Response.
    data, step, tolerance : pm.Data
        Measurements, their step [s], and delta of ABC.
    scale : float
        Of the noise, where a likelihood knows it [m/s^2].
    """

    mu: pt.TensorVariable
    data: pt.TensorVariable
    step: pt.TensorVariable
    tolerance: pt.TensorVariable | None
    scale: float

    @staticmethod
    def sigma():
        """The scale where it is inferred."""
        return pm.Uniform("sigma", *paper.SIGMA_RANGE)


def _norm(it):
    pm.Normal("y", mu=it.mu, sigma=it.sigma(), observed=it.data, dims=DIMS)


def _tn(it):
    TruncNormalFeature("y", mu=it.mu, sigma=it.sigma(), observed=it.data, dims=DIMS)


def _exp(it):
    ExpFeature("y", mu=it.mu, sigma=it.sigma(), observed=it.data, dims=DIMS)


def _abc(it):
    DiscrepancySimulator("y", it.mu, epsilon=it.tolerance, observed=it.data, dims=DIMS)


def _correlated(it, sigma, tau):
    CorrelatedNormal("y", it.mu, sigma, tau, it.step, observed=it.data, dims=DIMS)


def _all_known(it):
    _correlated(it, it.scale, paper.CORRELATION_TIME)


def _known_time(it):
    _correlated(it, it.sigma(), paper.CORRELATION_TIME)


def _unknown_time(it):
    log_tau = pm.Uniform("log_tau", *np.log(paper.TAU_RANGE))
    _correlated(it, it.sigma(), pm.Deterministic("tau", pt.exp(log_tau)))


# The place of a likelihood is part of its seed: new ones go to the end.
LIKELIHOODS = {
    "NORM": _norm,
    "TN": _tn,
    "EXP": _exp,
    "ABC": _abc,
    "CN": _all_known,
    "CN-SIGMA": _known_time,
    "CN-TAU": _unknown_time,
}


def declare(
    likelihood: str,
    record: Record,
    data: xr.DataArray,
    *,
    structure: Callable[[pt.TensorVariable], Structure] = paper.chain,
    tolerance: float | None = None,
    scale: float | None = None,
) -> pm.Model:
    """Return the model of one structure of the study under one likelihood.

    Parameters
    ----------
    likelihood : {"NORM", "TN", "EXP", "ABC", "CN", "CN-SIGMA", "CN-TAU"}
        Eq. (2), (7), (9), the simulator node of Eqs. (14)-(15), or `CorrelatedNormal` with correlation time
        and scale known, the scale inferred, or both.
    record : Record
        Ground acceleration.
    data : DataArray (sensor, time)
        Measured floor accelerations [m/s^2] with their times.
    structure : callable
        theta -> structure.
    tolerance : float, optional
        delta of ABC [m^2/s^4].
    scale : float, optional
        Standard deviation of the noise that CN knows [m/s^2].

    Returns
    -------
    pymc.Model
        With `theta`, `sigma` and `tau` where they are inferred, and the data `y`. Measurements, their step
        and the tolerance are data of the model: `set_measurements` changes them without compiling anything
        anew.
    """
    times = data["time"].values
    coords = {"sensor": data["sensor"].values, "time": times}
    with pm.Model(coords=coords) as model:
        theta = pm.Uniform("theta", *paper.THETA_RANGE)
        step = pm.Data("step", times[1] - times[0])
        measured = pm.Data("measured", data.values, dims=("sensor", "time"))
        delta = None if tolerance is None else pm.Data("tolerance", tolerance)
        mu = response(structure(theta), record, dt=step)
        LIKELIHOODS[likelihood](Ingredients(mu, measured, step, delta, scale))
    return model


def set_measurements(model: pm.Model, data: xr.DataArray, tolerance: float | None = None):
    """Give a model of `declare` other measurements, at another step."""
    times = data["time"].values
    with model:
        pm.set_data({"measured": data.values, "step": times[1] - times[0]}, coords={"time": times})
        if tolerance is not None:
            pm.set_data({"tolerance": tolerance})
