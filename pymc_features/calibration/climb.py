"""Climbs to the likelihood's maximum, with few sets of derivatives."""

import numpy as np

from pymc_features.calibration.fit import Fit, events_at, information_of, log_likelihood, residuals_of
from pymc_features.calibration.sandwich import whitening

DIFFERENCE = 0.02  # standard errors of independent samples that derivatives are taken over,
WIDEST, NARROWEST = 1e-3, 1e-7  # but no more and no less than this, on the unconstrained scale
NARROW = 1e-5  # before standard errors are known
STEPS = 100  # towards the maximum, at most
CONVERGED, FAILED = 1e-3, 3e-3  # standard errors of independent samples that the last step, and one that
# leads no higher, may be long
SHORTER = 0.3  # than the step before must one be that is taken with the derivatives of another point
NEAR = 0.1  # of such a standard error: derivatives there are those at the maximum
LEAST = 0.1  # of the information that the curvature is taken to have where it is less, or negative
LONGEST = 1.0  # step, on the unconstrained scale
SINGULAR = 1e-12  # of the largest relative eigenvalue: directions that change nothing


def climb_likelihood(predictions, z) -> Fit:
    """The maximum of the likelihood near a point (d,), by Levenberg's and Marquardt's method.

    Derivatives, a prediction or two for each parameter, are kept for as long as steps with them become much
    shorter from one to the next. Where residuals are large their second derivatives count; these are learnt
    from one set of derivatives to the next.
    """
    start = predictions.count
    here = predictions(z)
    value, damping, last = log_likelihood(here), 1e-6, np.inf
    if value == -np.inf:
        raise ValueError("the fit must start where the likelihood is finite. Pass another `idata`.")
    events, at, central = events_at(predictions, z, np.full(len(z), NARROW), here, [1.0]), z, False
    score, second = score_of(events), np.zeros((len(z), len(z)))
    before = score
    for _ in range(STEPS):
        step = newton(curvature(information_of(events), second), score, damping)
        length, moved = standard_errors(events, step), standard_errors(events, z - at)
        if length < CONVERGED and central and moved < NEAR:
            break
        if length < SHORTER * last and not (length < CONVERGED):
            values = predictions(z + step)
            trial = log_likelihood(values)
            if trial > value:
                z, here, value, damping, last = z + step, values, trial, damping / 10.0, length
                events = with_residuals(events, here)
                score = score_of(events)
                continue
            if length < FAILED and central and moved < NEAR:
                break
            if moved == 0.0:
                damping = max(damping, 1e-6) * 10.0
                continue
        if length < CONVERGED:  # with these derivatives, and perhaps only for its damping
            damping = 1e-6
        central = length < NEAR
        sides = [1.0, -1.0] if central else [1.0]
        events, stale = events_at(predictions, z, differences(events), here, sides), score
        score, last = score_of(events), np.inf
        if moved > 0.0:
            second = learnt(second, z - at, stale - score, before - score)
        at, before = z, score
    return Fit(z, events, predictions.count - start)


def standard_errors(events, step) -> float:
    """Length of a step (d,), in standard errors of independent samples."""
    return np.sqrt(excess(events) * max(0.0, step @ information_of(events) @ step))


def score_of(events):
    """Gradient of the log-likelihood (d,) of all events."""
    return sum(event.score for event in events)


def learnt(second, step, change, total):
    """What second derivatives add to the information (d, d), after a step (d,) that it changed by `change`.

    `total` is the change of the whole score (Dennis, Gay & Welsch, ACM Trans. Math. Softw. 7, 1981).
    """
    along, known = total @ step, step @ second @ step
    if not along > 0:
        return second
    size = min(1.0, abs(step @ change / known)) if known else 1.0
    off = change - size * (second @ step)
    cross = np.outer(off, total) / along
    return size * second + cross + cross.T - (off @ step) / along**2 * np.outer(total, total)


def curvature(information, second):
    """Their sum (d, d), but at least a part of the information in every direction."""
    whiten = whitening(information)
    unwhiten = whiten.T @ information
    relative = whiten.T @ second @ whiten
    values, vectors = np.linalg.eigh(0.5 * (relative + relative.T))
    along = (vectors * np.maximum(values, LEAST - 1.0)) @ vectors.T
    return information + unwhiten.T @ along @ unwhiten


def with_residuals(events, values):
    """The events with the residuals at another point, and the derivatives they had."""
    return [
        event._replace(residuals=residuals_of(value), claimed=value[4], response=value[0])
        for event, value in zip(events, values, strict=True)
    ]


def excess(events):
    """Samples over the observations that the likelihood claims."""
    return sum(event.n_samples for event in events) / sum(event.claimed.sum() for event in events)


def differences(events):
    """Steps (d,) of central differences, a part of the standard errors of independent samples."""
    scale = np.sqrt(excess(events) * np.diag(information_of(events))).clip(min=np.finfo(float).tiny)
    return np.clip(DIFFERENCE / scale, NARROWEST, WIDEST)


def newton(information, score, damping):
    """A damped Newton step (d,), none along directions that change nothing."""
    scale = np.sqrt(np.diag(information))
    scale = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    known = values > SINGULAR * values.max(initial=0.0)
    along = vectors.T @ (score / scale)
    step = vectors @ np.where(known, along / np.where(known, values + damping, 1.0), 0.0) / scale
    return step / max(1.0, np.abs(step).max() / LONGEST)
