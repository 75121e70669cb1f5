"""From derivatives by reduced matrices to those by what parameters change in K and M.

With C the derivative by the reduced Phi' A Phi, an entry (i, k) of A has the derivative (Phi C Phi')_ik; one
of M besides (Phi g)_i iota_k, by the load M iota.

A spring of a chain is not four entries but its drift, with the row v = phi_i - phi_(i-1) of the modes: its
derivative v C v' is right to the last digits where the spring is all but rigid. The entries are nearly equal
there, and their difference would be noise.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.numbers.compiled_numbers import lanes, new_four
from pymc_features.simulators.numbers.rows import view
from pymc_features.simulators.oscillators.modal_lanes import new_rows
from pymc_features.simulators.oscillators.samples import four, new_numbers, put_four


class Terms(NamedTuple):
    """What parameters change in a symmetric matrix: theta[parameter] factor at (row, column), its lower half.

    Entries that several parameters change follow each other.
    """

    row: np.ndarray
    column: np.ndarray
    parameter: np.ndarray
    factor: np.ndarray


@jit
def new_terms(count):
    """Room for terms."""
    integers = np.zeros((3, count), dtype=np.int64)
    return Terms(integers[0], integers[1], integers[2], np.zeros(count))


@jit
def put_term(terms, k, row, column, parameter, factor):
    """Write one term."""
    terms.row[k], terms.column[k], terms.parameter[k], terms.factor[k] = row, column, parameter, factor


@jit
def terms_of(stack, n):
    """Terms of a stack (1 + p, n n) or, of a constant matrix, (1, n n)."""
    count = 0
    for turn in range(2):
        terms = new_terms(count)
        count = 0
        for i in range(n):
            for k in range(i + 1):
                for term in range(1, stack.shape[0]):
                    if stack[term, i * n + k] != 0.0:
                        if turn == 1:
                            put_term(terms, count, i, k, term - 1, stack[term, i * n + k])
                        count += 1
    return terms


class Spread(NamedTuple):
    """Room for the derivatives of structures in lanes by theta: (p), (n all), (n d).

    `drifts` (n all) are those of the springs of a chain, or empty: then terms of the stiffness are entries.
    """

    by_theta: np.ndarray
    half: np.ndarray
    loads: np.ndarray
    drifts: np.ndarray


@jit
def new_spread(lot, n_theta, in_drifts, widths):
    """Room for derivatives by so many parameters."""
    n, like = lot.n_all, widths.structure
    half, loads = new_numbers((n * n + 4) * lanes(like)), new_rows(n * lot.n_inputs, like)
    return Spread(new_rows(n_theta, like), half, loads, new_rows(n * n if in_drifts else 0, like))


@jit
def write_drifts(lot, spread):
    """Write phi_i - phi_(i-1) of all springs."""
    n = lot.n_all
    for i in range(n * n):
        for lane in range(lot.is_there.size):
            below = lot.at[i - n, lane] if i >= n else 0.0
            spread.drifts[i, lane] = lot.at[i, lane] - below


@jit
def write_half(at, matrix, spread, n, widths):
    """Write Phi C, four modes at a time: what stands behind the last is overwritten, or of no consequence.

    `at` is Phi, or others rows (n, n) of modes.
    """
    like = widths.structure
    half, nil = view(spread.half, like), 0.0 * like
    for b in range(n):
        for r in range(0, n, 4):
            total = new_four(nil, nil, nil, nil)
            for s in range(n):
                total = total + at[b * n + s] * four(matrix, s * n + r)
            put_four(half, b * n + r, total)


@jit
def write_loads(lot, by_load, spread, widths):
    """Write Phi g."""
    like, n, d = widths.structure, lot.n_all, lot.n_inputs
    at, loads = view(lot.at, like), view(spread.loads, like)
    for b in range(n):
        for i in range(d):
            total = 0.0 * like
            for r in range(lot.n_modes):
                total = total + at[b * n + r] * by_load[r * d + i]
            loads[b * d + i] = total


@jit
def entry_of(at, lot, spread, influence, a, b, of_mass, widths):
    """Derivative by an entry of the lower half, and by the one that is equal to it."""
    like, n, d = widths.structure, lot.n_all, lot.n_inputs
    half, loads = view(spread.half, like), view(spread.loads, like)
    even = odd = 0.0 * like
    for r in range(0, n - 1, 2):
        even = even + at[a * n + r] * half[b * n + r]
        odd = odd + at[a * n + r + 1] * half[b * n + r + 1]
    if n % 2 == 1:
        even = even + at[a * n + n - 1] * half[b * n + n - 1]
    total = (even + odd) * (1.0 if a == b else 2.0)
    if of_mass:
        for i in range(d):
            total = total + loads[a * d + i] * influence[b, i]
            if a != b:
                total = total + loads[b * d + i] * influence[a, i]
    return total


@jit
def add_terms(terms, matrix, at, lot, spread, influence, of_mass, widths):
    """Add the derivatives through one matrix, whose derivative in modes is given, to those by theta.

    `at` is Phi or, of the springs of a chain, their drifts; `influence` (n, d) are displacements under unit
    displacements of the supports.
    """
    if terms.factor.size == 0:
        return
    like, row, column = widths.structure, -1, -1
    by_theta, entry = view(spread.by_theta, like), 0.0 * like
    write_half(at, matrix, spread, lot.n_all, widths)
    for k in range(terms.factor.size):
        if terms.row[k] != row or terms.column[k] != column:
            row, column = terms.row[k], terms.column[k]
            entry = entry_of(at, lot, spread, influence, row, column, of_mass, widths)
        parameter = terms.parameter[k]
        by_theta[parameter] = by_theta[parameter] + terms.factor[k] * entry


@jit
def spread_to_theta(lot, reduced, stiffness, mass, influence, spread, widths):
    """Write the derivatives by theta; `stiffness` and `mass` are `Terms`."""
    like, springs = widths.structure, lot.at
    spread.by_theta.fill(0.0)
    if spread.drifts.shape[0] > 0:
        springs = spread.drifts
        write_drifts(lot, spread)
    write_loads(lot, view(reduced.by_load, like), spread, widths)
    for of_mass in (False, True):
        rows, matrix = (lot.at, reduced.mass) if of_mass else (springs, reduced.stiffness)
        terms = mass if of_mass else stiffness
        add_terms(terms, view(matrix, like), view(rows, like), lot, spread, influence, of_mass, widths)


@jit
def add_damping(lot, reduced, lane, rayleigh, ratios):
    """Add the derivatives of one lane by Rayleigh's pair (2,) and the ratios (>= m,)."""
    for r in range(lot.n_modes):
        by_damping, square = reduced.by_damping[r, lane], lot.squares[r, lane]
        rayleigh[0] += by_damping
        rayleigh[1] += by_damping * square
        ratios[r] += by_damping * 2.0 * np.sqrt(square)
