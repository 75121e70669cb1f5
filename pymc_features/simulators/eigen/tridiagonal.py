"""Symmetric tridiagonal eigenproblems, one in each vector lane.

The implicit QL iteration (Bowdler, Martin, Reinsch & Wilkinson, Numer. Math. 11, 293-306, 1968) in lockstep:
every lane takes its own shifts and splits where it must; lanes that have nothing to do in a sweep are turned
by the identity. Of the eigenvectors it turns only the rows that are asked for: with x any vector, its
products with all eigenvectors come out if x stands where the identity would.

The eigenvalues are right to rounding of the largest one. Where that is not enough, `twisted_vector` gives the
whole vector of one of them in O(n), and its Rayleigh quotient the digits that are missing.
"""

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.numbers.compiled_numbers import highest, magnitude, square_root, where_less
from pymc_features.simulators.numbers.vectors import load, splat, store

MAX_SWEEPS = 60  # for each eigenvalue; two or three are typical
SPLIT = 2.3e-16  # entries beside the diagonal, of its two, that are taken for zero
TINY = 1e-300  # keeps quotients of zeros from becoming NaN
LOSS = 1e-3  # eigenvalues below this share of the largest have lost digits that a quotient brings back
ROUNDS = 3  # of inverse iteration and quotient; one does in all but strongly graded matrices
SETTLED = 1e-7  # change of a quotient, whose next one is right to the square of it
APART = 1e-6  # of the largest eigenvalue: vectors of gaps above are found one by one, orthogonal to 1e-10
REACH = 1e-13  # of the largest eigenvalue: QL errs by less, and what moves further is another eigenvalue


@jit
def splits(diagonal, off_diagonal, low):
    """For each lane, where the block that begins at `low` ends, and the diagonal entry there."""
    n = diagonal.shape[0]
    split, at_split = splat(float(n - 1)), load(diagonal, n - 1)
    for k in range(n - 2, low - 1, -1):
        entry = load(diagonal, k)
        scale = splat(SPLIT) * (magnitude(entry) + magnitude(load(diagonal, k + 1)))
        off = magnitude(load(off_diagonal, k))
        split = where_less(scale, off, split, splat(float(k)))
        at_split = where_less(scale, off, at_split, entry)
    return split, at_split


@jit
def sweep(diagonal, off_diagonal, vectors, low, split, at_split):
    """One implicit QL sweep of the block low ... split of each lane; nothing where split = low."""
    width = vectors.shape[0] // diagonal.shape[0]
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
        for k in range(width):
            upper, lower = load(vectors, (i + 1) * width + k), load(vectors, i * width + k)
            store(vectors, (i + 1) * width + k, s * lower + c * upper)
            store(vectors, i * width + k, c * lower - s * upper)
    here = splat(low + 0.5)
    store(diagonal, low, where_less(here, split, first - p, first))
    store(off_diagonal, low, where_less(here, split, g, off))
    for k in range(low + 1, top + 1):
        e = load(off_diagonal, k)
        is_split = where_less(splat(k - 0.5), split, where_less(split, splat(k + 0.5), one, zero), zero)
        store(off_diagonal, k, where_less(zero, is_split, zero, e))


@jit
def diagonalise_lanes(diagonal, off_diagonal, vectors):
    """Overwrite `diagonal` (n, LANES) by the eigenvalues and turn `vectors` (n w, LANES) to their basis.

    Parameters
    ----------
    off_diagonal : array (n, LANES)
        The n - 1 entries beside the diagonal first; overwritten.
    vectors : array (n w, LANES)
        Columns of w vectors x, entry i of column k in row i w + k; afterwards their products with eigenvector
        i. Of the identity, w = n, these are the eigenvectors, in rows.

    Returns
    -------
    bool
        False if an eigenvalue of any lane does not converge.
    """
    n = diagonal.shape[0]
    for low in range(n - 1):
        for turn in range(MAX_SWEEPS + 1):
            split, at_split = splits(diagonal, off_diagonal, low)
            if highest(split) == low:
                break
            if turn == MAX_SWEEPS:
                return False
            sweep(diagonal, off_diagonal, vectors, low, split, at_split)
    return True


@jit
def twisted_vector(diagonal, off_diagonal, value, pivots, vector):
    """Write the eigenvector (n, LANES) of eigenvalues known to a few digits, its largest entry about one.

    From the triangular factors of T - value from both ends, which meet where their pivots leave least
    (Parlett & Dhillon, Linear Algebra Appl. 267, 247-279, 1997). `pivots` (2 n, LANES) is overwritten.
    """
    n = diagonal.shape[0]
    zero, one = splat(0.0), splat(1.0)
    tiny = splat(TINY)
    from_above, from_below = zero, zero  # inverse pivots
    before, behind = zero, zero  # entries beside the diagonal of the rows that the factors come from
    for i in range(n):
        k = n - 1 - i
        down = load(diagonal, i) - value - before * before * from_above
        from_above = one / where_less(magnitude(down), tiny, tiny, down)
        up = load(diagonal, k) - value - behind * behind * from_below
        from_below = one / where_less(magnitude(up), tiny, tiny, up)
        store(pivots, i, from_above)
        store(pivots, n + k, from_below)
        before = load(off_diagonal, i)
        behind = load(off_diagonal, k - 1) if k > 0 else zero
    place, least, before = zero, splat(1e308), zero
    for i in range(n):
        left, behind = load(diagonal, i) - value - before, zero
        if i < n - 1:
            behind = load(off_diagonal, i) * load(off_diagonal, i)
            left = left - behind * load(pivots, n + i + 1)
        before = behind * load(pivots, i)
        left = magnitude(left)
        place = where_less(left, least, splat(float(i)), place)
        least = where_less(left, least, left, least)
    entry = zero
    for i in range(n - 1, -1, -1):
        below = entry * (zero - load(off_diagonal, i) * load(pivots, i))
        entry = where_less(splat(i + 0.5), place, below, where_less(splat(i - 0.5), place, one, zero))
        store(vector, i, entry)
    for i in range(1, n):
        above = entry * (zero - load(off_diagonal, i - 1) * load(pivots, n + i))
        entry = where_less(place, splat(i - 0.5), above, load(vector, i))
        store(vector, i, entry)


@jit
def are_apart(values):
    """Whether no two eigenvalues of any lane are so close that their vectors must be found together."""
    n, least = values.shape[0], splat(1e300)
    largest = largest_values(values)
    for r in range(n):
        value = load(values, r)
        for s in range(r):
            gap = magnitude(value - load(values, s))
            least = where_less(gap, least, gap, least)
    return not highest(largest * APART - least) > 0.0  # NaN is nobody's neighbour


@jit
def whole_vectors(diagonal, off_diagonal, values, pivots, vector, vectors):
    """Write the eigenvectors of eigenvalues that are apart into the rows of `vectors` (n n, LANES).

    `pivots` (2 n, LANES) and `vector` (n, LANES) are overwritten.
    """
    n = diagonal.shape[0]
    for r in range(n):
        twisted_vector(diagonal, off_diagonal, load(values, r), pivots, vector)
        square = splat(0.0)
        for i in range(n):
            entry = load(vector, i)
            square = square + entry * entry
        scale = splat(1.0) / square_root(square)
        for i in range(n):
            store(vectors, r * n + i, load(vector, i) * scale)


@jit
def eigenvectors(diagonal, off_diagonal, values, vectors, room):
    """Write eigenvalues (n, LANES) and, in rows, eigenvectors (n n, LANES); False if that fails.

    The eigenvalues alone come first; the vectors are then found one by one, where none are close: QL takes
    longer. `room` are arrays (n, LANES), (2 n, LANES) and (n, LANES).
    """
    (work, pivots, vector), n = room, diagonal.shape[0]
    for turn in range(2):
        for i in range(n):
            store(values, i, load(diagonal, i))
            store(work, i, load(off_diagonal, i))
        for i in range(n * n if turn == 1 else 0):
            store(vectors, i, splat(1.0 if i % (n + 1) == 0 else 0.0))
        if not diagonalise_lanes(values, work, vectors if turn == 1 else vectors[:0]):
            return False
        if turn == 0 and are_apart(values):
            whole_vectors(diagonal, off_diagonal, values, pivots, vector, vectors)
            break
    return True


@jit
def has_lost(value, largest):
    """One where an eigenvalue has lost digits to rounding of the largest one, zero elsewhere."""
    return where_less(value, largest * LOSS, splat(1.0), splat(0.0))


@jit
def largest_values(values):
    """Largest absolute entry of each lane."""
    largest = splat(0.0)
    for r in range(values.shape[0]):
        size = magnitude(load(values, r))
        largest = where_less(largest, size, size, largest)
    return largest
