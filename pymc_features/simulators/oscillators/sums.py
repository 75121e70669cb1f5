"""Sums over time that gradients take from the march, of numbers with derivatives.

With u_jk = dL/dy_j[k] and f_r the output of mode r per unit participation, all that is taken from the history
of L are

    products     P_jr = sum_k u_jk y_r[k],
    own          Q_r = sum_k (sum_j S_jr u_jk) y_r[k], with its derivatives by s and d,
    ground, direct  sum_k u_jk a[k], of the input as it is marched and of its own values.

No history is kept, and no cost grows with the number of parameters.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.numbers.compiled_numbers import (
    lanes,
    new_dual,
    new_quadratic,
    of_kind,
    registers,
    the_narrowed,
    the_output,
    the_sum,
)
from pymc_features.simulators.numbers.rows import view, zero
from pymc_features.simulators.oscillators.march import compare, four_outputs, march_block, new_oscillators
from pymc_features.simulators.oscillators.modal_lanes import write_oscillators
from pymc_features.simulators.oscillators.samples import (
    BLOCK,
    data_of,
    even,
    four,
    four_data,
    gathered,
    new_numbers,
    new_samples,
    put_four,
)


class SumArrays(NamedTuple):
    """Arrays behind `Sums`; the caller keeps them."""

    factors: np.ndarray
    seen: np.ndarray
    products: np.ndarray
    own: np.ndarray
    ground: np.ndarray
    direct: np.ndarray


class Sums(NamedTuple):
    """Sums over time, as `Rows`, while they are taken or after they are gathered.

    Attributes
    ----------
    factors, seen : structure's numbers (s), (s, modes)
        -2 w_j / N and S Phi.
    products : (s, d, modes)
    own : (d, modes)
    ground, direct : (s, d)
    modes : int
    """

    factors: object
    seen: object
    products: object
    own: object
    ground: object
    direct: object
    modes: int


class GradientWalk(NamedTuple):
    """Structures in lanes on their way through a record, and the sums of their gradients.

    `observed` are data (s, u) or, if `is_given`, u itself; of pairs the products have derivatives. The sums
    are there twice, as they are taken and as they are gathered.
    """

    modes: object
    arrays: object
    samples: object
    sample_arrays: object
    sum_arrays: SumArrays
    taken: Sums
    found: Sums
    observed: np.ndarray
    is_given: bool
    in_pairs: bool


@jit
def new_gradient_walk(excitation, observed, is_given, in_pairs, n_modes, product, widths):
    """Room for gradients of structures with so many modes, under inputs (d, t).

    The products are like the number given: with derivatives, of pairs, or without.
    """
    observed = np.ascontiguousarray(observed)  # reached by address
    (n_sensors, n_times), wide, one = observed.shape, lanes(widths.wide), lanes(widths.structure)
    dual = new_dual(widths.wide, widths.wide, widths.wide)
    state = new_quadratic(dual, dual, dual)
    sample_arrays, samples = new_samples(excitation, observed, n_times, n_sensors, widths)
    d, together = samples.inputs, even(n_modes) * samples.inputs
    arrays, modes = new_oscillators(n_modes, n_sensors, together, state, samples, widths)
    m, s, output = modes.modes, modes.sensors, the_output(state)
    sums = SumArrays(
        new_numbers(s * one),
        new_numbers(s * m * one),
        new_numbers(s * d * m * wide * registers(product)),
        new_numbers(d * m * wide * registers(output)),
        new_numbers(s * d * wide),
        new_numbers(s * d * wide),
    )
    like, across = widths.structure, widths.wide
    shared = view(sums.factors, like), view(sums.seen, like)
    places = view(sums.products, product), view(sums.own, output)
    taken = Sums(*shared, *places, view(sums.ground, across), view(sums.direct, across), m)
    places = view(sums.products, the_narrowed(product, like)), view(sums.own, the_narrowed(output, like))
    found = Sums(*shared, *places, view(sums.ground, like), view(sums.direct, like), m)
    return GradientWalk(
        modes, arrays, samples, sample_arrays, sums, taken, found, observed, is_given, in_pairs
    )


@jit
def weigh(modes, sums, samples, data, block, is_given):
    """Turn the misfits of a block into u, unless u stands for the data, and add u times the inputs."""
    d = samples.inputs
    for j in range(modes.sensors):
        factor = sums.factors[j]
        for k in range(0, BLOCK, 4):
            if is_given:
                u = four_data(data, j, k) + zero(modes.misfits)
            else:
                u = factor * four(modes.misfits, j * BLOCK + k)
            put_four(modes.misfits, j * BLOCK + k, u)
        for i in range(d):
            ground, at = sums.ground[j * d + i], i * samples.ground_length + block * BLOCK
            for k in range(0, BLOCK, 4):
                ground = ground + the_sum(four(modes.misfits, j * BLOCK + k) * four(samples.ground, at + k))
            sums.ground[j * d + i] = ground
            if samples.is_own:
                direct, at = sums.direct[j * d + i], i * samples.length + block * BLOCK
                for k in range(0, BLOCK, 4):
                    u = four(modes.misfits, j * BLOCK + k)
                    direct = direct + the_sum(u * four(samples.own, at + k))
                sums.direct[j * d + i] = direct


@jit
def add_sums(modes, sums, samples, i, r, in_pairs):
    """Add what a block gives to P and, unless modes are pairs, Q of a mode under input i."""
    q, m = i * modes.modes + r, modes.modes
    own, kind = sums.own[q], zero(sums.products)
    for k in range(0, BLOCK, 4):
        y = four_outputs(modes, q, k)
        product, back = of_kind(y, kind), sums.seen[r] * four(modes.misfits, k)
        for j in range(modes.sensors):
            row, u = (j * samples.inputs + i) * m + r, four(modes.misfits, j * BLOCK + k)
            sums.products[row] = sums.products[row] + the_sum(product * u)
            if j > 0 and not in_pairs:
                back = back + sums.seen[j * m + r] * u
        if not in_pairs:
            own = own + the_sum(back * y)
    sums.own[q] = own


@jit
def sum_history(lot, walk, widths):
    """Take the structures in the lanes through the whole record and gather the sums of `walk`."""
    modes, samples, taken, found, arrays = walk.modes, walk.samples, walk.taken, walk.found, walk.sum_arrays
    for array in (arrays.products, arrays.own, arrays.ground, arrays.direct):
        array.fill(0.0)
    m, d, follows = modes.modes, samples.inputs, write_oscillators(modes, lot, samples, widths)
    for block in range(samples.n_blocks):
        data = data_of(walk.sample_arrays, samples, walk.observed, block)
        for i in range(d):
            march_block(modes, samples, block, i, 0, m, i * m, follows)
            if not walk.is_given:
                compare(modes, samples, data, block, i, 0, m, i * m)
        weigh(modes, taken, samples, data, block, walk.is_given)
        for i in range(d):
            for r in range(m):
                add_sums(modes, taken, samples, i, r, walk.in_pairs)
    like = widths.structure
    gathered(taken.products, modes.sensors * d * m, found.products, like)
    gathered(taken.own, d * m, found.own, like)
    gathered(taken.ground, modes.sensors * d, found.ground, like)
    gathered(taken.direct, modes.sensors * d, found.direct, like)
