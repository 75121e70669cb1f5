"""Pairs of complex modes on their way through a record, with the sums that their gradients need.

One structure in each vector lane. A number a + b i with i^2 = -1, or +1 where both poles of the pair are
real, stands for both modes of a pair, see `eigen.complex_modes`; what is summed over both is twice its real
part. A mode is f' = lambda f + a, of which the march has the displacement and the velocity of its pair with
their derivatives by s = z z* and d = -(z + z*), z = lambda h, see `oscillators.exact_step`:

    f = -h u,   u = R + D J,   D = displacement / h^2,   R = velocity / h + D d / 2,   J = h b i,
    du/dz = z* du/ds - du/dd + D / 2.
"""

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import store
from pymc_features.simulators.derivatives.pair_memory import put_number
from pymc_features.simulators.eigen.complex_modes import mode_places, pole_of
from pymc_features.simulators.eigen.pairs import write_shares
from pymc_features.simulators.eigen.residues import at_sensor, input_factor, norm
from pymc_features.simulators.numbers.compiled_numbers import new_quadratic
from pymc_features.simulators.numbers.rows import view
from pymc_features.simulators.oscillators.arguments import (
    ABSOLUTE_ACCELERATION,
    RELATIVE_ACCELERATION,
    RELATIVE_VELOCITY,
)
from pymc_features.simulators.oscillators.modal_lanes import PARTS


@jit
def order_of(quantity):
    """How many times the displacement is differentiated."""
    if quantity in (ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION):
        return 2
    return 1 if quantity == RELATIVE_VELOCITY else 0


@jit
def write_pair(oscillators, pairs, modes, r, p, quantity):
    """Write pair r, place p of the panel, into the pairs of `eigen.pairs` and `PairLanes`."""
    at, m = mode_places(modes), modes.omega.shape[0]
    (a, b), square = pole_of(at, p)
    store(pairs.poles, 3 * r, a)
    store(pairs.poles, 3 * r + 1, b)
    store(pairs.poles, 3 * r + 2, square)
    put_number(pairs.left, r, norm(at, p))
    put_number(pairs.right, r, input_factor(at, p))
    for j in range(oscillators.forced.shape[0]):
        put_number(pairs.seen, j * m + r, at_sensor(at, j, p))
    write_shares(oscillators, at, r, p, quantity)


@jit
def marched(products, row, after, r, rows, ground):
    """Sum over a mode less what stands before the input in its states, with derivatives."""
    x = products[row]
    v, s, d = after[r], after[rows + r], after[2 * rows + r]
    return x.v - v * ground, x.s - s * ground, x.d - d * ground


@jit
def complete_sums(pairs, lot, sums, quantity, widths):
    """Write the sums of dL/dy times a pole's output and its derivative by lambda."""
    like, h, m = widths.structure, lot.step, lot.n_modes // 2
    rows, poles, found = lot.after.shape[0] // PARTS, view(pairs.poles, like), view(pairs.sums, like)
    after, of_ground, order = view(lot.after, like), view(pairs.of_ground, like), order_of(quantity)
    for j in range(lot.n_sensors):
        ground = sums.ground[j]
        of_ground[j] = ground
        for r in range(m):
            a, b, square = poles[3 * r], poles[3 * r + 1], poles[3 * r + 2]
            at = j * sums.modes + r
            q, q_s, q_d = marched(sums.products, at, after, r, rows, ground)
            v, v_s, v_d = marched(sums.products, at + m, after, m + r, rows, ground)
            scale, half = 1.0 / (h * h), (0.0 - h) * a  # d / 2
            q, q_s, q_d = scale * q, scale * q_s, scale * q_d
            scale = 1.0 / h
            c = scale * v + half * q
            c_s, c_d = scale * v_s + half * q_s, scale * v_d + half * q_d + 0.5 * q
            turn = h * b  # of J in units of i
            real = 0.5 * q - half * c_s - turn * turn * square * q_s - c_d
            imaginary = 0.0 - turn * (half * q_s + c_s + q_d)
            pole = new_quadratic(a, b, square)
            output = new_quadratic((0.0 - h) * c, (0.0 - h) * (turn * q), square)
            slope = new_quadratic((0.0 - h * h) * real, (0.0 - h * h) * imaginary, square)
            for _ in range(order):
                slope = pole * slope + output
                output = pole * output
            row = 4 * (j * m + r)
            found[row], found[row + 1] = output.re, output.im
            found[row + 2], found[row + 3] = slope.re, slope.im
