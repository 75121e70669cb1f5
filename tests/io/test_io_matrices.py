"""Matrices of structures: round trips through every format, and files that hold something else."""

import h5py
import numpy as np
import pytest
from scipy import sparse
from scipy.io import mmwrite, savemat

from pymc_features import read_matrices
from support.refusals import refusals

DENSE = np.array([[300.0, -100.5, 0.0], [-100.5, 300.0, 1e-7], [0.0, 1e-7, 7.0]])
SPARSE = sparse.csc_array(DENSE)


def same(found, expected):
    assert sparse.issparse(found) == sparse.issparse(expected)
    assert found.dtype == np.float64
    found, expected = (a.toarray() if sparse.issparse(a) else a for a in (found, expected))
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("matrix", [DENSE, SPARSE, SPARSE.tocoo()], ids=["array", "csc", "coo"])
@pytest.mark.parametrize("symmetry", ["general", "symmetric"])
def test_matrix_market(tmp_path, matrix, symmetry):
    """The stored half of a symmetric matrix is completed."""
    mmwrite(tmp_path / "K.mtx", matrix, precision=17, symmetry=symmetry)
    assert (symmetry in (tmp_path / "K.mtx").read_text()) and list(read_matrices(tmp_path / "K.mtx")) == ["K"]
    same(read_matrices(tmp_path / "K.mtx")["K"], matrix)


def test_matlab_5(tmp_path):
    path = tmp_path / "frame.mat"
    savemat(path, {"M": np.array([1, 2, 3]), "K": DENSE, "C": sparse.csc_matrix(SPARSE), "note": "SI"})
    found = read_matrices(path)
    assert sorted(found) == ["C", "K", "M"]
    same(found["M"], np.array([1.0, 2.0, 3.0]))
    same(found["K"], DENSE)
    same(found["C"], SPARSE)


def save_v73(path, *, jc=None):
    """The layout MATLAB writes: transposed arrays, a sparse matrix as a group of compressed columns."""
    with h5py.File(path, "w") as file:
        file.create_dataset("K", data=np.arange(6.0).reshape(2, 3)).attrs["MATLAB_class"] = np.bytes_(
            "double"
        )
        group = file.create_group("C")
        group.attrs["MATLAB_sparse"] = np.uint64(3)
        group.create_dataset("data", data=SPARSE.data)
        group.create_dataset("ir", data=SPARSE.indices.astype(np.uint64))
        group.create_dataset("jc", data=(SPARSE.indptr if jc is None else jc).astype(np.uint64))
    return path


def test_matlab_73(tmp_path):
    found = read_matrices(save_v73(tmp_path / "frame.mat"))
    same(found["K"], np.arange(6.0).reshape(2, 3).T)
    same(found["C"], SPARSE)


def test_numpy(tmp_path):
    path = tmp_path / "frame.npz"
    np.savez(path, M=np.ones(3, dtype=np.float32), K=DENSE)
    found = read_matrices(path)
    same(found["M"], np.ones(3))
    same(found["K"], DENSE)
    sparse.save_npz(tmp_path / "K.npz", SPARSE.tocsr())
    same(read_matrices(tmp_path / "K.npz")["K"], SPARSE)


def test_pickles_are_not_opened(tmp_path):
    path = tmp_path / "trap.npz"
    np.savez(path, K=np.array([{}, 1], dtype=object))
    with pytest.raises(ValueError, match="trap.npz must be a NumPy file, it cannot be read .*allow_pickle"):
        read_matrices(path)


def broken_hdf5_index(path):
    save_v73(path, jc=np.array([0, 2, 5, 99]))


def hdf5_elsewhere(path):
    """A sparse matrix whose entries are in another file."""
    save_v73(path)
    with h5py.File(path, "a") as file:
        del file["C"]["data"]
        file["C"]["data"] = h5py.ExternalLink("other.mat", "/secret")


FILES_THAT_HOLD_SOMETHING_ELSE = {  # what is said: what is given
    "K.mtx must hold %%MatrixMarket above, or 3 or 5 numbers in": ("K.mtx", lambda p: p.write_text("hello")),
    "the 4 entries that it announces, got 2": (
        "K.mtx",
        lambda p: p.write_text("%%MatrixMarket matrix array real general\n2 2\n1\n2\n"),
    ),
    "K.mtx, line 0: the matrix must be real, and general, sym.*, got complex": (
        "K.mtx",
        lambda p: mmwrite(p, 1j * DENSE),
    ),
    "K.mtx, `K`: entries must be finite, got NaN": ("K.mtx", lambda p: mmwrite(p, DENSE * np.nan)),
    "K.mat must be a MATLAB .mat": ("K.mat", lambda p: p.write_bytes(b"MATLAB 5.0 MAT-file" + bytes(50))),
    "must hold matrices of real numbers, got note": ("K.mat", lambda p: savemat(p, {"note": "SI"})),
    "K.mat must be a MATLAB .mat file, it cannot be read": ("K.mat", broken_hdf5_index),
    "K.mat must be a MATLAB .mat file, it cannot be read .*NoneType": ("K.mat", hdf5_elsewhere),
    "K.npz must be a NumPy file, it cannot be read": ("K.npz", lambda p: p.write_bytes(b"PK\x03\x04")),
    "must hold matrices of real numbers, got K": ("K.npz", lambda p: np.savez(p, K=np.array(["a"]))),
    "must hold matrices of real numbers, got nothing": ("K.npz", lambda p: np.savez(p)),
    "`path` must end in .mtx, .mat, .npz, .* got K.npy. Export": ("K.npy", lambda p: np.save(p, DENSE)),
}


@refusals("name write", FILES_THAT_HOLD_SOMETHING_ELSE)
def test_files_that_hold_something_else(tmp_path, name, write, match):
    write(tmp_path / name)
    with pytest.raises(ValueError, match=match):
        read_matrices(tmp_path / name)


def test_no_file(tmp_path):
    with pytest.raises(FileNotFoundError, match="`path` must be an existing file"):
        read_matrices(tmp_path / "K.mtx")
