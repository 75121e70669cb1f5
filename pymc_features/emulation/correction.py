"""How far an emulator's posterior is from that of the simulator, by true runs at some of its draws."""

from typing import NamedTuple

import numpy as np

LEVELS = (0.05, 0.5, 0.95)


def normalised(log_weights):
    """Weights (n,) with mean one; none where a run failed."""
    log_weights = np.where(np.isfinite(log_weights), log_weights, -np.inf)
    weights = np.exp(log_weights - log_weights.max())
    return weights / weights.mean()


def largest_change(theta, log_weights) -> float:
    """Largest change of a quantile over the 5-95 % width, when draws (n, d) get weights."""
    if not np.isfinite(log_weights).any():
        return np.inf
    weights = normalised(log_weights)
    worst = 0.0
    for column in theta.T:
        before, after = weighted_quantiles(column, np.ones(len(column))), weighted_quantiles(column, weights)
        worst = max(worst, np.abs(after - before).max() / max(before[-1] - before[0], 1e-300))
    return float(worst)


def weighted_quantiles(x, weights):
    """Quantiles (level,) of weighted points (point,)."""
    order = np.argsort(x)
    at = (np.cumsum(weights[order]) - 0.5 * weights[order]) / weights.sum()
    return np.interp(LEVELS, at, x[order])


class Remaining(NamedTuple):
    """What is left of the emulator's error after true runs have been learnt, for each parameter (d,).

    Attributes
    ----------
    shift, shift_se : array
        Of the mean, in standard deviations of the posterior, with its standard error.
    stretch, stretch_se : array
        Of the standard deviation, relative.
    efficiency : float
        Effective share of the true runs when they are weighed.
    """

    shift: np.ndarray
    shift_se: np.ndarray
    stretch: np.ndarray
    stretch_se: np.ndarray
    efficiency: float

    @property
    def largest(self) -> float:
        """Largest error of all, two standard errors included."""
        ends = [np.abs(self.shift) + 2.0 * self.shift_se, np.abs(self.stretch) + 2.0 * self.stretch_se]
        return float(np.max(ends))


def remaining(theta, at, log_ratios, log_updates) -> Remaining:
    """The error that is left.

    Parameters
    ----------
    theta : array (n, d)
        Draws from the posterior of an emulator.
    at : array of int (m,)
        Those of them, independent, where the simulator was run.
    log_ratios : array (m,)
        True log-likelihoods less the emulator's there.
    log_updates : array (n,)
        Log-likelihoods of the emulator that has learnt these runs, less those of the one before.

    Notes
    -----
    With weights w = exp(log_ratios) of mean one, E_true f - E_emulator f = Cov(w, f) is estimated by the mean
    of (w - 1)(f - E_emulator f), whose standard error shrinks with the error of the emulator: a control
    variate, since E_emulator f is known from all draws. What the update has moved f by is taken away.
    """
    weights, updates = normalised(log_ratios), normalised(log_updates)
    scaled = (theta - theta.mean(axis=0)) / theta.std(axis=0)
    results = []
    for f in (scaled, 0.5 * (scaled**2 - 1.0)):
        terms = (weights[:, None] - 1.0) * f[at]
        done = ((updates[:, None] - 1.0) * f).mean(axis=0)
        results += [terms.mean(axis=0) - done, terms.std(axis=0, ddof=1) / np.sqrt(len(at))]
    return Remaining(*results, float(len(weights) / (weights**2).sum() * weights.mean() ** 2))
