"""Parameters whose prior ends near to the likelihood's maximum: which they are, and what is said of them."""

import warnings

import numpy as np

from pymc_features.calibration.coordinates import BEYOND
from pymc_features.calibration.fit import Fit
from pymc_features.calibration.sandwich import Sandwich
from pymc_features.exceptions import CalibrationWarning

NEAR = 6.0  # standard deviations from a bound that count
WANTED = 2.0  # standard deviations beyond a bound that make a warning
SHORT = 2.0  # standard deviations from a bound within which the shortest interval is given: beyond, equal
# tails hardly differ from it, and nearer they never contain the bound
FEW = 0.01  # of the draws between an interval and a bound: the interval ends at the bound


def free_maximum(fit: Fit, result: Sandwich) -> np.ndarray:
    """Coordinates (d,) where the likelihood would have its maximum without bounds, by one step beyond."""
    return fit.w + result.claims @ fit.pushing


def deviations(result: Sandwich) -> np.ndarray:
    """Standard deviations (d,) of coordinates, NaN of what the likelihood does not know."""
    sd = np.sqrt(np.diag(result.covariance))
    return np.where(sd > 0, sd, np.nan)


def near_bounds(fit: Fit, result: Sandwich) -> np.ndarray:
    """Parameters (d,) whose prior ends so near to the maximum that this may shape the interval.

    Those that no response depends on only where their score pushes them against it.
    """
    free = np.clip(free_maximum(fit, result), *fit.coordinates.limits)
    room = fit.coordinates.rooms(fit.coordinates.unconstrained(free), deviations(result)).min(axis=0)
    of_response = np.any([np.any(e.sensitivities, axis=(0, 1)) for e in fit.events], axis=0)
    return (fit.pushing != 0) | (of_response & (room < NEAR))


def own_scale(predictions, fit: Fit, result: Sandwich) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """What is said of parameters (d,) near a bound, on their own scale, and the units of coordinates there.

    `point`, the maximum; `near_bound`; the nearest `bound`, NaN of others; `room`, how many standard
    deviations within it the free maximum lies, negative beyond.
    """
    coordinates, near, space = fit.coordinates, fit.coordinates.near, predictions.space
    far = np.where(coordinates.sides == 2, BEYOND, coordinates.origin)
    values = space.variables(np.where(near, [np.full(len(far), -BEYOND), far], fit.z))
    low, high = np.hstack([values[rv.name].reshape(2, -1) for rv in predictions.model.free_RVs])
    free, sd, units = free_maximum(fit, result), deviations(result), np.where(near, high - low, 1.0)
    to_low, to_high = ((free - coordinates.limits[0]) / sd, (coordinates.limits[1] - free) / sd)
    found = {
        "point": np.where(near, low + units * fit.w, fit.w),
        "near_bound": near,
        "bound": np.where(near, np.where(to_low < to_high, low, high), np.nan),
        "room": np.where(near, np.minimum(to_low, to_high), np.nan),
    }
    return found, units


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


def interval(draws, probability=0.9, bound=None) -> tuple[float, float]:
    """Equal-tailed interval of draws (n,), or, next to a bound, the shortest: an equal-tailed one never
    contains the bound.
    """
    if bound is None:
        return tuple(map(float, np.quantile(draws, [0.5 - 0.5 * probability, 0.5 + 0.5 * probability])))
    x = np.sort(draws)
    n = int(np.ceil(probability * len(x)))
    first = int(np.argmin(x[n - 1 :] - x[: len(x) - n + 1]))
    low, high = x[first], x[first + n - 1]
    if bound >= high and np.mean((x > high) & (x < bound)) < FEW:
        high = bound
    if bound <= low and np.mean((x > bound) & (x < low)) < FEW:
        low = bound
    return float(low), float(high)
