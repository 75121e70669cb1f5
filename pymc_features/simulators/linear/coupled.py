"""Dense structures whose damping is a matrix, by complex modes in lanes: misfits and gradients.

Their classical modes are those of `dense_structures`; what follows from the complex ones is brought back to
these, and from there to theta as with classical damping.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.algebra import ZERO_STIFFNESS
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.eigen.complex_modes import Pairs, find_pairs, new_pairs
from pymc_features.simulators.eigen.matrices import (
    assemble_lanes,
    factorise_lanes,
    multiply_lanes,
)
from pymc_features.simulators.eigen.pair_gradients import (
    complete_sums,
    derive_matrices,
    new_pair_room,
    poles_apart,
)
from pymc_features.simulators.linear.dense_structures import (
    changes_of,
    n_structures,
    solve_classical,
    structures_together,
)
from pymc_features.simulators.numbers.compiled_numbers import (
    in_lanes,
    larger,
    magnitude,
    new_dual,
    square_root,
    where_less,
)
from pymc_features.simulators.numbers.rows import view
from pymc_features.simulators.numbers.vectors import new_vectors
from pymc_features.simulators.oscillators.evaluation import new_derivatives, new_lanes
from pymc_features.simulators.oscillators.march import evaluate, new_walk
from pymc_features.simulators.oscillators.modal_lanes import ModalLanes, clear, new_modal_lanes, new_rows
from pymc_features.simulators.oscillators.modal_system import highest_coupled_step
from pymc_features.simulators.oscillators.reduction import bring
from pymc_features.simulators.oscillators.samples import of_population
from pymc_features.simulators.oscillators.spread import add_terms, spread_to_theta, terms_of
from pymc_features.simulators.oscillators.sums import new_gradient_walk, sum_history

# Residues above that many times the classical ones: two modes, or both of a pair, coalesce. Derivatives lose
# digits by the third power of it.
CANCELLING, CANCELLING_SLOPES = 1e5, 100.0


class CoupledLanes(NamedTuple):
    """Structures with coupled damping in lanes.

    Attributes
    ----------
    classical, lot : ModalLanes
        Of the classical modes, and of the pairs of complex modes, each twice.
    memory, pairs : array, Pairs
        The memory of the pairs, and these.
    damping, half, modal : array (n n, LANES), (m n, LANES), (m m, LANES)
        C, Phi'C and D = Phi'C Phi.
    highest : float
        omega and D from where a mode is too fast to be stepped [1/s].
    """

    classical: ModalLanes
    lot: ModalLanes
    memory: np.ndarray
    pairs: Pairs
    damping: np.ndarray
    half: np.ndarray
    modal: np.ndarray
    highest: float


@jit
def new_coupled(structures, excitation, with_gradients, samples):
    """Lanes for structures."""
    classical, wanted = new_lanes(structures, excitation, with_gradients, samples), structures.wanted
    (s, n), m, step = wanted.sensors.shape, wanted.n_modes, excitation.dt / excitation.substeps
    sizes, request = (2 * m, 2 * m, 2 * m, s), (step, wanted.quantity)
    lot = new_modal_lanes(sizes, classical.motion, (False, True), samples, request, structures.widths)
    modal, damping, half = new_vectors(m * m), new_vectors(n * n), new_vectors(m * n)
    memory, pairs = new_pairs(classical, modal, with_gradients)
    highest = highest_coupled_step(excitation) / step
    return CoupledLanes(classical, lot, memory, pairs, damping, half, modal, highest)


@jit
def solve_coupled(lanes, structures, place, cancelling):
    """Find the complex modes of structures `first` ... of `count`; returns one in lanes that came out right.

    `cancelling` is that of `find_pairs`.
    """
    classical, at, lot, like = lanes.classical, lanes.pairs, lanes.lot, structures.widths.structure
    solve_classical(structures, classical, place)
    n, present, squares = structures.influence.shape[0], new_vectors(1), view(classical.squares, like)
    for lane in range(lot.is_there.size):
        present[0, lane] = 1.0 if classical.is_there[lane] else 0.0
    for r in range(at.m):
        at.omega[r] = square_root(squares[r])
    solved, own, _ = structures.room
    assemble_lanes(structures.parameters.damping, own.theta, n, True, lanes.damping)
    project(lanes, solved.rows, n)
    good = check_damping(lanes, own.mass, view(present, like)[0])
    write_forced(lanes)
    return find_pairs(lot, at, good, cancelling)


@jit
def keep_lanes(lanes, good):
    """Write which lanes have pairs, those where `good` is positive, and empty the others."""
    lot, present = lanes.lot, new_vectors(1)
    view(present, good)[0] = good
    for lane in range(lot.is_there.size):
        lot.is_there[lane] = present[0, lane] > 0.0
        if not lot.is_there[lane]:
            clear(lot, lane)
        for r in range(lot.n_modes if lot.is_there[lane] else 0):
            lot.moves[r, lane] = lot.participation[r, lane] = 1.0


@jit
def project(lanes, rows, n):
    """Write D = Phi'C Phi, the rows those of Phi'."""
    m = lanes.pairs.m
    multiply_lanes((rows, n, 1), (lanes.damping, n, 1), (m, n, n), lanes.half)
    multiply_lanes((lanes.half, n, 1), (rows, 1, n), (m, n, m), lanes.modal)


@jit
def check_damping(lanes, mass, good):
    """Take the lanes out of the good ones where D has a negative eigenvalue, or a mode is too fast.

    M is given by its lower half, (n n, LANES).
    """
    at, nil, room = lanes.pairs, in_lanes(0.0), new_vectors(lanes.modal.shape[0])
    inertia = drag = stiffest = nil
    n, m, shifted = int(np.sqrt(mass.shape[0])), at.m, view(room, nil)
    for i in range(n):
        inertia = inertia + view(mass, nil)[i * n + i]
        drag = drag + view(lanes.damping, nil)[i * n + i]
    ratio = magnitude(drag) / inertia
    shift = ZERO_STIFFNESS * where_less(0.0, ratio, ratio, 1.0)
    for r in range(m):
        stiffest = larger(stiffest, larger(at.omega[r], at.damping[r * m + r]))
        for s in range(r + 1):
            shifted[r * m + s] = at.damping[r * m + s] + (shift if r == s else nil)
    factorise_lanes(room, m, False)
    good = where_less(0.0, shifted[m * m - 1], good, 0.0)
    return where_less(stiffest, lanes.highest, good, 0.0)


@jit
def write_forced(lanes):
    """Write S iota less S Phi Gamma at the sensors; with all modes it is known without its rounding error."""
    classical, at, like = lanes.classical, lanes.pairs, in_lanes(0.0)
    forced, by_forces = view(lanes.lot.forced, like), view(classical.forced, like)
    for j in range(at.s):
        total = classical.motion[j, 0] + like
        for r in range(at.m):
            total = total - at.shapes[j * at.m + r] * at.participation[r]
        forced[j] = by_forces[j] if classical.is_complete else total


@jit
def march_coupled(parameters, excitation, wanted, observed, n_statistics):
    """Misfits of the particles whose complex modes come out right, NaN of the others, and which those are.

    Parameters
    ----------
    parameters : LinearParameters
        theta (p or 1, k); dense matrices, C symmetric.
    excitation : Excitation
        With one input (1, t).
    wanted : Outputs
    observed : array (s, u)
        Data.
    n_statistics : int
        One for e_j, or four.

    Returns
    -------
    array (p, s, n_statistics)
    bool array (p,)
        Whether they are written. The others may be invalid, or have modes that coalesce.
    """
    count, (s, n_times), widths = n_structures(parameters), observed.shape, of_population()
    result, history = np.empty((count, s, n_statistics)), np.empty((0, 0))
    is_written, structures = np.zeros(count, dtype=np.bool_), structures_together(parameters, wanted)
    walk = new_walk(excitation, observed, n_times, 2 * wanted.n_modes, s, widths)
    lanes = new_coupled(structures, excitation, False, walk.samples)
    for first in range(0, count, lanes.lot.is_there.size):
        keep_lanes(lanes, solve_coupled(lanes, structures, (first, count), CANCELLING))
        evaluate(lanes.lot, walk, history, first, result, widths)
        for lane in range(min(lanes.lot.is_there.size, count - first)):
            is_written[first + lane] = lanes.lot.is_there[lane]
    return result, is_written


@jit
def add_coupled_gradients(parameters, excitation, wanted, observed, weights, gradient):
    """Add the gradients by theta of the weighted e_j, of the particles whose complex modes come out right.

    Parameters as in `march_coupled`, of all modes, and these:

    weights : array (p, s, 1)
    gradient : array (p or 1, k)
        Updated.

    Returns
    -------
    bool array (p,)
        Which particles are done. The others may be invalid, or have poles that are close.
    """
    n, count, widths = wanted.n_modes, weights.shape[0], of_population()
    is_done, like = np.zeros(count, dtype=np.bool_), widths.wide
    walk = new_gradient_walk(excitation, observed, False, True, 2 * n, new_dual(like, like, like), widths)
    structures = structures_together(parameters, wanted)
    lanes = new_coupled(structures, excitation, True, walk.samples)
    classical, lot, at = lanes.classical, lanes.lot, lanes.pairs
    reduced, spread, changes = new_derivatives(classical, changes_of(parameters), widths)
    terms, by_damping, matrices = terms_of(parameters.damping, n), new_rows(n * n + 4, like), new_pair_room(n)
    duration = observed.shape[1] * excitation.stride * lot.step
    for first in range(0, count, lot.is_there.size):
        good = solve_coupled(lanes, structures, (first, count), CANCELLING_SLOPES)
        keep_lanes(lanes, good * poles_apart(at, duration))
        bring(lot, walk, weights, first)
        sum_history(lot, walk, widths)
        complete_sums(at, lot, walk.found)
        derive_matrices(at, wanted.quantity, reduced, by_damping, matrices)
        own = parameters.influence
        spread_to_theta(classical, reduced, changes.stiffness, changes.mass, own, spread, widths)
        by_modes, rows = view(by_damping, like), view(classical.at, like)
        add_terms(terms, by_modes, rows, classical, spread, own, False, widths)
        for lane in range(lot.is_there.size):
            if lot.is_there[lane]:
                is_done[first + lane] = True
                gradient[(first + lane) % gradient.shape[0]] += spread.by_theta[:, lane]
    return is_done
