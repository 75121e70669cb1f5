"""Parameters whose prior ends near to the likelihood's maximum: their intervals, and what is said of them."""

import warnings

import numpy as np

from pymc_features.exceptions import CalibrationWarning

WANTED = 2.0  # standard deviations beyond a bound that make a warning
SHORT = 2.0  # standard deviations from a bound within which the shortest interval is given: beyond, equal
# tails hardly differ from it, and nearer they never contain the bound
FEW = 0.01  # of the draws between an interval and a bound: the interval ends at the bound


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
