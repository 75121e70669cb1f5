"""A log-likelihood near its maximum, by second derivatives of residuals and scales.

Where a response is smooth, draws by it need hardly be weighed, and cost no response.
"""

import contextlib
import itertools
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from pymc_features.calibration.coordinates import Coordinates
from pymc_features.calibration.fit import log_likelihood
from pymc_features.calibration.modes import chosen
from pymc_features.calibration.peaks import Peak
from pymc_features.calibration.sandwich import whitening
from pymc_features.calibration.stretched import Stretched
from pymc_features.inference.parameters import to_unconstrained
from pymc_features.smc.kernels.checkpoint import Journal, model_fingerprint
from pymc_features.smc.proposals.mixture import equal_draws, pareto_smoothed

CURVED = 0.1  # standard deviations over which curvature is measured
WORTH = 0.9  # of draws, below which an expansion is not used
KEPT = 100  # draws at a time of which a checkpoint keeps the likelihood
MOST_EXPANDED = 15  # directions in which residuals are expanded: 136 histories are kept for each sensor


class Expansion(NamedTuple):
    """A log-likelihood near its maximum along some axes.

    Attributes
    ----------
    coordinates : Coordinates
    point : array (d,)
        Where the expansion is made.
    along : array (k, d)
        How far a change of coordinates goes along each axis.
    gram : array (sensor, c, c)
        Of the coefficients of 1, of each axis, and of each pair of axes.
    log_scale : array (c, sensor)
        Coefficients of ln s.
    claimed : array (sensor,)
        m, see `comparison`.
    """

    coordinates: Coordinates
    point: np.ndarray
    along: np.ndarray
    gram: np.ndarray
    log_scale: np.ndarray
    claimed: np.ndarray
    last_error = ""

    def __call__(self, z):
        """Nothing, log-likelihood and no failures, each (n,), of unconstrained points (n, d)."""
        a = (self.coordinates.of(z) - self.point) @ self.along.T
        first, second = np.triu_indices(a.shape[1])
        with np.errstate(over="ignore", invalid="ignore"):  # far away
            terms = np.concatenate([np.ones((len(a), 1)), a, a[:, first] * a[:, second]], axis=1)
            squares = np.stack([np.sum((terms @ gram) * terms, axis=1) for gram in self.gram], axis=1)
            log_scale = terms @ self.log_scale
            value = (-0.5 * np.exp(-2.0 * log_scale) * squares - log_scale * self.claimed).sum(axis=1)
        return None, np.where(np.isfinite(value), value, -np.inf), np.zeros(len(a), dtype=bool)

    def with_rng(self, rng) -> "Expansion":
        """The same: nothing is drawn."""
        return self


def curved(predictions, peak: Peak) -> tuple[Peak, Expansion | None]:
    """The peak with the likelihood's own curvature as A, where that is positive, and its expansion.

    Both are along the axes of A, of parameters that are not near a bound: where they are correlated, a change
    of one of them alone by its standard deviation leads far away. No expansion along many axes.
    """
    fit, result, free = peak.fit, peak.sandwich, ~peak.fit.coordinates.near
    whiten = whitening(result.information * np.outer(free, free))
    widths = np.sqrt(np.diag(whiten.T @ result.variability @ whiten))
    steps = CURVED * np.minimum(widths, 1.0)
    axes, k, at_maximum = (whiten * steps).T, len(steps), predictions(fit.z)

    def value(w):
        values = predictions(fit.coordinates.unconstrained(w))
        found = [[log_likelihood(values)]]
        if k <= MOST_EXPANDED:
            log_scales = [v.log_scale - here.log_scale for v, here in zip(values, at_maximum, strict=True)]
            unscaled = [np.exp(s)[:, None] * v.residuals for s, v in zip(log_scales, values, strict=True)]
            found += log_scales + [x.ravel() for x in unscaled]
        return np.concatenate(found)

    columns = second_order(value, fit.w, axes)
    first, second = np.triu_indices(k)
    curvature = np.zeros((k, k))
    np.add.at(curvature, (first, second), -columns[1 + k :, 0])
    relative = (curvature + curvature.T) / np.outer(steps, steps)
    if np.linalg.eigvalsh(relative).min(initial=np.inf) > 0:
        unwhiten = whiten.T @ (result.information * free)
        more = unwhiten.T @ (relative - np.eye(k)) @ unwhiten
        peak = peak._replace(sandwich=result._replace(information=result.information + more))
    if k > MOST_EXPANDED:
        return peak, None
    claimed = np.concatenate([v.claimed for v in at_maximum])
    ends = 1 + np.cumsum([0, len(claimed), *(v.mu.shape[-1] for v in at_maximum for _ in v.claimed)])
    log_scale, *series = (columns[:, i:j] for i, j in itertools.pairwise(ends))
    gram = np.array([x @ x.T for x in series])
    return peak, Expansion(fit.coordinates, fit.w, np.linalg.pinv(axes).T, gram, log_scale, claimed)


def second_order(value, w, axes) -> np.ndarray:
    """Coefficients (c, n) of 1, of each axis (k, d) and of each pair, in a function of points (d,)."""
    here = value(w)
    ends = [np.reshape([value(w + s * axis) for axis in axes], (len(axes), len(here))) for s in (1.0, -1.0)]
    middle, pairs = 0.5 * (ends[0] + ends[1]) - here, []
    for i, j in zip(*np.triu_indices(len(axes)), strict=True):
        if i == j:
            pairs.append(middle[i])
        else:
            both = value(w + axes[i] + axes[j]) + value(w - axes[i] - axes[j])
            pairs.append(0.5 * both - here - middle[i] - middle[j])
    return np.array([here, *(0.5 * (ends[0] - ends[1])), *pairs])


def weighed(model, idata, guess: Stretched, target: Stretched, checkpoint, number, rng) -> xr.DataTree | None:
    """A posterior by a guess of the likelihood as that by the likelihood; None where they are not near."""
    z = to_unconstrained(model, idata["posterior"].to_dataset())
    flat = z.reshape(-1, z.shape[-1])
    values = *evaluated(target, flat, model, checkpoint, number), guess(flat)[1]
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


def evaluated(target: Stretched, z, model, checkpoint, number):
    """Log-likelihood and failures (n,) of points (n, d), part by part where a checkpoint keeps them."""
    if checkpoint is None:
        return target(z)[1:]
    Path(checkpoint).mkdir(parents=True, exist_ok=True)
    journal = Journal(Path(checkpoint) / f"calibrated_{number}.record", model_fingerprint(model))
    with contextlib.closing(journal):
        parts = [journal.evaluate(target, x) for x in np.array_split(z, -(-len(z) // KEPT))]
    return [np.concatenate(x) for x in list(zip(*parts, strict=True))[1:]]
