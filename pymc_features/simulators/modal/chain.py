"""Modes of spring-mass chains, and of nonlinear chains in small motions, with their gradients."""

import numpy as np

from pymc_features.simulators.chain.modes import chain_modes
from pymc_features.simulators.chain.parameters import (
    ChainParameters,
    check_sizes,
    drifts_of,
    own_rows,
    zeros_like,
)
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.modal.perturbation import (
    Cotangent,
    pull_back_modes,
    write_modes,
)
from pymc_features.simulators.oscillators.modal_system import write_damping


@jit
def solve_chain(own, n_modes):
    """All modes of a chain, with the damping of those that are kept.

    Returns
    -------
    valid : bool
        False if the parameters describe no structure; the rest is undefined then.
    omega, rows : array (n,), (n, n)
        As `chain_modes` writes them.
    damping : array (m,)
        D [1/s].
    """
    n = own.mass.size
    omega, participation, rows, damping = np.empty(n), np.empty(n), np.zeros((n, n)), np.empty(n_modes)
    valid = chain_modes(own.mass, own.stiffness, omega, rows, participation)
    if valid:
        valid = write_damping(omega[:n_modes], own.rayleigh, own.ratios, 0.0, damping)
    return valid, omega, rows, damping


@jit
def chain_population_modes(parameters, wanted):
    """Frequencies (p, m), shapes (p, m, s) and damping ratios (p, m) of a population of `ChainParameters`."""
    check_sizes(own_rows(parameters, 0), wanted)
    count, m = 1, wanted.n_modes
    for array in parameters:
        count = max(count, array.shape[0])
    frequencies, ratios = np.full((count, m), np.nan), np.full((count, m), np.nan)
    shapes = np.full((count, m, wanted.sensors.size), np.nan)
    for p in range(count):
        valid, omega, rows, damping = solve_chain(own_rows(parameters, p), m)
        if valid:
            write_modes((omega, rows, damping), wanted.sensors, frequencies[p], shapes[p], ratios[p])
    return frequencies, shapes, ratios


def chain_frequencies(parameters, n_modes) -> np.ndarray:
    """Natural frequencies (p, m) [Hz], each right to its own digits; nothing is compiled for them.

    With drifts D u the stiffness is D' k D, so that they are singular values of k^(1/2) D M^(-1/2), which is
    bidiagonal (Demmel & Kahan, SIAM J. Sci. Stat. Comput. 11, 1990).
    """
    mass, stiffness = np.broadcast_arrays(parameters.mass, parameters.stiffness)
    is_chain = ((mass > 0) & (mass < np.inf) & (stiffness > 0) & (stiffness < np.inf)).all(axis=1)
    heavy, stiff = np.sqrt(mass[is_chain]), np.sqrt(stiffness[is_chain])
    matrices, i = np.zeros((*heavy.shape, heavy.shape[1])), np.arange(heavy.shape[1])
    matrices[:, i, i] = stiff / heavy
    matrices[:, i[:-1], i[1:]] = -stiff[:, 1:] / heavy[:, :-1]
    frequencies = np.full((len(mass), n_modes), np.nan)
    frequencies[is_chain] = np.linalg.svd(matrices, compute_uv=False)[:, : -n_modes - 1 : -1] / (2.0 * np.pi)
    return frequencies


@jit
def add_modes_gradient(own, wanted, cotangent, gradients):
    """Add the gradient of one chain to `gradients`; NaN where its parameters describe none."""
    m = wanted.n_modes
    valid, omega, rows, damping = solve_chain(own, m)
    if not valid:
        for gradient in gradients:
            gradient[:] = np.nan
        return
    by_damping, shapes = (gradients.rayleigh, gradients.ratios), np.ascontiguousarray(rows[:m].T)
    left_stiffness, left_mass = pull_back_modes(
        (omega, rows), own.rayleigh, wanted.sensors, cotangent, by_damping
    )
    drifts, turned = drifts_of(shapes), drifts_of(left_stiffness)
    for i in range(omega.size):
        for r in range(m):
            gradients.stiffness[i] += turned[i, r] * drifts[i, r]
            gradients.mass[i] += left_mass[i, r] * shapes[i, r]


@jit
def chain_modes_gradient(parameters, wanted, cotangent):
    """Gradients in the shapes of the parameters; what all particles share, in one row, gets the sum."""
    check_sizes(own_rows(parameters, 0), wanted)
    gradients = zeros_like(parameters)
    for p in range(cotangent.frequencies.shape[0]):
        own = Cotangent(cotangent.frequencies[p], cotangent.shapes[p], cotangent.ratios[p])
        add_modes_gradient(own_rows(parameters, p), wanted, own, own_rows(gradients, p))
    return gradients


def small_motion_modes(parameters, wanted) -> tuple:
    """Modes of nonlinear chains about rest: those of the initial stiffness."""
    return chain_population_modes(ChainParameters(*parameters[:4]), wanted)


def small_motion_gradient(parameters, wanted, cotangent) -> tuple:
    """Gradients by all parameters of nonlinear chains; those of the law have no part in small motions."""
    linear = ChainParameters(*parameters[:4])
    return *chain_modes_gradient(linear, wanted, cotangent), *(np.zeros(x.shape) for x in parameters[4:])
