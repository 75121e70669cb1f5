"""SciPy's adaptive method of eighth order, with a right-hand side that Numba compiles."""

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp

from benchmarks.peers.population import chain_rates, mean_squares

TOLERANCE = 1e-8  # relative; absolute of metres and metres per second


def prepare(population):
    """Return a call that evaluates e_j of nonlinear chains, one after the other."""
    case = population.case
    n, times, ground = case.n_dof, np.arange(case.observed.shape[1]) * case.step, case.fine_acceleration
    rates = chain_rates(population.structure.family, np, njit)
    mass, springs, rayleigh, _, values = population.parameters

    @njit
    def at(t, y, mass, stiffness, rayleigh, values, times, ground):
        own = rates(
            y[:n], y[n : 2 * n], y[2 * n :], np.interp(t, times, ground), mass, stiffness, rayleigh, values
        )
        return np.concatenate(own)

    def histories():
        for p, stiffness in enumerate(springs):
            given = mass[0], stiffness, rayleigh[0], values[p % len(values)], times, ground
            found = solve_ivp(
                at,
                times[[0, -1]],
                np.zeros(3 * n),
                method="DOP853",
                t_eval=times,
                args=given,
                rtol=TOLERANCE,
                atol=1e-2 * TOLERANCE,
                max_step=case.step,
            ).y.T.copy()  # rows, for which `at` is compiled
            own = [at(t, y, *given)[n : 2 * n] + g for t, y, g in zip(times, found, ground, strict=True)]
            yield np.array(own).T[case.sensors]

    return lambda: mean_squares(list(histories()), case)
