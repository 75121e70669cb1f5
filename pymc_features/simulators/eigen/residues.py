"""Residues of pairs of complex modes, and whether all pairs are there, see `complex_modes`.

That all pairs are found, and none twice, shows in the sums of the residues: of all pairs they are zero, and
times lambda S Phi Gamma.
"""

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import load, magnitude, splat, store, where_less
from pymc_features.simulators.compiled.vector_math import larger
from pymc_features.simulators.compiled.vector_memory import read_lanes, write_lanes
from pymc_features.simulators.eigen.complex_modes import PANEL, pole_of
from pymc_features.simulators.eigen.pair_numbers import over, times

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
