"""Modes of linear structures given by their matrices, and their gradients.

Dense structures with classical damping stay in compiled code (`dense`). Of a damping matrix C the modes are
those without damping and the ratios phi' C phi / (2 omega), as of `LinearStructure.modes`.
"""

import numpy as np

from pymc_features.algebra import shifted_factor
from pymc_features.simulators.compiled.arrays import writable
from pymc_features.simulators.linear.arguments import Arguments, n_particles
from pymc_features.simulators.linear.projection import Cotangent as Reduced
from pymc_features.simulators.linear.projection import to_parameters
from pymc_features.simulators.linear.system import System, solve_system, uncoupled
from pymc_features.simulators.modal.dense import add_dense_gradients, dense_population_modes
from pymc_features.simulators.modal.neighbours import Neighbours
from pymc_features.simulators.modal.perturbation import (
    Cotangent,
    by_eigenvalues,
    damping_ratio,
    reduced_cotangents,
)
from pymc_features.simulators.oscillators.arguments import Excitation


def linear_population_modes(parameters, wanted) -> tuple:
    """Frequencies (p, m), shapes (p, m, s), damping ratios (p, m) of a population of `LinearParameters`."""
    check(parameters, wanted)
    if parameters.is_dense and parameters.is_classical:
        return dense_population_modes(parameters.for_kernel(), wanted)
    count, m = n_particles(parameters), wanted.n_modes
    frequencies, ratios = np.full((count, m), np.nan), np.full((count, m), np.nan)
    shapes = np.full((count, m, wanted.sensors.size), np.nan)
    near = neighbours(parameters, wanted, count)
    for p in range(count):
        system = solve(parameters.one_of(p), wanted, near)
        if system is not None:
            damping = uncoupled(system.modal_damping)
            frequencies[p] = system.omega / (2.0 * np.pi)
            shapes[p] = system.shapes[wanted.sensors].T
            ratios[p] = [damping_ratio(*pair) for pair in zip(system.omega, damping, strict=True)]
    return frequencies, shapes, ratios


def linear_modes_gradient(parameters, wanted, cotangent) -> tuple:
    """Gradients in the shapes of theta, rayleigh and ratios; what all particles share gets the sum."""
    check(parameters, wanted)
    sums = tuple(np.zeros(array.shape) for array in parameters.random)
    if parameters.is_dense and parameters.is_classical:
        add_dense_gradients(parameters.for_kernel(), wanted, cotangent, sums)
        return sums
    near = neighbours(parameters, wanted, len(cotangent.frequencies))
    for p in range(len(cotangent.frequencies)):
        a = arguments(parameters.one_of(p), wanted)
        system = solve(a.parameters, wanted, near, for_gradient=True)
        if system is None:
            own = (np.nan,) * len(sums)
        else:
            own = to_parameters(a, system, reduced(a, system, Cotangent(*(part[p] for part in cotangent))))
        for total, part in zip(sums, own, strict=True):
            total[p % total.shape[0]] += part
    return sums


def neighbours(parameters, wanted, count) -> Neighbours | None:
    """What makes use of the structures before, of several large sparse ones."""
    if count == 1 or parameters.is_dense or parameters.one_of(0).has_constant_modes:
        return None
    near = Neighbours(parameters.one_of(0), wanted.n_modes)
    return near if near.is_worthwhile else None


def solve(parameters, wanted, near, *, for_gradient=False) -> System | None:
    """The system of one structure; None where there is none."""
    a = arguments(parameters, wanted)
    if near is None:
        return solve_system(a, left_out=for_gradient)
    known = near.modes(parameters, checked=not for_gradient)
    system = None if known is None else solve_system(a, known=known)
    if system is not None and for_gradient:
        return system._replace(factor=shifted_factor(system.mass, system.stiffness))
    return system


def check(parameters, wanted):
    """Refuse sizes that do not agree."""
    first, n = parameters.one_of(0), parameters.n_dof
    if wanted.sensors.size and not 0 <= wanted.sensors.min() <= wanted.sensors.max() < n:
        raise ValueError("`sensors` must be degrees of freedom of the structure")
    a = arguments(first, wanted)
    a._replace(wanted=wanted._replace(sensors=np.empty((0, n)))).check()


def arguments(parameters, wanted) -> Arguments:
    """What `solve_system` takes: a structure at rest, whose steps are short enough for any mode."""
    return Arguments(parameters, Excitation(np.zeros((parameters.forces.shape[1], 2)), 0.0, 1, 1), wanted)


def reduced(a, system, cotangent) -> Reduced:
    """Derivatives of L by the reduced matrices, by the shapes outside their span, and by the damping."""
    omega, (rayleigh, ratios) = writable(system.omega), a.parameters.random[1:]
    by_shapes = np.zeros(system.shapes.shape)
    np.add.at(by_shapes, a.wanted.sensors, cotangent.shapes.T)
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
