"""Derivatives of single modes: frequencies, shapes and damping ratios by the reduced matrices.

For K phi_r = lambda_r M phi_r, phi_r' M phi_r = 1, changes dK and dM make

    dlambda_r = phi_r' (dK - lambda_r dM) phi_r,
    dphi_r = sum_s phi_s phi_s' (dK - lambda_r dM) phi_r / (lambda_r - lambda_s) - phi_r phi_r' dM phi_r / 2

(Fox & Kapoor, AIAA J. 6, 2426-2429, 1968), and what leaves the span of the modes kept. With b_r, the
derivative of a number L by phi_r, and B = Phi' [b_1 ...], a pair of modes adds to dL

    phi_s' dK phi_r (B_sr - B_rs) / (lambda_r - lambda_s)
    - phi_s' dM phi_r [(lambda_r + lambda_s) / 2 (B_sr - B_rs) / (lambda_r - lambda_s) + (B_sr + B_rs) / 2].

Written so, the gap divides what turns the two shapes in their plane, and nothing else. What depends on the
plane alone has B_sr = B_rs. Where two frequencies are equal, no other derivative exists, and the quotient
counts as zero.

How the kept modes leave their span when the structure changes, where all modes are at hand.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit


@jit
def outside_span(omega, rows, n_modes, loads):
    """(K - lambda_r M)^+ b_r for the kept modes (n, m), the inverse taken on the modes left out.

    So the kept modes leave their span when K and M change: dphi_r = -(K - lambda_r M)^+ (dK - lambda_r dM)
    phi_r. `omega` (n,) and `rows` (n, n) are all modes, `loads` b (n, m). Where omega is infinite the rows
    are motions without mass, phi' K phi = 1.
    """
    parts = np.dot(rows[n_modes:], loads)
    for s in range(parts.shape[0]):
        above = omega[n_modes + s]
        if above == np.inf:
            continue
        for r in range(n_modes):
            parts[s, r] /= (above - omega[r]) * (above + omega[r])
    return np.dot(rows[n_modes:].T, parts)


class Cotangent(NamedTuple):
    """Derivatives of a number L by modes; of a population with one more axis in front.

    Attributes
    ----------
    frequencies : array (m,)
        [1/Hz].
    shapes : array (m, s)
    ratios : array (m,)
    """

    frequencies: np.ndarray
    shapes: np.ndarray
    ratios: np.ndarray


@jit
def damping_ratio(omega, damping):
    """D / (2 omega); of a rigid body zero, or infinite if it is damped."""
    if omega == 0.0 and damping == 0.0:
        return 0.0
    return damping / (2.0 * omega)


@jit
def write_modes(solved, sensors, frequencies, shapes, ratios):
    """Write frequencies (m,) [Hz], shapes (m, s) and damping ratios (m,) of one structure at its sensors.

    `solved` are omega (>= m,) [rad/s], shapes in rows (>= m, n) and damping 2 zeta omega (m,) [1/s].
    """
    omega, rows, damping = solved
    for r in range(frequencies.size):
        frequencies[r] = omega[r] / (2.0 * np.pi)
        ratios[r] = damping_ratio(omega[r], damping[r])
        for j in range(sensors.size):
            shapes[r, j] = rows[r, sensors[j]]


@jit
def by_eigenvalues(omega, ratio_slopes, cotangent):
    """Derivatives (m,) of L by lambda, at fixed shapes.

    `ratio_slopes` (m,) are the derivatives of the damping ratios by omega. A rigid body, whose frequency has
    none by lambda, gets one only where L asks for it.
    """
    result = np.zeros(omega.size)
    for r in range(omega.size):
        by_omega = cotangent.frequencies[r] / (2.0 * np.pi)
        if cotangent.ratios[r] != 0.0:
            by_omega += cotangent.ratios[r] * ratio_slopes[r]
        if by_omega != 0.0:
            result[r] = by_omega / (2.0 * omega[r])
    return result


@jit
def reduced_cotangents(omega, by_eigenvalue, turned):
    """Derivatives (m, m) of L by Phi' K Phi and Phi' M Phi.

    Parameters
    ----------
    omega, by_eigenvalue : array (m,)
    turned : array (m, m)
        B_sr = phi_s' b_r.
    """
    m = omega.size
    stiffness, mass = np.zeros((m, m)), np.zeros((m, m))
    for r in range(m):
        for s in range(m):
            gap = (omega[r] - omega[s]) * (omega[r] + omega[s])
            turn = 0.0
            if r == s:
                turn = by_eigenvalue[r]
            elif gap != 0.0:
                turn = 0.5 * (turned[s, r] - turned[r, s]) / gap
            stiffness[s, r] = turn
            mean = 0.5 * (omega[r] * omega[r] + omega[s] * omega[s])
            mass[s, r] = -mean * turn - 0.25 * (turned[s, r] + turned[r, s])
    return stiffness, mass


@jit
def pull_back_modes(solved, rayleigh, sensors, cotangent, by_damping):
    """Left factors (n, m) of the derivatives by the entries of K and M; their right one is Phi.

    Parameters
    ----------
    solved : tuple of arrays (n,), (n, n)
        omega and shapes in rows of all modes.
    rayleigh : array (2,)
    sensors : integer array (s,)
    cotangent : Cotangent
    by_damping : tuple of arrays (2,), (k,)
        Derivatives by Rayleigh's pair and the ratios; updated.
    """
    (omega, rows), (by_rayleigh, by_ratios), m = solved, by_damping, cotangent.frequencies.size
    kept, slopes, by_shapes = omega[:m].copy(), np.empty(m), np.zeros((omega.size, m))
    for r in range(m):
        slopes[r] = 0.5 * (rayleigh[1] - rayleigh[0] / kept[r] ** 2)
        if cotangent.ratios[r] != 0.0:
            by_rayleigh[0] += cotangent.ratios[r] / (2.0 * kept[r])
            by_rayleigh[1] += cotangent.ratios[r] * 0.5 * kept[r]
            by_ratios[r] += cotangent.ratios[r]
        for j in range(sensors.size):
            by_shapes[sensors[j], r] += cotangent.shapes[r, j]
    by_eigenvalue = by_eigenvalues(kept, slopes, cotangent)
    by_stiffness, by_mass = reduced_cotangents(kept, by_eigenvalue, np.dot(rows[:m], by_shapes))
    shapes = np.ascontiguousarray(rows[:m].T)
    left_stiffness, left_mass = np.dot(shapes, by_stiffness), np.dot(shapes, by_mass)
    if m < omega.size:
        outside = outside_span(omega, rows, m, by_shapes)
        left_stiffness -= outside
        left_mass += outside * kept**2
    return left_stiffness, left_mass
