"""Responses and gradients of structures whose modes are uncoupled, by `oscillators.systems`."""

import numpy as np

from pymc_features.simulators.compiled.arrays import writable
from pymc_features.simulators.linear.projection import Cotangent
from pymc_features.simulators.linear.system import modes_at_outputs
from pymc_features.simulators.oscillators.misfit import weigh_history
from pymc_features.simulators.oscillators.modal_system import DampingLaw
from pymc_features.simulators.oscillators.systems import (
    Direct,
    march_system,
    modal_gradient,
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
    """Derivatives of L = sum w y, or of the statistics of the misfit, see `state_adjoint.pull_back`."""
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
