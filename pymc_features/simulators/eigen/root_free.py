"""Eigenvalues alone of symmetric tridiagonal matrices, one in each vector lane, by QL without square roots.

The rotations of QL enter the diagonal, and the squares of the entries beside it, by their squares only
(Reinsch, Comm. ACM 16, 689, 1973, in the form of LAPACK's DSTERF). A rotation is then two quotients side by
side, where that of `tridiagonal.sweep` waits for a root and for a quotient after it.
"""

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
from pymc_features.simulators.eigen.tridiagonal import MAX_SWEEPS, SPLIT, TINY


@jit
def ends_of_blocks(diagonal, squares, low):
    """For each lane, where the block that begins at `low` ends, and the diagonal entry there."""
    n = diagonal.shape[0]
    split, at_split = splat(float(n - 1)), load(diagonal, n - 1)
    for k in range(n - 2, low - 1, -1):
        entry = load(diagonal, k)
        scale = splat(SPLIT) * (magnitude(entry) + magnitude(load(diagonal, k + 1)))
        is_split = scale * scale, load(squares, k)
        split = where_less(*is_split, split, splat(float(k)))
        at_split = where_less(*is_split, at_split, entry)
    return split, at_split


@jit
def shift_of(diagonal, squares, low):
    """Wilkinson's shift of each lane."""
    first, square = load(diagonal, low), load(squares, low)
    off = square_root(where_less(square, splat(TINY), splat(TINY), square))
    half = (load(diagonal, low + 1) - first) / (2.0 * off)
    root = square_root(half * half + 1.0)
    return first - off / (half + where_less(half, splat(0.0), 0.0 - root, root))


@jit
def sweep_squares(diagonal, squares, low, split, at_split):
    """One QL sweep of the block low ... split of each lane; nothing where split = low."""
    zero, one, tiny = splat(0.0), splat(1.0), splat(TINY)
    first, first_square, shift = load(diagonal, low), load(squares, low), shift_of(diagonal, squares, low)
    gamma_start = at_split - shift
    c, s, gamma, p = one, zero, gamma_start, gamma_start * gamma_start  # where a block ends s r is zero
    for i in range(int(highest(split)) - 1, low - 1, -1):
        here, square, alpha = splat(i + 0.5), load(squares, i), load(diagonal, i)  # split = i + 1 lies above
        r = p + square
        share, inverse = r * (one / p), one / r  # r is positive within a block
        new_c, new_s = p * inverse, square * inverse
        new_gamma = new_c * (alpha - shift) - new_s * gamma
        new_p = where_less(p, tiny, c * square, new_gamma * new_gamma * share)
        # lanes whose block ends below i stay as they are
        store(squares, i + 1, where_less(here, split, s * r, load(squares, i + 1)))
        store(diagonal, i + 1, where_less(here, split, gamma + (alpha - new_gamma), load(diagonal, i + 1)))
        c, s = where_less(here, split, new_c, c), where_less(here, split, new_s, s)
        gamma, p = where_less(here, split, new_gamma, gamma), where_less(here, split, new_p, p)
    here = splat(low + 0.5)
    store(diagonal, low, where_less(here, split, shift + gamma, first))
    store(squares, low, where_less(here, split, s * p, first_square))


@jit
def values_of_lanes(diagonal, squares):
    """Overwrite `diagonal` (n, LANES) by the eigenvalues; False if one of any lane does not converge.

    `squares` (n, LANES) are those of the n - 1 entries beside the diagonal; overwritten.
    """
    for low in range(diagonal.shape[0] - 1):
        for turn in range(MAX_SWEEPS + 1):
            split, at_split = ends_of_blocks(diagonal, squares, low)
            if highest(split) == low:
                break
            if turn == MAX_SWEEPS:
                return False
            sweep_squares(diagonal, squares, low, split, at_split)
    return True
