"""Climbs to the likelihood's maximum, with few sets of derivatives."""

import numpy as np
from scipy.optimize import lsq_linear
from scipy.special import expit

from pymc_features.calibration.comparison import log_likelihood
from pymc_features.calibration.fit import Fit, events_at
from pymc_features.calibration.sandwich import combined

DIFFERENCE = 0.02  # standard errors of independent samples that derivatives are taken over,
WIDEST, NARROWEST = 1e-3, 1e-7  # but no more and no less than this, in coordinates
NARROW = 1e-5  # before standard errors are known
STEPS = 100  # towards the maximum, at most
CONVERGED, FAILED = 1e-3, 3e-3  # standard errors of independent samples that the last step, and one that
# leads no higher, may be long
SHORTER = 0.3  # than the step before must one be that is taken with the derivatives of another point
NEAR = 0.1  # of such a standard error: derivatives there are those at the maximum
LEAST = 0.1  # of the information that the curvature is taken to have where it is less, or negative
LONGEST, LONGEST_SHARE = 1.0, 0.25  # step of a coordinate, and of one between two bounds
BESIDE, MUCH = 0.05, 3.0  # share of the distance between bounds; how far on the unconstrained scale
SINGULAR = 1e-12  # of the largest relative eigenvalue: directions that change nothing


def climb_likelihood(predictions, z) -> Fit:
    """The maximum of the likelihood near a point (d,), by Levenberg's and Marquardt's method.

    Derivatives, a prediction or two for each parameter, are kept for as long as steps with them become much
    shorter from one to the next. Where residuals are large their second derivatives count; these are learnt
    from one set of derivatives to the next. A parameter that a step would take out of its prior is from then
    on measured from the bound, and stays within.
    """
    count, here = predictions.count, predictions(z)
    fit = Fit(predictions.coordinates, z, [], log_likelihood(here))
    if fit.height == -np.inf:
        raise ValueError("the fit must start where the likelihood is finite. Pass another `idata`.")
    events = events_at(predictions, z, np.full(len(z), NARROW), here, fit.coordinates, central=False)
    fit = bounded(fit._replace(events=events), z)
    second, damping, last, central = np.zeros((len(z), len(z))), 1e-6, np.inf, False
    at, before = fit.w, fit.score  # where derivatives were taken
    for _ in range(STEPS):
        information, limits = fit.information, fit.coordinates.limits
        longest = np.where(fit.coordinates.near & (fit.coordinates.sides == 2), LONGEST_SHARE, LONGEST)
        curvature = combined(information, second, lambda values: np.maximum(values, LEAST - 1.0))
        step = newton(curvature, fit.score, damping, np.clip(limits - fit.w, -longest, longest))
        independent = information * sum((~v.gaps).sum() for v in here) / fit.claimed
        length, moved = (np.sqrt(max(0.0, x @ independent @ x)) for x in (step, fit.w - at))
        if length < CONVERGED and central and moved < NEAR:
            break
        if length < SHORTER * last and not (length < CONVERGED):
            w = np.clip(fit.w + step, *limits)
            values = predictions(fit.coordinates.unconstrained(w))
            if (height := log_likelihood(values)) > fit.height:
                here, damping, last = values, damping / 10.0, length
                pairs = zip(fit.events, here, strict=True)
                events = [e._replace(value=v, residuals=v.residuals) for e, v in pairs]
                fit = fit._replace(w=w, height=height, events=events)
                continue
            if length < FAILED and central and moved < NEAR:
                break
            if moved == 0.0:
                damping = max(damping, 1e-6) * 10.0
                continue
        if length < CONVERGED:  # with these derivatives, and perhaps only for its damping
            damping = 1e-6
        central = length < NEAR
        scale = np.sqrt(np.diag(independent)).clip(min=np.finfo(float).tiny)
        steps = np.clip(DIFFERENCE / scale, NARROWEST, WIDEST)
        events = events_at(predictions, fit.w, steps, here, fit.coordinates, central)
        anew = fit._replace(events=events)
        if moved > 0.0:
            second = learnt(second, fit.w - at, fit.score - anew.score, before - anew.score)
        fit = bounded(anew, z)
        if fit is not anew:
            second = np.zeros_like(second)
        at, before, last = fit.w, fit.score, np.inf
    frequencies = predictions.frequencies(fit.z)
    events = [e._replace(frequencies=f) for e, f in zip(fit.events, frequencies, strict=True)]
    return fit._replace(events=events, n_evaluations=predictions.count - count)


def bounded(fit: Fit, start) -> Fit:
    """The fit, with parameters measured from the bound that they are beside and the next step would cross.

    Beside an only bound is what has come much nearer to it since `start` (d,).
    """
    coordinates, z = fit.coordinates, fit.z
    step = newton(fit.information, fit.score, 0.0, (-np.inf, np.inf))
    own = coordinates.own_slopes(z) / coordinates.slopes(z) * step
    low, high = coordinates.distance(z), expit(-z)
    beside = np.where(coordinates.sides == 2, low < BESIDE, z < start - MUCH)
    crosses = (coordinates.sides > 0) & beside & (own < -low)
    crosses |= (coordinates.sides == 2) & (high < BESIDE) & (own > high)
    if not (crosses & ~coordinates.near).any():
        return fit
    return fit.measured_from_bounds(coordinates.near | crosses)[0]


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


def newton(information, score, damping, room):
    """A damped Newton step (d,) within least and largest steps, none along directions that change nothing."""
    scale = np.sqrt(np.diag(information))
    scale = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    known = values > SINGULAR * values.max(initial=0.0)
    along = vectors.T @ (score / scale)
    step = vectors @ np.where(known, along / np.where(known, values + damping, 1.0), 0.0) / scale
    low, high = room
    if ((step > low) & (step < high)).all():
        return step
    roots = np.sqrt(np.where(known, values + damping, 0.0))
    target = np.where(known, along / np.where(known, roots, 1.0), 0.0)
    return lsq_linear((vectors * roots).T, target, (low * scale, high * scale), method="bvls").x / scale
