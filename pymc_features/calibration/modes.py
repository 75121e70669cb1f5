"""Several maxima of a likelihood: how they are found, and how their posteriors are put together."""

from typing import NamedTuple

import numpy as np
import xarray as xr

from pymc_features.calibration.climb import climb_likelihood
from pymc_features.calibration.effective import (
    best_fit,
    some_draws,
    starting_points,
    with_noise,
)
from pymc_features.calibration.fit import Fit, log_likelihood
from pymc_features.calibration.sandwich import Sandwich, sandwich
from pymc_features.calibration.stretched import stretching
from pymc_features.smc.proposals.mixture import equal_draws

CLIMBS = 4  # from the draws that are farthest from what has been climbed from or to
CANDIDATES = 100  # draws that these are chosen from
DISTINCT = 3.0  # standard deviations, by the residuals, between maxima that are not one
LIGHTEST = 1e-3  # weight of a mode that is left out


class Peak(NamedTuple):
    """A maximum of the likelihood, its height but for a constant, and its sandwich."""

    fit: Fit
    height: float
    sandwich: Sandwich

    def distance(self, z) -> np.ndarray:
        """Standard deviations (...,) between the maximum and unconstrained points (..., d)."""
        apart = self.fit.coordinates.of(z) - self.fit.w
        return np.sqrt(np.einsum("...i,ij,...j->...", apart, self.sandwich.precision, apart))


class Part(NamedTuple):
    """The posterior around one maximum, the power of its likelihood, and the log-likelihood there."""

    idata: xr.DataTree
    power: float
    height: float


def distinct_peaks(predictions, idata, model_error, rng) -> list[Peak]:
    """Maxima of the likelihood that draws of a posterior lead to and that may matter, the highest first."""
    model = predictions.model

    def peak_of(fit):
        height = log_likelihood(predictions(fit.z))
        return Peak(fit, height, sandwich(fit.events, fit.information, model_error))

    peaks = [peak_of(best_fit(predictions, starting_points(model, idata, "idata"), rng))]
    draws = some_draws(model, idata["posterior"].to_dataset(), CANDIDATES)
    scale = draws.std(axis=0)
    scale[scale == 0.0] = 1.0
    known = [peaks[0].fit.z]
    for _ in range(min(CLIMBS, len(draws) - 1)):
        distances = ((draws[:, None] - np.array(known)) / scale) ** 2
        start = draws[distances.sum(axis=2).min(axis=1).argmax()]
        fit = with_noise(climb_likelihood(predictions, start))
        known += [start, fit.z]
        peak = peak_of(fit)
        if all(min(other.distance(fit.z), peak.distance(other.fit.z)) > DISTINCT for other in peaks):
            peaks.append(peak)
    peaks.sort(key=lambda peak: -peak.height)
    return [peak for peak, weight in zip(peaks, rough_weights(peaks), strict=True) if weight > LIGHTEST]


def rough_weights(peaks):
    """Relative weights of maxima, the highest first, by Laplace's approximation under a flat prior."""
    if len(peaks) == 1:
        return np.ones(1)
    power, _ = stretching(peaks[0].sandwich.information, peaks[0].sandwich.precision)
    volumes = [-0.5 * log_determinant(peak.sandwich.precision) for peak in peaks]
    logs = [power * peak.height + volume for peak, volume in zip(peaks, volumes, strict=True)]
    return np.exp(np.array(logs) - max(logs))


def log_determinant(precision) -> float:
    """Of the directions that are not flat."""
    values = np.linalg.eigvalsh(precision)
    return float(np.log(values[values > 1e-12 * values.max()]).sum())


def pooled(parts: list[Part], rng) -> xr.DataTree:
    """Draws of all modes by their weights; the other groups are those of the heaviest."""
    if len(parts) == 1:
        return parts[0].idata
    weights = mode_weights(parts)
    first = int(weights.argmax())
    result = parts[first].idata
    result["posterior"], mode = mixed([part.idata["posterior"].to_dataset() for part in parts], weights, rng)
    result["sample_stats"]["mode"] = xr.DataArray(mode, dims=("chain", "draw"))
    advice = [part.idata["sample_stats"].attrs["advice"] for part in parts]
    result["sample_stats"].attrs |= {"n_modes": len(parts), "advice": next((x for x in advice if x), "")}
    every = [part.idata["calibration"].to_dataset() for part in parts]
    described = xr.concat(every, "mode", combine_attrs="override")
    described["n_eff_mode"] = ("mode", [one.attrs["n_eff"] for one in every])
    result["calibration"] = xr.DataTree(described.assign(weight=("mode", weights)))
    return result


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


def mode_weights(parts) -> np.ndarray:
    """Weights (mode,): volumes of the stretched likelihoods, heights by the power of the highest."""
    highest = max(parts, key=lambda part: part.height)
    logs = [
        part.idata["sample_stats"].attrs["log_evidence"] + (highest.power - part.power) * part.height
        for part in parts
    ]
    weights = np.exp(np.array(logs) - max(logs))
    return weights / weights.sum()
