"""Complex modes of structures whose damping couples the classical ones, one structure in each vector lane.

In classical modes q" + D q' + Omega^2 q = -Gamma a, D symmetric. A complex mode (lambda, x) satisfies

    (lambda^2 + omega_s^2) x_s + lambda (D x)_s = 0   for all s.

Starting from classical mode r, x_r = 1, the equations s != r are solved for x_s, with the newest values on
the right, and equation r is a Newton step for lambda, until nothing moves. Modes go in panels of two, whose
vectors stay in the first-level cache.

Each mode stands for a pair: lambda = a + i b and a - i b, with i^2 = -1, or two real ones where the mode is
overdamped, then with i^2 = +1, which changes nothing but a sign in products. A pair marches as one oscillator
with the frequency and damping of its product and sum, lambda_1 lambda_2 and -(lambda_1 + lambda_2), and its
residues u_j x'Gamma / (x' (2 lambda + D) x) give what the sensors see of its displacement and velocity.

That all pairs are found, and none twice, shows in the sums of the residues: of all pairs they are zero, and
times lambda S Phi Gamma.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import (
    highest,
    load,
    magnitude,
    splat,
    square_root,
    store,
    where_less,
)
from pymc_features.simulators.compiled.vector_math import larger
from pymc_features.simulators.compiled.vector_memory import new_vectors
from pymc_features.simulators.eigen.pair_numbers import over, times

PANEL = 2
MAX_ITERATIONS = 80
EARLY, LARGE = 12, 0.02  # a vector that moves that much after so many iterations will not settle
SETTLED = 1e-14  # error of a vector whose own entry is one
NEARLY, SHRINKING = 1e-11, 0.1  # changes below and shares of the one before, at which they foretell the rest
STALLED = 1e-12  # change that is taken for rounding after twice as many iterations
COMPLETE = 1e-11  # error of the sums of residues beside the sum of their classical absolute values
CANCELLING = 1e5  # residues above that many times the classical ones: two modes, or both of a pair, coalesce


class ComplexLanes(NamedTuple):
    """Complex modes of structures, one in each lane.

    Attributes
    ----------
    is_good : array (1, LANES)
        One where the modes came out right, zero where not.
    damping : array (m m, LANES)
        D.
    omega : array (m, LANES)
        Classical frequencies [rad/s].
    participation, seen : array (m, LANES), (s m, LANES)
        Gamma, and the classical shapes at the sensors.
    vectors, products : array (2 PANEL m, LANES)
        x and D x of one panel: of entry s, real and imaginary part of each mode.
    poles : array (3 PANEL, LANES)
        a, b and i^2.
    sums : array (3 s, LANES)
        Of the residues, of lambda times them, and of the absolute values of those.
    """

    is_good: np.ndarray
    damping: np.ndarray
    omega: np.ndarray
    participation: np.ndarray
    seen: np.ndarray
    vectors: np.ndarray
    products: np.ndarray
    poles: np.ndarray
    sums: np.ndarray


@jit
def new_complex(n_modes, n_sensors):
    """Room for structures of m modes."""
    return ComplexLanes(
        is_good=new_vectors(1),
        damping=new_vectors(n_modes * n_modes),
        omega=new_vectors(n_modes),
        participation=new_vectors(n_modes),
        seen=new_vectors(n_sensors * n_modes),
        vectors=new_vectors(2 * PANEL * n_modes),
        products=new_vectors(2 * PANEL * n_modes),
        poles=new_vectors(3 * PANEL),
        sums=new_vectors(3 * n_sensors),
    )


@jit
def start_panel(modes, first):
    """Write a first guess of the modes `first` ...; what stands behind the last mode repeats it.

    The poles are classical, the vectors what one step makes of classical ones.
    """
    m, zero, one = modes.omega.shape[0], splat(0.0), splat(1.0)
    for p in range(PANEL):
        r = min(first + p, m - 1)
        half, omega = splat(0.5) * load(modes.damping, r * m + r), load(modes.omega, r)
        gap = (half - omega) * (half + omega)
        square = where_less(gap, zero, zero - one, one)
        pole = zero - half, square_root(magnitude(gap))
        store(modes.poles, 3 * p, pole[0])
        store(modes.poles, 3 * p + 1, pole[1])
        store(modes.poles, 3 * p + 2, square)
        for s in range(m):
            row, d = 2 * (PANEL * s + p), load(modes.damping, s * m + s)
            stiffness = impedance(pole, square, load(modes.omega, s), d)
            coupling = zero - load(modes.damping, s * m + r)
            x = over((pole[0] * coupling, pole[1] * coupling), stiffness, square)
            store(modes.vectors, row, one if s == r else x[0])
            store(modes.vectors, row + 1, zero if s == r else x[1])


@jit
def impedance(pole, square, omega, d):
    """lambda^2 + d lambda + omega^2."""
    own = times(pole, pole, square)
    return own[0] + omega * omega + d * pole[0], own[1] + d * pole[1]


@jit
def multiply_rows(modes, s, live):
    """Write entries s ... s + 3 of D x of the panel in the lanes that are `live`.

    What stands behind the last entry repeats it.
    """
    m, x = modes.omega.shape[0], modes.vectors
    s1, s2, s3 = min(s + 1, m - 1), min(s + 2, m - 1), min(s + 3, m - 1)
    a0 = a1 = a2 = a3 = b0 = b1 = b2 = b3 = splat(0.0)
    c0 = c1 = c2 = c3 = e0 = e1 = e2 = e3 = splat(0.0)
    for t in range(m):
        k = 2 * PANEL * t
        x0, x1, x2, x3 = load(x, k), load(x, k + 1), load(x, k + 2), load(x, k + 3)
        d0, d1 = load(modes.damping, s * m + t), load(modes.damping, s1 * m + t)
        d2, d3 = load(modes.damping, s2 * m + t), load(modes.damping, s3 * m + t)
        a0, a1, a2, a3 = a0 + d0 * x0, a1 + d0 * x1, a2 + d0 * x2, a3 + d0 * x3
        b0, b1, b2, b3 = b0 + d1 * x0, b1 + d1 * x1, b2 + d1 * x2, b3 + d1 * x3
        c0, c1, c2, c3 = c0 + d2 * x0, c1 + d2 * x1, c2 + d2 * x2, c3 + d2 * x3
        e0, e1, e2, e3 = e0 + d3 * x0, e1 + d3 * x1, e2 + d3 * x2, e3 + d3 * x3
    write_four(modes.products, 2 * PANEL * s, (a0, a1, a2, a3), live)
    write_four(modes.products, 2 * PANEL * s1, (b0, b1, b2, b3), live)
    write_four(modes.products, 2 * PANEL * s2, (c0, c1, c2, c3), live)
    write_four(modes.products, 2 * PANEL * s3, (e0, e1, e2, e3), live)


@jit
def write_four(matrix, row, vectors, live):
    """Write four vectors, one after the other, in the lanes that are `live`."""
    zero = splat(0.0)
    store(matrix, row, where_less(zero, live, vectors[0], load(matrix, row)))
    store(matrix, row + 1, where_less(zero, live, vectors[1], load(matrix, row + 1)))
    store(matrix, row + 2, where_less(zero, live, vectors[2], load(matrix, row + 2)))
    store(matrix, row + 3, where_less(zero, live, vectors[3], load(matrix, row + 3)))


@jit
def improve_pole(modes, r, p, live):
    """One Newton step for the pole of mode p of the panel, number r; returns by how much it moved."""
    row, omega = 2 * (PANEL * r + p), load(modes.omega, r)
    pole, square = (load(modes.poles, 3 * p), load(modes.poles, 3 * p + 1)), load(modes.poles, 3 * p + 2)
    y = load(modes.products, row), load(modes.products, row + 1)
    own_square, drag = times(pole, pole, square), times(pole, y, square)
    left = own_square[0] + omega * omega + drag[0], own_square[1] + drag[1]
    step = over(left, (2.0 * pole[0] + y[0], 2.0 * pole[1] + y[1]), square)
    real, imaginary = pole[0] - step[0], pole[1] - step[1]
    store(modes.poles, 3 * p, where_less(splat(0.0), live, real, pole[0]))
    store(modes.poles, 3 * p + 1, where_less(splat(0.0), live, imaginary, pole[1]))
    return (magnitude(step[0]) + magnitude(step[1])) / (magnitude(real) + magnitude(imaginary))


@jit
def improve_entry(modes, s, p, live):
    """One step for entry s of mode p of the panel; returns by how much it moved."""
    row, m = 2 * (PANEL * s + p), modes.omega.shape[0]
    pole, square = (load(modes.poles, 3 * p), load(modes.poles, 3 * p + 1)), load(modes.poles, 3 * p + 2)
    y, omega = (load(modes.products, row), load(modes.products, row + 1)), load(modes.omega, s)
    d, x = load(modes.damping, s * m + s), (load(modes.vectors, row), load(modes.vectors, row + 1))
    pull = times(pole, (d * x[0] - y[0], d * x[1] - y[1]), square)
    new = over(pull, impedance(pole, square, omega, d), square)
    store(modes.vectors, row, where_less(splat(0.0), live, new[0], x[0]))
    store(modes.vectors, row + 1, where_less(splat(0.0), live, new[1], x[1]))
    return magnitude(new[0] - x[0]) + magnitude(new[1] - x[1])


@jit
def sweep_panel(modes, first, live):
    """Improve all entries and poles of a panel once; returns by how much they moved at most."""
    m, moved = modes.omega.shape[0], splat(0.0)
    for s in range(0, m, 4):
        multiply_rows(modes, s, live)
        for row in range(s, min(s + 4, m)):
            for p in range(PANEL):
                if row == min(first + p, m - 1):
                    change = improve_pole(modes, row, p, live)
                else:
                    change = improve_entry(modes, row, p, live)
                # NaN counts as a large change
                moved = where_less(
                    change, splat(1e300), where_less(moved, change, change, moved), splat(1e300)
                )
    return moved


@jit
def settle_panel(modes, first):
    """Iterate a panel until all its modes have settled; lanes where one does not are no longer good.

    Changes shrink by a constant factor: what is left behind the last one follows from it and the one before.
    """
    zero, one = splat(0.0), splat(1.0)
    live, before = load(modes.is_good, 0), splat(1e100)
    for iteration in range(MAX_ITERATIONS):
        moved = sweep_panel(modes, first, live)
        limit = splat(LARGE if iteration >= EARLY else 1e100)
        lost = where_less(zero, live, where_less(moved, limit, zero, one), zero)
        store(modes.is_good, 0, load(modes.is_good, 0) - lost)
        shrinks = where_less(moved, splat(SHRINKING) * before, moved * moved / before, moved)
        left = where_less(moved, splat(NEARLY), shrinks, moved)
        enough = splat(SETTLED if iteration < 2 * EARLY else STALLED)
        live = where_less(zero, lost, zero, where_less(left, enough, zero, live))
        before = moved
        if not highest(live) > 0.0:
            return
    store(modes.is_good, 0, load(modes.is_good, 0) - live)


@jit
def at_sensor(modes, j, p):
    """Mode p of the panel at sensor j, as (real, imaginary)."""
    m, x = modes.omega.shape[0], modes.vectors
    real = imaginary = splat(0.0)
    for s in range(m):
        row, weight = 2 * (PANEL * s + p), load(modes.seen, j * m + s)
        real, imaginary = real + weight * load(x, row), imaginary + weight * load(x, row + 1)
    return real, imaginary


@jit
def norm(modes, p):
    """1 / x' (2 lambda + D) x of mode p of the panel."""
    m, x, zero = modes.omega.shape[0], modes.vectors, splat(0.0)
    square = load(modes.poles, 3 * p + 2)
    pole = 2.0 * load(modes.poles, 3 * p), 2.0 * load(modes.poles, 3 * p + 1)
    real = imaginary = zero
    for s in range(m):
        row = 2 * (PANEL * s + p)
        entry, y = (
            (load(x, row), load(x, row + 1)),
            (load(modes.products, row), load(modes.products, row + 1)),
        )
        twice = times(pole, entry, square)
        term = times(entry, (twice[0] + y[0], twice[1] + y[1]), square)
        real, imaginary = real + term[0], imaginary + term[1]
    return over((splat(1.0), zero), (real, imaginary), square)


@jit
def input_factor(modes, p):
    """x'Gamma / x' (2 lambda + D) x of mode p of the panel."""
    real = imaginary = splat(0.0)
    for s in range(modes.omega.shape[0]):
        row, weight = 2 * (PANEL * s + p), load(modes.participation, s)
        real = real + weight * load(modes.vectors, row)
        imaginary = imaginary + weight * load(modes.vectors, row + 1)
    return times((real, imaginary), norm(modes, p), load(modes.poles, 3 * p + 2))


@jit
def check_sums(modes, n_sensors, cancelling):
    """Take the lanes out of the good ones where modes are missing, or residues cancel.

    `cancelling` is how many times larger than the classical ones the residues may be.
    """
    m, zero, one = modes.omega.shape[0], splat(0.0), splat(1.0)
    scale = wrong = left = whole = fastest = zero
    for r in range(m):
        fastest = larger(fastest, load(modes.omega, r))
    for j in range(n_sensors):
        total = size = zero
        for s in range(m):
            share = load(modes.seen, j * m + s) * load(modes.participation, s)
            total, size = total + share, size + magnitude(share)
        left = larger(left, magnitude(load(modes.sums, 3 * j)) * fastest)
        wrong = larger(wrong, magnitude(load(modes.sums, 3 * j + 1) - total))
        whole, scale = larger(whole, load(modes.sums, 3 * j + 2)), larger(scale, size)
    passed = where_less(left, COMPLETE * scale, one, zero)
    passed = where_less(wrong, COMPLETE * scale, passed, zero)
    passed = where_less(whole, cancelling * scale, passed, zero)
    store(modes.is_good, 0, load(modes.is_good, 0) * passed)
