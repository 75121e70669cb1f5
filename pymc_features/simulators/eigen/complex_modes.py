"""Complex modes of structures whose damping couples the classical ones, one structure in each vector lane.

In classical modes q" + D q' + Omega^2 q = -Gamma a, D symmetric. A complex mode (lambda, x) satisfies

    (lambda^2 + omega_s^2) x_s + lambda (D x)_s = 0   for all s.

Starting from classical mode r, x_r = 1, the equations s != r are solved for x_s, with the newest values on
the right, and equation r is a Newton step for lambda, until nothing moves. Modes go in panels of four, whose
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
    LANES,
    highest,
    load,
    magnitude,
    splat,
    square_root,
    store,
    where_less,
)
from pymc_features.simulators.compiled.vector_math import larger

PANEL = 4
MAX_ITERATIONS = 80
EARLY, LARGE = 12, 0.02  # a vector that moves that much after so many iterations will not settle
SETTLED = 1e-14  # change of a vector whose own entry is one
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
        is_good=np.zeros((1, LANES)),
        damping=np.zeros((n_modes * n_modes, LANES)),
        omega=np.zeros((n_modes, LANES)),
        participation=np.zeros((n_modes, LANES)),
        seen=np.zeros((n_sensors * n_modes, LANES)),
        vectors=np.zeros((2 * PANEL * n_modes, LANES)),
        products=np.zeros((2 * PANEL * n_modes, LANES)),
        poles=np.zeros((3 * PANEL, LANES)),
        sums=np.zeros((3 * n_sensors, LANES)),
    )


@jit
def times(x, y, square):
    """Product of two numbers (real, imaginary), i^2 = `square`."""
    return x[0] * y[0] + square * (x[1] * y[1]), x[0] * y[1] + x[1] * y[0]


@jit
def over(x, y, square):
    """Quotient of two such numbers."""
    size = splat(1.0) / (y[0] * y[0] - square * (y[1] * y[1]))
    real, imaginary = times(x, (y[0], 0.0 - y[1]), square)
    return real * size, imaginary * size


@jit
def start_panel(modes, first):
    """Write the classical modes `first` ... as the first guess; those behind the last repeat it."""
    m, zero, one = modes.omega.shape[0], splat(0.0), splat(1.0)
    for p in range(PANEL):
        r = min(first + p, m - 1)
        half, omega = splat(0.5) * load(modes.damping, r * m + r), load(modes.omega, r)
        gap = (half - omega) * (half + omega)
        store(modes.poles, 3 * p, zero - half)
        store(modes.poles, 3 * p + 1, square_root(magnitude(gap)))
        store(modes.poles, 3 * p + 2, where_less(gap, zero, zero - one, one))
        for s in range(m):
            row = 2 * (PANEL * s + p)
            store(modes.vectors, row, one if s == r else zero)
            store(modes.vectors, row + 1, zero)


@jit
def multiply_row(modes, s):
    """Write entry s of D x of the panel."""
    m, x = modes.omega.shape[0], modes.vectors
    a0 = a1 = a2 = a3 = b0 = b1 = b2 = b3 = splat(0.0)
    for t in range(m):
        d, k = load(modes.damping, s * m + t), 2 * PANEL * t
        a0, b0 = a0 + d * load(x, k), b0 + d * load(x, k + 1)
        a1, b1 = a1 + d * load(x, k + 2), b1 + d * load(x, k + 3)
        a2, b2 = a2 + d * load(x, k + 4), b2 + d * load(x, k + 5)
        a3, b3 = a3 + d * load(x, k + 6), b3 + d * load(x, k + 7)
    k = 2 * PANEL * s
    store(modes.products, k, a0)
    store(modes.products, k + 1, b0)
    store(modes.products, k + 2, a1)
    store(modes.products, k + 3, b1)
    store(modes.products, k + 4, a2)
    store(modes.products, k + 5, b2)
    store(modes.products, k + 6, a3)
    store(modes.products, k + 7, b3)


@jit
def improve_entry(modes, s, p, is_own, live):
    """One step for entry s of mode p of the panel, or for its pole; returns by how much it moved."""
    row, m = 2 * (PANEL * s + p), modes.omega.shape[0]
    pole, square = (load(modes.poles, 3 * p), load(modes.poles, 3 * p + 1)), load(modes.poles, 3 * p + 2)
    y, omega = (load(modes.products, row), load(modes.products, row + 1)), load(modes.omega, s)
    own_square = times(pole, pole, square)
    if is_own:
        drag = times(pole, y, square)
        left = own_square[0] + omega * omega + drag[0], own_square[1] + drag[1]
        step = over(left, (2.0 * pole[0] + y[0], 2.0 * pole[1] + y[1]), square)
        real, imaginary = pole[0] - step[0], pole[1] - step[1]
        store(modes.poles, 3 * p, where_less(splat(0.0), live, real, pole[0]))
        store(modes.poles, 3 * p + 1, where_less(splat(0.0), live, imaginary, pole[1]))
        return (magnitude(step[0]) + magnitude(step[1])) / (magnitude(real) + magnitude(imaginary))
    d, x = load(modes.damping, s * m + s), (load(modes.vectors, row), load(modes.vectors, row + 1))
    pull = times(pole, (d * x[0] - y[0], d * x[1] - y[1]), square)
    stiffness = own_square[0] + omega * omega + d * pole[0], own_square[1] + d * pole[1]
    new = over(pull, stiffness, square)
    store(modes.vectors, row, where_less(splat(0.0), live, new[0], x[0]))
    store(modes.vectors, row + 1, where_less(splat(0.0), live, new[1], x[1]))
    return magnitude(new[0] - x[0]) + magnitude(new[1] - x[1])


@jit
def settle_panel(modes, first):
    """Iterate a panel until all its modes have settled; lanes where one does not are no longer good."""
    m, zero, one = modes.omega.shape[0], splat(0.0), splat(1.0)
    live = load(modes.is_good, 0)
    for iteration in range(MAX_ITERATIONS):
        moved = zero
        for s in range(m):
            multiply_row(modes, s)
            for p in range(PANEL):
                change = improve_entry(modes, s, p, s == min(first + p, m - 1), live)
                moved = where_less(
                    change, splat(1e300), where_less(moved, change, change, moved), splat(1e300)
                )
        limit = splat(LARGE if iteration >= EARLY else 1e100)
        lost = where_less(zero, live, where_less(moved, limit, zero, one), zero)
        store(modes.is_good, 0, load(modes.is_good, 0) - lost)
        enough = splat(SETTLED if iteration < 2 * EARLY else STALLED)
        live = where_less(zero, lost, zero, where_less(moved, enough, zero, live))
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
def input_factor(modes, p):
    """x'Gamma / (x' (2 lambda + D) x) of mode p of the panel."""
    m, x, zero = modes.omega.shape[0], modes.vectors, splat(0.0)
    square = load(modes.poles, 3 * p + 2)
    pole = 2.0 * load(modes.poles, 3 * p), 2.0 * load(modes.poles, 3 * p + 1)
    real = imaginary = norm_real = norm_imaginary = zero
    for s in range(m):
        row, weight = 2 * (PANEL * s + p), load(modes.participation, s)
        entry = load(x, row), load(x, row + 1)
        real, imaginary = real + weight * entry[0], imaginary + weight * entry[1]
        twice = times(pole, entry, square)
        y = load(modes.products, row), load(modes.products, row + 1)
        term = times(entry, (twice[0] + y[0], twice[1] + y[1]), square)
        norm_real, norm_imaginary = norm_real + term[0], norm_imaginary + term[1]
    return over((real, imaginary), (norm_real, norm_imaginary), square)


@jit
def check_sums(modes, n_sensors):
    """Take the lanes out of the good ones where modes are missing, or residues cancel."""
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
    passed = where_less(whole, CANCELLING * scale, passed, zero)
    store(modes.is_good, 0, load(modes.is_good, 0) * passed)
