"""Damping by modal ratios as a function of masses and springs, and its derivatives.

With the modes phi_r of K phi = lambda M phi, phi' M phi = 1, the damping of Eq. (19)'s chain is

    M^-1 C = sum_r c_r P_r,   c_r = 2 zeta_r omega_r,   P_r = phi_r phi_r' M.

The projectors P_r of A = M^-1 K change by sum_s (P_r dA P_s + P_s dA P_r) / (lambda_r - lambda_s), so that

    d(M^-1 C) = sum_rs f_rs P_r dA P_s + sum_r 2 omega_r dzeta_r P_r,
    f_rs = (c_r - c_s) / (lambda_r - lambda_s) = (zeta_r + zeta_s) / (omega_r + omega_s)
                                                 + (zeta_r - zeta_s) / (omega_r - omega_s)

and f_rr = zeta_r / omega_r (Daleckii & Krein; see `pairs.py`). Without the second term, which is zero for
equal ratios, it is right at repeated frequencies too; with it the damping jumps where the modes cross.
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit


@jit
def product(a, b, transposed, scale):
    """The matrix a diag(scale) b or, if `transposed`, a' diag(scale) b: loops compile faster than algebra."""
    n = scale.size
    result = np.zeros((n, n))
    for i in range(n):
        for k in range(n):
            factor = scale[k] * (a[k, i] if transposed else a[i, k])
            for j in range(n):
                result[i, j] += factor * b[k, j]
    return result


@jit
def damping_coefficients(mass, omega, shapes, ratios):
    """M^-1 C (n, n); the rows of `shapes` (n, n) are the modes of `modal.chain_modes`."""
    n = mass.size
    weights = np.empty(n)
    for r in range(n):
        weights[r] = 2.0 * ratios[r] * omega[r]
    result = product(shapes, shapes, True, weights)
    for i in range(n):
        for j in range(n):
            result[i, j] *= mass[j]
    return result


@jit
def divided_difference(omega, ratios, r, s):
    """f_rs of a pair of modes."""
    difference = (ratios[r] + ratios[s]) / (omega[r] + omega[s])
    if ratios[r] != ratios[s]:
        difference += (ratios[r] - ratios[s]) / (omega[r] - omega[s])
    return difference


@jit
def drift(shapes, r, i):
    """Drift of spring `i` in mode `r`."""
    return shapes[r, i] - (shapes[r, i - 1] if i > 0 else 0.0)


@jit
def damping_tangent(mass, omega, shapes, ratios, directions):
    """Derivative (n, n) of M^-1 C along directions of mass, stiffness and ratios, each (n,)."""
    d_mass, d_stiffness, d_ratios = directions
    n = mass.size
    inner, ones = np.zeros((n, n)), np.ones(n)
    for r in range(n):
        for s in range(n):
            for i in range(n):  # phi_r' (dK - lambda_s dM) phi_s
                inner[r, s] += drift(shapes, r, i) * d_stiffness[i] * drift(shapes, s, i)
                inner[r, s] -= shapes[r, i] * d_mass[i] * shapes[s, i] * omega[s] * omega[s]
            inner[r, s] *= divided_difference(omega, ratios, r, s)
        inner[r, r] += 2.0 * omega[r] * d_ratios[r]
    result = product(product(shapes, inner, True, ones), shapes, False, ones)
    for i in range(n):
        for j in range(n):
            result[i, j] *= mass[j]
    return result


@jit
def add_damping_gradient(mass, omega, shapes, ratios, cotangent, gradients):
    """Add to the gradients by mass, stiffness and ratios what the `cotangent` (n, n) of M^-1 C gives."""
    d_mass, d_stiffness, d_ratios = gradients
    n = mass.size
    half = product(shapes, cotangent, False, np.ones(n))
    for r in range(n):
        for s in range(n):
            inner = 0.0
            for j in range(n):  # phi_r' B M phi_s
                inner += half[r, j] * mass[j] * shapes[s, j]
            if r == s:
                d_ratios[r] += 2.0 * omega[r] * inner
            inner *= divided_difference(omega, ratios, r, s)
            for i in range(n):
                d_stiffness[i] += inner * drift(shapes, r, i) * drift(shapes, s, i)
                d_mass[i] -= inner * shapes[r, i] * shapes[s, i] * omega[s] * omega[s]
