"""Complex modes of structures whose damping couples the classical ones, one structure in each vector lane.

In classical modes q" + D q' + Omega^2 q = -Gamma a, D symmetric. A complex mode (lambda, x) satisfies

    (lambda^2 + omega_s^2) x_s + lambda (D x)_s = 0   for all s.

Starting from classical mode r, x_r = 1, what is left of the equations s != r, with the newest values of the
others, is divided by lambda^2 + d_s lambda + omega_s^2, which gives a step of x_s, and equation r is a Newton
step for lambda, until nothing moves. That divisor need not be exact: it is computed anew while vectors still
move much. Modes go in panels of two, whose vectors stay in the first-level cache.

Each mode stands for a pair: lambda = a + i b and a - i b, with i^2 = -1, or two real ones where the mode is
overdamped, then with i^2 = +1, which changes nothing but a sign in products. A pair marches as one oscillator
with the frequency and damping of its product and sum, lambda_1 lambda_2 and -(lambda_1 + lambda_2), and its
residues u_j x'Gamma / (x' (2 lambda + D) x) give what the sensors see of its displacement and velocity.

Numbers a + b i with i^2 = -1, or +1 where both poles of a pair of modes are real, one in each lane.

Residues of pairs of complex modes, and whether all pairs are there, see `complex_modes`.

That all pairs are found, and none twice, shows in the sums of the residues: of all pairs they are zero, and
times lambda S Phi Gamma.

Pairs of complex modes as the march takes them: each twice, seen by its displacement and by its velocity.

Both poles of a pair make up an oscillator q" + d q' + s q = -a with s their product and d less their sum, and
what a sensor sees of the pair is a combination of q and q'.
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
from pymc_features.simulators.compiled.vector_memory import new_vectors, read_lanes, write_lanes
from pymc_features.simulators.eigen.matrices import PANEL, multiply_rows, multiply_two_rows
from pymc_features.simulators.oscillators.arguments import RELATIVE_DISPLACEMENT, RELATIVE_VELOCITY
from pymc_features.simulators.oscillators.modal_lanes import clear


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
def impedance(pole, square, omega, d):
    """lambda^2 + d lambda + omega^2."""
    own = times(pole, pole, square)
    return own[0] + omega * omega + d * pole[0], own[1] + d * pole[1]


MAX_ITERATIONS = 80
EARLY, LARGE = 12, 0.02  # a vector that moves that much after so many iterations will not settle
RENEWED = 1e-4  # a vector that moves less needs no new inverses
SETTLED = 1e-14  # change of a vector whose own entry is one, all entries together
NEARLY, SHRINKING = 2e-9, 0.1  # changes and their rates, below which they foretell the rest
FORESEEN = 3e-11  # what may be left then: no modes are close, and errors not magnified
STALLED = 1e-12  # change that is taken for rounding after twice as many iterations


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
    inverses : array (2 PANEL m, LANES)
        1 / (lambda^2 + d_s lambda + omega_s^2), in the same order, of poles that were near enough.
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
    inverses: np.ndarray
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
        inverses=new_vectors(2 * PANEL * n_modes),
        poles=new_vectors(3 * PANEL),
        sums=new_vectors(3 * n_sensors),
    )


class ModePlaces(NamedTuple):
    """Number of modes, and addresses of the arrays of `ComplexLanes`."""

    m: int
    damping: int
    omega: int
    participation: int
    seen: int
    vectors: int
    products: int
    inverses: int
    poles: int
    sums: int


@jit
def mode_places(modes):
    """Addresses of the arrays, see `compiled.vector_memory.aligned`."""
    return ModePlaces(
        modes.omega.shape[0],
        modes.damping.ctypes.data,
        modes.omega.ctypes.data,
        modes.participation.ctypes.data,
        modes.seen.ctypes.data,
        modes.vectors.ctypes.data,
        modes.products.ctypes.data,
        modes.inverses.ctypes.data,
        modes.poles.ctypes.data,
        modes.sums.ctypes.data,
    )


@jit
def start_panel(modes, first):
    """Write a first guess of the modes `first` ...; what stands behind the last mode repeats it.

    The poles are classical, the vectors what one step makes of classical ones.
    """
    at, zero, one = mode_places(modes), splat(0.0), splat(1.0)
    m = at.m
    for p in range(PANEL):
        r = min(first + p, m - 1)
        half, omega = splat(0.5) * read_lanes(at.damping, r * m + r), read_lanes(at.omega, r)
        gap = (half - omega) * (half + omega)
        square = where_less(gap, zero, zero - one, one)
        pole = zero - half, square_root(magnitude(gap))
        write_lanes(at.poles, 3 * p, pole[0])
        write_lanes(at.poles, 3 * p + 1, pole[1])
        write_lanes(at.poles, 3 * p + 2, square)
    write_inverses(at, first, one)
    for p in range(PANEL):
        r = min(first + p, m - 1)
        pole, square = pole_of(at, p)
        for s in range(m):
            row, coupling = 2 * (PANEL * s + p), zero - read_lanes(at.damping, s * m + r)
            inverse = read_lanes(at.inverses, row), read_lanes(at.inverses, row + 1)
            x = times((pole[0] * coupling, pole[1] * coupling), inverse, square)
            write_lanes(at.vectors, row, one if s == r else x[0])
            write_lanes(at.vectors, row + 1, zero if s == r else x[1])


@jit
def pole_of(at, p):
    """Pole of mode p of the panel, and i^2."""
    a, b = read_lanes(at.poles, 3 * p), read_lanes(at.poles, 3 * p + 1)
    return (a, b), read_lanes(at.poles, 3 * p + 2)


@jit
def write_inverses(at, first, where):
    """Write 1 / (lambda^2 + d_s lambda + omega_s^2) of a panel in the lanes where `where` is positive."""
    m, zero, one = at.m, splat(0.0), splat(1.0)
    for p in range(PANEL):
        r = min(first + p, m - 1)
        pole, square = pole_of(at, p)
        for s in range(m):
            if s != r:
                row, d = 2 * (PANEL * s + p), read_lanes(at.damping, s * m + s)
                old = read_lanes(at.inverses, row), read_lanes(at.inverses, row + 1)
                new = over((one, zero), impedance(pole, square, read_lanes(at.omega, s), d), square)
                write_lanes(at.inverses, row, where_less(zero, where, new[0], old[0]))
                write_lanes(at.inverses, row + 1, where_less(zero, where, new[1], old[1]))


@jit
def improve_pole(at, r, p, live):
    """One Newton step for the pole of mode p of the panel, number r; returns by how much it moved."""
    row, omega = 2 * (PANEL * r + p), read_lanes(at.omega, r)
    pole, square = pole_of(at, p)
    y = read_lanes(at.products, row), read_lanes(at.products, row + 1)
    own_square, drag = times(pole, pole, square), times(pole, y, square)
    left = own_square[0] + omega * omega + drag[0], own_square[1] + drag[1]
    step = over(left, (2.0 * pole[0] + y[0], 2.0 * pole[1] + y[1]), square)
    real, imaginary = pole[0] - step[0], pole[1] - step[1]
    write_lanes(at.poles, 3 * p, where_less(splat(0.0), live, real, pole[0]))
    write_lanes(at.poles, 3 * p + 1, where_less(splat(0.0), live, imaginary, pole[1]))
    return (magnitude(step[0]) + magnitude(step[1])) / (magnitude(real) + magnitude(imaginary))


@jit
def improve_rows(at, rows, first, live, moved):
    """One step for some entries of the panel, from row to row; adds to `moved` by how much they moved."""
    m, zero = at.m, splat(0.0)
    for p in range(PANEL):
        r, (pole, square) = min(first + p, m - 1), pole_of(at, p)
        own_square = times(pole, pole, square)
        turned = square * own_square[1], square * pole[1]
        for s in range(rows[0], rows[1]):
            if s == r:
                moved = moved + improve_pole(at, r, p, live)
                pole, square = pole_of(at, p)
                own_square = times(pole, pole, square)
                turned = square * own_square[1], square * pole[1]
                continue
            row, omega = 2 * (PANEL * s + p), read_lanes(at.omega, s)
            y = read_lanes(at.products, row), read_lanes(at.products, row + 1)
            x = read_lanes(at.vectors, row), read_lanes(at.vectors, row + 1)
            own = own_square[0] + omega * omega
            left = own * x[0] + turned[0] * x[1] + pole[0] * y[0] + turned[1] * y[1]
            beside = own * x[1] + own_square[1] * x[0] + pole[0] * y[1] + pole[1] * y[0]
            inverse = read_lanes(at.inverses, row), read_lanes(at.inverses, row + 1)
            step = times((left, beside), inverse, square)
            write_lanes(at.vectors, row, where_less(zero, live, x[0] - step[0], x[0]))
            write_lanes(at.vectors, row + 1, where_less(zero, live, x[1] - step[1], x[1]))
            moved = moved + (magnitude(step[0]) + magnitude(step[1]))
    return moved


@jit
def sweep_panel(at, first, live):
    """Improve all entries and poles of a panel once; returns by how much they moved, NaN included."""
    m, moved = at.m, splat(0.0)
    for s in range(0, m, 4):
        if m - s > 2:
            multiply_rows(at, s, live)
        else:
            multiply_two_rows(at, s, live)
        moved = improve_rows(at, (s, min(s + 4, m)), first, live, moved)
    return moved


@jit
def settle_panel(modes, first):
    """Iterate a panel until all its modes have settled; lanes where one does not are no longer good.

    Near a coalescence every other change is small. So it is the larger of the last two that tells, or, where
    they shrink fast, what follows from the last one and the larger of the last two rates.
    """
    zero, one = splat(0.0), splat(1.0)
    at = mode_places(modes)
    live, before, last_rate, renewed = load(modes.is_good, 0), splat(1e100), one, zero
    for iteration in range(MAX_ITERATIONS):
        if highest(renewed) > 0.0:
            write_inverses(at, first, renewed)
        moved = sweep_panel(at, first, live)
        limit = splat(LARGE if iteration >= EARLY else 1e100)
        lost = where_less(zero, live, where_less(moved, limit, zero, one), zero)
        store(modes.is_good, 0, load(modes.is_good, 0) - lost)
        rate = larger(moved / before, last_rate)
        is_foreseen = where_less(moved, splat(NEARLY), where_less(rate, splat(SHRINKING), one, zero), zero)
        left = where_less(zero, is_foreseen, moved * rate, larger(moved, before))
        slowly = splat(SETTLED if iteration < 2 * EARLY else STALLED)
        enough = where_less(zero, is_foreseen, splat(FORESEEN), slowly)
        live = where_less(zero, lost, zero, where_less(left, enough, zero, live))
        before, last_rate = moved, moved / before
        renewed = where_less(splat(RENEWED), moved, live, zero)
        if not highest(live) > 0.0:
            return
    store(modes.is_good, 0, load(modes.is_good, 0) - live)


COMPLETE = 1e-9  # error of the sums of residues beside the sum of their classical absolute values
CANCELLING = 1e5  # residues above that many times the classical ones: two modes, or both of a pair, coalesce


@jit
def add_to_sums(at, j, pole, residue):
    """Add the residue of a pair at sensor j to the sums that are checked; `pole` is a, b and i^2."""
    a, b, square = pole
    speed, rate = 2.0 * residue[0], 2.0 * (a * residue[0] + square * (b * residue[1]))
    whole = magnitude(a * residue[0]) + magnitude(b * residue[1]) + magnitude(a * residue[1])
    write_lanes(at.sums, 3 * j, read_lanes(at.sums, 3 * j) + speed)
    write_lanes(at.sums, 3 * j + 1, read_lanes(at.sums, 3 * j + 1) + rate)
    write_lanes(at.sums, 3 * j + 2, read_lanes(at.sums, 3 * j + 2) + whole + magnitude(b * residue[0]))


@jit
def at_sensor(at, j, p):
    """Mode p of the panel at sensor j, as (real, imaginary)."""
    m, x = at.m, at.vectors
    real = imaginary = splat(0.0)
    for s in range(m):
        row, weight = 2 * (PANEL * s + p), read_lanes(at.seen, j * m + s)
        real, imaginary = real + weight * read_lanes(x, row), imaginary + weight * read_lanes(x, row + 1)
    return real, imaginary


@jit
def norm(at, p):
    """1 / x' (2 lambda + D) x of mode p of the panel."""
    m, x, zero = at.m, at.vectors, splat(0.0)
    pole, square = pole_of(at, p)
    real = imaginary = zero
    for s in range(m):
        row = 2 * (PANEL * s + p)
        entry, y = (
            (read_lanes(x, row), read_lanes(x, row + 1)),
            (read_lanes(at.products, row), read_lanes(at.products, row + 1)),
        )
        twice = times((2.0 * pole[0], 2.0 * pole[1]), entry, square)
        term = times(entry, (twice[0] + y[0], twice[1] + y[1]), square)
        real, imaginary = real + term[0], imaginary + term[1]
    return over((splat(1.0), zero), (real, imaginary), square)


@jit
def input_factor(at, p):
    """x'Gamma / x' (2 lambda + D) x of mode p of the panel."""
    real = imaginary = splat(0.0)
    for s in range(at.m):
        row, weight = 2 * (PANEL * s + p), read_lanes(at.participation, s)
        real = real + weight * read_lanes(at.vectors, row)
        imaginary = imaginary + weight * read_lanes(at.vectors, row + 1)
    return times((real, imaginary), norm(at, p), read_lanes(at.poles, 3 * p + 2))


@jit
def check_sums(modes, n_sensors, cancelling):
    """Take the lanes out of the good ones where modes are missing, or residues cancel.

    `cancelling` is how many times larger than the classical ones the residues may be.
    """
    m, zero, one = modes.omega.shape[0], splat(0.0), splat(1.0)
    scale = wrong = left = whole = fastest = not_numbers = zero
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
        not_numbers = not_numbers + zero * load(modes.sums, 3 * j + 2)  # NaN is passed over by `larger`
    passed = where_less(left, COMPLETE * scale, one, zero)
    passed = where_less(wrong, COMPLETE * scale, passed, zero)
    passed = where_less(whole, cancelling * scale, passed, zero)
    passed = where_less(not_numbers, one, passed, zero)
    store(modes.is_good, 0, load(modes.is_good, 0) * passed)


class Pairs(NamedTuple):
    """Pairs of structures, one in each lane.

    Attributes
    ----------
    stiffness, drag : array (m, LANES)
        s and d.
    shapes : array (2 s m, LANES)
        Before q and q' of pair r at sensor j, in rows 2 (j m + r) ...
    forced : array (s, LANES)
        S iota less S Phi Gamma.
    """

    stiffness: np.ndarray
    drag: np.ndarray
    shapes: np.ndarray
    forced: np.ndarray


@jit
def new_oscillator_pairs(m, n_sensors):
    """Room for m pairs."""
    return Pairs(new_vectors(m), new_vectors(m), new_vectors(2 * n_sensors * m), new_vectors(n_sensors))


@jit
def write_shares(pairs, at, r, p, quantity):
    """Write pair r, place p of the panel, and what sensors see of it; add it to the sums that are checked.

    `at` are the places of the complex modes.
    """
    (a, b), square = pole_of(at, p)
    stiffness, drag, factor = a * a - square * (b * b), 0.0 - 2.0 * a, input_factor(at, p)
    store(pairs.stiffness, r, stiffness)
    store(pairs.drag, r, drag)
    m = pairs.stiffness.shape[0]
    for j in range(pairs.forced.shape[0]):
        residue = times(at_sensor(at, j, p), factor, square)
        speed, size = 2.0 * residue[0], 2.0 * (a * residue[0] - square * (b * residue[1]))
        by_q, by_v = 0.0 - size, speed
        rate = by_q - drag * by_v  # of q' in the velocity, and of the input in the acceleration
        add_to_sums(at, j, (a, b, square), residue)
        if quantity != RELATIVE_DISPLACEMENT:
            by_q, by_v = 0.0 - stiffness * by_v, rate
            if quantity != RELATIVE_VELOCITY:
                by_q, by_v = 0.0 - stiffness * by_v, by_q - drag * by_v
        store(pairs.shapes, 2 * (j * m + r), by_q)
        store(pairs.shapes, 2 * (j * m + r) + 1, by_v)


@jit
def write_pairs(pairs, modes, n_sensors, quantity):
    """Find and write the complex modes of all lanes; `modes.is_good` tells which came out right."""
    m, at = modes.omega.shape[0], mode_places(modes)
    for i in range(3 * n_sensors):
        store(modes.sums, i, splat(0.0))
    for first in range(0, m, PANEL):
        start_panel(modes, first)
        settle_panel(modes, first)
        for p in range(min(PANEL, m - first)):
            write_shares(pairs, at, first + p, p, quantity)
    check_sums(modes, n_sensors, CANCELLING)


@jit
def fill_lanes(lot, pairs, is_good):
    """Write the pairs of good lanes, `is_good` (1, LANES), as displacements, then as velocities."""
    m = pairs.stiffness.shape[0]
    for lane in range(lot.is_there.size):
        lot.is_there[lane] = is_good[0, lane] > 0.0
        if not lot.is_there[lane]:
            clear(lot, lane)
            continue
        for r in range(2 * m):
            lot.squares[r, lane], lot.damping[r, lane] = pairs.stiffness[r % m, lane], pairs.drag[r % m, lane]
            lot.moves[r, lane] = lot.participation[r, lane] = 1.0
            for j in range(lot.n_sensors):
                lot.shapes[j * lot.n_all + r, lane] = pairs.shapes[2 * (j * m + r % m) + r // m, lane]
        for j in range(lot.n_sensors):
            lot.forced[j, lane] = pairs.forced[j, lane]
