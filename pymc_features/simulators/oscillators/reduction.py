"""From sums over time to derivatives by the reduced matrices Phi' K Phi and Phi' M Phi, the load and D.

With the participation Gamma, F = dL/dS outside of the modes' span, g = dL/d(Phi' load) and
G = dL/dlambda per unit participation, summed over the inputs, the derivatives for r and s apart are

    c_rs = [(S'F)_sr + Gamma_s g_r - (S'F)_rs - Gamma_r g_s] / (lambda_r - lambda_s),
    K: c_rs / 2,   M: -[(lambda_r + lambda_s) c_rs + (S'F)_rs + (S'F)_sr + Gamma_s g_r + Gamma_r g_s] / 4,

the divided differences of the outputs (Daleckii & Krein; Higham, Functions of Matrices, SIAM 2008, theorem
3.11). They are finite where two frequencies meet, as derivatives of eigenvectors are not: of modes that are
close c_rs is its limit, the mean of both derivatives. Modes left out have no F and no g of their own.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.numbers.compiled_numbers import (
    highest,
    larger,
    magnitude,
    square_root,
    where_less,
)
from pymc_features.simulators.numbers.rows import view
from pymc_features.simulators.oscillators.arguments import ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION
from pymc_features.simulators.oscillators.modal_lanes import new_rows
from pymc_features.simulators.oscillators.sums import sum_history

# Two modes are close if their phase difference over the decay time is below this [rad]. The mean of the two
# derivatives is then right to about the square of it over 12, the quotient to the rounding error of f divided
# by it.
CLOSE = 3e-4
MASSLESS = 1e300  # lambda above belong to motions without mass, phi' K phi = 1


class Reduced(NamedTuple):
    """Derivatives, arrays (rows, lanes).

    Attributes
    ----------
    by_lambda, by_damping : (m)
        By lambda, along the law of damping, and D.
    by_load : (m d)
        g.
    by_shapes : (s m)
        F.
    changes, slopes : (m d), (s m d)
        Derivatives by lambda per unit participation; and of each sensor by itself, of close modes only.
    stiffness, mass : (all all)
        By Phi' K Phi and Phi' M Phi, symmetric.
    """

    by_lambda: np.ndarray
    by_damping: np.ndarray
    by_load: np.ndarray
    by_shapes: np.ndarray
    changes: np.ndarray
    slopes: np.ndarray
    stiffness: np.ndarray
    mass: np.ndarray


@jit
def new_reduced(lot, widths):
    """Room for derivatives of structures in lanes."""
    m, n, s, d, like = lot.n_modes, lot.n_all, lot.n_sensors, lot.n_inputs, widths.structure
    return Reduced(
        new_rows(m, like),
        new_rows(m, like),
        new_rows(m * d, like),
        new_rows(s * m, like),
        new_rows(m * d, like),
        new_rows(s * m * d, like),
        new_rows(n * n + 4, like),
        new_rows(n * n + 4, like),
    )


@jit
def by_lambda_of(lot, sums, i, r, ground, widths):
    """Derivatives by lambda, along the law of damping, and by D, of a mode under input i."""
    m, h, after = lot.damping.shape[0], lot.step, view(lot.after, widths.structure)
    own, slope = sums.own[i * sums.modes + r], view(lot.slopes, widths.structure)[r]
    by_s, by_d = own.s - ground * after[m + r], own.d - ground * after[2 * m + r]
    return (h * h) * by_s + (h * slope) * by_d, h * by_d


@jit
def derive_modes(lot, sums, is_own, reduced, widths):
    """Write the derivatives by lambda, D, load and shapes of each mode that is marched, from gathered sums.

    `is_own` tells whether inputs have values of their own.
    """
    like, d, m = widths.structure, lot.n_inputs, sums.modes
    after, participation = view(lot.after, like), view(lot.participation, like)
    by_lambda, by_damping = view(reduced.by_lambda, like), view(reduced.by_damping, like)
    by_load, by_shapes = view(reduced.by_load, like), view(reduced.by_shapes, like)
    changes, nil = view(reduced.changes, like), 0.0 * like
    is_acceleration = lot.quantity == ABSOLUTE_ACCELERATION or lot.quantity == RELATIVE_ACCELERATION
    constant = 1.0 if is_acceleration else 0.0  # q" is the output less the input's own value
    for r in range(lot.n_modes):
        by_lambda[r] = by_damping[r] = nil
        for j in range(lot.n_sensors):
            by_shapes[j * lot.n_modes + r] = nil
        for i in range(d):
            gamma, ground, load = participation[r * d + i], nil, nil
            for j in range(lot.n_sensors):
                at, seen, row = j * d + i, sums.seen[j * m + r], j * lot.n_modes + r
                marched = sums.ground[at]
                output = sums.products[at * m + r] - after[r] * marched
                output = output - constant * (sums.direct[at] if is_own else marched)
                ground, load = ground + seen * marched, load + seen * output
                by_shapes[row] = by_shapes[row] + gamma * output
            change, drag = by_lambda_of(lot, sums, i, r, ground, widths)
            changes[r * d + i], by_load[r * d + i] = change, load
            by_lambda[r], by_damping[r] = by_lambda[r] + gamma * change, by_damping[r] + gamma * drag


@jit
def nearness(lot, r, s, duration, widths):
    """Phase difference [rad] of modes r and s < r over the time for which they swing.

    Modes with ratios of their own that differ are never close: where they cross, the response jumps from one
    to the other. `duration` is that of the record [s].
    """
    like = widths.structure
    squares, damping, ratios = view(lot.squares, like), view(lot.damping, like), view(lot.ratios, like)
    omega, other, nil = square_root(squares[r]), square_root(squares[s]), 0.0 * like
    gap, decay, long = magnitude(omega - other), 0.5 * damping[r], nil + duration
    memory = where_less(1.0, duration * decay, 1.0 / decay, long)
    # at least a fraction of a period: what is slower or overdamped depends on the frequency itself
    difference = gap * larger(memory, 3.0 / omega)
    # of modes that hardly swing it is lambda that counts, not omega
    growth = gap * (omega + other) * duration * larger(long, view(lot.slopes, like)[r])
    growth = where_less(0.0, ratios[r], difference, growth)
    difference = where_less(growth, difference, growth, difference)
    difference = where_less(0.0, magnitude(ratios[r] - ratios[s]), 1.0, difference)
    return where_less(0.0, gap, difference, nil)


@jit
def some_are_close(lot, duration, widths):
    """Whether two modes of a structure are close."""
    like, found = widths.structure, 0.0
    present = new_rows(1, like)
    for lane in range(lot.is_there.size):
        present[0, lane] = 1.0 if lot.is_there[lane] else 0.0
    is_there = view(present, like)[0]
    for r in range(lot.n_modes):
        for s in range(r):
            found = max(
                found, highest(where_less(nearness(lot, r, s, duration, widths), CLOSE, is_there, 0.0))
            )
    return found > 0.0


@jit
def see_alone(lot, sums, j, widths):
    """Let the sums be those of what sensor j sees by itself."""
    for i in range(lot.n_sensors):
        for r in range(lot.n_modes):
            sums.seen[i * sums.modes + r] = 0.0 * widths.structure + (1.0 if i == j else 0.0)


@jit
def write_slopes(lot, sums, reduced, j, widths):
    """Write the derivatives by lambda of what sensor j sees by itself, from its sums."""
    slopes, d = view(reduced.slopes, widths.structure), lot.n_inputs
    for r in range(lot.n_modes):
        for i in range(d):
            change, _ = by_lambda_of(lot, sums, i, r, sums.ground[j * d + i], widths)
            slopes[(j * lot.n_modes + r) * d + i] = change


@jit
def coupled(lot, reduced, r, s, widths):
    """(S'F)_sr + Gamma_s g_r, and the limit of a close pair, summed over sensors and inputs."""
    like, d, m, n = widths.structure, lot.n_inputs, lot.n_modes, lot.n_all
    shapes, participation = view(lot.shapes, like), view(lot.participation, like)
    by_shapes, by_load = view(reduced.by_shapes, like), view(reduced.by_load, like)
    of_shapes = of_load = 0.0 * like
    for j in range(lot.n_sensors):
        of_shapes = of_shapes + shapes[j * n + s] * by_shapes[j * m + r]
    for i in range(d):
        of_load = of_load + participation[s * d + i] * by_load[r * d + i]
    return of_shapes, of_load


@jit
def limit_of(lot, reduced, r, s, widths):
    """Derivative by lambda of what modes r and s put out in each other's place, one of two terms."""
    like, d, m = widths.structure, lot.n_inputs, lot.n_modes
    shapes, participation = view(lot.shapes, like), view(lot.participation, like)
    slopes, changes, total = view(reduced.slopes, like), view(reduced.changes, like), 0.0 * like
    for i in range(d):
        total = total + participation[s * d + i] * changes[r * d + i]
        for j in range(lot.n_sensors):
            share = shapes[j * lot.n_all + r] * participation[s * d + i]
            total = total + share * slopes[(j * m + s) * d + i]
    return total


@jit
def derive_pairs(lot, reduced, duration, has_close, widths):
    """Write the derivatives by the reduced matrices, of all pairs of modes, from those of each mode."""
    like, n, m = widths.structure, lot.n_all, lot.n_modes
    squares, by_lambda = view(lot.squares, like), view(reduced.by_lambda, like)
    stiffness, mass = view(reduced.stiffness, like), view(reduced.mass, like)
    for r in range(n):
        for s in range(min(r + 1, m)):
            here, there = squares[r], squares[s]
            sf, sg = coupled(lot, reduced, s, r, widths)
            if r >= m:  # a mode left out, or without mass
                apart = where_less(here, MASSLESS, there - here, -1.0)
                quotient = (sf + sg) / apart
                by_stiffness, by_mass = 0.5 * quotient, -0.5 * (there * quotient)
            elif r == s:
                by_stiffness, by_mass = by_lambda[r], 0.0 - (here * by_lambda[r] + sg)
            else:
                rf, rg = coupled(lot, reduced, r, s, widths)
                difference = ((sf - rg) - (rf - sg)) / (there - here)
                if has_close:
                    mean = 0.5 * (limit_of(lot, reduced, r, s, widths) + limit_of(lot, reduced, s, r, widths))
                    difference = where_less(nearness(lot, r, s, duration, widths), CLOSE, mean, difference)
                both = 0.5 * ((sf + rf) + (sg + rg))
                by_stiffness = 0.5 * difference
                by_mass = -0.5 * (0.5 * (here + there) * difference + both)
            stiffness[r * n + s] = stiffness[s * n + r] = by_stiffness
            mass[r * n + s] = mass[s * n + r] = by_mass


@jit
def derive(lot, walk, reduced, widths):
    """March the structures in the lanes, and write all derivatives.

    Where modes are close they are marched once more for each sensor, with what it sees by itself.
    """
    samples = walk.samples
    duration = samples.n_times * samples.stride * lot.step
    has_close = some_are_close(lot, duration, widths)
    for j in range(-1, lot.n_sensors if has_close else 0):  # one call, for all the march is compiled into it
        if j >= 0:
            see_alone(lot, walk.found, j, widths)
        sum_history(lot, walk, widths)
        if j >= 0:
            write_slopes(lot, walk.found, reduced, j, widths)
        else:
            derive_modes(lot, walk.found, samples.is_own, reduced, widths)
    derive_pairs(lot, reduced, duration, has_close, widths)


@jit
def bring(lot, walk, weights, first):
    """Write S Phi, and -2 w / N of weights (p, s, ..), of particles `first` ... in the lanes."""
    arrays, lots, m = walk.sum_arrays, lot.is_there.size, walk.found.modes
    for lane in range(lots):
        own = weights[min(first + lane, weights.shape[0] - 1)]
        for j in range(lot.n_sensors):
            arrays.factors[j * lots + lane] = -2.0 * own[j, 0] / walk.samples.n_times
            for r in range(lot.n_modes):
                arrays.seen[(j * m + r) * lots + lane] = lot.shapes[j * lot.n_all + r, lane]


@jit
def derive_from(lot, sums, reduced, first, widths):
    """Write all derivatives of particles `first` ... from sums over time, without close modes.

    `sums` are those of dL/dy_j times modal outputs (p, s, m), relative to the ground in accelerations, and
    dL/dlambda at the same D and shapes and dL/dD, both (p, m).
    """
    outputs, by_lambda, by_damping = sums
    for lane in range(min(lot.is_there.size, outputs.shape[0] - first)):
        p = first + lane
        for r in range(lot.n_modes):
            change, load = by_damping[p, r], 0.0
            reduced.by_damping[r, lane] = change
            reduced.by_lambda[r, lane] = by_lambda[p, r] + lot.slopes[r, lane] * change
            for j in range(lot.n_sensors):
                load += lot.shapes[j * lot.n_all + r, lane] * outputs[p, j, r]
                own = lot.participation[r, lane] * outputs[p, j, r]
                reduced.by_shapes[j * lot.n_modes + r, lane] = own
            reduced.by_load[r, lane] = load
    derive_pairs(lot, reduced, 0.0, False, widths)
