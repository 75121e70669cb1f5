"""Modes and their derivatives with sixty digits."""

import numpy as np
from mpmath import mp

mp.dps = 60
STEP = mp.mpf(10) ** -28  # of central differences: right to twenty digits and more


def precise_modes(mass, stiffness, damping):
    """omega, shapes in columns and damping ratios, of matrices (n, n) of mp numbers, ascending."""
    n = mass.rows
    factor = mp.cholesky(mass)
    inverse = factor**-1
    values, vectors = mp.eigsy(inverse * stiffness * inverse.T)
    shapes = inverse.T * vectors
    omega = [mp.sqrt(v) for v in values]
    ratios = []
    for r in range(n):
        shape = shapes[:, r]
        ratios.append((shape.T * damping * shape)[0] / (2 * omega[r]))
    return omega, shapes, ratios


def weighed(matrices, theta, weights, near):
    """sum c f + sum W phi + sum d zeta of M, C and K at theta, the shapes in the sense of those `near`.

    `matrices` maps mp numbers to (M, C, K); `weights` are c (m,), W (m, n) and d (m,); `near` (m, n).
    """
    mass, damping, stiffness = (mp.matrix(a) for a in matrices(theta))
    omega, shapes, ratios = precise_modes(mass, stiffness, damping)
    total = mp.mpf(0)
    for r in range(len(weights[0])):
        along = sum(float(shapes[i, r]) * near[r, i] for i in range(mass.rows))
        sign = 1 if along > 0 else -1
        total += mp.mpf(weights[0][r]) * omega[r] / (2 * mp.pi) + mp.mpf(weights[2][r]) * ratios[r]
        total += sum(mp.mpf(weights[1][r, i]) * sign * shapes[i, r] for i in range(mass.rows))
    return total


def precise_gradient(matrices, theta, weights, near):
    """Gradient (p,) of `weighed` by central differences of sixty digits."""
    theta = [mp.mpf(float(x)) for x in theta]
    slopes = []
    for i in range(len(theta)):
        ends = []
        for sign in (1, -1):
            moved = list(theta)
            moved[i] += sign * STEP
            ends.append(weighed(matrices, moved, weights, near))
        slopes.append(float((ends[0] - ends[1]) / (2 * STEP)))
    return np.array(slopes)
