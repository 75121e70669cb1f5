"""One structure as a `ModalSystem`: response and misfit, their gradient, their change along a direction.

Between these and the parameters of a structure stand its reduced matrices, see `linear.projection`.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.numbers.compiled_numbers import dot, new_four
from pymc_features.simulators.numbers.rows import view
from pymc_features.simulators.oscillators.arguments import ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION
from pymc_features.simulators.oscillators.evaluation import evaluate, new_walk
from pymc_features.simulators.oscillators.fast_modes import highest_step
from pymc_features.simulators.oscillators.march import compare, four_outputs, march_block
from pymc_features.simulators.oscillators.modal_lanes import new_modal_lanes, put_system, write_oscillators
from pymc_features.simulators.oscillators.modal_system import DampingLaw
from pymc_features.simulators.oscillators.reduction import bring, close_modes, derive, new_reduced
from pymc_features.simulators.oscillators.samples import (
    BLOCK,
    data_of,
    four,
    new_numbers,
    of_one,
    put_four,
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


class ModalChange(NamedTuple):
    """Changes of a structure along a direction: as `ModalGradient`, of what stands there."""

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


@jit
def combine_change(system, change, close, combination):
    """Write the factors (3, s, d, m) of f, df/dlambda and df/dD in the change of the response.

    The factors of a pair of modes are opposite to the last bit: f_r and f_s cancel where they are nearly
    equal. `close` (m, m) is from `close_modes`.
    """
    omega, shapes, participation = system.omega, system.shapes, system.participation
    by_f, by_lambda, by_damping = combination
    for i in range(participation.shape[1]):
        for j in range(shapes.shape[0]):
            for r in range(omega.size):
                shape, gamma, scale = shapes[j, r], participation[r, i], change.mass[r, r]
                own = change.stiffness[r, r] - omega[r] * omega[r] * scale
                by_f[j, i, r] += gamma * change.shapes[j, r] + shape * (change.load[r, i] - gamma * scale)
                by_lambda[j, i, r] += shape * gamma * own
                by_damping[j, i, r] = shape * gamma * change.damping[r]
                for s in range(r):
                    both = gamma * shapes[j, s] + participation[s, i] * shape
                    mean = 0.5 * (omega[r] * omega[r] + omega[s] * omega[s])
                    pair = both * (change.stiffness[r, s] - mean * change.mass[r, s])
                    scaled = 0.5 * both * change.mass[r, s]
                    if close[r, s]:
                        by_lambda[j, i, r] += 0.5 * pair
                        by_lambda[j, i, s] += 0.5 * pair
                        pair = 0.0
                    else:
                        pair /= (omega[r] - omega[s]) * (omega[r] + omega[s])
                    by_f[j, i, r] += pair - scaled
                    by_f[j, i, s] -= pair + scaled


@jit
def turn_to_steps(lot, combination):
    """Turn the factors into those of outputs with derivatives by s and d; what they give before inputs."""
    (_, n_sensors, d, m), h, all_rows = combination.shape, lot.step, lot.damping.shape[0]
    is_acceleration = lot.quantity == ABSOLUTE_ACCELERATION or lot.quantity == RELATIVE_ACCELERATION
    before = np.zeros((2, n_sensors, d))
    for j in range(n_sensors):
        for i in range(d):
            for r in range(m):
                value, by_lambda, by_damping = combination[:, j, i, r]
                by_s = by_lambda * (h * h)
                by_d = h * (by_damping + lot.slopes[r, 0] * by_lambda)
                combination[1, j, i, r], combination[2, j, i, r] = by_s, by_d
                share = value * lot.after[r, 0] + by_s * lot.after[all_rows + r, 0]
                before[0, j, i] += share + by_d * lot.after[2 * all_rows + r, 0]
                before[1, j, i] += value if is_acceleration else 0.0
    return before


@jit
def write_change(modes, samples, block, factors, m, before, change, wide):
    """Write the change of the response in a block, (s, BLOCK) rows."""
    value, by_s, by_d = factors
    d = samples.inputs
    for j in range(before.shape[1]):
        for k in range(0, BLOCK, 4):
            total = new_four(wide, wide, wide, wide)
            for i in range(d):
                at = block * BLOCK + k
                total = total - before[0, j, i] * four(samples.ground, i * samples.ground_length + at)
                total = total - before[1, j, i] * four(samples.own, i * samples.length + at)
                for r in range(m):
                    row = (j * d + i) * m + r
                    y = dot(four_outputs(modes, i * modes.modes + r, k), value[row], by_s[row], by_d[row])
                    total = total + y
            put_four(change, j * BLOCK + k, total)


@jit
def march_change(system, law, direct, excitation, quantity, change, observed, history):
    """Write the change of the response along a direction into the history, or return that of its misfit.

    Parameters
    ----------
    change : ModalChange
    observed : array (s, u)
        Data; not read if there is a `history`.
    history : array (s, u) or (0, 0)

    Returns
    -------
    array (s,)
        Change of sum_k r_k^2; zero if there is a `history`.
    """
    (s, m), d, widths = system.shapes.shape, system.participation.shape[1], of_one()
    data = observed if history.shape[0] == 0 else np.zeros(history.shape)
    walk = new_gradient_walk(excitation, data, False, False, m, widths.wide, widths)
    modes, samples, sums = walk.modes, walk.samples, np.zeros(s)
    lot = new_lane(system, law, direct, samples, excitation, quantity, widths)
    follows, combination = write_oscillators(modes, lot, samples, widths), np.zeros((3, s, d, m))
    duration = samples.n_times * samples.stride * lot.step
    combine_change(system, change, close_modes(lot, duration, widths), combination)
    before, flat = turn_to_steps(lot, combination), combination.reshape((3, s * d * m))
    factors = view(flat[0], 0.0), view(flat[1], 0.0), view(flat[2], 0.0)
    numbers = new_numbers(s * samples.size)
    rows, misfits = view(numbers, widths.wide), walk.arrays.misfits
    for block in range(samples.n_blocks):
        here, first = data_of(walk.sample_arrays, samples, data, block), block * samples.size
        for i in range(d):
            march_block(modes, samples, block, i, 0, modes.modes, i * modes.modes, follows)
            compare(modes, samples, here, block, i, 0, modes.modes, i * modes.modes)
        write_change(modes, samples, block, factors, m, before, rows, 0.0 * widths.wide)
        for j in range(s):
            for k in range(min(samples.size, samples.n_times - first)):
                number = numbers[j * samples.size + k]
                if history.shape[0] > 0:
                    history[j, first + k] = number
                else:
                    sums[j] -= 2.0 * misfits[j * samples.size + k] * number
    return sums
