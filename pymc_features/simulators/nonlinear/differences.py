"""Derivatives of the response of a nonlinear chain, by central differences.

With y(h) the response at parameters p + h d, d the direction,

    dy = [y(h) - y(-h)] / 2h,    or    dy = [4 y(h) - 3 y(0) - y(2h)] / 2h

and its mirror image where only one side is a structure, for example at n = 1 of Bouc-Wen springs. Both are of
second order in h. No parameter changes by more than `STEP` of its size, and the response by no more than
`MAX_CHANGE` of its peak: small enough for the kinks of the law, large beside rounding errors. The Fisher
information of Bouc-Wen chains (n = 1, 1.2 and 2) and Duffing chains with 3 and 10 storeys under El Centro is
right to 1e-5 of its diagonal, and most often to 1e-7. A direction costs two responses, and a gradient two for
each number that it is wanted by.
"""

import numpy as np

STEP = 1e-5
MAX_CHANGE = 1e-3
FIRST_STEP = 1e6  # in units of the direction, where all that changes is zero and has no size
TRIALS = 30


def relative_size(parameters, direction) -> float:
    """Largest change along a direction beside the parameters' size; 0 where all that changes is zero."""
    largest = 0.0
    for name, values, change in zip(parameters._fields, parameters, direction, strict=True):
        # rows of one unit: alpha and beta have different ones
        rows = values[:, None] if name == "rayleigh" else np.atleast_2d(values)
        size = np.abs(rows).max(axis=1)
        change = np.abs(change.reshape(rows.shape)).max(axis=1)
        largest = max(largest, (change[size > 0.0] / size[size > 0.0]).max(initial=0.0))
    return largest


def directional_derivative(response, parameters, direction, middle) -> np.ndarray:
    """Derivative (s, u) of a response along a direction; NaN where neither side of it is a structure.

    Parameters
    ----------
    response : callable
        Takes a named tuple such as `parameters`; NaN where it describes no structure.
    parameters : NonlinearParameters
        Of one chain.
    direction : tuple of array
        Change of each parameter.
    middle : array (s, u)
        The response at the parameters.
    """

    def at(h):
        return response(type(parameters)(*(p + h * d for p, d in zip(parameters, direction, strict=True))))

    widest = max(np.abs(d).max(initial=0.0) for d in direction)
    if not widest:
        return 0.0 * middle
    relative = relative_size(parameters, direction)
    h = STEP / relative if relative else FIRST_STEP / widest
    for _ in range(TRIALS):
        ahead, behind = at(h), at(-h)
        changes = [np.abs(y - middle).max() for y in (ahead, behind) if np.isfinite(y).all()]
        if changes and max(changes) <= MAX_CHANGE * np.abs(middle).max():
            break
        h *= 0.1
    if np.isnan(behind).any():
        return (4.0 * ahead - 3.0 * middle - at(2.0 * h)) / (2.0 * h)
    if np.isnan(ahead).any():
        return (3.0 * middle - 4.0 * behind + at(-2.0 * h)) / (2.0 * h)
    return (ahead - behind) / (2.0 * h)


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
