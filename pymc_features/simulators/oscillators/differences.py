"""Derivatives of responses along a direction of the parameters, by central differences.

With y(h) the response at parameters p + h d, d the direction,

    dy = [y(h) - y(-h)] / 2h,    or    dy = [4 y(h) - 3 y(0) - y(2h)] / 2h

and its mirror image where only one side is a structure, for example at n = 1 of Bouc-Wen springs. Both are of
second order in h. A direction costs two responses, and a gradient two for each number that it is wanted by.

Linear structures: the response changes by 2e-6 to 1e-4 of its peak, which leaves 1e-10 to 3e-8 of the
derivative in rounding errors and third derivatives; 4e-7 where `n_modes` cuts between modes 1e-5 apart.
Springs that yield: no parameter changes by more than 1e-5 of its size, and the response by no more than 1e-3
of its peak, which is small enough for the kinks of the law and large beside rounding errors. The Fisher
information of Bouc-Wen chains (n = 1, 1.2 and 2) and Duffing chains with 3 and 10 storeys under El Centro is
right to 1e-5 of its diagonal, and most often to 1e-7.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.oscillators.misfit import measured_difference


class Steps(NamedTuple):
    """First step beside the parameters' size, and bounds of the change of the response beside its peak."""

    first: float
    least_change: float
    largest_change: float


SMOOTH, WITH_KINKS = Steps(1e-6, 2e-6, 1e-4), Steps(1e-5, 0.0, 1e-3)
FIRST_STEP = 1e6  # in units of the direction, where all that changes is zero and has no size
TRIALS = 30
OF_MANY_UNITS = ("rayleigh", "theta")  # their entries are of different sizes


def relative_size(parameters, direction) -> float:
    """Largest change along a direction beside the parameters' size; 0 where all that changes is zero."""
    largest = 0.0
    for name, values, change in zip(parameters._fields, parameters, direction, strict=False):
        rows = values[:, None] if name in OF_MANY_UNITS else np.atleast_2d(values)
        size = np.abs(rows).max(axis=1, initial=0.0)
        change = np.abs(change.reshape(rows.shape)).max(axis=1, initial=0.0)
        largest = max(largest, (change[size > 0.0] / size[size > 0.0]).max(initial=0.0))
    return largest


def directional_derivative(response, parameters, direction, middle, steps=WITH_KINKS) -> np.ndarray:
    """Derivative (s, u) of a response along a direction; NaN where neither side of it is a structure.

    Parameters
    ----------
    response : callable
        Takes a named tuple such as `parameters`; NaN where it describes no structure.
    parameters : named tuple
        Of one structure.
    direction : tuple of array
        Change of each of the first parameters.
    middle : array (s, u)
        The response at the parameters.
    steps : Steps
    """

    def at(h):
        moved = (p + h * d for p, d in zip(parameters, direction, strict=False))
        return response(type(parameters)(*moved, *parameters[len(direction) :]))

    widest = max(np.abs(d).max(initial=0.0) for d in direction)
    if not widest or np.isnan(middle).any():
        return 0.0 * middle
    relative, peak = relative_size(parameters, direction), np.abs(middle).max()
    h = steps.first / relative if relative else FIRST_STEP / widest
    for _ in range(TRIALS):
        ahead, behind = at(h), at(-h)
        changes = [np.abs(y - middle).max() for y in (ahead, behind) if np.isfinite(y).all()]
        if not changes or max(changes) > steps.largest_change * peak:
            h *= 0.1
        elif 0.0 < max(changes) < steps.least_change * peak:
            h *= 10.0
        else:
            break
    if np.isnan(behind).any():
        return (4.0 * ahead - 3.0 * middle - at(2.0 * h)) / (2.0 * h)
    if np.isnan(ahead).any():
        return (3.0 * middle - 4.0 * behind + at(-2.0 * h)) / (2.0 * h)
    return (ahead - behind) / (2.0 * h)


def tangents(response, n_parameters, steps) -> dict:
    """The functions of a family along a direction of its first parameters, see `families`."""

    def response_tangent(parameters, excitation, wanted, directions):
        first = (np.array(p, dtype=np.float64) for p in parameters[:n_parameters])
        given = type(parameters)(*first, *parameters[n_parameters:])
        directions = tuple(np.array(d, dtype=np.float64) for d in directions)
        if [d.shape for d in directions] != [p.shape for p in given[:n_parameters]]:
            raise ValueError("the directions must have the shapes of the parameters")

        def of_parameters(moved):
            return response(moved, excitation, wanted)

        return directional_derivative(of_parameters, given, directions, of_parameters(given), steps)

    def discrepancy_tangent(parameters, excitation, wanted, observed, directions):
        history = response(parameters, excitation, wanted)
        if np.shape(observed) != history.shape:
            raise ValueError(
                "`observed` or the cotangent must have the shape (sensor, time) of the response, "
                f"{history.shape}, got {np.shape(observed)}."
            )
        change = response_tangent(parameters, excitation, wanted, directions)
        return (2.0 * measured_difference(history, observed) * change).mean(axis=1)

    return {"response_tangent": response_tangent, "discrepancy_tangent": discrepancy_tangent}


def gradient(response, parameters, sought, middle, cotangent) -> tuple:
    """Gradient of sum_jk W_jk y_jk by parameters; NaN by numbers that are not sought, or describe no chain.

    Parameters
    ----------
    response, parameters, middle
        As of `directional_derivative`.
    sought : tuple of str, optional
        Names of the parameters, "law[2]" for a row of a table. All by default.
    cotangent : array (s, u)
        W.
    """
    found = type(parameters)(*(np.full(p.shape, np.nan) for p in parameters))
    if not np.isfinite(middle[..., -1]).all():
        return found
    for name, values, result in zip(parameters._fields, parameters, found, strict=True):
        if name == "ratios" and not values.any():
            continue  # no damping by them
        for i in np.ndindex(values.shape):
            if sought is None or name in sought or f"{name}[{i[0]}]" in sought:
                direction = type(parameters)(*map(np.zeros_like, parameters))
                getattr(direction, name)[i] = 1.0
                change = directional_derivative(response, parameters, direction, middle)
                result[i] = (cotangent * change).sum()
    return found
