"""The parameters of a spring-mass chain, and checks of sizes."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.oscillators.arguments import n_outputs


class ChainParameters(NamedTuple):
    """Masses on springs in a row, with Rayleigh damping and damping ratios added to it.

    Of a population each array has one more axis in front: a row for each particle, or one for all.

    Attributes
    ----------
    mass, stiffness : array (n,)
        Masses [kg] and springs [N/m], both from the base upwards.
    rayleigh : array (2,)
        alpha [1/s] and beta [s].
    ratios : array (n,)
        Damping ratios [-] of the modes, lowest first.
    """

    mass: np.ndarray
    stiffness: np.ndarray
    rayleigh: np.ndarray
    ratios: np.ndarray


@jit
def own_rows(parameters, p):
    """Row p of each parameter of a population; one row stands for all."""
    mass, stiffness, rayleigh, ratios = parameters
    return ChainParameters(
        mass[p % mass.shape[0]],
        stiffness[p % stiffness.shape[0]],
        rayleigh[p % rayleigh.shape[0]],
        ratios[p % ratios.shape[0]],
    )


@jit
def zeros_like(parameters):
    """Gradients of the shapes of the parameters, zero."""
    mass, stiffness, rayleigh, ratios = parameters
    return ChainParameters(
        np.zeros(mass.shape), np.zeros(stiffness.shape), np.zeros(rayleigh.shape), np.zeros(ratios.shape)
    )


@jit
def as_population(parameters):
    """The parameters of one chain, or arrays of their shapes, as rows of a population of one."""
    mass, stiffness, rayleigh, ratios = parameters
    return ChainParameters(
        mass.reshape((1, mass.size)),
        stiffness.reshape((1, stiffness.size)),
        rayleigh.reshape((1, rayleigh.size)),
        ratios.reshape((1, ratios.size)),
    )


@jit
def check_sizes(parameters, wanted):
    """Refuse inputs whose sizes would make the kernels read outside their arrays."""
    mass, stiffness, rayleigh, ratios = parameters
    n_dof = mass.size
    if stiffness.size != n_dof or ratios.size != n_dof or rayleigh.size != 2:
        raise ValueError("`mass`, `stiffness` and damping `ratios` must have equal lengths")
    for j in range(wanted.sensors.size):
        if wanted.sensors[j] < 0 or wanted.sensors[j] >= n_dof:
            raise ValueError("`sensors` must be degrees of freedom of the structure")
    if wanted.n_modes < 1 or wanted.n_modes > n_dof:
        raise ValueError("`n_modes` must lie between 1 and the number of degrees of freedom")


@jit
def check_history(history, excitation, wanted):
    """Refuse data, or weights on the response, of another shape than the response's."""
    total = n_outputs(excitation.acceleration.size, excitation.substeps, excitation.stride)
    if history.shape[0] != wanted.sensors.size or history.shape[1] != total:
        raise ValueError("`observed` or the cotangent must have the shape (sensor, time) of the response")


@jit
def check_population(parameters, excitation, wanted, observed):
    """Refuse inputs whose sizes do not agree; return the number of particles."""
    check_sizes(own_rows(parameters, 0), wanted)
    check_history(observed, excitation, wanted)
    mass, stiffness, rayleigh, ratios = parameters
    n_particles = max(mass.shape[0], stiffness.shape[0], rayleigh.shape[0], ratios.shape[0])
    for size in (mass.shape[0], stiffness.shape[0], rayleigh.shape[0], ratios.shape[0]):
        if size != 1 and size != n_particles:
            raise ValueError(
                "`mass`, `stiffness`, `rayleigh` and `ratios` must have one row, or one for each particle"
            )
    return n_particles


@jit
def drifts_of(shapes):
    """Drifts (n, k) of the springs in the columns of displacements (n, k)."""
    drifts = shapes.copy()
    for i in range(1, shapes.shape[0]):  # operations on slices compile long, see `copy_entries`
        for r in range(shapes.shape[1]):
            drifts[i, r] -= shapes[i - 1, r]
    return drifts
