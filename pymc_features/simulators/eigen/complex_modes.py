"""Complex modes of structures whose damping couples the classical ones, one structure in each vector lane.

In classical modes q" + D q' + Omega^2 q = -Gamma a, D symmetric. A complex mode (lambda, x) satisfies

    (lambda^2 + omega_s^2) x_s + lambda (D x)_s = 0   for all s.

Starting from classical mode r, x_r = 1, what is left of the equations s != r, with the newest values of the
others, is divided by lambda^2 + d_s lambda + omega_s^2, which gives a step of x_s, and equation r is a Newton
step for lambda, until nothing moves. That divisor need not be exact: it is computed anew while vectors still
move much. Modes go in panels of two, whose vectors stay in the first-level cache.

Each mode stands for a pair: lambda = a + b J and a - b J, with J^2 = -1, or two real ones where the mode is
overdamped, then with J^2 = +1, which changes nothing but a sign in products. A pair marches as one
oscillator q" + d q' + s q = -a with s the product of its poles and d less their sum. Its residues
S Phi x x'Gamma / (x' (2 lambda + D) x) give what the sensors see of its displacement and velocity: the march
takes each pair twice, seen by its displacement and by its velocity.

That all pairs are found, and none twice, shows in the sums of the residues: of all pairs they are zero, and
times lambda S Phi Gamma.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.numbers.compiled_numbers import (
    highest,
    in_lanes,
    lanes,
    larger,
    magnitude,
    new_four,
    new_quadratic,
    square_root,
    where_less,
)
from pymc_features.simulators.numbers.rows import moved, view
from pymc_features.simulators.numbers.vectors import new_vectors
from pymc_features.simulators.oscillators.arguments import RELATIVE_DISPLACEMENT, RELATIVE_VELOCITY

PANEL = 2  # complex modes that are multiplied by D together
MAX_ITERATIONS = 80
EARLY, LARGE = 12, 0.02  # a vector that moves that much after so many iterations will not settle
RENEWED = 1e-4  # a vector that moves less needs no new inverses
SETTLED = 1e-14  # change of a vector whose own entry is one, all entries together
NEARLY, SHRINKING = 2e-9, 0.1  # changes and their rates, below which they foretell the rest
FORESEEN = 3e-11  # what may be left then: no modes are close, and errors not magnified
STALLED = 1e-12  # change that is taken for rounding after twice as many iterations
COMPLETE = 1e-9  # error of the sums of residues beside the sum of their classical absolute values


@jit
def number(rows, i, square):
    """Number i, of real and imaginary parts in memory; J^2 = `square`."""
    return new_quadratic(rows[2 * i], rows[2 * i + 1], square)


@jit
def put_number(rows, i, x):
    """Write the real and imaginary parts of number i."""
    rows[2 * i], rows[2 * i + 1] = x.re, x.im


@jit
def inverse(x):
    """1 / x."""
    size = 1.0 / (x.re * x.re - x.square * (x.im * x.im))
    return new_quadratic(x.re * size, (0.0 - x.im) * size, x.square)


class Pairs(NamedTuple):
    """Pairs of complex modes of structures, one in each lane, as `Rows` of lanes; two for a complex number.

    Attributes
    ----------
    damping, omega : (m m), (m)
        D and the classical frequencies [rad/s].
    shapes, participation : (s m), (m)
        Classical modes at the sensors, and Gamma.
    entries, products, inverses : (2 PANEL m)
        x, D x and 1 / (lambda^2 + d_s lambda + omega_s^2) of one panel: of entry s, each mode.
    fours, products_in_four : (m)
        The first two again, all four of an entry in one number.
    checks : (3 s)
        Sums of the residues, of lambda times them, and of the absolute values of those.
    poles : (3 m + 3)
        a, b and J^2 of all modes, and of what fills up the last panel.
    left, right : (2 m)
        1 / alpha and x'Gamma / alpha, alpha = x' (2 lambda + D) x.
    seen, vectors : (2 s m), (2 m m)
        S Phi x, and entry s of x of mode r in s m + r; the latter for gradients alone.
    sums, ground : (4 s m), (s)
        Of dL/dy_j times the output of a pole, and its derivative by lambda; of dL/dy_j times the input.
    m, s : int
        Modes and sensors.
    with_vectors : bool
        Whether x is kept.
    """

    damping: object
    omega: object
    shapes: object
    participation: object
    entries: object
    products: object
    inverses: object
    fours: object
    products_in_four: object
    checks: object
    poles: object
    left: object
    right: object
    seen: object
    vectors: object
    sums: object
    ground: object
    m: int
    s: int
    with_vectors: bool


@jit
def new_pairs(classical, damping, with_vectors):
    """Memory that the caller keeps, and `Pairs` in it, of structures whose classical modes are in lanes."""
    m, s, like = classical.n_modes, classical.n_sensors, in_lanes(0.0)
    even, panel, kept = s + s % 2, 2 * PANEL * m, 2 * m * m if with_vectors else 0
    sizes = m, panel, panel, panel, 3 * s, 3 * m + 3, 2 * m, 2 * m, 2 * even * m, kept, 4 * even * m, even
    begins, total = np.empty(len(sizes), dtype=np.int64), 0
    for i in range(len(sizes)):
        begins[i], total = total * lanes(like), total + sizes[i]
    memory = new_vectors(total)
    rows, fours = view(memory, like), view(memory, new_four(like, like, like, like))
    return memory, Pairs(
        view(damping, like),
        moved(rows, begins[0]),
        view(classical.shapes, like),
        view(classical.participation, like),
        moved(rows, begins[1]),
        moved(rows, begins[2]),
        moved(rows, begins[3]),
        moved(fours, begins[1]),
        moved(fours, begins[2]),
        moved(rows, begins[4]),
        moved(rows, begins[5]),
        moved(rows, begins[6]),
        moved(rows, begins[7]),
        moved(rows, begins[8]),
        moved(rows, begins[9]),
        moved(rows, begins[10]),
        moved(rows, begins[11]),
        m,
        s,
        with_vectors,
    )


@jit
def pole_of(rows, r):
    """Pole r, of a, b and J^2 in memory."""
    return new_quadratic(rows[3 * r], rows[3 * r + 1], rows[3 * r + 2])


@jit
def put_pole(rows, r, pole):
    """Write pole r."""
    rows[3 * r], rows[3 * r + 1], rows[3 * r + 2] = pole.re, pole.im, pole.square


@jit
def start_panel(at, first):
    """Write a first guess of the modes `first` ...; what stands behind the last mode repeats it.

    The poles are classical, the vectors what one step makes of classical ones.
    """
    m, nil, one = at.m, in_lanes(0.0), in_lanes(1.0)
    for p in range(PANEL):
        r = min(first + p, m - 1)
        half, omega = 0.5 * at.damping[r * m + r], at.omega[r]
        gap = (half - omega) * (half + omega)
        square = where_less(gap, 0.0, nil - one, one)
        put_pole(at.poles, first + p, new_quadratic(nil - half, square_root(magnitude(gap)), square))
    write_inverses(at, first, one)
    for p in range(PANEL):
        r, pole = min(first + p, m - 1), pole_of(at.poles, first + p)
        for s in range(m):
            x = number(at.inverses, PANEL * s + p, pole.square) * (pole * (nil - at.damping[s * m + r]))
            if s == r:
                x = new_quadratic(one, nil, pole.square)
            put_number(at.entries, PANEL * s + p, x)


@jit
def write_inverses(at, first, where):
    """Write 1 / (lambda^2 + d_s lambda + omega_s^2) of a panel in the lanes where `where` is positive."""
    for p in range(PANEL):
        r, pole = min(first + p, at.m - 1), pole_of(at.poles, first + p)
        own = pole * pole
        for s in range(at.m):
            if s != r:
                old = number(at.inverses, PANEL * s + p, pole.square)
                omega, d = at.omega[s], at.damping[s * at.m + s]
                new = inverse(own + pole * d + omega * omega)
                put_number(at.inverses, PANEL * s + p, where_less(0.0, where, new, old))


@jit
def improve_pole(at, first, p, r, live):
    """One Newton step for the pole of mode r, in place p of the panel; returns by how much it moved."""
    pole, omega = pole_of(at.poles, first + p), at.omega[r]
    y = number(at.products, PANEL * r + p, pole.square)
    step = (pole * pole + omega * omega + pole * y) * inverse(2.0 * pole + y)
    new = pole - step
    put_pole(at.poles, first + p, where_less(0.0, live, new, pole))
    return (magnitude(step.re) + magnitude(step.im)) / (magnitude(new.re) + magnitude(new.im))


@jit
def improve_rows(at, rows, first, live, moved):
    """One step for some entries of the panel, from row to row; adds to `moved` by how much they moved."""
    for p in range(PANEL):
        r, pole = min(first + p, at.m - 1), pole_of(at.poles, first + p)
        own = pole * pole
        for s in range(rows[0], rows[1]):
            if s == r:
                moved = moved + improve_pole(at, first, p, r, live)
                pole = pole_of(at.poles, first + p)
                own = pole * pole
                continue
            row, omega = PANEL * s + p, at.omega[s]
            x, y = number(at.entries, row, pole.square), number(at.products, row, pole.square)
            left = (own + omega * omega) * x + pole * y
            step = number(at.inverses, row, pole.square) * left
            put_number(at.entries, row, where_less(0.0, live, x - step, x))
            moved = moved + (magnitude(step.re) + magnitude(step.im))
    return moved


@jit
def multiply_rows(at, s, live):
    """Write entries s ... s + 3 of D x of the panel in the lanes that are `live`.

    What stands behind the last entry repeats it.
    """
    m, nil = at.m, in_lanes(0.0)
    s1, s2, s3 = min(s + 1, m - 1), min(s + 2, m - 1), min(s + 3, m - 1)
    a = b = c = e = new_four(nil, nil, nil, nil)
    for t in range(m):
        x = at.fours[t]
        a, b = a + at.damping[s * m + t] * x, b + at.damping[s1 * m + t] * x
        c, e = c + at.damping[s2 * m + t] * x, e + at.damping[s3 * m + t] * x
    y = at.products_in_four
    y[s], y[s1] = where_less(0.0, live, a, y[s]), where_less(0.0, live, b, y[s1])
    y[s2], y[s3] = where_less(0.0, live, c, y[s2]), where_less(0.0, live, e, y[s3])


@jit
def multiply_two_rows(at, s, live):
    """Entries s and s + 1 of `multiply_rows`, for what is left behind the last four."""
    m, nil = at.m, in_lanes(0.0)
    a = b = new_four(nil, nil, nil, nil)
    s1, y = min(s + 1, m - 1), at.products_in_four
    for t in range(m):
        x = at.fours[t]
        a, b = a + at.damping[s * m + t] * x, b + at.damping[s1 * m + t] * x
    y[s], y[s1] = where_less(0.0, live, a, y[s]), where_less(0.0, live, b, y[s1])


@jit
def sweep_panel(at, first, live):
    """Improve all entries and poles of a panel once; returns by how much they moved, NaN included."""
    moved = in_lanes(0.0)
    for s in range(0, at.m, 4):
        if at.m - s > 2:
            multiply_rows(at, s, live)
        else:
            multiply_two_rows(at, s, live)
        moved = improve_rows(at, (s, min(s + 4, at.m)), first, live, moved)
    return moved


@jit
def settle_panel(at, first, good):
    """Iterate a panel until all its modes have settled; lanes where one does not are no longer good.

    Near a coalescence every other change is small. So it is the larger of the last two that tells, or, where
    they shrink fast, what follows from the last one and the larger of the last two rates.
    """
    nil, one = in_lanes(0.0), in_lanes(1.0)
    live, before, last_rate, renewed = good, nil + 1e100, one, nil
    for iteration in range(MAX_ITERATIONS):
        if highest(renewed) > 0.0:
            write_inverses(at, first, renewed)
        moved = sweep_panel(at, first, live)
        limit = LARGE if iteration >= EARLY else 1e100
        lost = where_less(0.0, live, where_less(moved, limit, nil, one), nil)
        good = good - lost
        rate = larger(moved / before, last_rate)
        is_foreseen = where_less(moved, NEARLY, where_less(rate, SHRINKING, one, nil), nil)
        left = where_less(0.0, is_foreseen, moved * rate, larger(moved, before))
        enough = where_less(0.0, is_foreseen, FORESEEN, SETTLED if iteration < 2 * EARLY else STALLED)
        live = where_less(0.0, lost, nil, where_less(left, enough, nil, live))
        before, last_rate = moved, moved / before
        renewed = where_less(RENEWED, moved, live, nil)
        if not highest(live) > 0.0:
            return good
    return good - live


@jit
def put_pair(lot, at, first, p):
    """Write the pair in place p of the panel as march and gradients take it; add it to the checks."""
    r, pole, m, n_all, like = first + p, pole_of(at.poles, first + p), at.m, lot.n_all, in_lanes(0.0)
    squares, drags, shapes = view(lot.squares, like), view(lot.damping, like), view(lot.shapes, like)
    nothing = new_quadratic(like, like, pole.square)
    size = load = nothing
    for s in range(m):
        x = number(at.entries, PANEL * s + p, pole.square)
        size = size + x * (2.0 * (pole * x) + number(at.products, PANEL * s + p, pole.square))
        load = load + at.participation[s] * x
        if at.with_vectors:
            put_number(at.vectors, s * m + r, x)
    norm = inverse(size)
    factor = load * norm
    stiffness, drag = pole.re * pole.re - pole.square * (pole.im * pole.im), 0.0 - 2.0 * pole.re
    squares[r], squares[m + r], drags[r], drags[m + r] = stiffness, stiffness, drag, drag
    put_number(at.left, r, norm)
    put_number(at.right, r, factor)
    for j in range(at.s):
        seen = nothing
        for s in range(m):
            seen = seen + at.shapes[j * m + s] * number(at.entries, PANEL * s + p, pole.square)
        put_number(at.seen, j * m + r, seen)
        residue = seen * factor
        rate, turned = pole.re * residue.re, pole.square * (pole.im * residue.im)
        by_q, by_v = -2.0 * (rate - turned), 2.0 * residue.re
        at.checks[3 * j] = at.checks[3 * j] + by_v
        at.checks[3 * j + 1] = at.checks[3 * j + 1] + 2.0 * (rate + turned)
        whole = magnitude(pole.re * residue.re) + magnitude(pole.im * residue.im)
        whole = whole + magnitude(pole.re * residue.im) + magnitude(pole.im * residue.re)
        at.checks[3 * j + 2] = at.checks[3 * j + 2] + whole
        for _ in range(order_of(lot.quantity)):
            by_q, by_v = 0.0 - stiffness * by_v, by_q - drag * by_v
        shapes[j * n_all + r], shapes[j * n_all + m + r] = by_q, by_v


@jit
def order_of(quantity):
    """How many times the displacement is differentiated."""
    if quantity == RELATIVE_DISPLACEMENT:
        return 0
    return 1 if quantity == RELATIVE_VELOCITY else 2


@jit
def find_pairs(lot, at, good, cancelling):
    """Find and write the pairs of all lanes; returns one in the lanes where they came out right.

    Parameters
    ----------
    lot : ModalLanes
        For the pairs, each twice.
    at : Pairs
    good : lanes
        One where there is a structure.
    cancelling : float
        How many times larger than the classical ones the residues may be.
    """
    for i in range(3 * at.s):
        at.checks[i] = in_lanes(0.0)
    for first in range(0, at.m, PANEL):
        start_panel(at, first)
        good = settle_panel(at, first, good)
        for p in range(min(PANEL, at.m - first)):
            put_pair(lot, at, first, p)
    return good * passed(at, cancelling)


@jit
def passed(at, cancelling):
    """One in the lanes where no modes are missing, and residues do not cancel; zero elsewhere."""
    nil = in_lanes(0.0)
    scale = wrong = left = whole = fastest = not_numbers = nil
    for r in range(at.m):
        fastest = larger(fastest, at.omega[r])
    for j in range(at.s):
        total = size = nil
        for s in range(at.m):
            share = at.shapes[j * at.m + s] * at.participation[s]
            total, size = total + share, size + magnitude(share)
        left = larger(left, magnitude(at.checks[3 * j]) * fastest)
        wrong = larger(wrong, magnitude(at.checks[3 * j + 1] - total))
        whole, scale = larger(whole, at.checks[3 * j + 2]), larger(scale, size)
        not_numbers = not_numbers + 0.0 * at.checks[3 * j + 2]  # NaN is passed over by `larger`
    found = where_less(left, COMPLETE * scale, nil + 1.0, nil)
    found = where_less(wrong, COMPLETE * scale, found, nil)
    found = where_less(whole, cancelling * scale, found, nil)
    return where_less(not_numbers, 1.0, found, nil)
