"""Structures in lanes, whoever solves their eigenproblems: misfits, responses, modes and gradients.

A function `solve(structures, lot, place, highest)` fills the lanes: it writes the modes and damping of
structures `first` ... of `count`, the two numbers of the place, and empties the lanes of those that have no
response. `highest` is omega h from where a mode follows its input.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.oscillators.arguments import Outputs
from pymc_features.simulators.oscillators.march import evaluate, new_walk
from pymc_features.simulators.oscillators.modal_lanes import (
    NO_DAMPING,
    new_modal_lanes,
    put_damping,
    system_of,
)
from pymc_features.simulators.oscillators.modal_system import has_fast, highest_step
from pymc_features.simulators.oscillators.reduction import Reduced, bring, derive, derive_from, new_reduced
from pymc_features.simulators.oscillators.samples import Widths
from pymc_features.simulators.oscillators.spread import (
    Spread,
    Terms,
    add_damping,
    new_spread,
    spread_to_theta,
)
from pymc_features.simulators.oscillators.sums import new_gradient_walk
from pymc_features.simulators.oscillators.systems import new_systems, put_modes

NO_DATA = np.empty((0, 0))


class Structures(NamedTuple):
    """Structures of a population, or one.

    Attributes
    ----------
    parameters : named tuple
        Arrays with a row for each particle or one for all, `rayleigh` and `ratios` among them.
    wanted : Outputs
    influence, motion : array (n, d), (s, d)
        Displacements under unit displacements of the supports, of all degrees of freedom and at the sensors.
    room : object
        What `solve` needs for eigenproblems.
    widths : Widths
    """

    parameters: object
    wanted: Outputs
    influence: np.ndarray
    motion: np.ndarray
    room: object
    widths: Widths


@jit
def row_of(array, p):
    """Row p of an array, or the only one."""
    return array[p % array.shape[0]]


@jit
def new_lanes(structures, excitation, with_gradients, samples):
    """Lanes for the structures; gradients take all modes, and their shapes."""
    wanted, n, m = structures.wanted, structures.influence.shape[0], structures.wanted.n_modes
    sizes = n, n if with_gradients else m, m, structures.motion.shape[0]
    request = excitation.dt / excitation.substeps, wanted.quantity
    kinds, motion = (with_gradients, False), structures.motion
    return new_modal_lanes(sizes, motion, kinds, samples, request, structures.widths)


@jit
def damp(lot, parameters, first, highest):
    """Write the classical damping of the structures in the lanes."""
    for lane in range(lot.is_there.size):
        if lot.is_there[lane]:
            p = first + lane
            rayleigh, ratios = row_of(parameters.rayleigh, p), row_of(parameters.ratios, p)
            put_damping(lot, lane, rayleigh, ratios, NO_DAMPING, highest)


@jit
def evaluate_structures(solve, structures, excitation, observed, result, history):
    """Write the statistics (p, s, 1 or 4) of misfits, NaN for no structure; or the response of one.

    Parameters
    ----------
    solve : function
    structures : Structures
    excitation : Excitation
        Inputs (d, t).
    observed : array (s, u)
        Data, or (0, 0) for a response.
    result : array (p, s, 1 or 4)
    history : array (s, u) or (0, 0)
    """
    n_times, count = max(observed.shape[1], history.shape[1]), result.shape[0]
    s, m, highest = structures.motion.shape[0], structures.wanted.n_modes, highest_step(excitation)
    walk = new_walk(excitation, observed, n_times, m, s, structures.widths)
    lot = new_lanes(structures, excitation, False, walk.samples)
    for first in range(0, count, lot.is_there.size):
        solve(structures, lot, (first, count), highest)
        evaluate(lot, walk, history, first, result, structures.widths)
    if not lot.is_there[0]:
        history[:] = np.nan


@jit
def systems_of(solve, structures, excitation, count):
    """`Systems` of structures, for the tables of `long_records`."""
    (s, d), m, highest = structures.motion.shape, structures.wanted.n_modes, highest_step(excitation)
    systems, step = new_systems(count, s, m, d), excitation.dt / excitation.substeps
    walk = new_walk(excitation, NO_DATA, 1, m, s, structures.widths)
    lot = new_lanes(structures, excitation, False, walk.samples)
    for first in range(0, count, lot.is_there.size):
        solve(structures, lot, (first, count), highest)
        for lane in range(min(lot.is_there.size, count - first)):
            if lot.is_there[lane]:
                system, feed = system_of(lot, lane)
                if not has_fast(system, step, highest):
                    put_modes(systems, first + lane, system, feed)
    return systems


class Changes(NamedTuple):
    """What theta changes of K and M; `in_drifts` tells whether terms of K are springs of a chain."""

    n_theta: int
    stiffness: Terms
    mass: Terms
    in_drifts: bool


class Derivatives(NamedTuple):
    """Room for derivatives of structures in lanes, and what theta changes."""

    reduced: Reduced
    spread: Spread
    changes: Changes


@jit
def new_derivatives(lot, changes, widths):
    """Room for derivatives."""
    spread = new_spread(lot, changes.n_theta, changes.in_drifts, widths)
    return Derivatives(new_reduced(lot, widths), spread, changes)


@jit
def add_gradients(structures, lot, found, place, gradients):
    """Add the derivatives of all lanes to gradients, arrays (p or 1, ...); NaN for no structure.

    The last two are those by rayleigh and ratios, those before by consecutive numbers of theta.
    """
    (reduced, spread, changes), (first, count) = found, place
    terms = changes.stiffness, changes.mass
    spread_to_theta(lot, reduced, *terms, structures.influence, spread, structures.widths)
    for lane in range(min(lot.is_there.size, count - first)):
        at, p, n_arrays = 0, first + lane, len(gradients)
        if not lot.is_there[lane]:
            for array in gradients:
                row_of(array, p)[:] = np.nan
            continue
        for i in range(n_arrays - 2):
            own = row_of(gradients[i], p)
            for k in range(own.size):
                own[k] += spread.by_theta[at + k, lane]
            at += own.size
        rayleigh, ratios = row_of(gradients[n_arrays - 2], p), row_of(gradients[n_arrays - 1], p)
        add_damping(lot, reduced, lane, rayleigh, ratios)


@jit
def pull_back_structures(solve, structures, changes, excitation, data, gradients):
    """Add the gradients of structures.

    Parameters
    ----------
    solve, structures, excitation
        As of `evaluate_structures`.
    changes : Changes
    data : tuple
        The history (s, u), of data or of derivatives by the response; weights (p, s, 1) of e_j; and whether
        the history is of derivatives.
    gradients : tuple of array (p or 1, ...)
        As of `add_gradients`; updated.
    """
    (history, weights, is_given), widths, m = data, structures.widths, structures.wanted.n_modes
    count, highest = weights.shape[0], highest_step(excitation)
    walk = new_gradient_walk(excitation, history, is_given, False, m, widths.wide, widths)
    lot = new_lanes(structures, excitation, True, walk.samples)
    found = new_derivatives(lot, changes, widths)
    for first in range(0, count, lot.is_there.size):
        solve(structures, lot, (first, count), highest)
        bring(lot, walk, weights, first)
        derive(lot, walk, found.reduced, widths)
        add_gradients(structures, lot, found, (first, count), gradients)


@jit
def pull_back_sums(solve, structures, changes, excitation, sums, gradients):
    """Add the gradients of structures of which the sums over time are known, see `reduction.derive_from`.

    Under one input; no two modes of a structure may be close.
    """
    count, highest, widths = sums[0].shape[0], highest_step(excitation), structures.widths
    s, m = structures.motion.shape[0], structures.wanted.n_modes
    walk = new_walk(excitation, NO_DATA, 1, m, s, widths)
    lot = new_lanes(structures, excitation, True, walk.samples)
    found = new_derivatives(lot, changes, widths)
    for first in range(0, count, lot.is_there.size):
        solve(structures, lot, (first, count), highest)
        derive_from(lot, sums, found.reduced, first, widths)
        add_gradients(structures, lot, found, (first, count), gradients)
