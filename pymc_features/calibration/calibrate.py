"""`calibrate`: a posterior as wide as the residuals support, in every direction."""

import json
import warnings

import numpy as np
import pymc as pm
import xarray as xr
from pymc.util import RandomState
from scipy.stats import truncnorm

from pymc_features._checks import (
    check_choice,
    check_flag,
    check_integer,
    check_model,
    check_positive,
    check_seed,
)
from pymc_features.calibration.adjusted import adjusted_model, shape_of
from pymc_features.calibration.bounds import deviations, free_maximum, near_bounds, warn_beyond
from pymc_features.calibration.effective import described
from pymc_features.calibration.fit import Predictions, hessian, of_base_noise, residuals_of
from pymc_features.calibration.modes import Part, distinct_fits, pooled
from pymc_features.calibration.sandwich import Sandwich, sandwich, sentence, whitening, wider
from pymc_features.exceptions import CalibrationWarning, SamplingWarning
from pymc_features.inference.parameters import Unconstrained, posterior_for
from pymc_features.inference.sample import Search, compared_draws, sample_from
from pymc_features.smc import Reference, open_workers, population_logp, prior_points
from pymc_features.smc.proposals.reference import Mode

CURVED = 0.1  # standard deviations over which curvature is measured
PRIOR_DRAWS = 500
# mean square of standard deviations from the maximum that is far, and the share of draws that makes a warning
FAR, MANY = 10.0, 0.25
CHECKED, UNEXPLAINED = 40, 3.0  # draws looked at, and residuals over their sigma that are too large
NEAR_BOUND_DRAWS = 600  # of each stage, where a parameter is near a bound
NO_CLIMBS = "the maximum was known"


def calibrate(
    idata: xr.DataTree,
    *,
    model: pm.Model | None = None,
    draws: int | None = None,
    chains: int | None = None,
    random_seed: RandomState = None,
    progressbar: bool = True,
    model_error: str | None = "bands",
    base_noise: float | None = None,
    **settings,
) -> xr.DataTree:
    """Posterior whose width the residuals decide, not the sampling rate or the number of sensors.

    The likelihood is raised to the power, and stretched around its maximum by the matrix, that give it the
    curvature A B^-1 A, where B is the covariance of the score that the residuals support
    (`effective_samples`). With the prior as it is, the posterior is sampled again. The maximum does not move,
    the prior's bounds and information keep their meaning, and any likelihood of the response leads to nearly
    the same interval.

    Parameters
    ----------
    idata : DataTree
        What `sample`, `sample_smc` or `pm.sample` returned for NORM, TN, EXP, `GammaFeature` or
        `CorrelatedNormal`, of one or several records.
    model : pymc.Model, optional
        The model of the context by default.
    draws, chains : int, optional
        As in `idata` by default.
    random_seed : int or sequence of int, optional
        For the same draws each time.
    progressbar : bool
        Whether to show progress.
    model_error : str, optional
        "bands" (default) multiplies widths by how much the frequency bands of the record disagree about the
        parameters, at most by 2, where the model has natural frequencies; None does not.
    base_noise : float, optional
        Standard deviation of white noise on the record of the base [m/s^2], where it is known: intervals are
        as wide at least as it makes them. Frequency bands, which disagree under such noise, are not compared
        then.
    **settings
        Of `sample`.

    Returns
    -------
    DataTree
        As from `sample`, of the calibrated posterior; `sample_stats` has the attribute `power`, and the group
        `calibration` is what `effective_samples` returns, with the share of `leverage` in each standard
        deviation: what the fit took out of the residuals. The attribute `calibration` is a table, in JSON,
        of growth, parameters near a bound and leverage. With several modes that group has them as a
        dimension, with their `weight`, and `sample_stats` says of which `mode` a draw is; its other numbers
        are those of the heaviest. The evidence is that of the stretched likelihood, and must not be compared
        with others.

    Raises
    ------
    TypeError, ValueError
        As of `effective_samples`, or if the likelihood has no maximum near the draws.

    Warns
    -----
    CalibrationWarning
        If errors persist for more than a fifth of the record, or a quarter of the draws are far from the
        maximum.
    SamplingWarning
        As from `sample`.

    Notes
    -----
    Modes that lie more than some standard deviations apart are calibrated each by itself. Each has the
    evidence of its stretched likelihood, but the ratio of the maxima is raised to the power of the highest,
    which decides how much one mode is likelier than another. A bias of the model, the same in every record,
    is not seen in residuals.

    References
    ----------
    Ribatet, Cooley & Davison, Stat. Sin. 22, 2012; Shaby, Bayesian Anal. 9, 2014.
    """
    for name, value, least in (("draws", draws, 2), ("chains", chains, 1)):
        if value is not None:
            check_integer(value, name, least=least)
    check_seed(random_seed)
    check_flag(progressbar, "progressbar")
    if model_error is not None:
        check_choice(model_error, "model_error", ["bands"], "Or pass None.")
    model = check_model(model)
    if base_noise is not None:
        base_noise, model_error = check_positive(base_noise, "base_noise", "Pass m/s^2."), None
    posterior = posterior_for(model, idata, "idata")
    rng = np.random.default_rng(np.random.SeedSequence(random_seed).spawn(1)[0])
    settings |= {
        "draws": draws or posterior.sizes["draw"],
        "chains": chains or posterior.sizes["chain"],
        "random_seed": random_seed,
        "progressbar": progressbar,
    }
    predictions = Predictions(model)
    fits = distinct_fits(predictions, idata, rng)
    near = [near_bounds(fit, sandwich(fit.events, fit.information, model_error)) for fit in fits]
    fits = [fit.measured_from_bounds(np.any(near, axis=0)) for fit in fits]
    if np.any(near):  # a bell does not follow how others depend on these
        settings.setdefault("stage_draws", NEAR_BOUND_DRAWS)
    modes = []
    for fit in fits:
        result = curved(predictions, fit, sandwich(fit.events, fit.information, model_error))
        if base_noise is not None:
            noise = of_base_noise(predictions, fit, base_noise)
            result = result._replace(variability=wider(result.variability, noise))
        modes.append((fit, result))
    adjusted, parts = adjusted_model(model, modes[0][0].coordinates, len(modes)), []
    with open_workers(settings.pop("executor", None)) as workers:
        for i, mode in enumerate(modes):
            others, own = modes[:i] + modes[i + 1 :], settings | {"executor": workers}
            part = calibrated_mode(adjusted, mode, others, own, rng)
            found = described(predictions, *mode).assign(leverage=("parameter", leverage(*mode)))
            warn_beyond(found)
            part.idata["calibration"] = xr.DataTree(found)
            draws = compared_draws(model, part.idata["posterior"])
            far_away(draws, *mode)
            explain_the_data(predictions, draws, *mode)
            parts.append(part)
    calibrated = pooled(parts, rng)
    calibrated.attrs["calibration"] = json.dumps(table(calibrated["calibration"].to_dataset()))
    for group in ("observed_data", "constant_data"):
        if group in idata.children:
            calibrated[group] = idata[group].copy()
    if advice := calibrated["sample_stats"].attrs["advice"]:
        warnings.warn(advice, SamplingWarning, stacklevel=2)
    return calibrated


def far_away(draws, fit, result: Sandwich):
    """Warn if many draws (n, d) are far from the maximum at which the residuals have decided the width."""
    off = np.array([fit.coordinates.of(z) for z in ([] if draws is None else draws)]).reshape(-1, len(fit.w))
    off = off - fit.w
    directions = np.linalg.matrix_rank(whitening(result.information))
    away = np.einsum("ni,ij,nj->n", off, result.precision, off) > FAR * directions
    if away.size and away.mean() > MANY:
        warnings.warn(
            f"{100 * away.mean():.0f} % of the calibrated draws are far from the likelihood's maximum: the "
            "priors, or a maximum that no draw was near, outweigh it, and there the residuals have decided "
            "no width. Use a longer record, several events in one model, or priors that agree with the data.",
            CalibrationWarning,
            stacklevel=3,
        )


def explain_the_data(predictions, draws, fit, result: Sandwich):
    """Refuse draws (n, d) whose residuals are larger than their own sigma, and their width, allow."""
    values = [predictions(z) for z in ([] if draws is None else draws[:: max(1, len(draws) // CHECKED)])]
    squares = [
        sum(np.sum(residuals_of(v) ** 2) for v in value) / sum(v[4].sum() for v in value) for value in values
    ]
    left = sum(np.sum(event.residuals**2) for event in fit.events)
    wide = 1.0 + np.trace(result.claims @ result.variability) / left
    if squares and np.median(squares) > UNEXPLAINED**2 * wide:
        raise ValueError(
            "the calibrated draws must explain the data, got residuals "
            f"{np.median(squares) ** 0.5:.3g} times as large as their own sigma. The priors exclude what the "
            "data want: widen them, or give sigma a wider prior."
        )


def leverage(fit, result: Sandwich) -> np.ndarray:
    """Share (d,) of the standard deviations that comes from what the fit took out of the residuals."""
    without = sandwich(fit.events, fit.information, None, leverage=False)
    without = result._replace(variability=without.variability * result.factor**2)
    return 1.0 - deviations(without) / deviations(result)


def table(found: xr.Dataset) -> dict:
    """What made the intervals of the heaviest mode as wide as they are, of each parameter and of all."""
    if "mode" in found.dims:
        found = found.isel(mode=int(found["weight"].values.argmax()))
    rows = found[["standard_deviation", "leverage", "near_bound", "bound", "room"]].to_dataframe()
    rows = {
        name: {k: None if v != v else v for k, v in row.items()} for name, row in rows.T.to_dict().items()
    }
    return {"growth": found.attrs["growth"], "sentence": sentence(found.attrs["growth"]), "parameters": rows}


def calibrated_mode(adjusted, mode, others, settings, rng) -> Part:
    """The posterior around a maximum; each is a fit and its sandwich."""
    model, (fit, result), d = adjusted.model, mode, len(mode[0].w)
    shape = shape_of(fit, result)
    elsewhere = np.reshape([fit.w for fit, _ in others], (-1, d))
    precisions = np.reshape([result.precision for _, result in others], (-1, d, d))
    adjusted.set(shape, result.precision, elsewhere, precisions)
    found = Search(bell(model, *expected(fit, result), rng), 0, 0, NO_CLIMBS)
    idata = sample_from(found, model, Unconstrained(model), **settings)
    idata["sample_stats"].attrs |= {"power": shape.power}
    logp = population_logp(model, model.initial_point(), settings.get("compile_kwargs") or {})
    return Part(idata, shape.power, logp(fit.z[None])[1][0] / shape.power)


def expected(fit, result):
    """Where the calibrated likelihood is expected (d,), and its precision (d, d), unconstrained.

    Parameters near a bound have mean and width of the normal distribution cut off; others follow.
    """
    precision, mean = result.precision, free_maximum(fit, result)
    f, b = np.flatnonzero(~fit.coordinates.near), np.flatnonzero(fit.coordinates.near)
    sd = np.sqrt(np.diag(result.covariance)[b])
    low, high = ((ends[b] - mean[b]) / sd for ends in fit.coordinates.limits)
    w, (within, variance) = mean.copy(), truncnorm.stats(low, high, mean[b], sd)
    w[b] = within
    whiten = whitening(precision[np.ix_(f, f)])
    follow = -whiten @ whiten.T @ precision[np.ix_(f, b)]
    w[f] += follow @ (w[b] - mean[b])
    precision[np.ix_(b, b)] = np.diag(1.0 / variance) - precision[np.ix_(b, f)] @ follow
    z = fit.coordinates.unconstrained(w)
    slopes = fit.coordinates.slopes(z)
    return z, precision * np.outer(slopes, slopes)


def curved(predictions, fit, result: Sandwich) -> Sandwich:
    """The sandwich with the likelihood's own curvature as A, where that is positive.

    It is measured along the axes of A, of parameters that are not near a bound: where they are correlated, a
    change of one of them alone by its standard deviation leads far away.
    """
    free = ~fit.coordinates.near
    whiten = whitening(result.information * np.outer(free, free))
    widths = np.sqrt(np.diag(whiten.T @ result.variability @ whiten))
    steps = CURVED * np.minimum(widths, 1.0)
    relative = hessian(predictions, fit, (whiten * steps).T) / np.outer(steps, steps)
    unwhiten = whiten.T @ (result.information * free)
    information = result.information + unwhiten.T @ (relative - np.eye(len(steps))) @ unwhiten
    if not np.linalg.eigvalsh(relative).min(initial=np.inf) > 0:
        return result
    return result._replace(information=information)


def bell(model, point, precision, rng) -> Reference:
    """What to draw from first: a bell of the likelihood's wanted width, no wider than the prior."""
    prior = prior_points(model, PRIOR_DRAWS, rng)
    centre, scale = prior.mean(axis=0), prior.std(axis=0)
    covariance = np.linalg.inv(precision + np.diag(scale**-2.0))
    factor = np.linalg.cholesky(covariance / np.outer(scale, scale))
    return Reference([Mode((point - centre) / scale, factor, 0.0, 1)], centre, scale)
