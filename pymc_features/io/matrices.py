"""Structural matrices of finite-element programs, MATLAB, NumPy and SciPy.

Only numbers are read, dense or sparse; no pickles, nothing in the file is executed.
"""

import warnings
import zipfile
from os import PathLike
from pathlib import Path

import numpy as np
from scipy import sparse

from pymc_features._checks import check_path, listed
from pymc_features.io.formats.matlab import load_variables
from pymc_features.io.formats.text import read_columns
from pymc_features.io.matrix_formats import Found, read_calculix, read_harwell_boeing, read_mtx, read_nastran
from pymc_features.io.reading.lines import check_readable, check_size, shortened
from pymc_features.io.reading.recording import Request


class Matrices(dict):
    """Matrices by name.

    Attributes
    ----------
    labels : dict of str to list of str
        Degrees of freedom of the rows, as ``12:z``, of the matrices whose file names them.
    """

    def __init__(self, matrices: dict, labels: dict[str, list[str]]):
        super().__init__(matrices)
        self.labels = labels


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
    FileNotFoundError, OSError
        If there is no such file or it cannot be opened.
    ValueError
        If the suffix is none of these or the file does not hold matrices of real numbers.
    ImportError
        If the file is Nastran's and pyyeti is not installed.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "frame.npz"
    ...     np.savez(path, M=np.eye(2), K=[[2.0, -1.0], [-1.0, 1.0]])
    ...     sorted(read_matrices(path))
    ['K', 'M']
    """
    path = check_path(path)
    check_readable(path)
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise ValueError(f"`path` must end in {', '.join(READERS)}, got {path.name}. Export the matrices.")
    try:
        with warnings.catch_warnings():  # SciPy announces another class of sparse matrix
            warnings.simplefilter("ignore", DeprecationWarning)
            found = reader(path)
    except ImportError:
        raise
    except Exception as error:  # each damaged file fails in its own way, inside the parsers
        if str(error).startswith(path.name):
            raise
        raise ValueError(
            f"{path.name} must hold matrices, it cannot be read ({shortened(error)}). Save it again."
        ) from error
    matrices = {name: value for name, value in found.matrices.items() if _is_matrix(value)}
    if not matrices:
        held = listed(sorted(found.matrices)) if found.matrices else "nothing"
        raise ValueError(
            f"{path.name} must hold matrices of real numbers, got {held}. Save M, C and K as variables."
        )
    floats = {name: _as_floats(value, f"{path.name}, `{name}`") for name, value in matrices.items()}
    return Matrices(floats, {name: found.labels[name] for name in floats if name in found.labels})


def _read_mat(path: Path) -> Found:
    return Found(load_variables(path))


def _read_table(path: Path) -> Found:
    """A table of numbers, with labels of the columns or without."""
    columns = read_columns(path, Request(wrapped=False))
    labels = [label.text for label in columns.labels]
    square = columns.values.shape[0] == columns.values.shape[1]
    return Found({path.stem: columns.values}, {path.stem: labels} if square and all(labels) else {})


def _read_npz(path: Path) -> Found:
    with zipfile.ZipFile(path) as file:
        check_size(path, [entry.file_size for entry in file.infolist()])
    with np.load(path, allow_pickle=False) as file:
        names = set(file.files)
        arrays = {name: file[name] for name in file.files}
    if not {"format", "shape", "data"} <= names:
        return Found(arrays)
    check_size(path, [8 * int(size) for size in np.ravel(arrays["shape"])])
    matrix = sparse.load_npz(path)
    if matrix.format == "bsr":
        matrix.check_format(full_check=True)  # SciPy converts a damaged one to another matrix
    matrix = sparse.csc_array(matrix)
    matrix.check_format()
    return Found({path.stem: matrix})


READERS = {
    ".mtx": read_mtx,
    ".mat": _read_mat,
    ".npz": _read_npz,
    **dict.fromkeys((".sti", ".mas"), read_calculix),
    **dict.fromkeys((".hb", ".rsa", ".rua", ".matrix"), read_harwell_boeing),
    **dict.fromkeys((".op4", ".pch", ".bdf"), read_nastran),
    **dict.fromkeys((".csv", ".txt"), _read_table),
}


def _is_matrix(value) -> bool:
    """A matrix or vector of real numbers, of more than one entry or one by one."""
    return (
        hasattr(value, "dtype")
        and value.dtype.kind in "biuf"
        and value.ndim in (1, 2)
        and min(value.shape) > 0
    )


def _as_floats(value, where):
    if sparse.issparse(value):
        value = sparse.csc_array(value, dtype=np.float64)
        entries = value.data
    else:
        value = np.array(value, dtype=np.float64)
        entries = value
        if value.ndim == 2 and 1 in value.shape and value.size > 1:
            value = value.ravel()  # MATLAB has no vectors
    if not np.isfinite(entries).all():
        raise ValueError(f"{where}: entries must be finite numbers, got NaN or infinity. Correct them first.")
    return value
