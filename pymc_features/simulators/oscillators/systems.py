"""One structure as a `ModalSystem`: response and misfit, and their gradient.

Between these and the parameters of a structure stand its reduced matrices, see `linear.projection`.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.oscillators.evaluation import evaluate, new_walk
from pymc_features.simulators.oscillators.fast_modes import highest_step
from pymc_features.simulators.oscillators.modal_lanes import new_modal_lanes, put_system
from pymc_features.simulators.oscillators.modal_system import DampingLaw
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
