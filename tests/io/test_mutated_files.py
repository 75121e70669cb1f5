"""Damaged copies of a file of each format: each is refused plainly, or read as what it says.

`MUTATIONS` copies of each, by fixed seeds. A longer run, without pytest: `mutate(name, folder, 5000)`.
"""

import warnings
import zlib

import h5py
import numpy as np
import obspy
import pytest
import pyuff
from scipy import sparse
from scipy.io import mmwrite, savemat

from pymc_features import read_channels, read_matrices, read_modal, read_record
from pymc_features.io import read_channels_with_gaps
from pymc_features.io.formats.libraries import KINDS
from support import modal_files
from support import record_files as files
from support.mutations import is_what_it_says, mutated, outcome
from support.record_examples import EXAMPLES, FILM, MOTION

MUTATIONS = 60
STEP = 0.005
A = MOTION[0]
STIFFNESS = np.diag(np.full(6, 2.0)) - np.diag(np.ones(5), 1) - np.diag(np.ones(5), -1)


def save_hdf5(path, **arrays):
    with h5py.File(path, "w") as file:
        for name, values in arrays.items():
            file.create_dataset(name, data=values).attrs["MATLAB_class"] = np.bytes_("double")


def save_sparse_hdf5(path):
    """As MATLAB 7.3 does it."""
    matrix = sparse.csc_array(STIFFNESS)
    with h5py.File(path, "w") as file:
        group = file.create_group("K")
        group.attrs["MATLAB_sparse"] = np.uint64(matrix.shape[0])
        for name, values in (("data", matrix.data), ("ir", matrix.indices), ("jc", matrix.indptr)):
            group[name] = values if name == "data" else values.astype(np.uint64)


def save_wave(path, kind):
    values = (1e3 * A).astype(np.float32 if kind.startswith("SAC") else np.int32)
    header = {"station": "WTMC", "channel": "HNE", "delta": STEP}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        obspy.Stream([obspy.Trace(values, header)]).write(str(path), format=kind)


def save_histories(path, binary):
    path.unlink(missing_ok=True)
    sets = [
        {
            **{"type": 58, "binary": binary, "func_type": 1, "rsp_node": 7, "rsp_dir": k + 1, "ref_node": 1},
            **{"ref_dir": 1, "data": MOTION[k], "x": STEP * np.arange(A.size), "abscissa_spacing": 1},
            **{"ordinate_spec_data_type": 12, "abscissa_spec_data_type": 17, "orddenom_spec_data_type": 0},
        }
        for k in range(2)
    ]
    pyuff.UFF(str(path)).write_sets(sets, "add")


def record(**arguments):
    return lambda path: read_record(path, **arguments).acceleration


def channels(**arguments):
    return lambda path: read_channels(path, **arguments).values[0]


def with_gaps(**arguments):
    return lambda path: read_channels_with_gaps(path, **arguments).values[0]


CLOCK = "time [s],acc [g],b [g]\n" + "".join(f"{STEP * k:.3f},{x:.3f},{-x:.3f}\n" for k, x in enumerate(A))
GAPS = "".join(line for k, line in enumerate(CLOCK.splitlines(keepends=True)) if not 20 <= k < 25)
ROWS = "".join("".join(f"{x:10.3f}" for x in A[k : k + 8]) + "\n" for k in range(0, A.size, 8))
PAIRS = np.column_stack([FILM, np.round(np.sin(FILM), 3)])

READERS = {  # name: suffix, how the file is made, how it is read
    **{
        name: (example.suffix, lambda p, text=example.text: p.write_text(text), record(column=0))
        for name, example in EXAMPLES.items()
    },
    "channels of cosmos": (".v2", lambda p: p.write_text(EXAMPLES["cosmos"].text), channels()),
    "channels of nsmn": (".txt", lambda p: p.write_text(EXAMPLES["nsmn"].text), channels(columns="E-W")),
    "film, smc": (
        ".smc",
        lambda p: p.write_text(files.smc(PAIRS.ravel(), None, title="1 UNCORRECTED ACCELEROGRAM")),
        record(dt=0.004),
    ),
    "film, csmip": (".raw", lambda p: p.write_text(files.csmip_film(*PAIRS.T)), record(dt=0.004)),
    "csv": (".csv", lambda p: p.write_text(CLOCK), record(column=1)),
    "channels of csv": (".csv", lambda p: p.write_text(CLOCK), channels(columns="acc")),
    "csv with gaps": (".csv", lambda p: p.write_text(GAPS), with_gaps(columns="acc")),
    "wrapped text": (".acc", lambda p: p.write_text(ROWS), record(units="g", dt=STEP, wrapped=True)),
    "mat": (".mat", lambda p: savemat(p, {"ag": A, "dt": STEP, "units": "g"}), record()),
    "compressed mat": (
        ".mat",
        lambda p: savemat(p, {"ag": A, "fs": 200.0}, do_compression=True),
        record(units="g"),
    ),
    "channels of mat": (".mat", lambda p: savemat(p, {"a": MOTION.T, "dt": STEP}), channels(units="g")),
    "mat 7.3": (".mat", lambda p: save_hdf5(p, ag=A[None], dt=STEP), record(units="g")),
    **{
        kind: (f".{kind.lower()}", lambda p, kind=kind: save_wave(p, kind), record(units=1.0))
        for kind in KINDS
    },
    "mtx, array": (".mtx", lambda p: mmwrite(p, STIFFNESS, symmetry="symmetric"), read_matrices),
    "mtx, sparse": (
        ".mtx",
        lambda p: mmwrite(p, sparse.coo_array(STIFFNESS), symmetry="general"),
        read_matrices,
    ),
    "npz": (".npz", lambda p: np.savez(p, K=STIFFNESS, M=np.ones(6)), read_matrices),
    "npz, sparse": (".npz", lambda p: sparse.save_npz(p, sparse.csr_array(STIFFNESS)), read_matrices),
    "npz, blocks": (".npz", lambda p: sparse.save_npz(p, sparse.bsr_array(STIFFNESS)), read_matrices),
    "matrices of mat": (
        ".mat",
        lambda p: savemat(p, {"K": STIFFNESS, "C": sparse.csc_matrix(STIFFNESS)}),
        read_matrices,
    ),
    "modes, 55": (".uff", lambda p: p.write_text(modal_files.UNIVERSAL), read_modal),
    "complex modes, 55": (".uff", lambda p: p.write_text(modal_files.UNIVERSAL_COMPLEX), read_modal),
    "modes, 2414": (".unv", lambda p: p.write_text(modal_files.analysis_2414(0)), read_modal),
    "modes, csv": (".csv", lambda p: p.write_text(modal_files.TABLE), read_modal),
    "modes, json": (".json", lambda p: p.write_text(modal_files.JSON), read_modal),
    "modes, mat": (".mat", lambda p: savemat(p, modal_files.VARIABLES), read_modal),
    "complex modes, mat": (
        ".mat",
        lambda p: savemat(p, modal_files.COMPLEX_VARIABLES, do_compression=True),
        lambda p: read_modal(p, real=False),
    ),
    "histories, 58": (".uff", lambda p: save_histories(p, binary=0), channels(units=1.0, columns="7X")),
    "histories, 58b": (".uff", lambda p: save_histories(p, binary=1), channels(units=1.0, columns="7X")),
    "matrices of mat 7.3": (".mat", lambda p: save_hdf5(p, K=STIFFNESS, M=np.ones((1, 6))), read_matrices),
    "sparse matrices of mat 7.3": (".mat", save_sparse_hdf5, read_matrices),
}
#: Nothing in these files says how many values there are, or where each byte belongs.
COUNTLESS = {"csv", "channels of csv", "csv with gaps", "wrapped text", "mat", "mat 7.3", "SAC"}


def mutate(name, folder, count):
    """Read damaged copies of a file; how many were refused, read with a warning, and read."""
    suffix, make, read = READERS[name]
    path = folder / f"original{suffix}"
    make(path)
    raw, expected = path.read_bytes(), read(path)
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    tally = {"refused": 0, "warned": 0, "read": 0}
    path = folder / f"damaged{suffix}"
    for number in range(count):
        copy, n_changes = mutated(raw, rng)
        path.write_bytes(copy)
        found, warned = outcome(path, read, traced=number % 3 == 0)
        tally["refused" if found is None else "warned" if warned else "read"] += 1
        if isinstance(found, np.ndarray) and not warned and n_changes == 1 and name not in COUNTLESS:
            assert is_what_it_says(found, expected), f"{name}: another record, of {found.size} samples"
    return tally


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_damaged_copies(tmp_path, name):
    tally = mutate(name, tmp_path, MUTATIONS)
    assert tally["refused"] > MUTATIONS // 10
