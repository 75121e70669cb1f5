"""Modes of structures in lanes, and what the march needs of them.

Of several inputs each moves the modes by itself, and the sensors see the sum. What stands before an input in
the response, f_j = J_j - sum_r S_jr Gamma_r after_r, is the feed-through J of Eq. (24) less what stands
before the input in the states, see `exact_step`.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.numbers.compiled_numbers import (
    lanes,
    new_dual,
    of_kind,
    the_output,
    where_less,
    with_parts,
)
from pymc_features.simulators.numbers.rows import view, zero
from pymc_features.simulators.oscillators.arguments import (
    ABSOLUTE_ACCELERATION,
    RELATIVE_ACCELERATION,
    RELATIVE_DISPLACEMENT,
    RELATIVE_VELOCITY,
)
from pymc_features.simulators.oscillators.exact_step import exact_step
from pymc_features.simulators.oscillators.modal_system import (
    N_ORDERS,
    ModalSystem,
    can_be_damped,
    is_fast,
    modal_damping,
    write_feed,
    write_following,
)
from pymc_features.simulators.oscillators.samples import even, filled, new_numbers

PARTS = 3  # of a number with derivatives
NO_DAMPING = np.empty(0)  # where a law has it


class ModalLanes(NamedTuple):
    """Modes of structures, arrays (rows, lanes).

    Attributes
    ----------
    squares : (all)
        lambda = omega^2; infinite of motions without mass, which come last.
    damping, slopes, ratios, moves : (m)
        D [1/s], dD/dlambda [s] along the law of damping, ratios of the modes, and one where a mode is stepped
        (zero where it follows its input, or fills up a row).
    participation : (all d)
        Gamma.
    shapes : (s all)
        S Phi.
    forced : (s d)
        S Phi Phi' forces.
    at : (n all)
        Phi, or empty.
    after, following : (3 m), (orders 3 m)
        What stands before the input in the states, and before the inputs' own values in the outputs, of modes
        that follow; each with its derivatives by s and d.
    is_there : bool (lanes,)
        Which lanes have a structure.
    motion : array (s, d)
        S iota.
    n_modes, n_all, n_sensors, n_inputs : int
        Modes marched, modes at hand, sensors, inputs.
    is_complete : bool
        Whether these are all modes of the structures.
    in_pairs : bool
        Whether modes are pairs of `eigen.complex_modes`.
    step : float
        Of the recursion [s].
    quantity : int
    """

    squares: np.ndarray
    damping: np.ndarray
    slopes: np.ndarray
    ratios: np.ndarray
    moves: np.ndarray
    participation: np.ndarray
    shapes: np.ndarray
    forced: np.ndarray
    at: np.ndarray
    after: np.ndarray
    following: np.ndarray
    is_there: np.ndarray
    motion: np.ndarray
    n_modes: int
    n_all: int
    n_sensors: int
    n_inputs: int
    is_complete: bool
    in_pairs: bool
    step: float
    quantity: int


@jit
def new_rows(count, like):
    """Zeros (count, lanes)."""
    return new_numbers(count * lanes(like)).reshape((count, lanes(like)))


@jit
def new_modal_lanes(sizes, motion, kinds, samples, request, widths):
    """Lanes without structures.

    `sizes` are degrees of freedom, modes at hand, modes kept and sensors; `motion` (s, d) is S iota, the
    request step and quantity, `kinds` whether Phi is wanted and whether modes are pairs.
    """
    with_shapes, in_pairs = kinds
    (n_dof, n_all, n_modes, n_sensors), like, d = sizes, widths.structure, samples.inputs
    (step, quantity), n = request, n_dof if with_shapes else 0
    m = filled(n_modes, widths)
    return ModalLanes(
        new_rows(max(n_all, m), like),
        new_rows(m, like),
        new_rows(m, like),
        new_rows(m, like),
        new_rows(m, like),
        new_rows(n_all * d, like),
        new_rows(even(n_sensors) * n_all, like),
        new_rows(n_sensors * d, like),
        new_rows(n * n_all, like),
        new_rows(PARTS * m, like),
        new_rows(samples.orders * PARTS * m, like),
        np.zeros(lanes(like), dtype=np.bool_),
        motion,
        n_modes,
        n_all,
        n_sensors,
        d,
        n_modes == n_dof or in_pairs,
        in_pairs,
        step,
        quantity,
    )


@jit
def clear(lot, lane):
    """Take the structure out of a lane."""
    zeros = lot.squares, lot.damping, lot.slopes, lot.ratios, lot.moves, lot.participation, lot.shapes
    for array in (*zeros, lot.forced, lot.at, lot.following):
        for i in range(array.shape[0]):
            array[i, lane] = 0.0
    lot.is_there[lane] = False


@jit
def put_following(lot, lane, r, follows):
    """Write what stands before the inputs' own values in the output of mode r, nothing if it is stepped."""
    m, h = lot.damping.shape[0], lot.step
    factors = np.zeros((3, N_ORDERS))
    if follows:
        write_following(np.sqrt(lot.squares[r, lane]), lot.damping[r, lane], 0.0, lot.quantity, factors)
        if lot.quantity == ABSOLUTE_ACCELERATION or lot.quantity == RELATIVE_ACCELERATION:
            factors[0, 0] += 1.0
    for k in range(lot.following.shape[0] // (PARTS * m)):
        lot.following[(k * PARTS) * m + r, lane] = factors[0, k]
        lot.following[(k * PARTS + 1) * m + r, lane] = factors[1, k] / (h * h)
        lot.following[(k * PARTS + 2) * m + r, lane] = factors[2, k] / h


@jit
def put_damping(lot, lane, rayleigh, ratios, given, highest):
    """Write the damping of a lane with frequencies; it has none where the structure has no response.

    `given` is D (m,), or empty if a law has it; `highest` omega h from where a mode follows its input.
    """
    squares, damping, slopes, moves, h = lot.squares, lot.damping, lot.slopes, lot.moves, lot.step
    possible = True
    for r in range(lot.n_modes):
        omega, ratio, slope = np.sqrt(squares[r, lane]), ratios[r], rayleigh[1]
        if omega > 0.0:  # nothing changes the lambda of a rigid body
            slope += ratio / omega
        own = given[r] if given.size else modal_damping(omega, rayleigh, ratio)
        damping[r, lane], slopes[r, lane], lot.ratios[r, lane] = own, slope, ratio
        possible &= can_be_damped(omega * h, own * h)
        follows = is_fast(omega * h, own * h, highest)
        if follows or moves[r, lane] == 0.0:
            put_following(lot, lane, r, follows)
        moves[r, lane] = 0.0 if follows else 1.0
    lot.is_there[lane] = possible
    if not possible:
        clear(lot, lane)


@jit
def put_system(lot, lane, system, law, forced, highest):
    """Write a `ModalSystem`, with the law of its damping if it has one, else with D; `forced` (s, d)."""
    d = lot.n_inputs
    for r in range(lot.n_modes):
        lot.squares[r, lane] = system.omega[r] * system.omega[r]
        for i in range(d):
            lot.participation[r * d + i, lane] = system.participation[r, i]
        for j in range(lot.n_sensors):
            lot.shapes[j * lot.n_all + r, lane] = system.shapes[j, r]
    for j in range(lot.n_sensors):
        for i in range(d):
            lot.forced[j * d + i, lane] = forced[j, i]
    put_damping(lot, lane, law.rayleigh, law.ratios, system.damping, highest)


@jit
def system_of(lot, lane):
    """The `ModalSystem` of a lane, and the feed-through of its inputs (s, d)."""
    m, s, d = lot.n_modes, lot.n_sensors, lot.n_inputs
    shapes, participation, forced = np.empty((s, m)), np.empty((m, d)), np.empty((s, d))
    for r in range(m):
        for i in range(d):
            participation[r, i] = lot.participation[r * d + i, lane]
        for j in range(s):
            shapes[j, r] = lot.shapes[j * lot.n_all + r, lane]
    system = ModalSystem(np.sqrt(lot.squares[:m, lane]), lot.damping[:m, lane].copy(), shapes, participation)
    write_feed(system, lot.motion, lot.quantity, lot.is_complete, lot.forced[:, lane], forced)
    return system, forced


@jit
def some_follow(lot):
    """Whether a mode of some lane follows its input."""
    for r in range(lot.n_modes):
        for lane in range(lot.is_there.size):
            if lot.is_there[lane] and lot.moves[r, lane] == 0.0:
                return True
    return False


@jit
def write_steps(modes, lot, samples, widths):
    """Write e, c and the states at rest of all modes, and what stands before the inputs in the states."""
    wide, rows, h = widths.wide, lot.damping.shape[0] // lanes(widths.sample), lot.step
    squares, damping, moves = view(lot.squares, wide), view(lot.damping, wide), view(lot.moves, wide)
    after, kind, nil = view(lot.after, wide), the_output(zero(modes.states)), 0.0 * wide
    for g in range(rows):
        own = moves[g]
        s = where_less(0.5, own, squares[g] * (h * h), nil)
        d = where_less(0.5, own, damping[g] * h, nil)
        s, d = of_kind(new_dual(s, nil + 1.0, nil), kind), of_kind(new_dual(d, nil, nil + 1.0), kind)
        quantity = lot.quantity
        if lot.in_pairs:
            quantity = RELATIVE_DISPLACEMENT if 2 * g < rows else RELATIVE_VELOCITY
        transition, drive, before = exact_step(s, d, quantity, h)
        modes.transition[g], modes.drive[g] = transition, drive * own
        for i in range(samples.inputs):
            modes.states[i * modes.rows + g] = before * (own * samples.steps[i * samples.step_length])
        x = with_parts(the_output(before) * own)
        after[g], after[rows + g], after[2 * rows + g] = x.v, x.s, x.d


@jit
def write_sensors(modes, lot, samples, widths):
    """Write S Phi Gamma, what stands before the inputs, and modes that follow."""
    like, m, d = widths.structure, lot.damping.shape[0], samples.inputs
    shapes, participation, forced = (
        view(lot.shapes, like),
        view(lot.participation, like),
        view(lot.forced, like),
    )
    after, following = view(lot.after, like), view(lot.following, like)
    kind, is_absolute = zero(modes.following), lot.quantity == ABSOLUTE_ACCELERATION
    is_acceleration = is_absolute or lot.quantity == RELATIVE_ACCELERATION
    for j in range(lot.n_sensors):
        for i in range(d):
            own, motion = j * d + i, lot.motion[j, i]
            total = by_modes = 0.0 * like
            for r in range(lot.n_modes):
                share = shapes[j * lot.n_all + r] * participation[r * d + i]
                modes.shapes[own * modes.modes + r] = share
                total, by_modes = total + share * after[r], by_modes + share
            if lot.is_complete:  # their sum is then known without its rounding error
                by_modes = motion - forced[own]
            feed = 0.0 * like
            if is_acceleration:  # J of Eq. (24); the absolute one keeps the ground's share of modes left out
                feed = (motion if is_absolute else 0.0) - by_modes
            modes.direct[own] = feed
            modes.feed[own] = 0.0 - total if samples.is_own else feed - total
    for k in range(samples.orders):
        row = PARTS * k * m
        for r in range(lot.n_modes):
            x = new_dual(following[row + r], following[row + m + r], following[row + 2 * m + r])
            modes.following[k * modes.modes + r] = of_kind(x, kind)


@jit
def write_oscillators(modes, lot, samples, widths):
    """Write all that the march needs of the structures; whether a mode follows its input."""
    write_steps(modes, lot, samples, widths)
    write_sensors(modes, lot, samples, widths)
    return some_follow(lot)
