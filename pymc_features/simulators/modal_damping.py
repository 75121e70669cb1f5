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

from pymc_features.simulators.compilation import jit


@jit
def damping_coefficients(mass, weights, shapes):
    """sum_r weights_r P_r, (n, n); the rows of `shapes` (n, n) are the modes of `modal.chain_modes`."""
    return np.dot(shapes.T * weights, shapes * mass)


@jit
def divided_differences(omega, ratios):
    """f_rs of all pairs of modes, (n, n)."""
    n = omega.size
    differences = np.empty((n, n))
    for r in range(n):
        for s in range(n):
            differences[r, s] = (ratios[r] + ratios[s]) / (omega[r] + omega[s])
            if ratios[r] != ratios[s]:
                differences[r, s] += (ratios[r] - ratios[s]) / (omega[r] - omega[s])
    return differences


@jit
def drifts_of(shapes):
    """Drifts (n, n) of the modes: one row for each mode, as `shapes`."""
    drifts = shapes.copy()
    drifts[:, 1:] -= shapes[:, :-1]
    return drifts


@jit
def damping_tangent(mass, omega, shapes, ratios, directions):
    """Derivative (n, n) of M^-1 C along directions of mass, stiffness and ratios, each (n,)."""
    d_mass, d_stiffness, d_ratios = directions
    drifts = drifts_of(shapes)
    by_stiffness = np.dot(drifts * d_stiffness, drifts.T)  # phi_r' dK phi_s
    by_mass = np.dot(shapes * d_mass, shapes.T)
    inner = divided_differences(omega, ratios) * (by_stiffness - by_mass * (omega * omega))
    for r in range(omega.size):
        inner[r, r] += 2.0 * omega[r] * d_ratios[r]
    return np.dot(np.dot(shapes.T, inner), shapes * mass)


@jit
def add_damping_gradient(mass, omega, shapes, ratios, cotangent, gradients):
    """Add to the gradients by mass, stiffness and ratios what the `cotangent` (n, n) of M^-1 C gives."""
    d_mass, d_stiffness, d_ratios = gradients
    turned = np.dot(np.dot(shapes, cotangent), (shapes * mass).T)  # phi_r' B M phi_s
    inner = divided_differences(omega, ratios) * turned
    drifts = drifts_of(shapes)
    by_stiffness = np.dot(inner, drifts)
    by_mass = np.dot(inner * (omega * omega), shapes)
    for r in range(omega.size):
        d_ratios[r] += 2.0 * omega[r] * turned[r, r]
        for i in range(omega.size):
            d_stiffness[i] += drifts[r, i] * by_stiffness[r, i]
            d_mass[i] -= shapes[r, i] * by_mass[r, i]
