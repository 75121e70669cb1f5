"""Matrix Market files of real matrices: every token is checked, which SciPy's reader does not.

SciPy takes "1,5" for 1, doubles what a symmetric file holds in both halves, and takes memory for whatever
the header promises.

Boisvert, R. F., Pozo, R. and Remington, K. A. (1996), The Matrix Market Exchange Formats, NISTIR 5935.
"""

from pathlib import Path

import numpy as np
from scipy import sparse

from pymc_features.io.reading.lines import Lines, to_count
from pymc_features.io.reading.promise import check_promise

MOST_ROWS = 10**6  # of a sparse matrix with fewer bytes in its file
SIGNS = {"general": 0.0, "symmetric": 1.0, "skew-symmetric": -1.0}  # of the half that is not stored


def read_matrix_market(path: Path):
    """A dense or sparse matrix (n, m) of a Matrix Market file.

    Returns
    -------
    ndarray or coo_array
        Complex numbers are not read; the array is empty and complex then.

    Raises
    ------
    ValueError
        If the file is broken; the message names the line.
    """
    lines = Lines(path)
    words = lines.take("a banner").lower().split()
    if len(words) != 5 or words[0] != "%%matrixmarket" or words[1] != "matrix":
        raise lines.error(
            'the banner must be as "%%MatrixMarket matrix coordinate real general"', repr(words[:5])
        )
    layout, field, symmetry = words[2:]
    if field == "complex":
        return np.empty((1, 1), dtype=complex)
    if layout not in ("coordinate", "array") or field not in ("real", "double", "integer"):
        raise lines.error("the matrix must be stored as real coordinates or array", f"{layout} {field}")
    if symmetry not in SIGNS:
        raise lines.error("the symmetry must be general, symmetric or skew-symmetric", symmetry)
    sizes = _sizes(lines, 3 if layout == "coordinate" else 2)
    if SIGNS[symmetry] and sizes[0] != sizes[1]:
        raise lines.error("a symmetric matrix must be square", f"{sizes[0]} x {sizes[1]}")
    if layout == "array":
        return _dense(path, lines, sizes, SIGNS[symmetry])
    return _sparse(path, lines, sizes, SIGNS[symmetry])


def _sizes(lines: Lines, count: int) -> list[int]:
    """Rows, columns and stored entries, below the comments."""
    while (line := lines.take("the size of the matrix")).startswith("%") or not line.strip():
        pass
    sizes = [to_count(word) for word in line.split()]
    if len(sizes) != count or any(size is None or size < 1 for size in sizes[:2]) or None in sizes:
        raise lines.error(f"the size must be {count} whole numbers", repr(line.strip()[:60]))
    return sizes


def _dense(path, lines, sizes, sign):
    """Columns one below the other; of symmetric ones the part from the diagonal on, of skew ones below it."""
    n_rows, n_columns = sizes
    check_promise(path, [8 * n_rows * n_columns])
    first = {0.0: None, 1.0: 0, -1.0: 1}[sign]
    stored = np.ones((n_columns, n_rows), dtype=bool)
    if first is not None:
        stored = np.triu(stored, first)
    values = lines.rows(int(stored.sum()), 1, "entries", finite=False)[:, 0]
    _end(lines)
    matrix = np.zeros((n_columns, n_rows))
    matrix[stored] = values
    return matrix.T if first is None else matrix.T + sign * np.triu(matrix, 1)


def _sparse(path, lines, sizes, sign):
    """Row, column and value of each entry; of a symmetric matrix only those of one half."""
    n_rows, n_columns, count = sizes
    if max(n_rows, n_columns) > max(path.stat().st_size, MOST_ROWS):
        check_promise(path, [8 * n_rows, 8 * n_columns])
    entries = lines.rows(count, 3, "entries", finite=False)
    _end(lines)
    places = entries[:, :2]
    if (places != np.rint(places)).any() or (places < 1).any() or (places > sizes[:2]).any():
        wrong = places[((places != np.rint(places)) | (places < 1) | (places > sizes[:2])).any(axis=1)][0]
        raise ValueError(
            f"{path.name}: rows and columns must be from 1 to {n_rows} and {n_columns}, got {wrong.tolist()}."
        )
    rows, columns = (places - 1).astype(np.int64).T
    values = entries[:, 2]
    if sign:
        off = rows != columns
        if (rows > columns).any() and (rows < columns).any():
            raise ValueError(
                f"{path.name}: a symmetric matrix must be stored by one half, got entries in both. Write "
                "general in its first line if both halves are complete."
            )
        if sign < 0.0 and not off.all():
            raise ValueError(
                f"{path.name}: a skew-symmetric matrix must have no diagonal, got entries there."
            )
        rows, columns = np.r_[rows, columns[off]], np.r_[columns, rows[off]]
        values = np.r_[values, sign * values[off]]
    matrix = sparse.coo_array((values, (rows, columns)), shape=(n_rows, n_columns))
    if len(np.unique(rows * n_columns + columns)) < rows.size:
        raise ValueError(
            f"{path.name}: entries must stand once each, got several at one place. Add them first."
        )
    return matrix


def _end(lines):
    if (line := lines.peek()) is not None:
        raise lines.error("nothing may follow the entries that the size announces", repr(line.strip()[:60]))
