"""Files made to hang a reader, to fill the memory, or to be read as something else."""

import time
import tracemalloc
import zipfile

import h5py
import numpy as np
import pytest
from scipy import sparse
from scipy.io import mmread, mmwrite, savemat

from pymc_features import read_channels, read_matrices, read_record
from pymc_features.io.reading.lines import ALWAYS
from support import record_files as files
from support.refusals import refusals

SECONDS = 4.0
N = 50_000  # characters of a crafted line

CRAFTED = {
    "brackets without end": "a[" * (N // 2),
    "labels and blanks": "a " * 20 + "(" + " " * N,
    "digits and a letter": "1" * N + "x",
    "NPTS and blanks": "NPTS" + " " * N + "DT",
    "digits and commas": "1 , " * (N // 4) + "NPTS DT",
    "returns": "\r" * N + "x",
    "quotes": '"' * N,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CRAFTED)
@pytest.mark.parametrize("suffix", [".csv", ".at2"])
def test_time_is_proportional_to_the_text(tmp_path, name, suffix):
    """Twelve crafted lines above the numbers, which took minutes by regular expressions that go back."""
    path = tmp_path / f"crafted{suffix}"
    text = "\n".join(["title", *[CRAFTED[name]] * 12, "0.00,0.1", "0.02,0.2", ""])
    path.write_text(text, newline="")
    start = time.process_time()
    try:
        read_record(path, units="g", dt=0.02)
    except ValueError as error:
        assert len(str(error)) < 500
    assert time.process_time() - start < SECONDS


def peak_memory(action):
    """Bytes at most, and what is said."""
    tracemalloc.start()
    try:
        with pytest.raises((ValueError, OSError)) as caught:
            action()
        return tracemalloc.get_traced_memory()[1], str(caught.value)
    finally:
        tracemalloc.stop()


@pytest.mark.slow
@pytest.mark.parametrize("line", ["1", ""])
@pytest.mark.parametrize("suffix", [".csv", ".at2"])
def test_memory_of_many_short_lines(tmp_path, line, suffix):
    """Lines of one or two characters take no more than forty times the file."""
    path = tmp_path / f"short{suffix}"
    size = 150_000
    path.write_text((line + "\n") * (size // (len(line) + 1)) + "spoilt\n")
    used, _ = peak_memory(lambda: read_record(path, units="g", dt=0.02))
    assert used < 40 * size


def test_lines_without_end(tmp_path):
    path = tmp_path / "one_line.csv"
    path.write_text("1," * 20_000)
    with pytest.raises(ValueError, match="must hold at least 2 samples, got 1"):
        read_record(path, units="g")


def sparse_hdf5(path):
    with h5py.File(path, "w") as file:
        file.create_dataset("ag", shape=(2**40,), dtype="f8", chunks=(1024,))


def sparse_hdf5_group(path):
    with h5py.File(path, "w") as file:
        group = file.create_group("K")
        group.attrs["MATLAB_sparse"] = np.uint64(3)
        for name in ("data", "ir", "jc"):
            group.create_dataset(name, shape=(2**38,), dtype="f8", chunks=(1024,))


def promising_npy(path, shape="(1099511627776,)"):
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("K.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode())


def zipped_zeros(path):
    np.savez_compressed(path, K=np.zeros(10**7))


def mat_of_terabytes(path):
    savemat(path, {"ag": np.arange(5.0)})
    raw = bytearray(path.read_bytes())
    place = raw.index((5).to_bytes(4, "little"), 136)
    raw[place : place + 4] = (2**30).to_bytes(4, "little")
    path.write_bytes(raw)


def mat_5_that_begins_as_mat_4(path):
    """SciPy tells versions by a zero in the first four bytes, and takes memory for the name of the matrix."""
    savemat(path, {"ag": np.arange(5.0)})
    path.write_bytes(b"\0\0" + path.read_bytes()[2:])


def compressed_zeros(path):
    savemat(path, {"K": np.zeros((3000, 4000))}, do_compression=True)


PROMISES = {  # what is said: what is given
    "m.mat must be a MATLAB .mat file.*must not hold arrays of more .* got 8.8e.12": ("m.mat", sparse_hdf5),
    "m.mtx must not hold arrays": (
        "m.mtx",
        lambda p: p.write_text("%%MatrixMarket matrix array real general\n1000000 1000000\n1\n"),
    ),
    r"m.mtx must not hold arrays .* got 8e.12 b": (
        "m.mtx",
        lambda p: p.write_text("%%MatrixMarket matrix coordinate real general\n3 999999999999 1\n1 1 1\n"),
    ),
    "m.mtx, line 2: the file must hold the 999999999999 entries that it announces, got 1": (
        "m.mtx",
        lambda p: p.write_text("%%MatrixMarket matrix coordinate real general\n3 3 999999999999\n1 1 1\n"),
    ),
    "m.npz must be a NumPy file.*Unable to allocate": ("m.npz", promising_npy),
    "m.npz must not hold arrays of more": ("m.npz", zipped_zeros),
    "k.mat must be a MATLAB .mat file.*must not be larger than 6.71e.07 bytes": ("k.mat", compressed_zeros),
    "k.mat must be a MATLAB .mat file.*must not hold arrays of more .* got": ("k.mat", sparse_hdf5_group),
    "m.mat must be a MATLAB .mat file, it cannot be read": ("m.mat", mat_of_terabytes),
    "m.mat must be a MATLAB .mat file, it cannot be read .*byteswapping": (
        "m.mat",
        mat_5_that_begins_as_mat_4,
    ),
}


@pytest.mark.slow
@refusals("name write", PROMISES)
def test_promises_of_terabytes(tmp_path, name, write, match):
    """They are refused before memory is taken; what is compressed is inflated up to 64 MiB."""
    write(tmp_path / name)
    read = read_record if name == "m.mat" else read_matrices
    with pytest.raises(ValueError, match=match):
        read(tmp_path / name)
    used, _ = peak_memory(lambda: read(tmp_path / name))
    assert used < 4_000_000 + (ALWAYS if write is compressed_zeros else 0)
    if name == "m.mat":
        with pytest.raises(ValueError, match=match):
            read_channels(tmp_path / name)


@pytest.mark.parametrize(
    ("offset", "value", "message"),
    [
        (145, 0x08, "list index out of range"),  # complex, without an imaginary part
        (152, 11, "11"),  # no type of dimensions
        (128, 0x49, "a variable must be an array, type 14, got type 73"),
        (180, 0xFF, "a part announces 255 bytes, what holds it ends before"),
        (132, 0xFF, "a part announces .* bytes, what holds it ends before"),
    ],
)
def test_matlab_arrays_that_end_the_process(tmp_path, offset, value, message):
    """SciPy reads beyond the end of such arrays, or takes them as they are."""
    path = tmp_path / "m.mat"
    savemat(path, {"ag": np.arange(5.0)})
    raw = bytearray(path.read_bytes())
    raw[offset] = value
    path.write_bytes(raw)
    with pytest.raises(ValueError, match=f"m.mat must be a MATLAB .mat file, it cannot be read .*{message}"):
        read_record(path, units="g", dt=0.02)


# --- matrices that were read as others ----------------------------------------------------------


STIFFNESS = sparse.coo_array([[3.0, -1.0, 0.0], [-1.0, 2.5, -0.5], [0.0, -0.5, 1e-3]])
SYMMETRIC = "%%MatrixMarket matrix coordinate real symmetric\n2 2 4\n1 1 2\n1 2 -1\n2 1 -1\n2 2 2\n"


def wrong_bsr(path, **changed):
    matrix = sparse.bsr_array(np.kron(STIFFNESS.toarray(), np.ones((2, 2))), blocksize=(2, 2))
    sparse.save_npz(path, matrix)
    with np.load(path) as file:
        arrays = dict(file)
    np.savez(path, **(arrays | changed))


WRONG = {  # what is said: what is given
    "K.mtx: a symmetric matrix must be stored by one half, got": ("K.mtx", lambda p: p.write_text(SYMMETRIC)),
    "must hold 3 numbers in a line .*'1,5'": (
        "K.mtx",
        lambda p: p.write_text("%%MatrixMarket matrix coordinate real general\n1 1 1\n1 1 1,5\n"),
    ),
    "must hold 1 numbers in a line .*'2,5'": (
        "K.mtx",
        lambda p: p.write_text("%%MatrixMarket matrix array real general\n1 2\n1.0\n2,5\n"),
    ),
    "K.mtx: entries must stand once each": (
        "K.mtx",
        lambda p: p.write_text("%%MatrixMarket matrix coordinate real general\n2 2 2\n1 1 1\n1 1 1\n"),
    ),
    r"rows and columns must be from 1 to 2 and 2, got \[0.0, 1.0\]": (
        "K.mtx",
        lambda p: p.write_text("%%MatrixMarket matrix coordinate real general\n2 2 1\n0 1 1\n"),
    ),
    "must hold the 1 entries that it announces, got 2": (
        "K.mtx",
        lambda p: p.write_text("%%MatrixMarket matrix coordinate real general\n2 2 1\n1 1 1\n2 2 1\n"),
    ),
    "K.mtx: a skew-symmetric matrix must have no diagonal": (
        "K.mtx",
        lambda p: p.write_text("%%MatrixMarket matrix coordinate real skew-symmetric\n2 2 1\n1 1 1\n"),
    ),
    "must be real, and general, symmetric or skew-symmetric, got real symmetric, 2 x 3": (
        "K.mtx",
        lambda p: p.write_text("%%MatrixMarket matrix coordinate real symmetric\n2 3 1\n1 1 1\n"),
    ),
    "it cannot be read .Line 1: Invalid MatrixMarket header": (
        "K.mtx",
        lambda p: p.write_text("%%MatrixMarket matrix coordinate real odd\n2 2 1\n1 1 1\n"),
    ),
    "K.npz must be a NumPy file, it cannot be read .*pickled": (
        "K.npz",
        lambda p: (np.savez(p, K=np.eye(2)), p.write_bytes(p.read_bytes()[1:])),
    ),
    "K.npz must be a NumPy file": ("K.npz", lambda p: wrong_bsr(p, indices=np.array([0, 1, 0, 1, 9, 1, 2]))),
    "K.npz must be a NumPy file, it cannot": ("K.npz", lambda p: wrong_bsr(p, indptr=np.array([0, 9, 2, 7]))),
}


@refusals("name write", WRONG)
def test_matrices_that_were_read_as_others(tmp_path, name, write, match):
    write(tmp_path / name)
    with pytest.raises(ValueError, match=match):
        read_matrices(tmp_path / name)


@pytest.mark.parametrize("symmetry", ["general", "symmetric", "skew-symmetric"])
@pytest.mark.parametrize("layout", ["array", "coordinate"])
def test_matrix_market_is_read_as_scipy_does(tmp_path, symmetry, layout):
    dense = STIFFNESS.toarray()
    dense = dense - dense.T + np.triu(dense, 1) - np.triu(dense, 1).T if symmetry[0:2] == "sk" else dense
    path = tmp_path / "K.mtx"
    given = dense if layout == "array" else sparse.coo_array(dense)
    mmwrite(path, given, symmetry=symmetry, precision=17, comment="of a frame\n% of steel")
    found, theirs = read_matrices(path)["K"], mmread(path, spmatrix=False)
    if layout == "coordinate":
        found, theirs = found.toarray(), theirs.toarray()
    np.testing.assert_array_equal(found, theirs)
    np.testing.assert_array_equal(found, dense)


def test_block_sparse_matrix(tmp_path):
    wrong_bsr(tmp_path / "K.npz")
    expected = np.kron(STIFFNESS.toarray(), np.ones((2, 2)))
    np.testing.assert_array_equal(read_matrices(tmp_path / "K.npz")["K"].toarray(), expected)


def test_counts_that_no_file_holds(tmp_path):
    """The number of values in a header takes no memory by itself."""
    text = files.cosmos({"x": np.ones(80)}, 0.02).replace("     80 accel", f"{10**11:12d} accel")
    path = tmp_path / "long.v2"
    path.write_text(text)
    used, message = peak_memory(lambda: read_record(path))
    assert used < 2_000_000
    assert "(COSMOS), line" in message


MANY = [f"variable{k}" for k in range(800)]


@pytest.mark.parametrize("suffix", ["mat", "npz", "csv"])
def test_messages_list_the_first_of_many_variables(tmp_path, suffix):
    path = tmp_path / f"many.{suffix}"
    if suffix == "mat":
        savemat(path, dict.fromkeys(MANY, "text"))
    elif suffix == "npz":
        np.savez(path, **dict.fromkeys(MANY, np.array(["text"])))
    else:
        path.write_text("\n".join([",".join(MANY), *[",".join(["1.0"] * len(MANY))] * 20]) + "\n")
    with pytest.raises(ValueError, match=r"variable0.*, \.\.\. 800 in all") as caught:
        read_matrices(path) if suffix == "npz" else read_record(path, units="g", dt=0.01)
    assert len(str(caught.value)) < 1500
