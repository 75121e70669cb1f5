"""Gradients and tangents of structures whose modes are uncoupled, by `oscillators.gradient`."""

import numpy as np

from pymc_features.simulators.compiled.arrays import writable
from pymc_features.simulators.linear.projection import Cotangent
from pymc_features.simulators.linear.system import modes_at_outputs
from pymc_features.simulators.oscillators.arguments import ABSOLUTE_ACCELERATION
from pymc_features.simulators.oscillators.gradient import modal_gradient
from pymc_features.simulators.oscillators.modal_system import DampingLaw
from pymc_features.simulators.oscillators.recursion import modal_damping
from pymc_features.simulators.oscillators.tangent import ModalChange, march_change

NO_WEIGHTS = np.empty((0, 0))


def kernel_inputs(a, system):
    """Modal system, damping law and what stands before the inputs beside outputs relative to them, (s, d)."""
    given, modes, sensors = a.parameters, modes_at_outputs(a, system), a.wanted.sensors
    law = DampingLaw(writable(given.rayleigh), writable(given.ratios[: system.omega.size]))
    if a.wanted.quantity == ABSOLUTE_ACCELERATION:
        return modes, law, sensors @ given.influence
    return modes, law, np.zeros((sensors.shape[0], given.influence.shape[1]))


def pull_back(a, system, history, weights=None):
    """Derivatives of L = sum w y, or of the statistics of the misfit, see `state_adjoint.pull_back`."""
    modes, law, feed = kernel_inputs(a, system)
    weights = NO_WEIGHTS if weights is None else weights
    found = modal_gradient(
        modes, law, writable(feed), a.inputs, a.wanted.quantity, writable(history), writable(weights)
    )
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


def push_forward(a, system, change, directions, observed, history):
    """Change of sum_k r_k^2 (s,); that of the response goes into the history, if it is not empty.

    `change` is that of the reduced matrices; `directions` those of rayleigh and ratios.
    """
    (d_rayleigh, d_ratios), omega = directions, system.omega
    modes, law, feed = kernel_inputs(a, system)
    d_damping = modal_damping(omega, writable(d_rayleigh), writable(d_ratios[: omega.size]))
    d_load = change.load + change.shapes.T @ system.load
    d_modes = ModalChange(
        *map(writable, (change.stiffness, change.mass, d_load, a.wanted.sensors @ change.shapes, d_damping))
    )
    return march_change(modes, law, writable(feed), a.inputs, a.wanted.quantity, d_modes, observed, history)
