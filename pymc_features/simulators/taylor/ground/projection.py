"""Projection of a function that is linear between samples on polynomials, and what it loses."""

from functools import cache

import numpy as np
from numpy.polynomial import Polynomial, legendre

DEGREE = 5  # of the ground acceleration in a step
POINTS = 2  # to a sample, where the second integral is looked at


def twice_integrated(values, step):
    """Second integral from the first point, of functions (p, ...) that are linear between points."""
    once = np.cumsum(0.5 * step * (values[1:] + values[:-1]), axis=0)
    before = np.concatenate([np.zeros_like(once[:1]), once[:-1]])
    return np.cumsum(step * before + step**2 / 6.0 * (2.0 * values[:-1] + values[1:]), axis=0)


@cache
def projection(width):
    """Matrices that take the samples of a span, whose time goes from 0 to 1, to its polynomial and remainder.

    The polynomial has the moments of the samples up to its degree: its coefficients by Legendre polynomials
    are theirs.

    Returns
    -------
    coefficients : array (width + 1, DEGREE + 1)
    remainder : array (width + 1, POINTS width)
        Second integral of the remainder.
    """
    hats, degrees = np.eye(width + 1), np.arange(DEGREE + 1)
    nodes, weights = legendre.leggauss(DEGREE)
    times = (np.arange(width)[:, None] + 0.5 * (nodes + 1.0)).ravel() / width
    values = np.array([np.interp(times, np.arange(width + 1) / width, hat) for hat in hats])
    values = values * np.tile(0.5 * weights / width, width)
    moments = values @ legendre.legvander(2.0 * times - 1.0, DEGREE) * (2 * degrees + 1)
    powers = [legendre.Legendre.basis(k, domain=[0.0, 1.0]) for k in degrees]
    powers = [p.convert(kind=Polynomial).coef for p in powers]
    coefficients = moments @ np.array([np.pad(p, (0, DEGREE + 1 - p.size)) for p in powers])
    points = np.arange(POINTS * width + 1) / (POINTS * width)
    linear = np.array([np.interp(points, np.arange(width + 1) / width, hat) for hat in hats])
    of_samples = twice_integrated(linear.T, points[1]).T
    shares = 1.0 / ((degrees + 1) * (degrees + 2))
    of_polynomial = coefficients @ (shares[:, None] * points[1:] ** (degrees[:, None] + 2))
    return coefficients, of_samples - of_polynomial
