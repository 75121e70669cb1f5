"""Draws of posteriors: weighed by another likelihood, and those around several maxima put together."""

import contextlib

import numpy as np
import xarray as xr

from pymc_features.calibration.peaks import Peak
from pymc_features.calibration.stretched import Stretched
from pymc_features.inference.parameters import to_unconstrained
from pymc_features.smc.kernels.checkpoint import Journal, model_fingerprint
from pymc_features.smc.proposals.mixture import equal_draws, pareto_smoothed

WORTH = 0.9  # of draws that are weighed, below which they are not used
KEPT = 100  # draws at a time of which a checkpoint keeps the likelihood


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
    own = {name: (0.0 * stats[name]).where(~first, count) for name, count in counts.items()}
    stats = stats.assign(log_marginal_likelihood=evidences, ess=stats["ess"] * worth, **own)
    stats.attrs |= {
        "log_evidence": float(np.logaddexp.reduce(evidences.values) - np.log(len(evidences))),
        "ess": float(stats["ess"].sum()),
    }
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
    """Draws of the posteriors around maxima by their weights; other groups are those of the heaviest."""
    if len(parts) == 1:
        return parts[0]
    weights = mode_weights([part["sample_stats"].attrs for part in parts], peaks)
    result = parts[int(weights.argmax())]
    result["posterior"], mode = mixed([part["posterior"].to_dataset() for part in parts], weights, rng)
    result["sample_stats"]["mode"] = xr.DataArray(mode, dims=("chain", "draw"))
    advice = [part["sample_stats"].attrs["advice"] for part in parts]
    result["sample_stats"].attrs |= {"n_modes": len(parts), "advice": next((x for x in advice if x), "")}
    every = [part["calibration"].to_dataset() for part in parts]
    described = xr.concat(every, "mode", combine_attrs="override")
    described["n_eff_mode"] = ("mode", [one.attrs["n_eff"] for one in every])
    result["calibration"] = xr.DataTree(described.assign(weight=("mode", weights)))
    return result


def mode_weights(stats: list[dict], peaks: list[Peak]) -> np.ndarray:
    """Weights (mode,): volumes of the stretched likelihoods, heights by the power of the highest."""
    heights = [peak.fit.height for peak in peaks]
    power = stats[int(np.argmax(heights))]["power"]
    logs = [
        one["log_evidence"] + (power - one["power"]) * height
        for one, height in zip(stats, heights, strict=True)
    ]
    weights = np.exp(np.array(logs) - max(logs))
    return weights / weights.sum()


def mixed(posteriors, weights, rng):
    """Draws of posteriors by their weights, and which they are of (chain, draw)."""
    n_chains, n_draws = (posteriors[0].sizes[dim] for dim in ("chain", "draw"))
    mode = np.stack([equal_draws(weights, n_draws, rng) for _ in range(n_chains)])
    place = np.stack([rng.permutation(n_draws) for _ in range(n_chains)])
    return chosen(xr.concat(posteriors, "_part", join="override"), place, _part=mode), mode


def chosen(posterior, place, **more) -> xr.DataTree:
    """Draws of a posterior at places (chain, draw) of their chains, and of other dimensions."""
    at = {"draw": place, "chain": np.arange(len(place))[:, None].repeat(place.shape[1], axis=1), **more}
    at = {name: xr.DataArray(x, dims=("chain", "draw")) for name, x in at.items()}
    draws = posterior.isel(at).transpose("chain", "draw", ...)
    return xr.DataTree(draws.assign_coords({name: posterior[name] for name in ("chain", "draw")}))
