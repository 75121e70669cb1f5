"""Specimens under a prescribed displacement by SciPy: nothing of the package is in it."""

import numpy as np
from scipy.integrate import solve_ivp


def reference(law, displacement):
    """The force by SciPy, one branch after the other, each on one side of z = 0."""
    k, reach, ratio, n, beta, gamma, d_nu, d_eta, slip, p, q, psi, d_psi, severity = law
    solver = {"rtol": 1e-12, "atol": 1e-13, "method": "DOP853", "max_step": 0.1}
    z, e, before, found = 0.0, 0.0, 0.0, []

    def slope_of(side, way):
        def slope(_, state):
            z, e = state
            nu, eta = 1.0 + d_nu * e, 1.0 + d_eta * e
            z_u = (1.0 / (nu * (beta + gamma))) ** (1.0 / n)
            zeta_1 = slip * (1.0 - np.exp(-p * e))
            zeta_2 = (psi + d_psi * e) * (severity + zeta_1)
            h = 1.0 - zeta_1 * np.exp(-((z * way - q * z_u) ** 2) / zeta_2**2)
            return way * h * (1.0 - nu * abs(z) ** n * (gamma + beta * side)) / eta, way * z

        return slope

    def passes_zero(_, state):
        return state[0]

    passes_zero.terminal = True
    for d in displacement:
        way, start, end = np.sign(d - before), 0.0, abs(d - before) / reach
        if way and z * way < 0.0:
            part = solve_ivp(slope_of(-1.0, way), (start, end), (z, e), events=passes_zero, **solver)
            (z, e), start = part.y[:, -1], part.t[-1]
            z = 0.0 if part.status == 1 else z
        if way and start < end and z * way >= 0.0:
            z, e = solve_ivp(slope_of(1.0, way), (start, end), (z, e), **solver).y[:, -1]
        before = d
        found.append(ratio * k * d + (1.0 - ratio) * k * reach * z)
    return np.array(found)


def cycles(reach, peaks, steps):
    """Displacement through peaks, multiples of the yield displacement, in so many steps each."""
    ways = np.arange(len(peaks) * steps + 1) / steps
    return reach * np.interp(ways, np.arange(len(peaks) + 1), [0.0, *peaks])
