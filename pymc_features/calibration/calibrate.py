"""`calibrate`: a posterior as wide as the residuals support, in every direction."""

import contextlib
import json
import warnings
from pathlib import Path

import numpy as np
import pymc as pm
import xarray as xr
from pymc.util import RandomState

from pymc_features._checks import (
    check_choice,
    check_flag,
    check_integer,
    check_model,
    check_positive,
    check_seed,
)
from pymc_features.calibration.effective import described
from pymc_features.calibration.maxima import Peak, distinct_peaks, some_draws
from pymc_features.calibration.residuals import Predictions
from pymc_features.calibration.sandwich import sandwich, sentence, whitening
from pymc_features.calibration.stretched import Stretched, StretchedSMC, bell, curved, prior_and_likelihood
from pymc_features.exceptions import CalibrationWarning, SamplingWarning
from pymc_features.inference.parameters import posterior_for, to_unconstrained
from pymc_features.inference.sample import Search, sample_from
from pymc_features.smc import open_workers
from pymc_features.smc.kernels.checkpoint import Journal, model_fingerprint
from pymc_features.smc.proposals.mixture import equal_draws, pareto_smoothed

# mean square of standard deviations from the maximum that is far, and the share of draws that makes a warning
FAR, MANY = 10.0, 0.25
LOOKED_AT = 400  # draws of which this is seen
CHECKED, UNEXPLAINED = 40, 3.0  # of these, and residuals over their sigma that are too large
STAGE_DRAWS = 600  # of draws by an expansion, which cost hardly anything
NO_CLIMBS = "the maximum was known"
WORTH = 0.9  # of draws that are weighed, below which they are not used
WANTED = 2.0  # standard deviations beyond a bound that make a warning
KEPT = 100  # draws at a time of which a checkpoint keeps the likelihood


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
        Of `sample`. A `checkpoint` keeps all predictions.

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
    CalibrationWarning, SamplingWarning
        If errors persist for more than a fifth of the record, a quarter of the draws are far from the
        maximum, or the data want a parameter beyond its prior; and as from `sample`.

    Notes
    -----
    Draws are those of the likelihood's expansion by second derivatives of residuals and scales at its
    maximum, weighed by the likelihood itself: one prediction for each draw. Where weights are uneven, or more
    than 15 parameters change the response, the likelihood is sampled as by `sample`.

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
    near = np.any([peak.near_bounds() for peak in peaks], axis=0)
    curves = [curved(predictions, peak.measured_from_bounds(near)) for peak in peaks]
    peaks, expansions = map(list, zip(*curves, strict=True))
    if base_noise is not None:
        peaks = [peak.with_base_noise(predictions, base_noise) for peak in peaks]
    compiled = settings.get("compile_kwargs") or {}
    prior, likelihood = prior_and_likelihood(model, predictions.space.point, compiled)
    parts = []
    with open_workers(settings.pop("executor", None)) as workers:
        if workers is not None:
            likelihood, settings["cores"] = workers.run().of(likelihood), 1
        for i, (peak, expansion) in enumerate(zip(peaks, expansions, strict=True)):
            found = described(predictions, peak).assign(leverage=("parameter", leverage(peak)))
            warn_beyond(found)
            target = Stretched.around(prior, likelihood, peak, peaks[:i] + peaks[i + 1 :])
            search = Search(bell(model, peak, rng), 0, 0, NO_CLIMBS)
            sampled = calibrated_mode(predictions, target, expansion, search, i, settings, rng)
            sampled["calibration"] = xr.DataTree(found)
            check_draws(predictions, sampled["posterior"].to_dataset(), peak)
            parts.append(sampled)
    calibrated = pooled(parts, peaks, rng)
    calibrated.attrs["calibration"] = json.dumps(table(calibrated["calibration"].to_dataset()))
    for group in ("observed_data", "constant_data"):
        if group in idata.children:
            calibrated[group] = idata[group].copy()
    if advice := calibrated["sample_stats"].attrs["advice"]:
        warnings.warn(advice, SamplingWarning, stacklevel=2)
    return calibrated


def calibrated_mode(predictions, target: Stretched, expansion, found, number, settings, rng) -> xr.DataTree:
    """The posterior around a maximum: draws by the expansion of its likelihood, weighed, or else its own.

    The first draws are those `found`. What a checkpoint keeps of it is in a file of its `number`.
    """
    model, space, kept, idata = predictions.model, predictions.space, settings.get("checkpoint"), None
    settings = settings | {"kernel": StretchedSMC}
    if expansion is not None:
        guess = target._replace(likelihood=expansion)
        cheap = {"stage_draws": STAGE_DRAWS} | settings | {"checkpoint": None, "cores": 1, "logp": guess}
        idata = sample_from(found, model, space, **cheap)
        kept = None if kept is None else Path(kept) / f"calibrated_{number}.record"
        idata = weighed(model, idata, guess, target, kept, rng)
    if idata is None:
        idata = sample_from(found, model, space, **settings, logp=target)
    idata["sample_stats"].attrs["power"] = target.power
    return idata


def weighed(model, idata, guess: Stretched, target: Stretched, checkpoint, rng) -> xr.DataTree | None:
    """A posterior by a guess of the likelihood as that by the likelihood; None where they are not near.

    `checkpoint` is the file that keeps the likelihood of the draws, None without one.
    """
    z = to_unconstrained(model, idata["posterior"].to_dataset())
    flat = z.reshape(-1, z.shape[-1])
    values = *evaluated(target, flat, model, checkpoint), guess(flat)[1]
    value, failed, guessed = (np.reshape(x, z.shape[:2]) for x in values)
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
    counts = {name: (0.0 * stats[name]).where(~first, count) for name, count in counts.items()}
    stats = stats.assign(log_marginal_likelihood=evidences, ess=stats["ess"] * worth, **counts)
    log_evidence = np.logaddexp.reduce(evidences.values) - np.log(len(evidences))
    stats.attrs |= {"log_evidence": float(log_evidence), "ess": float(stats["ess"].sum())}
    idata["sample_stats"] = xr.DataTree(stats)
    return idata


def evaluated(target: Stretched, z, model, checkpoint):
    """Log-likelihood and failures (n,) of points (n, d), part by part where a checkpoint keeps them."""
    if checkpoint is None:
        return target(z)[1:]
    checkpoint.parent.mkdir(parents=True, exist_ok=True)
    with contextlib.closing(Journal(checkpoint, model_fingerprint(model))) as journal:
        parts = [journal.evaluate(target, x) for x in np.array_split(z, -(-len(z) // KEPT))]
    return [np.concatenate(x) for x in list(zip(*parts, strict=True))[1:]]


def pooled(parts: list[xr.DataTree], peaks: list[Peak], rng) -> xr.DataTree:
    """Draws of the posteriors around maxima by their weights; other groups are those of the heaviest.

    Weights are volumes of the stretched likelihoods, with heights by the power of the highest.
    """
    if len(parts) == 1:
        return parts[0]
    stats = [part["sample_stats"].attrs for part in parts]
    heights = np.array([peak.fit.height for peak in peaks])
    powers = np.array([one["power"] for one in stats])
    logs = [one["log_evidence"] for one in stats] + (powers[heights.argmax()] - powers) * heights
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    posteriors = [part["posterior"].to_dataset() for part in parts]
    n_chains, n_draws = (posteriors[0].sizes[dim] for dim in ("chain", "draw"))
    mode = np.stack([equal_draws(weights, n_draws, rng) for _ in range(n_chains)])
    place = np.stack([rng.permutation(n_draws) for _ in range(n_chains)])
    result = parts[int(weights.argmax())]
    result["posterior"] = chosen(xr.concat(posteriors, "_part", join="override"), place, _part=mode)
    result["sample_stats"]["mode"] = xr.DataArray(mode, dims=("chain", "draw"))
    advice = next((one["advice"] for one in stats if one["advice"]), "")
    result["sample_stats"].attrs |= {"n_modes": len(parts), "advice": advice}
    every = [part["calibration"].to_dataset() for part in parts]
    described = xr.concat(every, "mode", combine_attrs="override")
    described["n_eff_mode"] = ("mode", [one.attrs["n_eff"] for one in every])
    result["calibration"] = xr.DataTree(described.assign(weight=("mode", weights)))
    return result


def chosen(posterior, place, **more) -> xr.DataTree:
    """Draws of a posterior at places (chain, draw) of their chains, and of other dimensions."""
    at = {"draw": place, "chain": np.arange(len(place))[:, None].repeat(place.shape[1], axis=1), **more}
    at = {name: xr.DataArray(x, dims=("chain", "draw")) for name, x in at.items()}
    draws = posterior.isel(at).transpose("chain", "draw", ...)
    return xr.DataTree(draws.assign_coords({name: posterior[name] for name in ("chain", "draw")}))


def warn_beyond(found):
    """Warn of parameters that the data want beyond a bound of their prior, see `effective_samples`."""
    rows = (found[name].values for name in ("parameter", "bound", "point", "room"))
    for name, bound, point, room in zip(*rows, strict=True):
        if room < -WANTED:
            warnings.warn(
                f"the data want {name} {'above' if point <= bound else 'below'} {bound:.4g}, the edge of its "
                f"prior, by {-room:.2g} standard deviations: its interval is what the prior leaves of them. "
                "Widen the prior, or look for what the model lacks.",
                CalibrationWarning,
                stacklevel=3,
            )


def check_draws(predictions, posterior, peak: Peak):
    """Warn if many draws are far from the maximum, and refuse those that do not explain the data."""
    draws = some_draws(predictions.model, posterior, LOOKED_AT)
    n_directions = whitening(peak.sandwich.information).shape[1]
    away = np.mean(peak.distance(draws) ** 2 > FAR * n_directions)
    if away > MANY:
        warnings.warn(
            f"{100 * away:.0f} % of the calibrated draws are far from the likelihood's maximum: the "
            "priors, or a maximum that no draw was near, outweigh it, and there the residuals have decided "
            "no width. Use a longer record, several events in one model, or priors that agree with the data.",
            CalibrationWarning,
            stacklevel=3,
        )
    values = [predictions(z) for z in draws[:: max(1, len(draws) // CHECKED)]]
    squares = [sum(np.sum(v.residuals**2) for v in x) / sum(v.claimed.sum() for v in x) for x in values]
    wide = 1.0 + np.trace(peak.sandwich.claims @ peak.sandwich.variability) / peak.fit.squares
    if np.median(squares) > UNEXPLAINED**2 * wide:
        raise ValueError(
            "the calibrated draws must explain the data, got residuals "
            f"{np.median(squares) ** 0.5:.3g} times as large as their own sigma. The priors exclude what the "
            "data want: widen them, or give sigma a wider prior."
        )


def leverage(peak: Peak) -> np.ndarray:
    """Share (d,) of the standard deviations that comes from what the fit took out of the residuals."""
    without = sandwich(peak.fit.events, None, leverage=False).variability * peak.sandwich.factor**2
    plain = peak._replace(sandwich=peak.sandwich._replace(variability=without))
    return 1.0 - plain.deviations / peak.deviations


def table(found: xr.Dataset) -> dict:
    """What made the intervals of the heaviest mode as wide as they are, of each parameter and of all."""
    if "mode" in found.dims:
        found = found.isel(mode=int(found["weight"].values.argmax()))
    rows = found[["standard_deviation", "leverage", "near_bound", "bound", "room"]].to_dataframe().T.to_dict()
    rows = {name: {k: None if v != v else v for k, v in row.items()} for name, row in rows.items()}
    return {"growth": found.attrs["growth"], "sentence": sentence(found.attrs["growth"]), "parameters": rows}
