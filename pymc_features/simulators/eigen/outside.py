"""How the kept modes leave their span when the structure changes, where all modes are at hand."""

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
