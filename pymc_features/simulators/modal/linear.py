"""Modes of linear structures given by their matrices, and their gradients.

Dense structures with classical damping stay in compiled code (`dense`). Of a damping matrix C the modes are
those without damping and the ratios phi' C phi / (2 omega), as of `LinearStructure.modes`.

Modes of dense structures with classical damping, and their gradients, in compiled code.
"""

import contextlib

import numpy as np
from scipy import sparse

from pymc_features.algebra import massless_motions, natural_modes
from pymc_features.simulators.compiled.arrays import writable
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.linear.arguments import Arguments, n_particles
from pymc_features.simulators.linear.dense import solve_dense
from pymc_features.simulators.linear.projection import Cotangent as Reduced
from pymc_features.simulators.linear.projection import to_parameters
from pymc_features.simulators.linear.system import solved, uncoupled
from pymc_features.simulators.modal.perturbation import (
    Cotangent,
    by_eigenvalues,
    damping_ratio,
    pull_back_modes,
    reduced_cotangents,
    write_modes,
)
from pymc_features.simulators.oscillators.arguments import Excitation, Outputs


@jit
def dense_population_modes(parameters, wanted):
    """Frequencies (p, m), shapes (p, m, s) and damping ratios (p, m) of dense `LinearParameters`."""
    theta, rayleigh, ratios = parameters.theta, parameters.rayleigh, parameters.ratios
    count, m = max(theta.shape[0], rayleigh.shape[0], ratios.shape[0]), wanted.n_modes
    frequencies, damping_ratios = np.full((count, m), np.nan), np.full((count, m), np.nan)
    shapes = np.full((count, m, wanted.sensors.size), np.nan)
    for p in range(count):
        own = theta[p % theta.shape[0]], rayleigh[p % rayleigh.shape[0]], ratios[p % ratios.shape[0]]
        valid, omega, rows, damping, _ = solve_dense(parameters, own, 0.0, m, m)
        if valid:
            write_modes((omega, rows, damping), wanted.sensors, frequencies[p], shapes[p], damping_ratios[p])
    return frequencies, shapes, damping_ratios


@jit
def add_modes_gradient(parameters, own, wanted, cotangent, gradients):
    """Add the gradient of one structure to `gradients`; NaN where its parameters describe none.

    `own` and `gradients` are theta (p,), rayleigh (2,) and ratios (k,); the matrices are those of
    `parameters`.
    """
    n, m, (_, rayleigh, _) = parameters.influence.shape[0], wanted.n_modes, own
    grad_theta, grad_rayleigh, grad_ratios = gradients
    valid, omega, rows, damping, _ = solve_dense(parameters, own, 0.0, n, m)
    if not valid:
        for gradient in gradients:
            gradient[:] = np.nan
        return
    by_damping, sensors = (grad_rayleigh, grad_ratios), wanted.sensors
    left_stiffness, left_mass = pull_back_modes((omega, rows), rayleigh, sensors, cotangent, by_damping)
    if parameters.stiffness.shape[0] > 1:
        grad_theta += np.dot(parameters.stiffness[1:], np.dot(left_stiffness, rows[:m]).reshape(n * n))
    if parameters.mass.shape[0] > 1:
        grad_theta += np.dot(parameters.mass[1:], np.dot(left_mass, rows[:m]).reshape(n * n))


@jit
def add_dense_gradients(parameters, wanted, cotangent, gradients):
    """Add the gradients of all particles; theta, rayleigh and ratios have a row for each or one for all."""
    theta, rayleigh, ratios = parameters.theta, parameters.rayleigh, parameters.ratios
    grad_theta, grad_rayleigh, grad_ratios = gradients
    for p in range(cotangent.frequencies.shape[0]):
        i, j, k = p % theta.shape[0], p % rayleigh.shape[0], p % ratios.shape[0]
        own, own_gradients = (
            (theta[i], rayleigh[j], ratios[k]),
            (grad_theta[i], grad_rayleigh[j], grad_ratios[k]),
        )
        by_modes = Cotangent(cotangent.frequencies[p], cotangent.shapes[p], cotangent.ratios[p])
        add_modes_gradient(parameters, own, wanted, by_modes, own_gradients)


def linear_population_modes(parameters, wanted) -> tuple:
    """Frequencies (p, m), shapes (p, m, s), damping ratios (p, m) of a population of `LinearParameters`."""
    check(parameters, wanted)
    if parameters.is_dense and parameters.is_classical:
        return dense_population_modes(parameters.for_kernel(), wanted)
    count, m = n_particles(parameters), wanted.n_modes
    frequencies, ratios = np.full((count, m), np.nan), np.full((count, m), np.nan)
    shapes = np.full((count, m, wanted.sensors.size), np.nan)
    for p, own, system in solved(arguments(parameters, wanted), np.arange(count), signed=True):
        if system is not None:
            damping = uncoupled(system.modal_damping)
            frequencies[p] = system.omega / (2.0 * np.pi)
            shapes[p] = (own.wanted.sensors @ system.shapes).T
            ratios[p] = [damping_ratio(*pair) for pair in zip(system.omega, damping, strict=True)]
    return frequencies, shapes, ratios


def linear_frequencies(parameters, n_modes) -> np.ndarray:
    """Natural frequencies (p, m) [Hz], infinite beyond the rank of M; nothing is compiled for them."""
    omega = np.full((n_particles(parameters), n_modes), np.nan)
    if parameters.is_dense:
        for p in range(len(omega)):
            own = parameters.one_of(p)
            mass, stiffness = own.assemble(own.mass), own.assemble(own.stiffness)
            massless = massless_motions(mass) if own.is_finite else None
            if massless is None:
                continue
            with contextlib.suppress(ValueError, RuntimeError):  # of what is no structure
                found, _ = natural_modes(mass, stiffness, min(n_modes, massless.rank), massless=massless)
                omega[p] = np.append(found, np.full(n_modes - found.size, np.inf))
    else:
        wanted = Outputs(np.zeros(0, dtype=np.int64), n_modes, 0)
        for p, _, system in solved(arguments(parameters, wanted), np.arange(len(omega))):
            omega[p] = np.nan if system is None else system.omega
    return omega / (2.0 * np.pi)


def linear_modes_gradient(parameters, wanted, cotangent) -> tuple:
    """Gradients in the shapes of theta, rayleigh and ratios; what all particles share gets the sum."""
    check(parameters, wanted)
    sums = tuple(np.zeros(array.shape) for array in parameters.random)
    if parameters.is_dense and parameters.is_classical:
        add_dense_gradients(parameters.for_kernel(), wanted, cotangent, sums)
        return sums
    particles = np.arange(len(cotangent.frequencies))
    for p, a, system in solved(arguments(parameters, wanted), particles, left_out=True, signed=True):
        if system is None:
            own = (np.nan,) * len(sums)
        else:
            own = to_parameters(a, system, reduced(a, system, Cotangent(*(part[p] for part in cotangent))))
        for total, part in zip(sums, own, strict=True):
            total[p % total.shape[0]] += part
    return sums


def check(parameters, wanted):
    """Refuse sizes that do not agree."""
    first, n = parameters.one_of(0), parameters.n_dof
    if wanted.sensors.size and not 0 <= wanted.sensors.min() <= wanted.sensors.max() < n:
        raise ValueError("`sensors` must be degrees of freedom of the structure")
    arguments(first, wanted).check()


def arguments(parameters, wanted) -> Arguments:
    """What `solve_system` takes: structures at rest, whose steps are short enough for any mode."""
    entries = np.ones(wanted.sensors.size), (np.arange(wanted.sensors.size), wanted.sensors)
    rows = sparse.csr_array(entries, shape=(wanted.sensors.size, parameters.n_dof))
    excitation = Excitation(np.zeros((parameters.forces.shape[1], 2)), 0.0, 1, 1)
    return Arguments(parameters, excitation, wanted._replace(sensors=rows))


def reduced(a, system, cotangent) -> Reduced:
    """Derivatives of L by the reduced matrices, by the shapes outside their span, and by the damping."""
    omega, (rayleigh, ratios) = writable(system.omega), a.parameters.random[1:]
    by_shapes = a.wanted.sensors.T @ cotangent.shapes.T
    with np.errstate(divide="ignore", invalid="ignore"):
        by_damping = np.where(cotangent.ratios == 0.0, 0.0, cotangent.ratios / (2.0 * omega))
        if a.parameters.is_classical:
            slopes = 0.5 * (rayleigh[1] - rayleigh[0] / omega**2)
            by_rayleigh = np.array([by_damping.sum(), cotangent.ratios @ omega / 2.0])
            by_ratios, damping = np.zeros(ratios.size), None
            by_ratios[: omega.size] = cotangent.ratios
        else:
            slopes = -uncoupled(system.modal_damping) / (2.0 * omega**2)
            by_rayleigh, by_ratios, damping = np.zeros(2), np.zeros(ratios.size), np.diag(by_damping)
            by_shapes += (system.damping + system.damping.T) @ system.shapes * by_damping
    by_eigenvalue = by_eigenvalues(omega, slopes, Cotangent(*map(writable, cotangent)))
    by_stiffness, by_mass = reduced_cotangents(omega, by_eigenvalue, system.shapes.T @ by_shapes)
    load = np.zeros(system.participation.shape)
    return Reduced(by_stiffness, by_mass, damping, load, by_shapes, by_rayleigh, by_ratios)
