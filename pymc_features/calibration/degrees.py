"""`fill_degrees`: the degrees of freedom of a feature likelihood, from the residuals of a fit."""

import numpy as np
import pymc as pm
import xarray as xr
from pytensor.graph.basic import Constant

from pymc_features._checks import check_model, check_seed
from pymc_features.calibration.climb import climb_likelihood
from pymc_features.calibration.effective import described, sensor_n_eff
from pymc_features.calibration.fit import Predictions
from pymc_features.calibration.peaks import Peak, best_fit
from pymc_features.calibration.sandwich import sandwich
from pymc_features.distributions.checks import warn_about_variance
from pymc_features.distributions.gamma import Filled, GammaFeatureRV

FIRST = 2.0  # degrees of freedom of the first fit: those of EXP


def fill_degrees(model: pm.Model | None = None, *, random_seed: int | None = None) -> xr.Dataset:
    """Take the degrees of freedom m of each ``GammaFeature(..., m="residuals")`` from the residuals.

    The likelihood is maximised with m = 2; the observations that the residuals of each sensor support, as
    `effective_samples` counts them, become its m, and a second fit from there gives those that stay. A
    sensor whose response no parameter changes gets the mean of the others. Repeat it after `pm.set_data`
    with other data.

    Parameters
    ----------
    model : pymc.Model, optional
        The model of the context by default. Its data `{name}_m` are set.
    random_seed : int, optional
        For the choice of points to climb from.

    Returns
    -------
    Dataset
        As from `effective_samples`, of the second fit; m is `n_eff`.

    Raises
    ------
    TypeError, ValueError
        If no likelihood waits for m, or as of `effective_samples`.

    Warns
    -----
    CalibrationWarning
        If errors persist for more than a fifth of the record.
    FeatureLikelihoodWarning
        If so few observations are left that the posterior has no finite variance.

    Examples
    --------
    >>> from pymc_features import GammaFeature
    >>> measured = np.random.default_rng(1).normal(3.0, 1.0, size=(1, 500))
    >>> with pm.Model() as model:
    ...     mu = pm.Normal("mu", 0.0, 10.0) * np.ones((1, 500))
    ...     y = GammaFeature("y", mu, pm.HalfNormal("sigma"), m="residuals", observed=measured)
    ...     counted = fill_degrees(random_seed=1)
    >>> bool((model["y_m"].get_value() > 300).all())  # white noise: about all samples
    True
    """
    check_seed(random_seed)
    model = check_model(model)
    waiting = degrees_of(model)
    before = {rv.name: data.get_value() for rv, data in waiting.items()}
    for data in waiting.values():
        data.set_value(np.full(data.get_value().shape, FIRST))
    try:
        predictions = Predictions(model)
        fit = best_fit(predictions, None, np.random.default_rng(random_seed))
        fill(waiting, fit)
        fit = climb_likelihood(predictions, fit.z)
        fill(waiting, fit)
    except Exception:
        for rv, data in waiting.items():
            data.set_value(before[rv.name])
        raise
    for rv, data in waiting.items():
        sigma = rv.owner.inputs[3]
        if not isinstance(sigma, Constant):
            warn_about_variance("GammaFeature", data.get_value().ravel(), sigma)
    return described(predictions, Peak(fit, sandwich(fit.events)))


def degrees_of(model) -> dict:
    """Data of the degrees of freedom that residuals decide, by random variable."""
    found = {}
    for rv in model.observed_RVs:
        m = rv.owner.inputs[-1] if isinstance(rv.owner.op, GammaFeatureRV) else None
        if m is not None and m.owner is not None and isinstance(m.owner.op, Filled):
            found[rv] = m.owner.inputs[0]
    if not found:
        names = ", ".join(rv.name for rv in model.observed_RVs) or "no likelihood"
        raise ValueError(
            f"`model` must have a GammaFeature with m='residuals', got {names}. Declare it so, or use "
            "effective_samples()."
        )
    return found


def fill(waiting, fit):
    """Set degrees of freedom to the observations that the residuals of a fit support."""
    events = {event.name: event for event in fit.events}
    for rv, data in waiting.items():
        event = events[rv.name]
        counted = np.array([sensor_n_eff(event, j) for j in range(len(event.claimed))])
        if np.isnan(counted).all():
            raise ValueError(f"`model` must have parameters that change the response of {rv.name}, got none.")
        counted = np.where(np.isnan(counted), np.nanmean(counted), counted)
        data.set_value(counted.reshape(data.get_value().shape))
