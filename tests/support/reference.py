"""Responses and derivatives by slow, obvious routes that share nothing with the package."""

import numpy as np
from scipy.linalg import expm


def interpolated(inputs, substeps):
    """Rows of samples, with `substeps` - 1 points on the straight line between each two."""
    times = np.arange(inputs.shape[1])
    fine = np.arange((times.size - 1) * substeps + 1) / substeps
    return np.stack([np.interp(fine, times, row) for row in inputs])


def first_order_hold(damping, stiffness, load, inputs, step, stride=1):
    """x, x', x" of x" + C x' + K x = B a(t) from rest, a(t) linear between samples (Van Loan).

    C and K (..., n, n) and B (..., n, d) may be complex; the histories (..., n, time) have every `stride`-th
    of the samples a (d, time).
    """
    n, d = load.shape[-2:]
    system = np.zeros((*load.shape[:-2], 2 * (n + d), 2 * (n + d)), np.result_type(damping, stiffness, load))
    system[..., :n, n : 2 * n] = np.eye(n)
    system[..., n : 2 * n, :n], system[..., n : 2 * n, n : 2 * n] = -stiffness, -damping
    system[..., n : 2 * n, 2 * n : 2 * n + d] = load
    system[..., 2 * n : 2 * n + d, 2 * n + d :] = np.eye(d) / step
    whole = expm(system * step)[..., : 2 * n, :]
    transition, driven = whole[..., : 2 * n], whole[..., 2 * n :]
    driven = np.moveaxis(driven @ np.vstack([inputs[:, :-1], np.diff(inputs)]), -1, 0)
    states = np.zeros((inputs.shape[1], *load.shape[:-2], 2 * n), system.dtype)
    for k in range(len(states) - 1):
        states[k + 1] = (transition @ states[k][..., None])[..., 0] + driven[k]
    x, v = np.split(np.moveaxis(states[::stride], 0, -1), 2, axis=-2)
    return x, v, load @ inputs[:, ::stride] - stiffness @ x - damping @ v


def richardson(function, x, direction=1.0, h=4e-3):
    """Derivative along a direction: central differences of h, h/2 and h/4, extrapolated to order six."""
    d = [(function(x + s * direction) - function(x - s * direction)) / (2 * s) for s in (h, h / 2, h / 4)]
    first, second = (4 * d[1] - d[0]) / 3, (4 * d[2] - d[1]) / 3
    return (16 * second - first) / 15


def misfit_statistics(misfit):
    """Mean square, mean squared increment over all samples, first and last of r (..., u); (..., 4)."""
    increments = (np.diff(misfit) ** 2).sum(axis=-1) / misfit.shape[-1]
    return np.stack([(misfit**2).mean(axis=-1), increments, misfit[..., 0], misfit[..., -1]], axis=-1)
