"""Divided differences of modal outputs: derivatives of a response that are right at repeated frequencies.

The response is y = phi f(Lambda) phi' M 1 in the modes of K phi = lambda M phi. Its derivative couples each
pair of modes r, s by the divided difference f[r, s] = (f_r - f_s) / (lambda_r - lambda_s) (Daleckii & Krein;
Higham, Functions of Matrices, SIAM 2008, theorem 3.11). It is finite where two frequencies meet, as
derivatives of eigenvectors are not: there it becomes df/dlambda.
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit

# Two modes are close if their phases part by less than this [rad] while the structure remembers. The mean of
# the two derivatives is then right to about the square of it over 12, the quotient to the rounding error of f
# divided by it.
CLOSE = 3e-4


@jit
def close_modes(omega, rayleigh, ratios, duration, n_modes):
    """Which pairs of kept modes take the derivative, bool (n_modes, n_modes), and whether there are any.

    Modes with dampings of their own by `ratios` that differ are never close: where they cross, the response
    jumps from one to the other.
    """
    close = np.zeros((n_modes, n_modes), dtype=np.bool_)
    found = False
    for r in range(n_modes):
        decay = 0.5 * (rayleigh[0] + rayleigh[1] * omega[r] * omega[r]) + ratios[r] * omega[r]
        # at least a fraction of a period: what is slower or overdamped depends on the frequency itself
        memory = max(min(duration, 1.0 / decay), 3.0 / omega[r])
        for s in range(r):
            gap = abs(omega[r] - omega[s])
            parted = gap * memory
            if ratios[r] == 0.0:  # of modes that hardly swing it is lambda that counts, not omega
                growth = gap * (omega[r] + omega[s]) * duration * max(duration, rayleigh[1])
                parted = min(parted, growth)
            if gap == 0.0 or (ratios[r] == ratios[s] and parted < CLOSE):
                close[r, s] = close[s, r] = found = True
    return close, found


@jit
def pair_weights(omega, participation, products, slopes, close, n_modes):
    """Derivatives of L with respect to phi' K phi and phi' M phi at fixed modes: two symmetric (n, n)."""
    n = omega.size
    by_stiffness, by_mass = np.zeros((n, n)), np.zeros((n, n))
    for r in range(n_modes):
        eigenvalue = omega[r] * omega[r]
        by_stiffness[r, r] = participation[r] * slopes[r, r]
        by_mass[r, r] = -participation[r] * (products[r, r] + eigenvalue * slopes[r, r])
        for s in range(n):
            if s == r or r < s < n_modes:
                continue
            kept = s < n_modes
            if kept and close[r, s]:
                on_s, on_r = 0.5 * (slopes[s, r] + slopes[s, s]), 0.5 * (slopes[r, r] + slopes[r, s])
            else:
                gap = (omega[r] - omega[s]) * (omega[r] + omega[s])
                on_s = (products[s, r] - (products[s, s] if kept else 0.0)) / gap
                on_r = (products[r, r] - (products[r, s] if kept else 0.0)) / gap
            both = participation[r] * on_s + participation[s] * on_r
            by_stiffness[r, s] = by_stiffness[s, r] = 0.5 * both
            inertia = eigenvalue * both
            if kept:
                inertia += participation[r] * products[s, s] + participation[s] * products[r, s]
            by_mass[r, s] = by_mass[s, r] = -0.5 * inertia
    return by_stiffness, by_mass
