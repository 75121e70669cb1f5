"""Maxima of a likelihood with what the residuals say of their width: near bounds, and several of them."""

from typing import NamedTuple

import numpy as np

from pymc_features.calibration.climb import climb_likelihood
from pymc_features.calibration.comparison import log_likelihood
from pymc_features.calibration.fit import Fit
from pymc_features.calibration.sandwich import Sandwich, combined, sandwich, stretching
from pymc_features.inference.parameters import posterior_for, to_unconstrained
from pymc_features.inference.sample import search
from pymc_features.smc import population_logp, prior_points

NEAR = 6.0  # standard deviations from a bound that count
STARTS = 20  # draws of which the most likely is climbed from
CLIMBS = 4  # from the draws that are farthest from what has been climbed from or to
CANDIDATES = 100  # draws that these are chosen from
DISTINCT = 3.0  # standard deviations, by the residuals, between maxima that are not one
LIGHTEST = 1e-3  # weight of a mode that is left out
ROUNDED = 1e-12  # of what a unit change of a parameter does to the response: rounding, no residuals
REALISATIONS = 200  # of noise on a base


class Peak(NamedTuple):
    """A maximum of the likelihood and its sandwich."""

    fit: Fit
    sandwich: Sandwich

    @property
    def free(self) -> np.ndarray:
        """Coordinates (d,) where the maximum would be without bounds, by one step beyond."""
        return self.fit.w + self.sandwich.claims @ self.fit.pushing

    @property
    def deviations(self) -> np.ndarray:
        """Standard deviations (d,) of coordinates, NaN of what the likelihood does not know."""
        sd = np.sqrt(np.diag(self.sandwich.covariance))
        return np.where(sd > 0, sd, np.nan)

    def distance(self, z) -> np.ndarray:
        """Standard deviations (...,) between the maximum and unconstrained points (..., d)."""
        apart = self.fit.coordinates.of(z) - self.fit.w
        return np.sqrt(np.einsum("...i,ij,...j->...", apart, self.sandwich.precision, apart))

    def near_bounds(self) -> np.ndarray:
        """Parameters (d,) whose prior ends so near to the maximum that this may shape the interval.

        Those that no response depends on only where their score pushes them against it.
        """
        coordinates, pushing = self.fit.coordinates, self.fit.pushing
        z = coordinates.unconstrained(np.clip(self.free, *coordinates.limits))
        sd = self.deviations * coordinates.own_slopes(z) / coordinates.slopes(z)
        low = coordinates.distance(z)
        room = np.where(coordinates.sides == 2, np.minimum(low, 1.0 - low), low) / sd
        of_response = np.any([np.any(e.sensitivities, axis=(0, 1)) for e in self.fit.events], axis=0)
        return (coordinates.sides > 0) & ((pushing != 0) | (of_response & (room < NEAR)))

    def measured_from_bounds(self, near) -> "Peak":
        """Take coordinates where some parameters (d,) are measured from a bound."""
        fit, ratio = self.fit.measured_from_bounds(near)
        result, square = self.sandwich, np.outer(ratio, ratio)
        matrices = ("information", "variability", "of_response")
        return Peak(fit, result._replace(**{x: getattr(result, x) * square for x in matrices}))

    def with_base_noise(self, predictions, sd: float) -> "Peak":
        """Make the peak at least as wide, in every direction, as white noise on the base does [m/s^2]."""
        noise, result = of_base_noise(predictions, self.fit, sd), self.sandwich
        variability = combined(result.variability, noise, lambda ratios: np.maximum(ratios - 1.0, 0.0))
        return Peak(self.fit, result._replace(variability=variability))


def of_base_noise(predictions, fit: Fit, sd: float) -> np.ndarray:
    """Covariance (d, d) of the score by white noise of a standard deviation [m/s^2] on the base's record.

    By `REALISATIONS` of the noise: good to 5 % of a standard deviation.
    """
    rng, scores = np.random.default_rng(0), []
    for _ in range(REALISATIONS):
        pairs = zip(predictions.with_noisy_base(fit.z, sd, rng), fit.events, strict=True)
        off = [np.einsum("stp,st->p", e.sensitivities, v.residuals - e.residuals) for v, e in pairs]
        scores.append(sum(off))
    return np.einsum("np,nq->pq", scores, scores) / REALISATIONS


def fit_near(predictions, z) -> Fit:
    """The maximum near a point (d,), if every sensor has residuals there."""
    fit = climb_likelihood(predictions, z)
    for event in fit.events:
        response = (event.sensitivities**2).sum(axis=1).max(axis=-1)
        silent = np.flatnonzero(~((event.residuals**2).sum(axis=1) > ROUNDED**2 * response))
        if silent.size:
            raise ValueError(
                f"the residuals of {event.value.name} must not vanish, got none at sensor {silent[0]}: data "
                "without noise support no estimate of their errors. Add the measurement noise, or leave out "
                "the sensor."
            )
    return fit


def best_fit(predictions, starts, rng) -> Fit:
    """The maximum near the most likely of some points (n, d); of a model's modes without points."""
    model = predictions.model
    if starts is None:
        logp = population_logp(model, predictions.space.point, {})
        found = search(model, logp, 1000, rng, None).reference
        starts = prior_points(model, 10 * STARTS, rng) if found is None else found.peaks
        heights = np.add(*logp(starts)[:2])
    else:
        heights = [log_likelihood(predictions(z)) for z in starts] if len(starts) > 1 else [0.0]
    return fit_near(predictions, starts[np.argmax(heights)])


def starting_points(model, idata, name: str) -> np.ndarray:
    """Unconstrained points (n, d) that a posterior offers: its modes where they are known, or some draws."""
    posterior = posterior_for(model, idata, name)
    if "modes" in idata.children and {rv.name for rv in model.free_RVs} <= set(idata["modes"].data_vars):
        return to_unconstrained(model, idata["modes"].to_dataset().expand_dims("chain"))[0]
    return some_draws(model, posterior)


def some_draws(model, posterior, number=STARTS) -> np.ndarray:
    """Unconstrained draws (n, d) of all chains, evenly spaced."""
    every = max(1, posterior.sizes["chain"] * posterior.sizes["draw"] // number)
    some = to_unconstrained(model, posterior.isel(draw=slice(None, None, every)))
    return some.reshape(-1, some.shape[-1])


def distinct_peaks(predictions, idata, model_error, rng) -> list[Peak]:
    """Maxima of the likelihood that draws of a posterior lead to and that may matter, the highest first."""
    model = predictions.model
    fit = best_fit(predictions, starting_points(model, idata, "idata"), rng)
    peaks, known = [Peak(fit, sandwich(fit.events, model_error))], [fit.z]
    draws = some_draws(model, idata["posterior"].to_dataset(), CANDIDATES)
    scale = draws.std(axis=0)
    scale[scale == 0.0] = 1.0
    for _ in range(min(CLIMBS, len(draws) - 1)):
        distances = ((draws[:, None] - np.array(known)) / scale) ** 2
        start = draws[distances.sum(axis=2).min(axis=1).argmax()]
        fit = fit_near(predictions, start)
        known += [start, fit.z]
        if all(other.distance(fit.z) > DISTINCT for other in peaks):
            peak = Peak(fit, sandwich(fit.events, model_error))
            if all(peak.distance(other.fit.z) > DISTINCT for other in peaks):
                peaks.append(peak)
    peaks.sort(key=lambda peak: -peak.fit.height)
    # weights by Laplace's approximation under a flat prior, heights by the power of the highest
    power, _ = stretching(peaks[0].sandwich.information, peaks[0].sandwich.precision)
    widths = [np.linalg.eigvalsh(peak.sandwich.precision) for peak in peaks]
    volumes = [-0.5 * np.log(x[x > 1e-12 * x.max()]).sum() for x in widths]
    logs = np.array([power * p.fit.height + volume for p, volume in zip(peaks, volumes, strict=True)])
    return [p for p, log in zip(peaks, logs, strict=True) if log > np.max(logs) + np.log(LIGHTEST)]
