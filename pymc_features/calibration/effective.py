"""How many independent observations the residuals support, beside those that a likelihood claims."""

import warnings

import numpy as np
import pymc as pm
import xarray as xr
from pytensor.graph.basic import Constant

from pymc_features._checks import check_group, check_model, check_seed
from pymc_features.calibration.maxima import Peak, best_fit, climb_likelihood, peak_at, starting_points
from pymc_features.calibration.residuals import Event, Predictions
from pymc_features.calibration.sandwich import directions, known, sandwich
from pymc_features.exceptions import CalibrationWarning
from pymc_features.inference.parameters import coordinate_names
from pymc_features.likelihoods.declaration import warn_about_variance
from pymc_features.likelihoods.mean_square import GammaFeatureRV, RequireDegrees

SHORT = 5.0  # time constants of the errors that a record must be long
FIRST = 2.0  # degrees of freedom of the first fit of `fill_degrees`: those of EXP
TINY = np.finfo(float).tiny


def effective_samples(
    source: xr.DataTree | pm.Model, *, model: pm.Model | None = None, random_seed: int | None = None
) -> xr.Dataset:
    """Independent observations that the residuals of a fit support, and the covariance they imply.

    At the maximum of the likelihood the score, the sum of sensitivities times residuals, would vary as much
    as the likelihood claims (A) if the errors were what it takes them for. How much it does vary (B) is
    estimated from the residuals, over time and across sensors (``pymc_features.calibration.sandwich``). In a
    direction v of the parameters the residuals support m v' A^-1 v / v' A^-1 B A^-1 v independent
    observations, where the likelihood claims m: all samples under NORM, two for each sensor under EXP, one
    under TN.

    Parameters
    ----------
    source : DataTree or pymc.Model
        What `sample`, `sample_smc` or `pm.sample` returned, or a model, of which the most probable mode is
        taken. The fit starts from the modes that `sample` found, or otherwise from draws, which takes longer.
        Likelihoods of several records are taken to have independent errors.
    model : pymc.Model, optional
        Of a DataTree; the model of the context by default.
    random_seed : int, optional
        For the choice of points to climb from.

    Returns
    -------
    Dataset
        Over `sensor` (name of the likelihood and index): `n_eff`, observations that its residuals support;
        `claimed`, those of the likelihood; `time_constant` [s] of the errors, the longest;
        `follows_response`, whether they grow with the response. Over `parameter` (on the unconstrained scale
        that PyMC samples, but near a bound of the prior on their own): `n_eff_parameter`,
        `standard_deviation` by the residuals, `claimed_standard_deviation`, `point`, the maximum within the
        prior, `near_bound`, the nearest `bound` and `room`, standard deviations from the maximum without
        bounds to it, negative beyond; and `changes_response`. Over `direction`, ascending: `n_eff_direction`
        and `direction_vector` (direction, parameter). The matrices `information` A, `variability` B and
        `covariance` A^-1 B A^-1 ``(parameter, parameter_)``, NaN for parameters that no likelihood knows of.
        Attributes: `n_eff` (geometric mean of the directions), `growth` (by how much frequency bands disagree
        about the parameters, NaN without natural frequencies; widths contain it up to 2), `claimed` (of all
        sensors), `n_evaluations` (predictions of the fit).

    Raises
    ------
    TypeError, ValueError
        If a likelihood is not known, the residuals vanish, or data have gaps under another likelihood than
        one of a feature, or for more than 40 % of the record.

    Warns
    -----
    CalibrationWarning
        If errors persist for more than a fifth of the record, which is then too short to tell how they vary.

    Notes
    -----
    A bias of the model, the same all along the record and in every event, cannot be seen from residuals. A
    correlation time that is inferred is left as its likelihood has it. Samples in gaps add nothing to the
    score; where it is estimated how errors vary, residuals beside a gap stand in for those in it.

    References
    ----------
    Godambe, Ann. Math. Stat. 31, 1960; Andrews & Monahan, Econometrica 60, 1992.
    """
    check_seed(random_seed)
    starts = None
    if isinstance(source, pm.Model):
        model = check_model(source)
    else:
        check_group(source, "source", "posterior", "Or pass a model, for a fit without draws.")
        model = check_model(model)
        starts = starting_points(model, source, "source")
    predictions = Predictions(model)
    return described(predictions, peak_at(best_fit(predictions, starts, np.random.default_rng(random_seed))))


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
    before = [data.get_value() for data in waiting.values()]
    for data in waiting.values():
        data.set_value(np.full(data.get_value().shape, FIRST))
    try:
        predictions = Predictions(model)
        fit = best_fit(predictions, None, np.random.default_rng(random_seed))
        fill(waiting, fit)
        fit = climb_likelihood(predictions, fit.z)
        fill(waiting, fit)
    except Exception:
        for data, m in zip(waiting.values(), before, strict=True):
            data.set_value(m)
        raise
    for rv, data in waiting.items():
        sigma = rv.owner.inputs[3]
        if not isinstance(sigma, Constant):
            warn_about_variance("GammaFeature", data.get_value().ravel(), sigma)
    return described(predictions, peak_at(fit))


def degrees_of(model) -> dict:
    """Data of the degrees of freedom that residuals decide, by random variable."""
    ms = {rv: rv.owner.inputs[-1] for rv in model.observed_RVs if isinstance(rv.owner.op, GammaFeatureRV)}
    found = {
        rv: m.owner.inputs[0] for rv, m in ms.items() if m.owner and isinstance(m.owner.op, RequireDegrees)
    }
    if not found:
        names = ", ".join(rv.name for rv in model.observed_RVs) or "no likelihood"
        raise ValueError(
            f"`model` must have a GammaFeature with m='residuals', got {names}. Declare it so, or use "
            "effective_samples()."
        )
    return found


def fill(waiting, fit):
    """Set degrees of freedom to the observations that the residuals of a fit support."""
    events = {event.value.name: event for event in fit.events}
    for rv, data in waiting.items():
        counted = sensors_n_eff(events[rv.name])
        if np.isnan(counted).all():
            raise ValueError(f"`model` must have parameters that change the response of {rv.name}, got none.")
        counted = np.where(np.isnan(counted), np.nanmean(counted), counted)
        data.set_value(counted.reshape(data.get_value().shape))


def sensors_n_eff(event: Event) -> np.ndarray:
    """Observations that residuals support (sensor,); NaN where no parameter changes the response."""
    counted = np.full(len(event.residuals), np.nan)
    for j in range(len(counted)):
        alone = event.of_sensor(j)
        if alone.of_response.any():
            values, _ = directions(alone.of_response, sandwich([alone]).variability)
            counted[j] = (alone.residuals**2).sum() / np.exp(np.mean(np.log(values.clip(min=TINY))))
    return counted


def described(predictions, peak: Peak) -> xr.Dataset:
    """The Dataset of `effective_samples`."""
    fit, result = peak
    of_response = sum(event.of_response for event in fit.events)
    if not known(of_response).size:
        raise ValueError("`model` must have parameters that change the response, got none.")
    warn_of_short_records(fit, result)
    values, vectors = directions(of_response, result.of_response)
    n_direction = fit.squares / values[::-1].clip(min=TINY)
    along = vectors.T[::-1] / np.linalg.norm(vectors.T[::-1], axis=1, keepdims=True)
    of_bounds, units = own_scale(predictions, peak)
    square, every = np.outer(units, units), np.arange(len(units))
    told = np.where(np.isin(every, known(result.information)), 1.0, np.nan)
    claims, covariance = (m * square * np.outer(told, told) for m in (result.claims, result.covariance))
    of_sensors = [
        {
            "n_eff": sensors_n_eff(event),
            "claimed": event.value.claimed,
            "time_constant": np.full(len(event.residuals), event.value.step * model.memory),
            "follows_response": model.follows_response,
        }
        for event, model in zip(fit.events, result.models, strict=True)
    ]
    variables = {
        "sensor": {name: np.concatenate([one[name] for one in of_sensors]) for name in of_sensors[0]},
        "parameter": {
            "n_eff_parameter": fit.claimed * np.diag(claims) / np.diag(covariance),
            "standard_deviation": np.sqrt(np.diag(covariance)),
            "claimed_standard_deviation": np.sqrt(np.diag(claims)),
            "changes_response": np.isin(every, known(of_response)),
            **of_bounds,
        },
        ("parameter", "parameter_"): {
            "information": result.information / square,
            "variability": result.variability / square,
            "covariance": covariance,
        },
        "direction": {"n_eff_direction": n_direction},
        ("direction", "parameter"): {"direction_vector": along},
    }
    names = coordinate_names(predictions.model, predictions.space)
    sensors = [f"{e.value.name}[{j}]" for e in fit.events for j in range(len(e.residuals))]
    return xr.Dataset(
        {name: (dims, x) for dims, some in variables.items() for name, x in some.items()},
        {"parameter": names, "parameter_": names, "sensor": sensors},
        {
            "n_eff": float(np.exp(np.mean(np.log(n_direction)))),
            "claimed": fit.claimed,
            "n_evaluations": fit.n_evaluations,
            "growth": result.growth,
        },
    )


def own_scale(predictions, peak: Peak) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """What is said of parameters (d,) near a bound, on their own scale, and units of coordinates there."""
    sides, near, origin = peak.fit.coordinates
    low, high = predictions.bounds(predictions.space.split(peak.fit.z))
    first = np.where(np.isfinite(low), low, high)  # the lower bound, or the only one
    one = np.exp(np.where(sides == 1, origin, 0.0)) * np.where(first == low, 1.0, -1.0)
    units = np.where(near, np.where(sides == 2, high - low, one), 1.0)
    to_first, to_last = peak.rooms
    found = {
        "point": np.where(near, first + units * peak.fit.w, peak.fit.w),
        "near_bound": near,
        "bound": np.where(near, np.where(to_first < to_last, first, high), np.nan),
        "room": np.where(near, np.minimum(to_first, to_last), np.nan),
    }
    return found, units


def warn_of_short_records(fit, result):
    """Warn of records that are too short to tell how their errors vary."""
    for event, model in zip(fit.events, result.models, strict=True):
        n = event.residuals.shape[1]
        if SHORT * model.memory > n:
            _, step, name = event.value[4:]
            step, unit = (1, "samples") if np.isnan(step) else (step, "s")
            warnings.warn(
                f"the errors of {name} persist for {model.memory * step:.3g} {unit} of a record of "
                f"{n * step:.3g} {unit}, too short to tell how they vary: intervals may be too narrow. Use "
                "a longer record, or several events.",
                CalibrationWarning,
                stacklevel=4,
            )
