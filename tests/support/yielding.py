"""Chains whose springs yield or harden, by SciPy."""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

from pymc_features.simulators import QUANTITIES


def tight_solution(given, acceleration, dt, at_kinks=False):
    """Histories (n, u) by quantity, at tolerances of 1e-12, with the laws as they are written.

    Each sample starts the integration anew, and `at_kinks` each reversal, or zero of an internal variable:
    the steps are then smooth in the parameters.
    """
    mass, stiffness, (alpha, beta), ratios, law = given
    n = mass.size
    matrix = np.diag(stiffness) + np.diag(np.r_[stiffness[1:], 0.0])
    matrix -= np.diag(stiffness[1:], 1) + np.diag(stiffness[1:], -1)
    squares, shapes = eigh(matrix, np.diag(mass))
    moved = np.diag(mass) @ shapes
    damping = alpha * np.diag(mass) + beta * matrix + moved * (2.0 * ratios * np.sqrt(squares)) @ moved.T

    def kinks(y):
        return np.r_[np.diff(y[n : 2 * n], prepend=0.0), y[2 * n :]]

    def slope(t, y, start, trend, signs):
        u, v, z = y.reshape(3, n)
        d, r = np.diff(u, prepend=0.0), np.diff(v, prepend=0.0)
        if len(law) == 1:
            force, change = stiffness * d + law[0] * d**3, 0.0 * z
        else:
            reach, ratio, order, b, c = law
            force = stiffness * (ratio * d + (1.0 - ratio) * reach * z)
            now = np.sign(r * z) if signs is None else signs
            change = r / reach * (1.0 - np.abs(z) ** order * (c + b * now))
        restoring = force - np.append(force[1:], 0.0) + damping @ v
        return np.concatenate([v, -restoring / mass - start - trend * t, change])

    states = [np.zeros(3 * n)]
    for now, after in zip(acceleration[:-1], acceleration[1:], strict=True):
        t, y, arguments = 0.0, states[-1], (now, (after - now) / dt)
        while t < dt:
            ahead = kinks(y + 1e-9 * slope(t, y, *arguments, None))
            signs = np.where(ahead[:n] * ahead[n:] < 0.0, -1.0, 1.0) if at_kinks else None
            events = []
            live = kinks(y) * ahead > 0.0  # what has just passed zero is not about to
            for k in np.flatnonzero(live) if at_kinks and len(law) > 1 else ():
                events.append(lambda t, y, *_, k=k: kinks(y)[k])
                events[-1].terminal = True
            options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-15, "events": events}
            part = solve_ivp(slope, (t, dt), y, args=(*arguments, signs), **options)
            t, y = part.t[-1], part.y[:, -1]
        states.append(y)
    y = np.array(states).T
    slopes = [slope(0.0, s, a, 0.0, None) for s, a in zip(states, acceleration, strict=True)]
    relative = np.array(slopes).T[n : 2 * n]
    return dict(zip(QUANTITIES, (relative + acceleration, relative, y[n : 2 * n], y[:n]), strict=True))
