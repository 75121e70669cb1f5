"""How many independent observations the residuals support, beside those that a likelihood claims."""

import warnings

import numpy as np
import pymc as pm
import xarray as xr

from pymc_features._checks import check_group, check_model, check_seed
from pymc_features.calibration.bounds import own_scale
from pymc_features.calibration.climb import climb_likelihood
from pymc_features.calibration.fit import Fit, Predictions, log_likelihood
from pymc_features.calibration.sandwich import Sandwich, known, sandwich, whitening
from pymc_features.exceptions import CalibrationWarning
from pymc_features.inference.parameters import (
    coordinate_names,
    posterior_for,
    to_unconstrained,
)
from pymc_features.inference.sample import search
from pymc_features.smc import population_logp, prior_points

STARTS = 20  # draws of which the most likely is climbed from
SHORT = 5.0  # time constants of the errors that a record must be long
ROUNDED = 1e-12  # of what a unit change of a parameter does to the response: rounding, no residuals


def effective_samples(
    source: xr.DataTree | pm.Model, *, model: pm.Model | None = None, random_seed: int | None = None
) -> xr.Dataset:
    """Independent observations that the residuals of a fit support, and the covariance they imply.

    At the maximum of the likelihood the score, the sum of sensitivities times residuals, would vary as much
    as the likelihood claims (A) if the errors were what it takes them for. How much it does vary (B) is
    estimated from the residuals, over time and across sensors (``pymc_features.calibration.spectrum``). In a
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
        Attributes: `n_eff` (geometric mean of the directions of the response), `growth` (by how much
        frequency bands disagree about the parameters, NaN without natural frequencies; widths contain it up
        to 2), `claimed` (of all sensors), `n_evaluations` (predictions of the fit: each set of sensitivities
        to d parameters takes d far from the maximum, and 2 d near it).

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
    What is the same all along the record and in every event, a bias of the model, cannot be seen from
    residuals. A correlation time that is inferred is left as its likelihood has it.

    Samples in gaps of the data add nothing to the score. Where it is estimated how errors vary, residuals
    beside a gap stand in for those in it; intervals cover as often as without gaps.

    References
    ----------
    Godambe, Ann. Math. Stat. 31, 1960; Ribatet, Cooley & Davison, Stat. Sin. 22, 2012; Andrews & Monahan,
    Econometrica 60, 1992.
    """
    check_seed(random_seed)
    if isinstance(source, pm.Model):
        model, starts = check_model(source), None
    else:
        check_group(source, "source", "posterior", "Or pass a model, for a fit without draws.")
        model = check_model(model)
        starts = starting_points(model, source, "source")
    predictions = Predictions(model)
    fit = best_fit(predictions, starts, np.random.default_rng(random_seed))
    return described(predictions, fit, sandwich(fit.events, fit.information))


def starting_points(model, idata, name: str) -> np.ndarray:
    """Unconstrained points (n, d) that a posterior offers: its modes where they are known, or some draws."""
    posterior = posterior_for(model, idata, name)
    if "modes" in idata.children and {rv.name for rv in model.free_RVs} <= set(idata["modes"].data_vars):
        modes = idata["modes"].to_dataset().expand_dims("chain")
        return to_unconstrained(model, modes)[0]
    return some_draws(model, posterior)


def best_fit(predictions, starts, rng) -> Fit:
    """The maximum of the likelihood near the most likely of some points (n, d), or of a model's modes."""
    model = predictions.model
    if starts is None:
        logp = population_logp(model, predictions.space.point, {})
        found = search(model, logp, 1000, rng, None)
        starts = prior_points(model, 10 * STARTS, rng) if found.reference is None else found.reference.peaks
        prior, likelihood, _ = logp(starts)
        return with_noise(climb_likelihood(predictions, starts[np.argmax(prior + likelihood)]))
    best = np.argmax([log_likelihood(predictions(z)) for z in starts]) if len(starts) > 1 else 0
    return with_noise(climb_likelihood(predictions, starts[best]))


def some_draws(model, posterior, number=STARTS) -> np.ndarray:
    """Unconstrained draws (n, d) of all chains, evenly spaced."""
    every = max(1, posterior.sizes["chain"] * posterior.sizes["draw"] // number)
    some = to_unconstrained(model, posterior.isel(draw=slice(None, None, every)))
    return some.reshape(-1, some.shape[-1])


def with_noise(fit: Fit) -> Fit:
    """The fit, if every sensor has residuals."""
    for event in fit.events:
        response = (event.sensitivities**2).sum(axis=1).max(axis=-1)
        silent = np.flatnonzero(~((event.residuals**2).sum(axis=1) > ROUNDED**2 * response))
        if silent.size:
            raise ValueError(
                f"the residuals of {event.name} must not vanish, got none at sensor {silent[0]}: data "
                "without noise support no estimate of their errors. Add the measurement noise, or leave out "
                "the sensor."
            )
    return fit


def of_sensor(event, j) -> float:
    """Observations that the residuals of one sensor support; NaN where no parameter changes its response."""
    alone = event.of_sensor(j)
    if not (information := alone.of_response).any():
        return np.nan
    varies = ratios(information, sandwich([alone], information).variability)
    return float((alone.residuals**2).sum() / np.exp(np.mean(np.log(varies))))


def ratios(information, variability) -> np.ndarray:
    """Eigenvalues of B over A, ascending, in the directions that A tells."""
    whiten = whitening(information)
    return np.linalg.eigvalsh(whiten.T @ variability @ whiten).clip(min=np.finfo(float).tiny)


def described(predictions, fit: Fit, result: Sandwich) -> xr.Dataset:
    """The Dataset of `effective_samples`."""
    events = fit.events
    claimed = sum(float(event.claimed.sum()) for event in events)
    of_response = sum(event.of_response for event in events)
    if not known(of_response).size:
        raise ValueError("`model` must have parameters that change the response, got none.")
    whiten = whitening(of_response)
    of_models = result.factor**2 * sum(model.variability for model in result.models)
    values, vectors = np.linalg.eigh(whiten.T @ of_models @ whiten)
    directions = (whiten @ vectors).T[::-1]
    squares = sum(float((event.residuals**2).sum()) for event in events)
    n_direction = squares / values[::-1].clip(min=np.finfo(float).tiny)
    claims, covariance = covariances(result)
    of_bounds, units = own_scale(predictions, fit, result)
    by_sensor = [(e, m, j) for e, m in zip(events, result.models, strict=True) for j in range(len(e.claimed))]
    persists(fit, result)
    names, square = coordinate_names(predictions.model, predictions.space), np.outer(units, units)
    variables = {
        "n_eff": ("sensor", [of_sensor(event, j) for event, _, j in by_sensor]),
        "claimed": ("sensor", [event.claimed[j] for event, _, j in by_sensor]),
        "time_constant": ("sensor", [model.memory * event.step for event, model, _ in by_sensor]),
        "follows_response": ("sensor", [model.follows_response[j] for _, model, j in by_sensor]),
        "n_eff_parameter": ("parameter", claimed * np.diag(claims) / np.diag(covariance)),
        "standard_deviation": ("parameter", np.sqrt(np.diag(covariance)) * np.abs(units)),
        "claimed_standard_deviation": ("parameter", np.sqrt(np.diag(claims)) * np.abs(units)),
        "changes_response": ("parameter", np.isin(np.arange(len(units)), known(of_response))),
        **{name: ("parameter", x) for name, x in of_bounds.items()},
        "information": (("parameter", "parameter_"), result.information / square),
        "variability": (("parameter", "parameter_"), result.variability / square),
        "covariance": (("parameter", "parameter_"), covariance * square),
        "n_eff_direction": ("direction", n_direction),
        "direction_vector": (
            ("direction", "parameter"),
            directions / np.linalg.norm(directions, axis=1, keepdims=True),
        ),
    }
    sensors = [f"{event.name}[{j}]" for event, _, j in by_sensor]
    attrs = {
        "n_eff": float(np.exp(np.mean(np.log(n_direction)))),
        "claimed": claimed,
        "n_evaluations": fit.n_evaluations,
        "growth": result.growth,
    }
    return xr.Dataset(variables, {"parameter": names, "parameter_": names, "sensor": sensors}, attrs)


def covariances(result: Sandwich):
    """A^-1 and A^-1 B A^-1 (d, d), NaN for parameters that no likelihood knows of."""
    claims, covariance = result.claims, result.covariance
    unknown = np.setdiff1d(np.arange(len(claims)), known(result.information))
    for matrix in (claims, covariance):
        matrix[unknown], matrix[:, unknown] = np.nan, np.nan
    return claims, covariance


def persists(fit, result):
    """Warn of records that are too short to tell how their errors vary."""
    for event, model in zip(fit.events, result.models, strict=True):
        n = event.residuals.shape[1]
        if SHORT * model.memory > n:
            step, unit = (1, "samples") if np.isnan(event.step) else (event.step, "s")
            warnings.warn(
                f"the errors of {event.name} persist for {model.memory * step:.3g} {unit} of a record of "
                f"{n * step:.3g} {unit}, too short to tell how they vary: intervals may be too narrow. Use "
                "a longer record, or several events.",
                CalibrationWarning,
                stacklevel=4,
            )
