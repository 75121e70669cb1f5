"""Several identifications of one mode: by label, in one sense, and how much they scatter."""

import numpy as np

SAME = 0.9  # MAC of a mode that an identification found twice
LEAST = 1e-4  # standard deviation of ln f and of a shape of length one: three digits of a table are no more


def rows_by_label(groups) -> np.ndarray:
    """Rows (g, k) of the identifications of each mode, -1 where it has fewer than k, from ones (g, i)."""
    places = [np.flatnonzero(row) for row in groups]
    k = max(map(len, places))
    return np.array([np.pad(p, (0, k - len(p)), constant_values=-1) for p in places])


def by_label(values, groups, missing=0.0) -> np.ndarray:
    """Values (i, ...) of identifications as (g, k, ...)."""
    rows = rows_by_label(groups)
    found = values[rows]
    found[rows < 0] = missing
    return found


def in_one_sense(shapes, groups) -> np.ndarray:
    """Shapes (i, s) with those of one mode turned by the phases, or signs, by which they agree best.

    The Gram matrix of e^(i a_j) v has the leading eigenvector e^(i a_j). A mode with one shape keeps it.
    """
    turned = shapes.copy()
    for row in groups:
        own = np.flatnonzero(row)
        if own.size > 1 and shapes.shape[1]:
            x = unit_rows(shapes[own])
            u = np.linalg.eigh(x @ x.conj().T)[1][:, -1]
            size = np.abs(u)
            turned[own] *= np.where(size > 0.0, u.conj() / np.where(size > 0.0, size, 1.0), 1.0)[:, None]
    return turned


def unit_rows(shapes) -> np.ndarray:
    """Rows of length one; rows of zeros stay."""
    length = np.linalg.norm(shapes, axis=1, keepdims=True)
    return shapes / np.where(length > 0.0, length, 1.0)


def frequency_scatter(frequencies, sd, groups) -> np.ndarray:
    """Standard deviations (i,) of ln f^ of each identification, besides the error of the model.

    Those that were identified; where there are none, of modes with several identifications, the deviation
    from the mean of each mode, pooled over modes.
    """
    counts = groups.sum(axis=1)
    repeated = (counts @ groups) > 1
    ln_f = np.log(frequencies)
    off = ln_f - (groups @ ln_f / counts) @ groups
    pooled = np.sqrt(np.sum(off**2) / max(1.0, np.sum(counts - 1.0)))
    return np.where(repeated & (sd == 0.0), max(pooled, LEAST), sd)


def shape_scatter(shapes, known, groups) -> np.ndarray:
    """Mean square (i,) by which shapes of length one differ from the mean of their mode; zero of lone shapes.

    Pooled over modes and channels, for the channels that an identification has.
    """
    x = unit_rows(shapes)
    counts = groups @ known
    mean = groups @ x / np.maximum(counts, 1.0)
    off = np.where(known > 0.0, x - groups.T @ mean, 0.0)
    free = np.sum(np.maximum(counts - 1.0, 0.0))
    each = max(np.sum(np.abs(off) ** 2) / max(1.0, free), LEAST**2)
    has_shape = known.any(axis=1)
    repeated = (groups @ has_shape) @ groups > 1
    return np.where(has_shape & repeated, each * known.sum(axis=1), 0.0)


def doubles(ln_f, sd, shapes, known) -> np.ndarray:
    """Number (i,) of the first identification that each is the same as, its own if there is none before it.

    The same are those whose frequencies are closer than their standard deviations and whose shapes agree, at
    three channels or more.
    """
    owner = np.arange(len(ln_f))
    for i in range(len(ln_f)):
        for j in range(i):
            both = known[i] * known[j]
            x, y = shapes[i] * both, shapes[j] * both
            norms = np.linalg.norm(x) * np.linalg.norm(y)
            if (
                both.sum() > 2
                and abs(ln_f[i] - ln_f[j]) < sd[i] + sd[j]
                and abs(x @ y.conj()) ** 2 > SAME * norms**2
            ):
                owner[i] = owner[j]
                break
    return owner
