"""Structural matrices: Matrix Market (.mtx), MATLAB (.mat, also v7.3) and NumPy/SciPy (.npz).

Only numbers are read, dense or sparse; no pickles, nothing in the file is executed.
"""

import warnings
import zipfile
from os import PathLike

import h5py
import numpy as np
from scipy import sparse

from pymc_features._checks import check_path, listed
from pymc_features.io.matrix_market import read_matrix_market
from pymc_features.io.reading.lines import check_readable, shortened
from pymc_features.io.reading.promise import check_promise
from pymc_features.io.tables.mat import load_hdf5, load_mat, stored_size


def read_matrices(path: str | PathLike) -> dict:
    """Read the matrices of a structure from a file.

    Parameters
    ----------
    path : str or path-like
        Matrix Market (``.mtx``, one matrix, symmetric storage completed), MATLAB (``.mat``), or NumPy
        (``.npz``, also by `scipy.sparse.save_npz`).

    Returns
    -------
    dict
        Name -> float64 array or SciPy sparse array, as in the file; the name of a single unnamed matrix
        is that of the file. Vectors, of lumped masses for example, are arrays (n,). Units are the
        file's: convert to kg, N s/m and N/m.

    Raises
    ------
    FileNotFoundError, OSError
        If there is no such file or it cannot be opened.
    ValueError
        If the suffix is none of these or the file does not hold matrices of real numbers.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
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
    except Exception as error:  # each damaged file fails in its own way, inside the parsers
        raise ValueError(
            f"{path.name} must hold matrices, it cannot be read ({shortened(error)}). Save it again."
        ) from error
    matrices = {name: value for name, value in found.items() if _is_matrix(value)}
    if not matrices:
        raise ValueError(
            f"{path.name} must hold matrices of real numbers, got "
            f"{listed(sorted(found)) if found else 'nothing'}. Save M, C and K as variables."
        )
    return {name: _as_floats(value, f"{path.name}, `{name}`") for name, value in matrices.items()}


def _read_mtx(path):
    return {path.stem: read_matrix_market(path)}


def _read_mat(path):
    if h5py.is_hdf5(path):
        return load_hdf5(path) | _load_hdf5_sparse(path)
    return {name: value for name, value in load_mat(path).items() if not name.startswith("__")}


def _load_hdf5_sparse(path):
    """MATLAB 7.3 keeps a sparse matrix as a group of compressed columns."""
    matrices = {}
    with h5py.File(path, "r") as file:
        for name in file:
            if not isinstance(file.get(name, getlink=True), h5py.HardLink):
                continue
            item = file[name]
            if not isinstance(item, h5py.Group) or "MATLAB_sparse" not in item.attrs:
                continue
            parts = [_column(item, part) for part in ("jc", "data", "ir") if part in item]
            check_promise(path, [stored_size(part) for part in parts])
            starts = _vector(item, "jc")
            shape = int(item.attrs["MATLAB_sparse"]), starts.size - 1
            parts = (_vector(item, "data"), _vector(item, "ir"), starts) if "data" in item else None
            matrices[name] = sparse.csc_array(shape if parts is None else parts, shape=shape)
            matrices[name].check_format()
    return matrices


def _column(group, name):
    """A data set of numbers stored in the file itself."""
    link = group.get(name, getlink=True)
    item = group[name] if isinstance(link, h5py.HardLink) else None
    if not isinstance(item, h5py.Dataset) or item.external or item.is_virtual or item.dtype.kind not in "iuf":
        raise ValueError(f"`{group.name}/{name}` is no vector of numbers")
    return item


def _vector(group, name):
    values = _column(group, name)[()].ravel()
    if name == "data":
        return values
    if not ((values >= 0) & (values < 2**62) & (values == np.rint(values))).all():
        raise ValueError(f"`{group.name}/{name}` must be places from 0 on")
    return values.astype(np.int64)


def _read_npz(path):
    with zipfile.ZipFile(path) as file:
        check_promise(path, [entry.file_size for entry in file.infolist()])
    with path.open("rb") as file:
        if file.read(2) != b"PK":  # NumPy would read what stands above the archive
            raise ValueError("it does not begin as an archive")
    with np.load(path, allow_pickle=False) as file:
        names = set(file.files)
        arrays = {name: _member(path, file, name) for name in file.files}
    if not {"format", "shape", "data"} <= names:
        return arrays
    check_promise(path, [8 * int(size) for size in np.ravel(arrays["shape"])])
    matrix = sparse.load_npz(path)
    if matrix.format == "bsr":
        matrix.check_format(full_check=True)  # SciPy converts a damaged one to another matrix
    matrix = sparse.csc_array(matrix)
    matrix.check_format()
    return {path.stem: matrix}


def _member(path, file, name):
    """An array of the archive, whose header may promise no more than the archive holds."""
    member = f"{name}.npy" if f"{name}.npy" in file.zip.namelist() else name
    with file.zip.open(member) as raw:
        version = np.lib.format.read_magic(raw)
        header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        shape, _, dtype = header[version](raw)
    n_bytes = dtype.itemsize
    for size in shape:
        n_bytes *= size
    if n_bytes > file.zip.getinfo(member).file_size:
        raise ValueError(f"`{name}` announces more entries than the archive holds")
    return file[name]


READERS = {".mtx": _read_mtx, ".mat": _read_mat, ".npz": _read_npz}


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
