"""Modes of a density to the last digits, by Newton's method from near them."""

from collections.abc import Callable

import numpy as np

from pymc_features.smc.proposals.ascent import curvature

MAX_NEWTON, MAX_HALVINGS = 30, 30
NO_GAIN = 1e-12  # in the log-density, of the next step: at a mode
SMALL_GAIN = 1e-4  # above which rounding does not keep it
SAME_MODE = 0.1  # squared distance in standard deviations of modes that are one


def gaussian_at(density: Callable, x: np.ndarray, scale: np.ndarray):
    """Go on from near a mode to it.

    Parameters
    ----------
    density : callable
        Log-density (n,) and its gradient (n, d) at points (n, d).
    x : array (d,)
    scale : array (d,)
        Of the coordinates.

    Returns
    -------
    x, value, curvature
        The mode, its log-density, and minus the Hessian there; None if there is no maximum with a positive
        definite curvature.
    """

    def scaled(points):
        values, slopes = density(scale * points)
        return values, slopes * scale

    u = x / scale
    value, slope = (part[0] for part in scaled(u[None]))
    for _ in range(MAX_NEWTON):
        hessian = curvature(scaled, u)
        if not np.isfinite(hessian).all():
            return None
        eigenvalues, vectors = np.linalg.eigh(hessian)
        least = 1e-12 * np.abs(eigenvalues).max()
        step = vectors @ ((vectors.T @ slope) / np.maximum(np.abs(eigenvalues), least))
        gain = float(slope @ step)
        if gain < NO_GAIN:
            break
        further = half_steps(scaled, u, value, step)
        if further is None:
            break
        u, value, slope = further
    if not (np.isfinite(value) and eigenvalues[0] > 0.0 and gain < SMALL_GAIN):
        return None
    return scale * u, float(value), hessian / np.outer(scale, scale)


def half_steps(density, x, value, step):
    """The first of ever shorter steps that is higher: point, value and slope; None if there is none."""
    for _ in range(MAX_HALVINGS):
        values, slopes = density((x + step)[None])
        if values[0] > value:
            return x + step, values[0], slopes[0]
        step = 0.5 * step
    return None


def distinct(modes: list) -> list:
    """Modes (x, value, curvature) from the highest on, without those that were found before."""
    kept = []
    for mode in sorted(modes, key=lambda m: -m[1]):
        x, _, hessian = mode
        if all((x - other) @ hessian @ (x - other) > SAME_MODE for other, _, _ in kept):
            kept.append(mode)
    return kept
