"""How the posteriors around several maxima of a likelihood are put together."""

import numpy as np
import xarray as xr

from pymc_features.calibration.peaks import Peak
from pymc_features.smc.proposals.mixture import equal_draws


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
