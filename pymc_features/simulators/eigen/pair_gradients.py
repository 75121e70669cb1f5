"""Derivatives by the entries of M, C and K of structures in lanes, from the sums of `pair_lanes`.

With Q(z) = z^2 M + z C + K and its inverse, the sum of x_k x_k' / (alpha_k (z - lambda_k)) over all poles,
the displacement -Q^-1 Gamma a changes by Q^-1 dQ Q^-1 Gamma a: by pairs of poles with divided differences,

    dL = sum_kl (x_k' dA x_l) p_k r_l lambda_k^i [v_k'o_k - v_k'o_l] / (lambda_k - lambda_l),

p_k = 1/alpha_k, r_l = x_l'Gamma/alpha_l, v_k = S x_k dL/dy, o_l the output of pole l, and i = 0, 1, 2 where A
is K, C or M. For k = l the quotient is v_k'do_k/dlambda. Where it is M two terms more come from what the
divided differences of z^2 lambda/(z - lambda) leave: the sum of lambda_k p_k x_k x_k' is the identity.

Of two pairs of poles with i_k and i_l the differences are numbers of four parts, of 1, i_k, i_l and i_k i_l.

Where pairs of complex modes of structures lie, one structure in each lane; `pair_lanes` fills it.

Pairs of complex modes on their way through a record, with the sums that their gradients need.

One structure in each vector lane. A number a + b i with i^2 = -1, or +1 where both poles of the pair are
real, stands for both modes of a pair, see `eigen.complex_modes`; what is summed over both is twice its real
part. A mode is f' = lambda f + a, of which the march has the displacement and the velocity of its pair with
their derivatives by s = z z* and d = -(z + z*), z = lambda h, see `oscillators.exact_step`:

    f = -h u,   u = R + D J,   D = displacement / h^2,   R = velocity / h + D d / 2,   J = h b i,
    du/dz = z* du/ds - du/dd + D / 2.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import load, magnitude, splat, store, where_less
from pymc_features.simulators.compiled.vector_math import larger
from pymc_features.simulators.compiled.vector_memory import new_vectors
from pymc_features.simulators.eigen.complex_modes import (
    at_sensor,
    input_factor,
    mode_places,
    norm,
    over,
    pole_of,
    times,
    write_shares,
)
from pymc_features.simulators.numbers.compiled_numbers import new_quadratic
from pymc_features.simulators.numbers.rows import view
from pymc_features.simulators.oscillators.arguments import (
    ABSOLUTE_ACCELERATION,
    RELATIVE_ACCELERATION,
    RELATIVE_VELOCITY,
)
from pymc_features.simulators.oscillators.modal_lanes import PARTS
from pymc_features.simulators.oscillators.reduction import CLOSE


class PairLanes(NamedTuple):
    """Pairs of complex modes of structures, one in each lane. Two vectors for each complex number.

    Attributes
    ----------
    poles : array (3 m, LANES)
        a, b and i^2.
    left, right : array (2 m, LANES)
        1 / alpha and x'Gamma / alpha, alpha = x' (2 lambda + D) x.
    seen : array (2 s m, LANES)
        S x, of sensor j and mode r in rows 2 (j m + r) ...
    vectors : array (2 m n, LANES)
        Phi x, of entry i and mode r in rows 2 (i m + r) ...
    sums : array (4 s m, LANES)
        Of dL/dy_j times the output of a pole, and its derivative by lambda.
    of_ground : array (s, LANES)
        Of dL/dy_j times the input.
    """

    poles: np.ndarray
    left: np.ndarray
    right: np.ndarray
    seen: np.ndarray
    vectors: np.ndarray
    sums: np.ndarray
    of_ground: np.ndarray


@jit
def new_pairs(n, m, n_sensors):
    """Room for structures of n degrees of freedom and m pairs of modes."""
    s = n_sensors + n_sensors % 2
    return PairLanes(
        poles=new_vectors(3 * m),
        left=new_vectors(2 * m),
        right=new_vectors(2 * m),
        seen=new_vectors(2 * s * m),
        vectors=new_vectors(2 * m * n),
        sums=new_vectors(4 * s * m),
        of_ground=new_vectors(s),
    )


@jit
def put_number(matrix, i, number):
    """Write a complex number."""
    store(matrix, 2 * i, number[0])
    store(matrix, 2 * i + 1, number[1])


@jit
def number(matrix, i):
    """A complex number."""
    return load(matrix, 2 * i), load(matrix, 2 * i + 1)


@jit
def order_of(quantity):
    """How many times the displacement is differentiated."""
    if quantity in (ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION):
        return 2
    return 1 if quantity == RELATIVE_VELOCITY else 0


@jit
def write_pair(oscillators, pairs, modes, r, p, quantity):
    """Write pair r, place p of the panel, into `Pairs` and `PairLanes`."""
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


@jit
def pole_at(pairs, r):
    """a, b and i^2 of pair r."""
    return load(pairs.poles, 3 * r), load(pairs.poles, 3 * r + 1), load(pairs.poles, 3 * r + 2)


@jit
def smaller(x, y):
    """The smaller of two numbers, lane by lane."""
    return where_less(x, y, x, y)


@jit
def poles_apart(pairs, duration):
    """One in the lanes where no two poles are close, as in `reduction.nearness`; zero elsewhere."""
    m, one, zero = pairs.poles.shape[0] // 3, splat(1.0), splat(0.0)
    apart = one
    for k in range(m):
        a, b, square = pole_at(pairs, k)
        size = magnitude(a) + b
        memory = where_less(one, duration * magnitude(a), one / magnitude(a), splat(duration))
        memory = larger(memory, 3.0 / size)
        for r in range(k):
            c, d, other = pole_at(pairs, r)
            across, along = magnitude(b - d), magnitude(a - c)
            gap = along + across
            # real poles, of one pair or of both
            real = smaller(magnitude(along - across), magnitude(along - (b + d)))
            mixed = where_less(square, zero, b, d) + larger(along - where_less(square, zero, d, b), zero)
            gap = where_less(zero, square * other, where_less(zero, square, real, gap), mixed)
            apart = where_less(splat(CLOSE), gap * memory, apart, zero)
    return apart


@jit
def own_differences(pairs, r, n_sensors):
    """v_r'o_r, and the differences of pole r with itself and with its partner."""
    m, zero = pairs.poles.shape[0] // 3, splat(0.0)
    _, b, square = pole_at(pairs, r)
    own = same = cross = (zero, zero)
    for j in range(n_sensors):
        seen, row = number(pairs.seen, j * m + r), 2 * (j * m + r)
        output = number(pairs.sums, row)
        product, slope = times(seen, output, square), times(seen, number(pairs.sums, row + 1), square)
        own = own[0] + product[0], own[1] + product[1]
        same = same[0] + slope[0], same[1] + slope[1]
        cross = cross[0] + seen[0] * output[1], cross[1] + seen[1] * output[1]
    return own, same, (cross[0] / b, cross[1] / b)


@jit
def write_differences(pairs, k, n_sensors, differences):
    """Write the divided differences of pair k, into rows 2 k and 2 k + 1 of a matrix (4 m m, LANES).

    Those with pair r, of four parts, stand in its columns 2 r and 2 r + 1. Returns v_k'o_k.
    """
    m, half = pairs.poles.shape[0] // 3, splat(0.5)
    a, b, square = pole_at(pairs, k)
    own, same, cross = own_differences(pairs, k, n_sensors)
    top, low = 4 * k * m, 4 * k * m + 2 * m
    for r in range(m):
        if r == k:
            store(differences, top + 2 * r, half * (same[0] + cross[0]))
            store(differences, low + 2 * r, half * (same[1] + cross[1]))
            store(differences, top + 2 * r + 1, half * (same[1] - cross[1]))
            store(differences, low + 2 * r + 1, half * (square * (same[0] - cross[0])))
            continue
        p0, p1, q0, q1 = own[0], own[1], splat(0.0), splat(0.0)
        for j in range(n_sensors):
            seen, output = number(pairs.seen, j * m + k), number(pairs.sums, 2 * (j * m + r))
            p0, p1 = p0 - seen[0] * output[0], p1 - seen[1] * output[0]
            q0, q1 = q0 - seen[0] * output[1], q1 - seen[1] * output[1]
        c, d, other = pole_at(pairs, r)
        gap = a - c
        # over gap + b i_k - d i_l: times gap + b i_k + d i_l, over a number with i_k only
        unlike = where_less(square * other, splat(0.0), b * b + d * d, (b - d) * (b + d))
        size = gap * gap + square * unlike, 2.0 * gap * b
        up, over_p, over_q = (gap, b), (p0, p1), (q0, q1)
        first, second = times(over_p, up, square), times(over_q, up, square)
        carry = other * d
        p = over((first[0] + carry * q0, first[1] + carry * q1), size, square)
        q = over((second[0] + d * p0, second[1] + d * p1), size, square)
        store(differences, top + 2 * r, p[0])
        store(differences, low + 2 * r, p[1])
        store(differences, top + 2 * r + 1, q[0])
        store(differences, low + 2 * r + 1, q[1])
    return own


@jit
def write_right(pairs, right):
    """Write r_l times the vectors, (n 2m, LANES), so that products with differences sum over both poles."""
    m = pairs.poles.shape[0] // 3
    n = pairs.vectors.shape[0] // (2 * m)
    for r in range(m):
        square, factor = load(pairs.poles, 3 * r + 2), number(pairs.right, r)
        for i in range(n):
            x = times(number(pairs.vectors, i * m + r), factor, square)
            put_number(right, i * m + r, (2.0 * x[0], 2.0 * (square * x[1])))


@jit
def multiply_left(pairs, by_pole, left):
    """Write p_k times the vectors into `left` (n 2m, LANES) or, `by_pole`, multiply it by lambda_k."""
    m = pairs.poles.shape[0] // 3
    n = pairs.vectors.shape[0] // (2 * m)
    for r in range(m):
        a, b, square = pole_at(pairs, r)
        factor = number(pairs.left, r)
        for i in range(n):
            if by_pole:  # the imaginary part has the sign that the sum over both poles gives it
                x = load(left, 2 * (i * m + r)), square * load(left, 2 * (i * m + r) + 1)
                x = times(x, (a, b), square)
            else:
                x = times(number(pairs.vectors, i * m + r), factor, square)
                x = 2.0 * x[0], 2.0 * x[1]
            put_number(left, i * m + r, (x[0], square * x[1]))


@jit
def add_mass_terms(pairs, sensors, modes, request, own, entries):
    """Add to the derivatives by M (n n, LANES) what divided differences leave; write those by the load.

    Parameters
    ----------
    sensors : array (s n, LANES)
        M^-1 S'.
    modes : tuple of arrays (n 2m, LANES), (n, LANES), (n, LANES)
        Of `write_right`; M^-1 times the load; the derivatives by the load, written.
    request : tuple
        Number of sensors and quantity.
    own : array (2 m, LANES)
        v_k'o_k.
    """
    (right, load_shape, by_load), (n_sensors, quantity) = modes, request
    m, n = pairs.poles.shape[0] // 3, load_shape.shape[0]
    is_acceleration = order_of(quantity) == 2
    for i in range(n):
        total = splat(0.0)
        for r in range(m):
            square = load(pairs.poles, 3 * r + 2)
            x = times(number(pairs.vectors, i * m + r), number(pairs.left, r), square)
            v = number(own, r)
            total = total - 2.0 * (x[0] * v[0] + square * (x[1] * v[1]))
        if is_acceleration:
            for j in range(n_sensors):
                total = total - load(pairs.of_ground, j) * load(sensors, j * n + i)
        store(by_load, i, total)
    for j in range(n_sensors):
        for k in range(n):
            total = splat(0.0)
            for r in range(m):
                output, x = number(pairs.sums, 2 * (j * m + r)), number(right, k * m + r)
                total = total + output[0] * x[0] + output[1] * x[1]
            if is_acceleration:
                total = total + load(pairs.of_ground, j) * load(load_shape, k)
            for i in range(n):
                row = i * n + k
                store(entries, row, load(entries, row) + load(sensors, j * n + i) * total)
