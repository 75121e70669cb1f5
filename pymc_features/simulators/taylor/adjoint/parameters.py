"""From the bars of the numbers that a march works with to the gradient by the parameters of chains."""

import numpy as np

from pymc_features.simulators.taylor.layout import DASHPOT, DRAG, MOBILITY
from pymc_features.simulators.taylor.population import modal_damping, modal_squares

STEP = 1e-100  # of the complex step, which has no rounding error


def constants_gradient(series, stiffness, values, bars):
    """Derivatives by stiffness (p, n) and the law's parameters (p, rows, n), from `bars` (p, n, constants).

    By complex steps through `Series.constants`, which does nothing but arithmetic.
    """
    rows = [stiffness, *values.swapaxes(0, 1)]
    found = []
    for k in range(len(rows)):
        moved = [row + 1j * STEP * (i == k) for i, row in enumerate(rows)]
        constants = series.constants(moved[0], np.array(moved[1:]))
        found.append(sum(bars[..., c] * x.imag / STEP for c, x in enumerate(constants)))
    for row, _ in series.adjoint.fixed:
        found[1 + row] = np.full_like(stiffness, np.nan)
    return found[0], np.stack(found[1:], axis=1)


def damping_gradient(mass, stiffness, ratios, bars):
    """Derivatives by masses, stiffnesses and ratios (p, n) of chains, from `bars` (p, n, n) of M^-1 C.

    As `chain.modal_damping.add_damping_gradient`, with M^-1/2 K M^-1/2 = A and the symmetric S, its function with
    eigenvectors Q: (M^-1 C)_ij = S_ij (m_j / m_i)^1/2.
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


def parameter_gradients(lanes, memory, parameters, step):
    """Gradient by the parameters of the chains in the lanes; `step` [s] is that of the first step of the march."""
    mass, stiffness, rayleigh, ratios, values = parameters
    bars, n = memory.bars, lanes.n
    record, entries, constants = memory.layout.record, memory.layout.entries, memory.layout.constants
    springs = bars[record : (n + 1) * record].reshape(n, record, -1)
    by_mobility, by_dashpot = springs[:, entries + MOBILITY].T, springs[:, entries + DASHPOT].T / step
    by_alpha = bars[(n + 1) * record + DRAG] * step
    by_stiffness, by_law = constants_gradient(
        lanes.series, stiffness, values, springs[:, constants:].transpose(2, 0, 1)
    )
    by_mass, by_ratios = -by_mobility / mass, np.full(stiffness.shape, np.nan)
    if lanes.modal.size:
        damping = memory.modal.reshape(n, n, -1).transpose(2, 0, 1) * step
        # what masses do to the springs' part of the accelerations, which are less by that of damping
        by_mass += (damping * modal_damping(mass, stiffness, ratios)).sum(axis=2) / mass
        more_mass, more_stiffness, by_ratios = damping_gradient(mass, stiffness, ratios, damping)
        by_mass, by_stiffness = by_mass + more_mass, by_stiffness + more_stiffness
    by_rayleigh = np.stack([by_alpha, (stiffness * by_dashpot).sum(axis=1)], axis=1)
    by_stiffness = by_stiffness + rayleigh[:, 1:] * by_dashpot
    return by_mass, by_stiffness, by_rayleigh, by_ratios, by_law
