"""Responses and gradients of structures whose modes are uncoupled, by `oscillators.systems`.

One structure as a `ModalSystem`: response and misfit, and their gradient.

Between these and the parameters of a structure stand its reduced matrices, see `linear.projection`.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.arrays import writable
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.linear.projection import Cotangent
from pymc_features.simulators.linear.system import modes_at_outputs
from pymc_features.simulators.oscillators.march import evaluate, new_walk
from pymc_features.simulators.oscillators.misfit import weigh_history
from pymc_features.simulators.oscillators.modal_lanes import new_modal_lanes, put_system
from pymc_features.simulators.oscillators.modal_system import DampingLaw, highest_step
from pymc_features.simulators.oscillators.reduction import bring, derive, new_reduced
from pymc_features.simulators.oscillators.samples import (
    of_one,
)
from pymc_features.simulators.oscillators.sums import new_gradient_walk


class ModalGradient(NamedTuple):
    """Derivatives of a number L with respect to what the march knows of a structure.

    Attributes
    ----------
    stiffness, mass : array (m, m)
        By Phi' K Phi and Phi' M Phi, at fixed Phi.
    load : array (m, d)
        By Phi' L, the load whose projection is Gamma.
    shapes : array (s, m)
        By S Phi, outside of the span of Phi.
    damping : array (m,)
        By D.
    """

    stiffness: np.ndarray
    mass: np.ndarray
    load: np.ndarray
    shapes: np.ndarray
    damping: np.ndarray


class Direct(NamedTuple):
    """What stands before the inputs: S iota and S Phi Phi' forces (s, d), and whether all modes are kept."""

    motion: np.ndarray
    forced: np.ndarray
    is_complete: bool


@jit
def new_lane(system, law, direct, samples, excitation, quantity, widths):
    """A lane with the structure in it."""
    (s, m), step = system.shapes.shape, excitation.dt / excitation.substeps
    sizes = m if direct.is_complete else m + 1, m, m, s
    lot = new_modal_lanes(sizes, direct.motion, (False, False), samples, (step, quantity), widths)
    put_system(lot, 0, system, law, direct.forced, highest_step(excitation))
    return lot


@jit
def march_system(system, direct, excitation, quantity, observed, history):
    """Statistics (s, 4) of the misfit, or the response in the history, unless it is empty."""
    (s, m), widths, law = system.shapes.shape, of_one(), DampingLaw(np.zeros(2), np.zeros(system.omega.size))
    data = observed if history.shape[0] == 0 else np.empty((0, 0))
    walk = new_walk(excitation, data, max(observed.shape[1], history.shape[1]), m, s, widths)
    lot, result = (
        new_lane(system, law, direct, walk.samples, excitation, quantity, widths),
        np.full((1, s, 4 if history.shape[0] == 0 else 1), np.nan),
    )
    if lot.is_there[0]:
        evaluate(lot, walk, history, 0, result, widths)
    else:
        history[:] = np.nan
    return result[0]


@jit
def modal_gradient(system, law, direct, excitation, quantity, history, weights, is_given):
    """`ModalGradient` of the weighted e_j, weights (s, 1), by data or, if `is_given`, of u in their place."""
    (s, m), d, widths = system.shapes.shape, system.participation.shape[1], of_one()
    walk = new_gradient_walk(excitation, history, is_given, False, m, widths.wide, widths)
    lot = new_lane(system, law, direct, walk.samples, excitation, quantity, widths)
    reduced = new_reduced(lot, widths)
    bring(lot, walk, weights.reshape((1, *weights.shape)), 0)
    derive(lot, walk, reduced, widths)
    return ModalGradient(
        reduced.stiffness[: m * m].copy().reshape((m, m)),
        reduced.mass[: m * m].copy().reshape((m, m)),
        reduced.by_load.copy().reshape((m, d)),
        reduced.by_shapes.copy().reshape((s, m)),
        reduced.by_damping[:m].copy().reshape(m),
    )


NO_HISTORY = np.empty((0, 0))


def kernel_inputs(a, system):
    """Modal system, law of its damping and what stands before the inputs, as the kernels take them."""
    given, modes, sensors = a.parameters, modes_at_outputs(a, system), a.wanted.sensors
    law = DampingLaw(writable(given.rayleigh), writable(given.ratios[: system.omega.size]))
    forced = modes.shapes @ (system.shapes.T @ given.forces)
    direct = Direct(writable(sensors @ given.influence), writable(forced), system.omega.size == given.n_dof)
    return modes, law, direct


def march_modes(a, system, observed, history):
    """Statistics (s, 4) of the misfit; the response in the history instead, unless it is empty."""
    modes, _, direct = kernel_inputs(a, system)
    return march_system(modes, direct, a.inputs, a.wanted.quantity, writable(observed), history)


def pull_back(a, system, history, weights=None):
    """Derivatives of L = sum w y, or of the statistics of the misfit, see `state_space.pull_back`."""
    kernel, is_given = kernel_inputs(a, system), weights is None
    if weights is None:
        weights = np.zeros((len(history), 1))
    elif weights.shape[1] > 1:  # for all statistics the response is kept
        response = np.empty(history.shape)
        march_modes(a, system, history, response)
        weigh_history(response, writable(history), writable(weights))
        history, is_given = response, True
    data = writable(history), writable(weights[:, :1]), is_given
    found = modal_gradient(*kernel, a.inputs, a.wanted.quantity, *data)
    omega, ratios = system.omega, np.zeros(a.parameters.ratios.size)
    ratios[: omega.size] = 2.0 * omega * found.damping
    return Cotangent(
        stiffness=found.stiffness,
        mass=found.mass,
        damping=None,
        load=found.load,
        shapes=a.wanted.sensors.T @ found.shapes + system.load @ found.load.T,
        rayleigh=np.array([found.damping.sum(), omega**2 @ found.damping]),
        ratios=ratios,
    )
