"""Posteriors as wide as the residuals support: `calibrate`, and the observations that they support."""

import contextlib
import json

import numpy as np
import pymc as pm
import xarray as xr
from pymc.util import RandomState
from pytensor.graph.basic import Constant
from scipy.special import logsumexp, softmax

from pymc_features._checks import check_choice, check_model, check_positive, check_seed, warn_caller
from pymc_features.calibration.maxima import best_fit, climb_likelihood, distinct_peaks
from pymc_features.calibration.residuals import Fit, Predictions
from pymc_features.calibration.sandwich import TINY, Peak, directions, known, sentence, whitening
from pymc_features.calibration.stretched import Stretched, StretchedSMC, bell, curved, prior_and_likelihood
from pymc_features.exceptions import CalibrationWarning, SamplingWarning
from pymc_features.inference.parameters import coordinate_names, posterior_for, some_draws, to_unconstrained
from pymc_features.inference.sample import Search, journal_in, sample_from
from pymc_features.likelihoods.declaration import warn_about_variance
from pymc_features.likelihoods.mean_square import GammaFeatureRV, RequireDegrees
from pymc_features.smc import check_run, open_workers
from pymc_features.smc.proposals.pool import equal_draws, pareto_smoothed

# mean square of standard deviations from the maximum that is far, and the share of draws that makes a warning
FAR, MANY = 10.0, 0.25
LOOKED_AT = 400  # draws of which this is seen
CHECKED, UNEXPLAINED = 40, 3.0  # of these, and residuals over their sigma that are too large
STAGE_DRAWS = 600  # of draws by an expansion, which cost hardly anything
WORTH = 0.9  # of draws that are weighed, below which they are not used
WANTED = 2.0  # standard deviations beyond a bound that make a warning
KEPT = 100  # draws at a time of which a checkpoint keeps the likelihood
SHORT = 5.0  # time constants of the errors that a record must be long
FIRST = 2.0  # degrees of freedom of the first fit of `calibration.fill_degrees`: those of EXP


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
    (`effective_samples`), and the posterior is sampled again. The maximum does not move, the prior's bounds
    and information keep their meaning, and any likelihood leads to nearly the same interval.

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
        as wide at least as it makes them, and frequency bands, which disagree then, are not compared.
    **settings
        Of `sample`. A `checkpoint` keeps all predictions.

    Returns
    -------
    DataTree
        As from `sample`; `sample_stats` has the attribute `power`, and the group `calibration` is what
        `effective_samples` returns, with the share of `leverage` in each standard deviation: what the fit
        took out of the residuals. The attribute `calibration` is a table, in JSON, of growth, parameters near
        a bound and leverage. With several modes that group has them as a dimension, with their `weight`, and
        `sample_stats` says of which `mode` a draw is; its other numbers are those of the heaviest. The
        evidence is that of the stretched likelihood, and must not be compared with others.

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

    Modes that lie more than three standard deviations apart are calibrated each by itself. Each has the
    evidence of its stretched likelihood, with the ratio of the maxima raised to the power of the highest.

    References
    ----------
    Ribatet, Cooley & Davison, Stat. Sin. 22, 2012; Shaby, Bayesian Anal. 9, 2014.
    """
    check_seed(random_seed)
    if model_error is not None:
        check_choice(model_error, "model_error", ["bands"], "Or pass None.")
    model = check_model(model)
    if base_noise is not None:
        base_noise, model_error = check_positive(base_noise, "base_noise", "Pass m/s^2."), None
    posterior = posterior_for(model, idata, "idata")
    draws = posterior.sizes["draw"] if draws is None else draws
    chains = posterior.sizes["chain"] if chains is None else chains
    check_run(draws, chains, settings.get("cores"), random_seed, progressbar)
    settings |= {"draws": draws, "chains": chains, "random_seed": random_seed, "progressbar": progressbar}
    rng = np.random.default_rng(np.random.SeedSequence(random_seed).spawn(1)[0])
    predictions = Predictions(model)
    peaks = distinct_peaks(predictions, idata, model_error, rng)
    near = np.any([peak.near_bounds() for peak in peaks], axis=0)
    peaks = [Peak.at(peak.fit.measured_from_bounds(near), model_error) for peak in peaks]
    peaks, expansions = map(list, zip(*(curved(predictions, peak) for peak in peaks), strict=True))
    if base_noise is not None:
        peaks = [peak.with_base_noise(predictions, base_noise) for peak in peaks]
    prior, likelihood = prior_and_likelihood(predictions, settings.get("compile_kwargs") or {})
    parts = []
    with open_workers(settings.pop("executor", None)) as workers:
        if workers is not None:
            likelihood, settings["cores"] = workers.run().of(likelihood), 1
        for i, (peak, expansion) in enumerate(zip(peaks, expansions, strict=True)):
            found = described(predictions, peak)
            plain = peak._replace(errors=Peak.at(peak.fit, None, leverage=False).errors)
            found["leverage"] = "parameter", 1.0 - plain.deviations / peak.deviations
            warn_beyond(found)
            of_peak = peak, peaks[:i] + peaks[i + 1 :]
            target, guess = (Stretched(prior, one, *of_peak) for one in (likelihood, expansion))
            search = Search(bell(model, peak, rng), 0, 0, "the maximum was known")
            sampled = calibrated_mode(predictions, target, guess, search, i, settings, rng)
            sampled["sample_stats"].attrs["power"] = target.power
            sampled["calibration"] = xr.DataTree(found)
            check_draws(predictions, sampled["posterior"], peak)
            parts.append(sampled)
    calibrated = pooled(parts, peaks, rng)
    calibrated.attrs["calibration"] = json.dumps(table(calibrated["calibration"].to_dataset()))
    for group in ("observed_data", "constant_data"):
        if group in idata.children:
            calibrated[group] = idata[group].copy()
    if advice := calibrated["sample_stats"].attrs["advice"]:
        warn_caller(advice, SamplingWarning)
    return calibrated


def calibrated_mode(predictions, target: Stretched, guess, found, number, settings, rng) -> xr.DataTree:
    """The posterior around a maximum: draws by the expansion of its likelihood, weighed, or else its own."""
    model, space = predictions.model, predictions.space
    settings = settings | {"kernel": StretchedSMC}
    if guess.likelihood is not None:
        cheap = {"stage_draws": STAGE_DRAWS} | settings | {"checkpoint": None, "cores": 1, "logp": guess}
        idata = sample_from(found, model, space, **cheap)
        journal = journal_in(settings.get("checkpoint"), f"calibrated_{number}", model)
        with contextlib.closing(journal) if journal else contextlib.nullcontext():
            if weighed(model, idata, guess, target, journal, rng):
                return idata
    return sample_from(found, model, space, **settings, logp=target)


def weighed(model, idata, guess: Stretched, target: Stretched, journal, rng) -> bool:
    """Make a posterior by a guess of the likelihood that by the likelihood, if they are near."""
    z = to_unconstrained(model, idata["posterior"].to_dataset())
    flat = z.reshape(-1, z.shape[-1])
    some = np.array_split(flat, -(-len(flat) // KEPT) if journal else 1)
    parts = [journal.evaluate(target, x) if journal else target(x) for x in some]
    _, *values = map(np.concatenate, zip(*parts, strict=True))
    value, failed, guessed = (np.reshape(x, z.shape[:2]) for x in (*values, guess(flat)[1]))
    logs = np.array([pareto_smoothed(x) for x in value - guessed])
    with np.errstate(invalid="ignore"):  # where no draw is possible
        weights = softmax(logs, axis=1)
    worth = 1.0 / np.mean(weights**2, axis=1) / weights.shape[1] ** 2
    if not worth.min() > WORTH:
        return False
    place = [equal_draws(x, len(x), rng) for x in weights]
    idata["posterior"] = chosen(idata["posterior"].to_dataset(), np.sort(place, axis=1))
    stats, first = idata["sample_stats"].to_dataset(), idata["sample_stats"]["stage"] == 0
    evidences = stats["log_marginal_likelihood"] + logsumexp(logs, axis=1) - np.log(weights.shape[1])
    counts = {"evaluations": value.shape[1], "failed": failed.sum(axis=1)[:, None]}
    counts = {name: (0.0 * stats[name]).where(~first, count) for name, count in counts.items()}
    stats = stats.assign(log_marginal_likelihood=evidences, ess=stats["ess"] * worth, **counts)
    log_evidence = logsumexp(evidences.values) - np.log(len(evidences))
    stats.attrs |= {"log_evidence": float(log_evidence), "ess": float(stats["ess"].sum())}
    idata["sample_stats"] = xr.DataTree(stats)
    return True


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
    weights = softmax(logs)
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
            warn_caller(
                f"the data want {name} {'above' if point <= bound else 'below'} {bound:.4g}, the edge of its "
                f"prior, by {-room:.2g} standard deviations: its interval is what the prior leaves of them. "
                "Widen the prior, or look for what the model lacks.",
                CalibrationWarning,
            )


def check_draws(predictions, posterior, peak: Peak):
    """Warn if many draws are far from the maximum, and refuse those that do not explain the data."""
    draws = some_draws(predictions.model, posterior, LOOKED_AT)
    away = np.mean(peak.distance(draws) ** 2 > FAR * whitening(peak.information).shape[1])
    if away > MANY:
        warn_caller(
            f"{100 * away:.0f} % of the calibrated draws are far from the likelihood's maximum: the "
            "priors, or a maximum that no draw was near, outweigh it, and there the residuals have decided "
            "no width. Use a longer record, several events in one model, or priors that agree with the data.",
            CalibrationWarning,
        )
    fits = [peak.fit._replace(events=predictions(z)) for z in draws[:: max(1, len(draws) // CHECKED)]]
    squares = [fit.squares / fit.claimed for fit in fits]
    wide = 1.0 + np.trace(peak.claims @ peak.variability) / peak.fit.squares
    if np.median(squares) > UNEXPLAINED**2 * wide:
        raise ValueError(
            "the calibrated draws must explain the data, got residuals "
            f"{np.median(squares) ** 0.5:.3g} times as large as their own sigma. The priors exclude what the "
            "data want: widen them, or give sigma a wider prior."
        )


def table(found: xr.Dataset) -> dict:
    """What made the intervals of the heaviest mode as wide as they are, of each parameter and of all."""
    if "mode" in found.dims:
        found = found.isel(mode=int(found["weight"].values.argmax()))
    rows = found[["standard_deviation", "leverage", "near_bound", "bound", "room"]].to_dataframe().T.to_dict()
    rows = {name: {k: None if v != v else v for k, v in row.items()} for name, row in rows.items()}
    return {"growth": found.attrs["growth"], "sentence": sentence(found.attrs["growth"]), "parameters": rows}


def effective_samples(
    source: xr.DataTree | pm.Model, *, model: pm.Model | None = None, random_seed: int | None = None
) -> xr.Dataset:
    """Independent observations that the residuals of a fit support, and the covariance they imply.

    At the maximum of the likelihood the score, the sum of sensitivities times residuals, would vary as much
    as the likelihood claims (A) if the errors were what it takes them for. How much it does vary (B) is
    estimated from the residuals, over time and across sensors (``pymc_features.calibration.sandwich``). In a
    direction v of the parameters the residuals support m v' A^-1 v / v' A^-1 B A^-1 v independent
    observations, where the likelihood claims m: all under NORM, 2 of a sensor under EXP, 1 under TN.

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
    model = check_model(source if isinstance(source, pm.Model) else model)
    idata = None if source is model else source
    if idata is not None:
        posterior_for(model, idata, "source", "Or pass a model, for a fit without draws.")
    predictions = Predictions(model)
    return described(predictions, Peak.at(best_fit(predictions, idata, np.random.default_rng(random_seed))))


def fill_degrees(model: pm.Model | None = None, *, random_seed: int | None = None) -> xr.Dataset:
    """Take the degrees of freedom m of each ``GammaFeature(..., m="residuals")`` from the residuals.

    The likelihood is maximised with m = 2; the observations that the residuals of each sensor support become
    its m, and a second fit from there gives those that stay. A sensor whose response no parameter changes
    gets the mean of the others. Repeat it after `pm.set_data` with other data.

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
    features = [rv for rv in model.observed_RVs if isinstance(rv.owner.op, GammaFeatureRV)]
    ms = {rv: rv.owner.inputs[-1].owner for rv in features}
    waiting = {rv: m.inputs[0] for rv, m in ms.items() if m and isinstance(m.op, RequireDegrees)}
    if not waiting:
        names = ", ".join(rv.name for rv in model.observed_RVs) or "no likelihood"
        raise ValueError(
            f"`model` must have a GammaFeature with m='residuals', got {names}. Declare it so, or use "
            "effective_samples()."
        )
    with contextlib.ExitStack() as undo:
        for data in waiting.values():
            undo.callback(data.set_value, data.get_value())
            data.set_value(np.full(data.get_value().shape, FIRST))
        predictions = Predictions(model)
        fit = best_fit(predictions, None, np.random.default_rng(random_seed))
        fill(waiting, fit)
        fit = climb_likelihood(predictions, fit.z)
        fill(waiting, fit)
        undo.pop_all()
    for rv, data in waiting.items():
        sigma = rv.owner.inputs[3]
        if not isinstance(sigma, Constant):
            warn_about_variance("GammaFeature", data.get_value().ravel(), sigma)
    return described(predictions, Peak.at(fit))


def fill(waiting, fit):
    """Set degrees of freedom to the observations that the residuals of a fit support."""
    events = {event.name: event for event in fit.events}
    for rv, data in waiting.items():
        counted = sensors_n_eff(events[rv.name])
        if np.isnan(counted).all():
            raise ValueError(f"`model` must have parameters that change the response of {rv.name}, got none.")
        data.set_value(np.nan_to_num(counted, nan=np.nanmean(counted)).reshape(data.get_value().shape))


def sensors_n_eff(event) -> np.ndarray:
    """Observations that residuals support (sensor,); NaN where no parameter changes the response."""
    counted = np.full(len(event.residuals), np.nan)
    for j in range(len(counted)):
        alone = event.of_sensor(j)
        if alone.of_response.any():
            values, _ = directions(alone.of_response, Peak.at(Fit(None, None, [alone])).errors)
            counted[j] = (alone.residuals**2).sum() / np.exp(np.mean(np.log(values.clip(min=TINY))))
    return counted


def described(predictions, peak: Peak) -> xr.Dataset:
    """The Dataset of `effective_samples`."""
    fit, (sides, near, origin) = peak.fit, peak.fit.coordinates
    of_response = sum(event.of_response for event in fit.events)
    if not known(of_response).any():
        raise ValueError("`model` must have parameters that change the response, got none.")
    warn_of_short_records(peak)
    errors = peak.factor**2 * sum(model.variability for model in peak.models)
    values, vectors = directions(of_response, errors)
    n_direction = fit.squares / values[::-1].clip(min=TINY)
    # parameters near a bound on their own scale: the lower bound, or the only one, and the unit from there
    low, high = predictions.bounds(predictions.space.split(fit.z))
    first = np.where(np.isfinite(low), low, high)
    one = np.exp(np.where(sides == 1, origin, 0.0)) * np.where(first == low, 1.0, -1.0)
    units = np.where(near, np.where(sides == 2, high - low, one), 1.0)
    to_first, to_last = peak.rooms
    square, told = np.outer(units, units), np.where(known(peak.information), units, np.nan)
    claims, covariance = (m * np.outer(told, told) for m in (peak.claims, peak.covariance))
    names = coordinate_names(predictions.model, predictions.space)
    memory = [event.step * m.memory for event, m in zip(fit.events, peak.models, strict=True)]
    over, of = ("parameter", "parameter_"), "parameter"
    variables = {
        "n_eff": ("sensor", np.concatenate([sensors_n_eff(event) for event in fit.events])),
        "claimed": ("sensor", np.concatenate([event.claimed for event in fit.events])),
        "time_constant": ("sensor", np.repeat(memory, [len(event.residuals) for event in fit.events])),
        "follows_response": ("sensor", np.concatenate([m.follows_response for m in peak.models])),
        "n_eff_parameter": (of, fit.claimed * np.diag(claims) / np.diag(covariance)),
        "standard_deviation": (of, np.sqrt(np.diag(covariance))),
        "claimed_standard_deviation": (of, np.sqrt(np.diag(claims))),
        "changes_response": (of, known(of_response)),
        "point": (of, np.where(near, first + units * fit.w, fit.w)),
        "near_bound": (of, near),
        "bound": (of, np.where(near, np.where(to_first < to_last, first, high), np.nan)),
        "room": (of, np.where(near, np.minimum(to_first, to_last), np.nan)),
        "information": (over, peak.information / square),
        "variability": (over, peak.variability / square),
        "covariance": (over, covariance),
        "n_eff_direction": ("direction", n_direction),
        "direction_vector": (("direction", of), (vectors / np.linalg.norm(vectors, axis=0)).T[::-1]),
    }
    sensors = [f"{event.name}[{j}]" for event in fit.events for j in range(len(event.residuals))]
    n_eff, growth = float(np.exp(np.mean(np.log(n_direction)))), peak.growth
    attrs = {"n_eff": n_eff, "claimed": fit.claimed, "n_evaluations": fit.n_evaluations, "growth": growth}
    return xr.Dataset(variables, {"parameter": names, "parameter_": names, "sensor": sensors}, attrs)


def warn_of_short_records(peak: Peak):
    """Warn of records that are too short to tell how their errors vary."""
    for event, model in zip(peak.fit.events, peak.models, strict=True):
        n = event.residuals.shape[1]
        if SHORT * model.memory > n:
            step, unit = (1, "samples") if np.isnan(event.step) else (event.step, "s")
            warn_caller(
                f"the errors of {event.name} persist for {model.memory * step:.3g} {unit} of a record of "
                f"{n * step:.3g} {unit}, too short to tell how they vary: intervals may be too narrow. Use "
                "a longer record, or several events.",
                CalibrationWarning,
            )
