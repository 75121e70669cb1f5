"""From the bars of the numbers that a march works with to the gradient by the parameters of chains."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.taylor.population import modal_damping, modal_squares

STEP = 1e-100  # of the complex step, which has no rounding error


def constants_gradient(series, stiffness, values, bars):
    """Derivatives by stiffness (p, n) and the law's parameters (p, rows, n), from `bars` (p, n, constants).

    By complex steps through `Series.constants`, or those of the adjoint, which do nothing but arithmetic.
    """
    rows, constants = [stiffness, *values.swapaxes(0, 1)], series.adjoint.constants or series.constants
    found = []
    for k in range(len(rows)):
        moved = [row + 1j * STEP if i == k else row for i, row in enumerate(rows)]
        changes = ((c, x) for c, x in enumerate(constants(moved[0], moved[1:])) if np.iscomplexobj(x))
        found.append(sum((bars[..., c] * x.imag / STEP for c, x in changes), np.zeros_like(stiffness)))
    for row, _ in series.adjoint.fixed:
        found[1 + row] = np.full_like(stiffness, np.nan)
    return found[0], np.stack(found[1:], axis=1)


def damping_gradient(mass, stiffness, ratios, bars):
    """Derivatives by masses, stiffnesses and ratios (p, n) of chains, from `bars` (p, n, n) of M^-1 C.

    As `chain.modal_damping.add_damping_gradient`: (M^-1 C)_ij = S_ij (m_j / m_i)^1/2, S a function of the
    symmetric M^-1/2 K M^-1/2 with its eigenvectors.
    """
    roots = np.sqrt(mass)
    scale = roots[:, None, :] / roots[:, :, None]
    squares, vectors, matrix = modal_squares(mass, stiffness)
    omega, n = np.sqrt(np.maximum(squares, 0.0)), mass.shape[1]
    inner = np.einsum("pir,pij,pjs->prs", vectors, bars * scale, vectors, optimize=True)
    by_ratios = 2.0 * omega * np.einsum("prr->pr", inner)
    sums, change = omega[:, :, None] + omega[:, None, :], omega[:, :, None] - omega[:, None, :]
    all_ratios = np.broadcast_to(ratios, omega.shape)
    slopes = (all_ratios[:, :, None] + all_ratios[:, None, :]) / sums
    difference = all_ratios[:, :, None] - all_ratios[:, None, :]
    slopes += np.divide(difference, change, out=np.zeros_like(change), where=difference != 0.0)
    of_matrix = np.einsum("pir,prs,pjs->pij", vectors, inner * slopes, vectors, optimize=True)
    of_matrix = 0.5 * (of_matrix + of_matrix.swapaxes(1, 2))
    damping = bars * modal_damping(mass, stiffness, ratios)
    by_mass = 0.5 * (damping.sum(axis=1) - damping.sum(axis=2)) / mass
    by_mass -= (of_matrix * matrix).sum(axis=2) / mass
    at = np.arange(n)
    diagonal = of_matrix[:, at, at] / mass
    by_stiffness = diagonal.copy()
    beside = of_matrix[:, at[1:], at[:-1]] / (roots[:, 1:] * roots[:, :-1])
    by_stiffness[:, 1:] += diagonal[:, :-1] - 2.0 * beside
    return by_mass, by_stiffness, by_ratios


class ChainBars(NamedTuple):
    """Bars of the numbers that a march works with, of particles p.

    Attributes
    ----------
    mobility, dashpot : array (p, n)
        By ln(1/m) at given forces of the springs, and by beta k.
    alpha : array (p,)
    constants : array (p, n, constants)
        Of the law.
    damping : array (p, n, n), or (p, 0, 0)
        By M^-1 C of modal ratios.
    """

    mobility: np.ndarray
    dashpot: np.ndarray
    alpha: np.ndarray
    constants: np.ndarray
    damping: np.ndarray


def parameter_gradients(series, parameters, bars):
    """Gradient by the parameters of particles, rows for all of which are given."""
    mass, stiffness, rayleigh, ratios, values = parameters
    by_stiffness, by_law = constants_gradient(series, stiffness, values, bars.constants)
    by_mass, by_ratios = -bars.mobility / mass, np.full(mass.shape, np.nan)
    if bars.damping.size:
        # what masses do to the springs' part of the accelerations, which are less by that of damping
        by_mass += (bars.damping * modal_damping(mass, stiffness, ratios)).sum(axis=2) / mass
        more_mass, more_stiffness, by_ratios = damping_gradient(mass, stiffness, ratios, bars.damping)
        by_mass, by_stiffness = by_mass + more_mass, by_stiffness + more_stiffness
    by_rayleigh = np.stack([bars.alpha, (stiffness * bars.dashpot).sum(axis=1)], axis=1)
    return by_mass, by_stiffness + rayleigh[:, 1:] * bars.dashpot, by_rayleigh, by_ratios, by_law
