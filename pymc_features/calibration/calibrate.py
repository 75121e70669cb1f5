"""`calibrate`: a posterior as wide as the residuals support, in every direction."""

import contextlib
import json
import warnings
from pathlib import Path

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
from pymc_features.calibration.bounds import deviations, free_maximum, near_bounds, warn_beyond
from pymc_features.calibration.effective import described
from pymc_features.calibration.fit import Predictions, of_base_noise, residuals_of
from pymc_features.calibration.modes import Part, Peak, chosen, distinct_peaks, pooled
from pymc_features.calibration.sandwich import Sandwich, sandwich, sentence, whitening, wider
from pymc_features.calibration.stretched import (
    Expansion,
    Stretched,
    StretchedSMC,
    expanded,
    prior_and_likelihood,
)
from pymc_features.exceptions import CalibrationWarning, SamplingWarning
from pymc_features.inference.parameters import Unconstrained, posterior_for, to_unconstrained
from pymc_features.inference.sample import Search, compared_draws, sample_from
from pymc_features.smc import Reference, open_workers, prior_points
from pymc_features.smc.kernels.checkpoint import Journal, model_fingerprint
from pymc_features.smc.proposals.mixture import equal_draws, pareto_smoothed
from pymc_features.smc.proposals.reference import Mode

CURVED = 0.1  # standard deviations over which curvature is measured
PRIOR_DRAWS = 500
# mean square of standard deviations from the maximum that is far, and the share of draws that makes a warning
FAR, MANY = 10.0, 0.25
CHECKED, UNEXPLAINED = 40, 3.0  # draws looked at, and residuals over their sigma that are too large
KEPT = 100  # draws at a time of which a checkpoint keeps the likelihood
STAGE_DRAWS = 600  # of draws by an expansion, which cost hardly anything
WORTH = 0.9  # of draws by an expansion of the likelihood, below which it is not used
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
    Draws are those of the likelihood's expansion by second derivatives of residuals and scales at its
    maximum, weighed by the likelihood itself: one prediction for each draw. Where weights are uneven, or more
    than 15 parameters change the response, the likelihood is sampled as by `sample`. A `checkpoint` keeps
    the predictions of both.

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
    peaks = distinct_peaks(predictions, idata, model_error, rng)
    near = np.any([near_bounds(peak.fit, peak.sandwich) for peak in peaks], axis=0)
    expansions: list = [None] * len(peaks)
    for i, peak in enumerate(peaks):
        fit = peak.fit.measured_from_bounds(near)
        result, expansion = curved(predictions, fit, sandwich(fit.events, fit.information, model_error))
        if base_noise is not None:
            noise = of_base_noise(predictions, fit, base_noise)
            result = result._replace(variability=wider(result.variability, noise))
        peaks[i], expansions[i] = Peak(fit, peak.height, result), expansion
    prior, likelihood = prior_and_likelihood(model, settings.get("compile_kwargs") or {})
    parts = []
    with open_workers(settings.pop("executor", None)) as workers:
        if workers is not None:
            likelihood, settings["cores"] = workers.run().of(likelihood), 1
        for i, (peak, expansion) in enumerate(zip(peaks, expansions, strict=True)):
            target = Stretched(prior, likelihood, peak, peaks[:i] + peaks[i + 1 :])
            found = described(predictions, peak.fit, peak.sandwich)
            found = found.assign(leverage=("parameter", leverage(peak)))
            warn_beyond(found)
            sampled = calibrated_mode(model, target, expansion, i, settings, rng)
            sampled["calibration"] = xr.DataTree(found)
            if (some := compared_draws(model, sampled["posterior"])) is not None:
                warn_if_far(some, peak)
                check_explained(predictions, some, peak)
            parts.append(Part(sampled, target.power, peak.height))
    calibrated = pooled(parts, rng)
    calibrated.attrs["calibration"] = json.dumps(table(calibrated["calibration"].to_dataset()))
    for group in ("observed_data", "constant_data"):
        if group in idata.children:
            calibrated[group] = idata[group].copy()
    if advice := calibrated["sample_stats"].attrs["advice"]:
        warnings.warn(advice, SamplingWarning, stacklevel=2)
    return calibrated


def curved(predictions, fit, result: Sandwich) -> tuple[Sandwich, Expansion | None]:
    """The sandwich with the likelihood's own curvature as A, where that is positive, and its expansion.

    Both are along the axes of A, of parameters that are not near a bound: where they are correlated, a change
    of one of them alone by its standard deviation leads far away.
    """
    free = ~fit.coordinates.near
    whiten = whitening(result.information * np.outer(free, free))
    widths = np.sqrt(np.diag(whiten.T @ result.variability @ whiten))
    steps = CURVED * np.minimum(widths, 1.0)
    relative, expansion = expanded(predictions, fit, (whiten * steps).T)
    relative /= np.outer(steps, steps)
    if not np.linalg.eigvalsh(relative).min(initial=np.inf) > 0:
        return result, expansion
    unwhiten = whiten.T @ (result.information * free)
    more = unwhiten.T @ (relative - np.eye(len(steps))) @ unwhiten
    return result._replace(information=result.information + more), expansion


def calibrated_mode(model, target: Stretched, expansion, number, settings, rng) -> xr.DataTree:
    """The posterior around a maximum: draws by the expansion of its likelihood, weighed, or else its own.

    What a checkpoint keeps of it is in a file of its `number`.
    """
    found, space = Search(bell(model, target.peak, rng), 0, 0, NO_CLIMBS), Unconstrained(model)
    own = settings | {"kernel": StretchedSMC}
    if expansion is not None:
        guess = target.by(expansion)
        cheap = {"stage_draws": STAGE_DRAWS} | own | {"checkpoint": None, "logp": guess}
        idata = sample_from(found, model, space, **cheap)
        z = to_unconstrained(model, idata["posterior"].to_dataset())
        shape, flat = z.shape[:2], z.reshape(-1, z.shape[-1])
        values = *evaluated(target, flat, model, own.get("checkpoint"), number), guess(flat)[1]
        idata = weighed(idata, *(np.reshape(x, shape) for x in values), rng)
    if expansion is None or idata is None:
        idata = sample_from(found, model, space, **own, logp=target)
    idata["sample_stats"].attrs |= {"power": target.power}
    return idata


def evaluated(target: Stretched, z, model, checkpoint, number):
    """Log-likelihood and failures (n,) of points (n, d), part by part where a checkpoint keeps them."""
    if checkpoint is None:
        return target(z)[1:]
    Path(checkpoint).mkdir(parents=True, exist_ok=True)
    journal = Journal(Path(checkpoint) / f"calibrated_{number}.record", model_fingerprint(model))
    with contextlib.closing(journal):
        parts = [journal.evaluate(target, x) for x in np.array_split(z, -(-len(z) // KEPT))]
    return [np.concatenate(x) for x in list(zip(*parts, strict=True))[1:]]


def weighed(idata, value, failed, guessed, rng) -> xr.DataTree | None:
    """A posterior by a guess of the likelihood as that by the likelihood; None where they are not near.

    Both, and failures of the latter, are those of its draws (chain, draw).
    """
    logs = value - guessed
    if not (logs.max(axis=1) > -np.inf).all():
        return None
    logs = np.array([pareto_smoothed(x) for x in logs])
    weights = np.exp(logs - logs.max(axis=1, keepdims=True))
    mean = weights.mean(axis=1)
    worth = mean**2 / np.mean(weights**2, axis=1)
    if not worth.min() > WORTH:
        return None
    place = [equal_draws(x / x.sum(), len(x), rng) for x in weights]
    idata["posterior"] = chosen(idata["posterior"].to_dataset(), np.sort(place, axis=1))
    stats, first = idata["sample_stats"].to_dataset(), idata["sample_stats"]["stage"] == 0
    evidences = stats["log_marginal_likelihood"] + logs.max(axis=1) + np.log(mean)
    counts = {"evaluations": value.shape[1], "failed": failed.sum(axis=1)[:, None]}
    own = {name: (0.0 * stats[name]).where(~first, count) for name, count in counts.items()}
    stats = stats.assign(log_marginal_likelihood=evidences, ess=stats["ess"] * worth, **own)
    stats.attrs |= {
        "log_evidence": float(np.logaddexp.reduce(evidences.values) - np.log(len(evidences))),
        "ess": float(stats["ess"].sum()),
    }
    idata["sample_stats"] = xr.DataTree(stats)
    return idata


def warn_if_far(draws, peak: Peak):
    """Warn if many draws (n, d) are far from the maximum at which the residuals have decided the width."""
    directions = np.linalg.matrix_rank(whitening(peak.sandwich.information))
    away = np.mean(peak.distance(draws) ** 2 > FAR * directions)
    if away > MANY:
        warnings.warn(
            f"{100 * away:.0f} % of the calibrated draws are far from the likelihood's maximum: the "
            "priors, or a maximum that no draw was near, outweigh it, and there the residuals have decided "
            "no width. Use a longer record, several events in one model, or priors that agree with the data.",
            CalibrationWarning,
            stacklevel=3,
        )


def check_explained(predictions, draws, peak: Peak):
    """Refuse draws (n, d) whose residuals are larger than their own sigma, and their width, allow."""
    values = [predictions(z) for z in draws[:: max(1, len(draws) // CHECKED)]]
    squares = [
        sum(np.sum(residuals_of(v) ** 2) for v in value) / sum(v[4].sum() for v in value) for value in values
    ]
    left = sum(np.sum(event.residuals**2) for event in peak.fit.events)
    wide = 1.0 + np.trace(peak.sandwich.claims @ peak.sandwich.variability) / left
    if np.median(squares) > UNEXPLAINED**2 * wide:
        raise ValueError(
            "the calibrated draws must explain the data, got residuals "
            f"{np.median(squares) ** 0.5:.3g} times as large as their own sigma. The priors exclude what the "
            "data want: widen them, or give sigma a wider prior."
        )


def leverage(peak: Peak) -> np.ndarray:
    """Share (d,) of the standard deviations that comes from what the fit took out of the residuals."""
    without = sandwich(peak.fit.events, peak.fit.information, None, leverage=False)
    without = peak.sandwich._replace(variability=without.variability * peak.sandwich.factor**2)
    return 1.0 - deviations(without) / deviations(peak.sandwich)


def table(found: xr.Dataset) -> dict:
    """What made the intervals of the heaviest mode as wide as they are, of each parameter and of all."""
    if "mode" in found.dims:
        found = found.isel(mode=int(found["weight"].values.argmax()))
    rows = found[["standard_deviation", "leverage", "near_bound", "bound", "room"]].to_dataframe()
    rows = {
        name: {k: None if v != v else v for k, v in row.items()} for name, row in rows.T.to_dict().items()
    }
    return {"growth": found.attrs["growth"], "sentence": sentence(found.attrs["growth"]), "parameters": rows}


def bell(model, peak: Peak, rng) -> Reference:
    """What to draw from first: a bell of the likelihood's wanted width, no wider than the prior."""
    prior = prior_points(model, PRIOR_DRAWS, rng)
    centre, scale = prior.mean(axis=0), prior.std(axis=0)
    point, precision = expected(peak.fit, peak.sandwich)
    covariance = np.linalg.inv(precision + np.diag(scale**-2.0))
    factor = np.linalg.cholesky(covariance / np.outer(scale, scale))
    return Reference([Mode((point - centre) / scale, factor, 0.0, 1)], centre, scale)


def expected(fit, result: Sandwich) -> tuple[np.ndarray, np.ndarray]:
    """Where the calibrated likelihood is expected (d,), and its precision (d, d), unconstrained.

    Parameters near a bound have mean and width of the normal distribution cut off; others follow.
    """
    coordinates, precision, mean = fit.coordinates, result.precision, free_maximum(fit, result)
    f, b = np.flatnonzero(~coordinates.near), np.flatnonzero(coordinates.near)
    sd = np.sqrt(np.diag(result.covariance)[b]).clip(min=np.finfo(float).tiny)
    low, high = ((ends[b] - mean[b]) / sd for ends in coordinates.limits)
    w, (within, variance) = mean.copy(), truncnorm.stats(low, high, mean[b], sd)
    whiten = whitening(precision[np.ix_(f, f)])
    follow = -whiten @ whiten.T @ precision[np.ix_(f, b)]
    w[b], w[f] = within, w[f] + follow @ (within - mean[b])
    precision[np.ix_(b, b)] = np.diag(1.0 / variance) - precision[np.ix_(b, f)] @ follow
    z = coordinates.unconstrained(w)
    return z, precision * np.outer(coordinates.slopes(z), coordinates.slopes(z))
