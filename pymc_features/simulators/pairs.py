"""Divided differences of modal outputs: derivatives of a response that are right at repeated frequencies.

The response is y = phi f(Lambda) phi' M 1 in the modes of K phi = lambda M phi. Its derivative couples each pair of
modes r, s by the divided difference f[r, s] = (f_r - f_s) / (lambda_r - lambda_s) (Daleckii & Krein; Higham, Functions
of Matrices, SIAM 2008, theorem 3.11). It is finite where two frequencies meet, as derivatives of eigenvectors are not:
there it becomes df/dlambda.
"""

import numpy as np

from pymc_features.simulators.compilation import jit

# Two modes are close if their phases part by less than this [rad] while the structure remembers. The mean of the two
# derivatives is then right to the square of it over 12, the quotient to the rounding error of f divided by it.
CLOSE = 3e-4


@jit
def close_modes(omega, rayleigh, ratios, duration, n_modes):
    """Which pairs of kept modes take the derivative: array of bool (n_modes, n_modes), and whether there are any.

    Modes with dampings of their own by `ratios` that differ are never close: where they cross, the response jumps from
    one to the other.
    """
    close = np.zeros((n_modes, n_modes), dtype=np.bool_)
    found = False
    for r in range(n_modes):
        decay = 0.5 * (rayleigh[0] + rayleigh[1] * omega[r] * omega[r]) + ratios[r] * omega[r]
        memory = min(duration, 1.0 / decay) if decay > 0.0 else duration
        for s in range(r):
            gap = abs(omega[r] - omega[s])
            if gap == 0.0 or (ratios[r] == ratios[s] and gap * memory < CLOSE):
                close[r, s] = close[s, r] = found = True
    return close, found
