"""Structural matrices of finite-element programs, MATLAB, NumPy and SciPy.

Only numbers are read, dense or sparse, nothing in a file is executed. Each reader gives matrices by name, and
their degrees of freedom where the file, or a list beside it, names them: node and direction, as ``12:z``.

Boisvert, R. F., Pozo, R. and Remington, K. A. (1996), The Matrix Market Exchange Formats, NISTIR 5935. Duff,
I. S., Grimes, R. G. and Lewis, J. G. (1992), Users' Guide for the Harwell-Boeing Sparse Matrix Collection,
TR/PA/92/86. Dassault Systemes, Abaqus Analysis User's Guide, Generating matrices. Dhondt, G., CalculiX
CrunchiX User's Manual, *FREQUENCY, SOLVER=MATRIXSTORAGE. ANSYS, Command Reference, HBMAT.
"""

from io import StringIO
from os import PathLike
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.io import mminfo, mmread

from pymc_features._checks import check_file, listed, require
from pymc_features.io.formats.matlab import load_variables
from pymc_features.io.formats.text import read_columns
from pymc_features.io.reading.lines import Lines, by_library, check_size, column_width, shortened, to_count
from pymc_features.io.reading.recording import Request

MOST_ROWS = 10**6  # of a sparse matrix with fewer bytes in its file
SIGNS = {"general": 0.0, "symmetric": 1.0, "skew-symmetric": -1.0}  # of the half that is not stored
AXES = ("x", "y", "z", "rx", "ry", "rz")  # directions 1 to 6
ANSYS = dict(zip(("UX", "UY", "UZ", "ROTX", "ROTY", "ROTZ"), AXES, strict=True))


class Matrices(dict):
    """Matrices by name; `labels`: degrees of freedom of the rows, as ``12:z``, where the file names them."""

    def __init__(self, matrices: dict, labels: dict[str, list[str]] | None = None):
        super().__init__(matrices)
        self.labels = labels or {}


def read_mtx(path: Path) -> Matrices:
    """A matrix of Matrix Market or of Abaqus, which have the same ending."""
    lines = Lines(path)
    if not lines.raw.lstrip().lower().startswith(b"%%matrixmarket"):
        # lines of node, direction, node, direction and value, or of row, column and value
        entries, labels = _numbers(lines), []
        if entries.shape[1] == 5:
            pairs = np.vstack([entries[:, :2], entries[:, 2:4]]).astype(np.int64)
            freedoms, numbers = np.unique(pairs, axis=0, return_inverse=True)
            labels = [_label(*freedom) for freedom in freedoms]
            entries = np.column_stack([numbers.reshape(2, -1).T + 1.0, entries[:, 4]])
        return _assembled(path, entries, labels=labels)
    *shape, n_entries, layout, field, symmetry = mminfo(path)
    square, sign = shape[0] == shape[1], SIGNS.get(symmetry)
    if field not in ("real", "double", "integer") or sign is None or min(shape) < 1 or (sign and not square):
        what = f"{field} {symmetry}, {shape[0]} x {shape[1]}"
        raise lines.error("the matrix must be real, and general, symmetric or skew-symmetric", what)
    lines.number = next(number for number, line in lines if not line.startswith("%"))  # that of the size
    coordinate = layout == "coordinate"
    body = _numbers(lines, 3 if coordinate else 1)  # of 1.5x SciPy would take the beginning
    if not coordinate:
        check_size(path, [8 * shape[0] * shape[1]])
        # of symmetric ones the columns from the diagonal on stand one below the other, of skew ones below it
        n_entries = (shape[0] * (shape[0] + int(sign))) // 2 if sign else shape[0] * shape[1]
    if len(body) != n_entries:
        raise lines.error(f"the file must hold the {n_entries} entries that it announces", len(body))
    if coordinate:
        return _assembled(path, body, shape, sign)
    return Matrices({path.stem: mmread(path, spmatrix=False)})


def _numbers(lines: Lines, n_columns: int | None = None) -> np.ndarray:
    """Rows of numbers (row, column) below the header; three or five, by default, as Abaqus has them."""
    rows = [row for number, row in lines if number > lines.number and row[:1] not in "*%"]
    rows = [row.replace(",", " ") for row in rows] if n_columns is None else rows
    count = len(rows[0].split()) if rows else n_columns or 0
    try:
        if count not in ((3, 5) if n_columns is None else (n_columns,)):
            raise ValueError(f"got {count} in the first")
        return np.loadtxt(StringIO("\n".join(rows)), ndmin=2, comments=None).reshape(-1, count)
    except ValueError as error:
        what = f"{n_columns} numbers" if n_columns else "%%MatrixMarket above, or 3 or 5 numbers"
        what = f"must hold {what} in a line ({shortened(error)}). Export it again."
        raise ValueError(f"{lines.title} {what}") from None


def _assembled(path: Path, entries: np.ndarray, shape=None, sign=None, labels=()) -> Matrices:
    """The matrix of rows, columns (from 1) and values (entry, 3); `sign` of the half that is not stored."""
    places = entries[:, :2]
    shape = (len(labels) or int(places.max(initial=0)),) * 2 if shape is None else tuple(shape)
    both = (places[:, 0] > places[:, 1]).any() and (places[:, 0] < places[:, 1]).any()
    sign = float(not both) if sign is None else sign
    if max(shape) > max(path.stat().st_size, MOST_ROWS):
        check_size(path, [8 * size for size in shape])
    wrong = ((places != np.rint(places)) | (places < 1) | (places > shape)).any(axis=1)
    what = f"from 1 to {shape[0]} and {shape[1]}, got {next(iter(places[wrong].tolist()), None)}"
    require(not wrong.any(), f"{path.name}: rows and columns must be {what}. Export it again.")
    rows, columns = (places - 1).astype(np.int64).T
    values, off = entries[:, 2], rows != columns
    problem = ""
    if sign and both:
        problem = "a symmetric matrix must be stored by one half, got entries in both. Call it general"
    elif sign < 0.0 and not off.all():
        problem = "a skew-symmetric matrix must have no diagonal, got entries there. Correct it"
    elif len(np.unique(rows * shape[1] + columns)) < rows.size:
        problem = "entries must stand once each, got several at one place. Add them first"
    require(not problem, f"{path.name}: {problem}.")
    if sign:
        rows, columns = np.r_[rows, columns[off]], np.r_[columns, rows[off]]
        values = np.r_[values, sign * values[off]]
    matrix = sparse.coo_array((values, (rows, columns)), shape=shape)
    return Matrices({path.stem: matrix}, {path.stem: labels} if labels else {})


def _label(node, direction) -> str:
    """A degree of freedom by its node and its direction, 1 to 6; scalar points have none."""
    axis = int(direction)
    return f"{int(node)}:{AXES[axis - 1]}" if 1 <= axis <= 6 else str(int(node))


def read_calculix(path: Path) -> Matrices:
    """Stiffness (.sti) or mass (.mas): row, column, value; degrees of freedom in the .dof beside it."""
    beside = path.with_suffix(".dof")
    pairs = [line.split()[0].partition(".") for _, line in Lines(beside)] if beside.exists() else []
    labels = [_label(to_count(node) or 0, to_count(axis) or 0) for node, _, axis in pairs]
    return _assembled(path, _numbers(Lines(path), 3), labels=labels)


def read_harwell_boeing(path: Path) -> Matrices:
    """A real assembled matrix (RSA, RUA); HBMAT writes its degrees of freedom to a .mapping beside it."""
    lines = Lines(path, "Harwell-Boeing")
    lines.take("a title")
    counts = [to_count(word) for word in lines.take("numbers of lines").split()]
    kind, *words = lines.take("the type of the matrix").split() or [""]
    kind, sizes = kind.upper(), [to_count(word) for word in words]
    if len(counts) < 4 or len(sizes) < 3 or None in [*counts, *sizes]:
        raise lines.error("the header must state lines, rows, columns and entries")
    if kind not in ("RSA", "RUA"):
        raise lines.error("the matrix must be real and assembled, RSA or RUA", kind, "Export it so.")
    formats = lines.take("the formats")
    if len(counts) > 4 and counts[4]:
        lines.take("the right-hand side")
    n_rows, n_columns, n_entries = sizes[:3]
    check_size(path, [8 * n_columns, 16 * n_entries])
    widths = [column_width(formats[slice(*place)], 0) for place in ((0, 16), (16, 32), (32, 52))]
    starts = lines.numbers(n_columns + 1, "first entries of the columns", widths[0])
    rows = lines.numbers(n_entries, "rows of the entries", widths[1])
    values = lines.numbers(n_entries, "entries", widths[2])
    if starts[0] != 1 or (np.diff(starts) < 0).any() or starts[-1] != n_entries + 1:
        raise lines.error("the first entries of the columns must rise to the last", starts[-1])
    columns = np.repeat(np.arange(1, n_columns + 1), np.diff(starts).astype(np.int64))
    entries = np.column_stack([rows, columns, values])
    beside, labels = path.with_suffix(".mapping"), []  # lines of equation, node and name, UX or ROTZ
    if beside.exists():
        words = [line.split() for _, line in Lines(beside)]
        names = {int(row[0]): f"{row[1]}:{ANSYS[row[2]]}" for row in words if row[2:3] and row[2] in ANSYS}
        labels = [names.get(k, str(k)) for k in range(1, n_rows + 1)]
    return _assembled(path, entries, (n_rows, n_columns), float(kind == "RSA"), labels)


def read_nastran(path: Path) -> Matrices:
    """OP4, text or binary, or DMIG in a punch file, by pyyeti."""
    with by_library("pyyeti", "fe", path, "Nastran"):
        with np.printoptions():  # which pyyeti changes for all when it is imported
            from pyyeti.nastran import bulk, op4
        if path.suffix.lower() == ".op4":
            return Matrices(dict(op4.read(str(path))))
        found = bulk.rddmig(str(path))
    labels = {name: [_label(*pair) for pair in frame.index] for name, frame in found.items()}
    return Matrices({name: frame.to_numpy() for name, frame in found.items()}, labels)


def read_matrices(path: str | PathLike) -> Matrices:
    """Read the matrices of a structure from a file.

    Parameters
    ----------
    path : str or path-like
        Matrix Market or Abaqus ``*MATRIX OUTPUT`` (``.mtx``), CalculiX (``.sti``, ``.mas``, with the ``.dof``
        beside it), Harwell-Boeing as ANSYS writes it (``.hb``, ``.rsa``, ``.rua``, ``.matrix``, with the
        ``.mapping`` beside it), Nastran OP4 and DMIG (``.op4``, ``.pch``, ``.bdf``, with the extra `fe`),
        MATLAB (``.mat``), NumPy (``.npz``, also by `scipy.sparse.save_npz`), or a table of numbers
        (``.csv``, ``.txt``). Halves that symmetric formats leave out are completed.

    Returns
    -------
    Matrices
        A dict: name -> float64 array or SciPy sparse array, as in the file; the name of a single unnamed
        matrix is that of the file. Vectors, of lumped masses for example, are arrays (n,). Its attribute
        `labels` has the degrees of freedom. Units are the file's: convert to kg, N s/m and N/m.

    Raises
    ------
    FileNotFoundError, OSError, ImportError
        If there is no such file, it cannot be opened, or is Nastran's and pyyeti is not installed.
    ValueError
        If the suffix is none of these or the file does not hold matrices of real numbers.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "frame.npz"
    ...     np.savez(path, M=np.eye(2), K=[[2.0, -1.0], [-1.0, 1.0]])
    ...     sorted(read_matrices(path))
    ['K', 'M']
    """
    path = check_file(path)
    reader = READERS.get(path.suffix.lower())
    require(reader, f"`path` must end in {', '.join(READERS)}, got {path.name}. Export the matrices.")
    try:
        found = reader(path)
    except Exception as error:  # each damaged file fails in its own way, inside the parsers
        if isinstance(error, ImportError) or str(error).startswith(path.name):
            raise
        said = f"it cannot be read ({shortened(error)}). Save it again."
        raise ValueError(f"{path.name} must hold matrices, {said}") from error
    floats = {}
    for name, value in found.items():
        if getattr(value, "ndim", 0) not in (1, 2) or value.dtype.kind not in "biuf" or 0 in value.shape:
            continue
        if is_sparse := sparse.issparse(value):
            value = sparse.csc_array(value, dtype=np.float64)
        else:
            value = np.array(value, dtype=np.float64)
            value = value.ravel() if 1 in value.shape and value.size > 1 else value  # as in MATLAB
        finite = np.isfinite(value.data if is_sparse else value).all()
        require(finite, f"{path.name}, `{name}`: entries must be finite, got NaN or infinity.")
        floats[name] = value
    held = f"{listed(sorted(found)) if found else 'nothing'}. Save M, C and K as variables."
    require(floats, f"{path.name} must hold matrices of real numbers, got {held}")
    return Matrices(floats, {name: found.labels[name] for name in floats if name in found.labels})


def _read_table(path: Path) -> Matrices:
    """A table of numbers, with labels of the columns or without."""
    columns = read_columns(path, Request(wrapped=False))
    labels = [label.text for label in columns.labels]
    square = columns.values.shape[0] == columns.values.shape[1]
    return Matrices({path.stem: columns.values}, {path.stem: labels} if square and all(labels) else {})


READERS = {
    ".mtx": read_mtx,
    **dict.fromkeys((".mat", ".npz"), lambda path: Matrices(load_variables(path))),
    **dict.fromkeys((".sti", ".mas"), read_calculix),
    **dict.fromkeys((".hb", ".rsa", ".rua", ".matrix"), read_harwell_boeing),
    **dict.fromkeys((".op4", ".pch", ".bdf"), read_nastran),
    **dict.fromkeys((".csv", ".txt"), _read_table),
}
