"""Maxima of a likelihood with what residuals say of their width: climbs, bounds nearby, several maxima."""

import numpy as np
from scipy.optimize import lsq_linear

from pymc_features.calibration.residuals import Fit, events_at, log_likelihood
from pymc_features.calibration.sandwich import Peak, of_values, stretching
from pymc_features.inference.parameters import some_draws, to_unconstrained
from pymc_features.inference.sample import search
from pymc_features.smc import population_logp, prior_points

DIFFERENCE = 0.02  # standard errors of independent samples that derivatives are taken over,
WIDEST, NARROWEST = 1e-3, 1e-7  # but no more and no less than this, in coordinates
NARROW = 1e-5  # before standard errors are known
STEPS = 100  # towards the maximum, at most
CONVERGED = 1e-3  # standard errors of independent samples that the last step may be long
SHORTER = 0.3  # than the step before must one be that is taken with the derivatives of another point
NEAR = 0.1  # of such a standard error: derivatives there are those at the maximum
LEAST = 0.1  # of the information that the curvature is taken to have where it is less, or negative
LONGEST, LONGEST_SHARE = 1.0, 0.25  # step of a coordinate, and of one between two bounds
BESIDE = 3.0  # on the unconstrained scale, from the middle of two bounds: within 5 % of their distance
SINGULAR = 1e-12  # of the largest relative eigenvalue: directions that change nothing
STARTS = 20  # draws of which the most likely is climbed from
CLIMBS = 4  # from the draws that are farthest from what has been climbed from or to
CANDIDATES = 100  # draws that these are chosen from
DISTINCT = 3.0  # standard deviations, by the residuals, between maxima that are not one
LIGHTEST = 1e-3  # weight of a mode that is left out
ROUNDED = 1e-12  # of what a unit change of a parameter does to the response: rounding, no residuals


def best_fit(predictions, idata, rng) -> Fit:
    """The maximum near the likeliest mode or draw of a posterior, or, without one, mode of the model."""
    model = predictions.model
    if idata is None:
        logp = population_logp(model, predictions.space.point, {})
        found = search(model, logp, 1000, rng, None).reference
        starts = prior_points(model, 10 * STARTS, rng) if found is None else found.peaks
        heights = np.add(*logp(starts)[:2])
    else:
        starts = some_draws(model, idata["posterior"], STARTS)
        if "modes" in idata.children and {rv.name for rv in model.free_RVs} <= set(idata["modes"].data_vars):
            starts = to_unconstrained(model, idata["modes"].to_dataset().expand_dims("chain"))[0]
        heights = [log_likelihood(predictions(z)) for z in starts] if len(starts) > 1 else [0.0]
    return climb_likelihood(predictions, starts[np.argmax(heights)])


def distinct_peaks(predictions, idata, model_error, rng) -> list[Peak]:
    """Maxima of the likelihood that draws of a posterior lead to and that may matter, the highest first."""
    model = predictions.model
    fit = best_fit(predictions, idata, rng)
    peaks, known = [Peak.at(fit, model_error)], [fit.z]
    draws = some_draws(model, idata["posterior"], CANDIDATES)
    scale = draws.std(axis=0)
    scale[scale == 0.0] = 1.0
    for _ in range(min(CLIMBS, len(draws) - 1)):
        distances = ((draws[:, None] - np.array(known)) / scale) ** 2
        start = draws[distances.sum(axis=2).min(axis=1).argmax()]
        fit = climb_likelihood(predictions, start)
        known += [start, fit.z]
        if all(other.distance(fit.z) > DISTINCT for other in peaks):
            peak = Peak.at(fit, model_error)
            if all(peak.distance(other.fit.z) > DISTINCT for other in peaks):
                peaks.append(peak)
    peaks.sort(key=lambda peak: -peak.fit.height)
    # weights by Laplace's approximation under a flat prior, heights by the power of the highest
    power, _ = stretching(peaks[0].information, peaks[0].precision)
    widths = [np.linalg.eigvalsh(peak.precision) for peak in peaks]
    volumes = [-0.5 * np.log(x[x > 1e-12 * x.max()]).sum() for x in widths]
    logs = np.array([power * p.fit.height + volume for p, volume in zip(peaks, volumes, strict=True)])
    return [p for p, log in zip(peaks, logs, strict=True) if log > np.max(logs) + np.log(LIGHTEST)]


def climb_likelihood(predictions, z) -> Fit:
    """The maximum of the likelihood near a point (d,), by Levenberg's and Marquardt's method.

    Derivatives, a prediction or two for each parameter, are kept for as long as steps with them become much
    shorter from one to the next. Where residuals are large their second derivatives count; these are learnt
    from one set of derivatives to the next. A parameter that a step would take out of its prior is from then
    on measured from the bound, and stays within. Every sensor must have residuals at the maximum.
    """
    count, here = predictions.count, predictions(z)
    fit = Fit(predictions.coordinates, z, [], log_likelihood(here))
    if fit.height == -np.inf:
        raise ValueError("the fit must start where the likelihood is finite. Pass another `idata`.")
    events = events_at(predictions, fit.coordinates, z, np.full(len(z), NARROW), here, central=False)
    fit = bounded(fit._replace(events=events), z)
    second, damping, last, central = np.zeros((len(z), len(z))), 1e-6, np.inf, False
    at, before = fit.w, fit.score  # where derivatives were taken
    for _ in range(STEPS):
        information, limits = fit.information, fit.coordinates.limits
        longest = np.where(fit.coordinates.near & (fit.coordinates.sides == 2), LONGEST_SHARE, LONGEST)
        more = of_values(information, second, lambda values: np.maximum(values, LEAST - 1.0))
        step = newton(information + more, fit.score, damping, np.clip(limits - fit.w, -longest, longest))
        independent = information * sum((~v.gaps).sum() for v in here) / fit.claimed
        length, moved = (np.sqrt(max(0.0, x @ independent @ x)) for x in (step, fit.w - at))
        if length < CONVERGED and central and moved < NEAR:
            break
        if length < SHORTER * last and not (length < CONVERGED):
            w = np.clip(fit.w + step, *limits)
            values = predictions(fit.coordinates.unconstrained(w))
            if (height := log_likelihood(values)) > fit.height:
                here, damping, last = values, damping / 10.0, length
                pairs = zip(here, fit.events, strict=True)
                events = [v._replace(sensitivities=e.sensitivities, of_scale=e.of_scale) for v, e in pairs]
                fit = fit._replace(w=w, height=height, events=events)
                continue
            if moved == 0.0:
                damping = max(damping, 1e-6) * 10.0
                continue
        if length < CONVERGED:  # with these derivatives, and perhaps only for its damping
            damping = 1e-6
        central = length < NEAR
        scale = np.sqrt(np.diag(independent)).clip(min=np.finfo(float).tiny)
        steps = np.clip(DIFFERENCE / scale, NARROWEST, WIDEST)
        events = events_at(predictions, fit.coordinates, fit.w, steps, here, central)
        anew = fit._replace(events=events)
        if moved > 0.0:
            second = learnt(second, fit.w - at, fit.score - anew.score, before - anew.score)
        fit = bounded(anew, z)
        if fit is not anew:
            second = np.zeros_like(second)
        at, before, last = fit.w, fit.score, np.inf
    for event in fit.events:
        response = (event.sensitivities**2).sum(axis=1).max(axis=-1)
        silent = np.flatnonzero(~((event.residuals**2).sum(axis=1) > ROUNDED**2 * response))
        if silent.size:
            raise ValueError(
                f"the residuals of {event.name} must not vanish, got none at sensor {silent[0]}: data "
                "without noise support no estimate of their errors. Add the measurement noise, or leave out "
                "the sensor."
            )
    frequencies = predictions.frequencies(fit.z)
    events = [e._replace(frequencies=f) for e, f in zip(fit.events, frequencies, strict=True)]
    return fit._replace(events=events, n_evaluations=predictions.count - count)


def bounded(fit: Fit, start) -> Fit:
    """The fit, with parameters measured from the bound that they are beside and the next step would cross."""
    sides, near = fit.coordinates.sides, fit.coordinates.near
    low, high = fit.coordinates.rooms(fit.z)
    step = newton(fit.information, fit.score, 0.0, (-np.inf, np.inf))
    beside = fit.z < np.where(sides == 2, 0.0, start) - BESIDE  # an only bound: nearer by so much
    crosses = (sides > 0) & ~near & (beside & (step < -low) | (fit.z > BESIDE) & (step > high))
    return fit.measured_from_bounds(near | crosses) if crosses.any() else fit


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
    roots = np.sqrt(np.where(values > SINGULAR * values.max(initial=0.0), values + damping, 0.0))
    target = vectors.T @ (score / scale) / np.where(roots > 0.0, roots, np.inf)
    room = tuple(end * scale for end in room)
    return lsq_linear((vectors * roots).T, target, room, method="bvls").x / scale
