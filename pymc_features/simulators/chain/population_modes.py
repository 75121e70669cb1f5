"""Modes of many chains at once: the QL iteration of `modes.py` in lockstep, one chain in each vector lane.

Every chain takes its own shifts and splits where it must; lanes that have nothing to do in a sweep are
turned by the identity. The result is that of `modes.chain_modes` up to rounding.
"""

import numpy as np

from pymc_features.simulators.chain.modes import MAX_ITERATIONS, is_chain
from pymc_features.simulators.compiled.arrays import ascending
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

TINY = 1e-300  # keeps quotients of zeros from becoming NaN


@jit
def splits(diagonal, off_diagonal, low):
    """For each lane, where the block that begins at `low` ends, and the diagonal entry there."""
    n = diagonal.shape[0]
    split, at_split = splat(float(n - 1)), load(diagonal, n - 1)
    for k in range(n - 2, low - 1, -1):
        entry = load(diagonal, k)
        scale = splat(2.3e-16) * (magnitude(entry) + magnitude(load(diagonal, k + 1)))
        off = magnitude(load(off_diagonal, k))
        split = where_less(scale, off, split, splat(float(k)))
        at_split = where_less(scale, off, at_split, entry)
    return split, at_split


@jit
def sweep(diagonal, off_diagonal, vectors, low, split, at_split):
    """One implicit QL sweep of the block low ... split of each lane; nothing where split = low."""
    n = diagonal.shape[0]
    zero, one, two = splat(0.0), splat(1.0), splat(2.0)
    first, off = load(diagonal, low), load(off_diagonal, low)
    safe = where_less(magnitude(off), splat(TINY), splat(TINY), off)
    shift = (load(diagonal, low + 1) - first) / (two * safe)
    root = square_root(shift * shift + one)
    g_start = at_split - first + off / (shift + where_less(shift, zero, zero - root, root))
    s = c = one
    p = zero
    g = g_start
    top = int(highest(split))
    for i in range(top - 1, low - 1, -1):
        here, above = splat(i + 0.5), splat(i + 1.5)  # split = i + 1 lies between the two
        begins = where_less(here, split, where_less(split, above, one, zero), zero)
        s, c = where_less(zero, begins, one, s), where_less(zero, begins, one, c)
        p, g = where_less(zero, begins, zero, p), where_less(zero, begins, g_start, g)
        e, d, d_next = load(off_diagonal, i), load(diagonal, i), load(diagonal, i + 1)
        f, b = s * e, c * e
        r = square_root(f * f + g * g)
        divisor = where_less(zero, r, r, one)
        new_s, new_c = f / divisor, where_less(zero, r, g / divisor, one)
        h = d_next - p
        q = (d - h) * new_s + two * new_c * b
        new_p = new_s * q
        # lanes whose block ends below i stay as they are
        s, c = where_less(here, split, new_s, zero), where_less(here, split, new_c, one)
        p, g = where_less(here, split, new_p, p), where_less(here, split, new_c * q - b, g)
        store(off_diagonal, i + 1, where_less(here, split, r, load(off_diagonal, i + 1)))
        store(diagonal, i + 1, where_less(here, split, h + new_p, d_next))
        for k in range(n):
            upper, lower = load(vectors, (i + 1) * n + k), load(vectors, i * n + k)
            store(vectors, (i + 1) * n + k, s * lower + c * upper)
            store(vectors, i * n + k, c * lower - s * upper)
    here = splat(low + 0.5)
    store(diagonal, low, where_less(here, split, first - p, first))
    store(off_diagonal, low, where_less(here, split, g, off))
    for k in range(low + 1, top + 1):
        e = load(off_diagonal, k)
        is_split = where_less(splat(k - 0.5), split, where_less(split, splat(k + 0.5), one, zero), zero)
        store(off_diagonal, k, where_less(zero, is_split, zero, e))


@jit
def diagonalise_lanes(diagonal, off_diagonal, vectors):
    """Overwrite `diagonal` (n, LANES) by the eigenvalues and `vectors` (n n, LANES) by the eigenvectors.

    As `modes.diagonalise`, for all lanes. Returns False if an eigenvalue of any lane does not converge.
    """
    n = diagonal.shape[0]
    for low in range(n - 1):
        for turn in range(MAX_ITERATIONS + 1):
            split, at_split = splits(diagonal, off_diagonal, low)
            if highest(split) == low:
                break
            if turn == MAX_ITERATIONS:
                return False
            sweep(diagonal, off_diagonal, vectors, low, split, at_split)
    return True


@jit
def fill_matrix(modes, lane, mass, stiffness):
    """Write one chain, its symmetric tridiagonal matrix, and the identity, into a lane of `ModeLanes`.

    Returns False, and leaves the matrix zero, where the parameters do not describe a chain.
    """
    n, diagonal, off_diagonal = mass.size, modes.frequencies, modes.off_diagonal
    possible = is_chain(mass, stiffness)
    for i in range(n):
        modes.mass[i, lane], modes.stiffness[i, lane] = mass[i], stiffness[i]
        above = stiffness[i + 1] if i + 1 < n else 0.0
        diagonal[i, lane] = (stiffness[i] + above) / mass[i]
        off_diagonal[i, lane] = -above / (np.sqrt(mass[i]) * np.sqrt(mass[i + 1])) if i + 1 < n else 0.0
        possible &= diagonal[i, lane] < np.inf and off_diagonal[i, lane] > -np.inf
    for i in range(n):
        modes.vectors[i * n + i, lane] = 1.0
        if not possible:
            diagonal[i, lane] = off_diagonal[i, lane] = 0.0
    return possible


@jit
def normalise_lanes(modes):
    """Turn eigenvectors into mode shapes in place: `modes.normalise` for all lanes.

    The frequencies and participation factors of `ModeLanes` are written, the off-diagonal overwritten.
    """
    _, masses, springs, frequencies, participation, work, vectors = modes
    n = masses.shape[0]
    zero, one = splat(0.0), splat(1.0)
    for i in range(n):
        store(work, i, one / square_root(load(masses, i)))
    for r in range(n):
        energy, inertia, below = zero, zero, zero
        for i in range(n):
            mass = load(masses, i)
            shape = load(vectors, r * n + i) * load(work, i)
            store(vectors, r * n + i, shape)
            drift = shape - below
            energy = energy + load(springs, i) * drift * drift
            inertia = inertia + mass * shape * shape
            below = shape
        scale = where_less(below, zero, zero - one, one) / square_root(inertia)
        total = zero
        for i in range(n):
            shape = load(vectors, r * n + i) * scale
            store(vectors, r * n + i, shape)
            total = total + load(masses, i) * shape
        store(frequencies, r, square_root(energy / inertia))
        store(participation, r, total)


@jit
def take_modes(modes, lane, omega, participation, rows):
    """Copy the modes of one lane of `ModeLanes` out of it, in ascending order of frequency."""
    n = omega.size
    order = ascending(modes.frequencies[:, lane])
    for r in range(n):
        omega[r] = modes.frequencies[order[r], lane]
        participation[r] = modes.participation[order[r], lane]
        for i in range(n):
            rows[r, i] = modes.vectors[order[r] * n + i, lane]
