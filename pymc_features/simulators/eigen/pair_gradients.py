"""Derivatives by the reduced matrices of structures in lanes, from sums over time of pairs of complex modes.

With Q(z) = z^2 + z D + Omega^2 in classical modes and its inverse, the sum of
x_k x_k' / (alpha_k (z - lambda_k)) over all poles, the displacement -Q^-1 Gamma a changes by
Q^-1 dQ Q^-1 Gamma a: by pairs of poles with divided differences,

    dL = sum_kl (x_k' dA x_l) p_k r_l lambda_k^i [v_k'o_k - v_k'o_l] / (lambda_k - lambda_l),

p_k = 1/alpha_k, r_l = x_l'Gamma/alpha_l, v_k = S Phi x_k dL/dy, o_l the output of pole l, and i = 0, 1, 2
where A is Phi'K Phi, Phi'C Phi or Phi'M Phi. For k = l the quotient is v_k'do_k/dlambda. Where it is
Phi'M Phi two terms more come from what the divided differences of z^2 lambda/(z - lambda) leave: the sum of
lambda_k p_k x_k x_k' is the identity.

A pair is a number a + b J, see `complex_modes`; what is summed over both poles is twice its real part. A pole
obeys f' = lambda f + a, of which the march has the displacement and the velocity of its pair with their
derivatives by s = z z* and d = -(z + z*), z = lambda h, see `oscillators.exact_step`:

    f = -h u,   u = R + D J,   D = displacement / h^2,   R = velocity / h + D d / 2,   J = h b i,
    du/dz = z* du/ds - du/dd + D / 2.

Of two pairs of poles with J_k and J_l the differences are numbers of four parts, of 1, J_k, J_l and J_k J_l.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.eigen.complex_modes import (
    inverse,
    number,
    order_of,
    pole_of,
    put_number,
)
from pymc_features.simulators.eigen.matrices import multiply_lanes
from pymc_features.simulators.numbers.compiled_numbers import (
    in_lanes,
    larger,
    magnitude,
    new_quadratic,
    where_less,
)
from pymc_features.simulators.numbers.rows import view
from pymc_features.simulators.numbers.vectors import new_vectors
from pymc_features.simulators.oscillators.modal_lanes import PARTS
from pymc_features.simulators.oscillators.reduction import CLOSE


@jit
def marched(products, row, after, r, rows, ground):
    """Sum over a mode less what stands before the input in its states, with derivatives."""
    x = products[row]
    v, s, d = after[r], after[rows + r], after[2 * rows + r]
    return x.v - v * ground, x.s - s * ground, x.d - d * ground


@jit
def complete_sums(at, lot, sums):
    """Write the sums of dL/dy times a pole's output and its derivative by lambda."""
    h, m, rows = lot.step, at.m, lot.after.shape[0] // PARTS
    after, order = view(lot.after, in_lanes(0.0)), order_of(lot.quantity)
    for j in range(at.s):
        ground = sums.ground[j]
        at.ground[j] = ground
        for r in range(m):
            pole, row = pole_of(at.poles, r), j * sums.modes + r
            q, q_s, q_d = marched(sums.products, row, after, r, rows, ground)
            v, v_s, v_d = marched(sums.products, row + m, after, m + r, rows, ground)
            scale, half = 1.0 / (h * h), (0.0 - h) * pole.re  # d / 2
            q, q_s, q_d = scale * q, scale * q_s, scale * q_d
            scale = 1.0 / h
            c = scale * v + half * q
            c_s, c_d = scale * v_s + half * q_s, scale * v_d + half * q_d + 0.5 * q
            turn = h * pole.im  # of J in units of i
            real = 0.5 * q - half * c_s - turn * turn * pole.square * q_s - c_d
            imaginary = 0.0 - turn * (half * q_s + c_s + q_d)
            output = new_quadratic((0.0 - h) * c, (0.0 - h) * (turn * q), pole.square)
            slope = new_quadratic((0.0 - h * h) * real, (0.0 - h * h) * imaginary, pole.square)
            for _ in range(order):
                slope = pole * slope + output
                output = pole * output
            put_number(at.sums, 2 * (j * m + r), output)
            put_number(at.sums, 2 * (j * m + r) + 1, slope)


@jit
def poles_apart(at, duration):
    """One in the lanes where no two poles are close, as in `reduction.nearness`; zero elsewhere."""
    one, nil = in_lanes(1.0), in_lanes(0.0)
    apart = one
    for k in range(at.m):
        pole = pole_of(at.poles, k)
        (a, b), square = (pole.re, pole.im), pole.square
        memory = where_less(1.0, duration * magnitude(a), one / magnitude(a), nil + duration)
        memory = larger(memory, 3.0 / (magnitude(a) + b))
        for r in range(k):
            other = pole_of(at.poles, r)
            across, along, d = magnitude(b - other.im), magnitude(a - other.re), other.im
            # real poles, of one pair or of both
            near, far = magnitude(along - across), magnitude(along - (b + d))
            real, beside = where_less(near, far, near, far), where_less(square, 0.0, d, b)
            mixed = where_less(square, 0.0, b, d) + larger(along - beside, nil)
            gap = where_less(0.0, square, real, along + across)
            gap = where_less(0.0, square * other.square, gap, mixed)
            apart = where_less(CLOSE, gap * memory, apart, nil)
    return apart


@jit
def own_differences(at, r):
    """v_r'o_r, and the differences of pole r with itself and with its partner."""
    pole = pole_of(at.poles, r)
    own = same = cross = new_quadratic(in_lanes(0.0), in_lanes(0.0), pole.square)
    for j in range(at.s):
        place = j * at.m + r
        seen, output = number(at.seen, place, pole.square), number(at.sums, 2 * place, pole.square)
        own, cross = own + seen * output, cross + seen * output.im
        same = same + seen * number(at.sums, 2 * place + 1, pole.square)
    return own, same, cross * (1.0 / pole.im)


@jit
def write_differences(at, k, differences):
    """Write the divided differences of pair k, into rows 2 k and 2 k + 1 of a matrix (2m, 2m).

    Those with pair r, of four parts, stand in its columns 2 r and 2 r + 1. Returns v_k'o_k.
    """
    m, pole, nil = at.m, pole_of(at.poles, k), in_lanes(0.0)
    own, same, cross = own_differences(at, k)
    top, low, square = 4 * k * m, 4 * k * m + 2 * m, pole.square
    for r in range(m):
        if r == k:
            differences[top + 2 * r] = 0.5 * (same.re + cross.re)
            differences[low + 2 * r] = 0.5 * (same.im + cross.im)
            differences[top + 2 * r + 1] = 0.5 * (same.im - cross.im)
            differences[low + 2 * r + 1] = 0.5 * (square * (same.re - cross.re))
            continue
        p, q = own, new_quadratic(nil, nil, square)
        for j in range(at.s):
            seen, row = number(at.seen, j * m + k, square), 4 * (j * m + r)
            p, q = p - seen * at.sums[row], q - seen * at.sums[row + 1]
        other = pole_of(at.poles, r)
        d = other.im
        # over gap - d J_r: times gap + d J_r, over a number with J_k only
        gap = new_quadratic(pole.re - other.re, pole.im, square)
        unlike = where_less(square * other.square, 0.0, gap.im * gap.im + d * d, (gap.im - d) * (gap.im + d))
        size = inverse(new_quadratic(gap.re * gap.re + square * unlike, 2.0 * (gap.re * gap.im), square))
        p, q = (p * gap + q * (other.square * d)) * size, (q * gap + p * d) * size
        differences[top + 2 * r], differences[low + 2 * r] = p.re, p.im
        differences[top + 2 * r + 1], differences[low + 2 * r + 1] = q.re, q.im
    return own


@jit
def write_right(at, right):
    """Write r_l times the vectors, (m, 2m), so that products with differences sum over both poles."""
    for r in range(at.m):
        square = at.poles[3 * r + 2]
        factor = 2.0 * number(at.right, r, square)
        for s in range(at.m):
            x = number(at.vectors, s * at.m + r, square) * factor
            right[2 * (s * at.m + r)], right[2 * (s * at.m + r) + 1] = x.re, square * x.im


@jit
def multiply_left(at, by_pole, left):
    """Write p_k times the vectors into `left` (m, 2m) or, `by_pole`, multiply it by lambda_k."""
    for r in range(at.m):
        pole = pole_of(at.poles, r)
        factor = 2.0 * number(at.left, r, pole.square)
        for s in range(at.m):
            i = s * at.m + r
            if by_pole:  # the imaginary part has the sign that the sum over both poles gives it
                x = new_quadratic(left[2 * i], pole.square * left[2 * i + 1], pole.square) * pole
            else:
                x = number(at.vectors, i, pole.square) * factor
            left[2 * i], left[2 * i + 1] = x.re, pole.square * x.im


class PairRoom(NamedTuple):
    """Room for `derive_matrices`: matrices (m, 2m) three times, (2m, 2m), (m, m) and (m, 2)."""

    left: np.ndarray
    right: np.ndarray
    partners: np.ndarray
    differences: np.ndarray
    product: np.ndarray
    own: np.ndarray


@jit
def new_pair_room(m):
    """Room for the derivatives of structures with m modes."""
    return PairRoom(
        new_vectors(2 * m * m),
        new_vectors(2 * m * m),
        new_vectors(2 * m * m),
        new_vectors(4 * m * m),
        new_vectors(m * m),
        new_vectors(2 * m),
    )


@jit
def derive_matrices(at, quantity, reduced, by_damping, room):
    """Write the derivatives by Phi'K Phi, Phi'M Phi and the load into `Reduced`, and those by Phi'C Phi."""
    like, m = in_lanes(0.0), at.m
    left, right, own = view(room.left, like), view(room.right, like), view(room.own, like)
    write_right(at, right)
    for k in range(m):
        put_number(own, k, write_differences(at, k, view(room.differences, like)))
    width = 2 * m
    multiply_lanes((room.right, width, 1), (room.differences, 1, width), (m, width, width), room.partners)
    for i in range(3):
        target = (reduced.stiffness, by_damping, reduced.mass)[i]
        multiply_left(at, i > 0, left)
        multiply_lanes((room.left, width, 1), (room.partners, 1, width), (m, width, m), room.product)
        if i == 2:
            share = 1.0 if order_of(quantity) == 2 else 0.0
            add_mass_terms(at, share, right, own, view(reduced.by_load, like), view(room.product, like))
        put_symmetric(view(room.product, like), m, view(target, like))


@jit
def put_symmetric(product, m, target):
    """Write the symmetric part of a matrix (m, m)."""
    for r in range(m):
        for s in range(r + 1):
            both = 0.5 * (product[r * m + s] + product[s * m + r])
            target[r * m + s], target[s * m + r] = both, both


@jit
def add_mass_terms(at, share, right, own, by_load, product):
    """Add to the derivatives by Phi'M Phi what divided differences leave; write those by the load.

    `share` is one of accelerations, which see the input itself, else zero; `own` are v_k'o_k.
    """
    m, nil = at.m, in_lanes(0.0)
    for s in range(m):
        total = nil
        for r in range(m):
            square = at.poles[3 * r + 2]
            x = number(at.vectors, s * m + r, square) * number(at.left, r, square)
            total = total - 2.0 * (x * number(own, r, square)).re
        for j in range(at.s):
            total = total - share * at.ground[j] * at.shapes[j * m + s]
        by_load[s] = total
    for j in range(at.s):
        for k in range(m):
            total = share * at.ground[j] * at.participation[k]
            for r in range(m):
                row = 2 * (k * m + r)
                total = total + at.sums[4 * (j * m + r)] * right[row]
                total = total + at.sums[4 * (j * m + r) + 1] * right[row + 1]
            for s in range(m):
                product[s * m + k] = product[s * m + k] + at.shapes[j * m + s] * total
