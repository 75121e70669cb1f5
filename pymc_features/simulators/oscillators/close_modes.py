"""Divided differences of modal outputs: derivatives of a response that are right at repeated frequencies.

The response is y = phi f(Lambda) phi' M 1 in the modes of K phi = lambda M phi. Its derivative couples each
pair of modes r, s by the divided difference f[r, s] = (f_r - f_s) / (lambda_r - lambda_s) (Daleckii & Krein;
Higham, Functions of Matrices, SIAM 2008, theorem 3.11). It is finite where two frequencies meet, as
derivatives of eigenvectors are not: there it becomes df/dlambda.
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.oscillators.recursion import modal_damping

# Two modes are close if their phase difference over the decay time is below this [rad]. The mean of the two
# derivatives is then right to about the square of it over 12, the quotient to the rounding error of f divided
# by it.
CLOSE = 3e-4


@jit
def close_modes(omega, law, duration):
    """Which pairs of modes take the derivative, bool (m, m), each mode with itself, and whether others do.

    Modes with dampings of their own by `law.ratios` that differ are never close: where they cross, the
    response jumps from one to the other. `duration` is that of the record [s].
    """
    n_modes, ratios = omega.size, law.ratios
    close = np.zeros((n_modes, n_modes), dtype=np.bool_)
    found = False
    for r in range(n_modes):
        close[r, r] = True
        decay = 0.5 * modal_damping(omega[r], law.rayleigh, ratios[r])
        # at least a fraction of a period: what is slower or overdamped depends on the frequency itself
        memory = max(min(duration, 1.0 / decay), 3.0 / omega[r])
        for s in range(r):
            gap = abs(omega[r] - omega[s])
            difference = gap * memory
            if ratios[r] == 0.0:  # of modes that hardly swing it is lambda that counts, not omega
                growth = gap * (omega[r] + omega[s]) * duration * max(duration, law.rayleigh[1])
                difference = min(difference, growth)
            if gap == 0.0 or (ratios[r] == ratios[s] and difference < CLOSE):
                close[r, s] = close[s, r] = found = True
    return close, found
