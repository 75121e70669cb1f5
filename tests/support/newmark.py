"""Newmark's method: slow, approximate, and independent of everything else here; a reference for tests."""

import numpy as np


def newmark(mass, damping, stiffness, force, dt, *, gamma=0.5, beta=0.25):
    """Integrate M u" + C u' + K u = p(t) from rest by Newmark's implicit method.

    Parameters
    ----------
    mass, damping, stiffness : array (n, n)
        Matrices.
    force : array (n, t)
        Nodal forces at the time steps.
    dt : float
        Time step [s].
    gamma, beta : float
        1/2 and 1/4: average acceleration, unconditionally stable; 1/2 and 1/6: linear acceleration.
        Second order in dt either way.

    Returns
    -------
    displacement, velocity, acceleration : array (n, t)

    References
    ----------
    N. M. Newmark, J. Eng. Mech. Div. ASCE 85 (1959) 67-94; Chopra, Dynamics of Structures, table 5.4.2.
    """
    n, n_times = force.shape
    displacement, velocity, acceleration = (np.zeros((n, n_times)) for _ in range(3))
    acceleration[:, 0] = np.linalg.solve(mass, force[:, 0])
    effective = mass + gamma * dt * damping + beta * dt**2 * stiffness
    inverse = np.linalg.inv(effective)
    for k in range(n_times - 1):
        u, v, a = displacement[:, k], velocity[:, k], acceleration[:, k]
        u_free = u + dt * v + (0.5 - beta) * dt**2 * a
        v_free = v + (1.0 - gamma) * dt * a
        a_next = inverse @ (force[:, k + 1] - damping @ v_free - stiffness @ u_free)
        displacement[:, k + 1] = u_free + beta * dt**2 * a_next
        velocity[:, k + 1] = v_free + gamma * dt * a_next
        acceleration[:, k + 1] = a_next
    return displacement, velocity, acceleration
