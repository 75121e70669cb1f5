"""MATLAB reader, every case in version 5 and 7.3 (HDF5)."""

import h5py
import numpy as np
import pytest
from scipy import sparse
from scipy.io import loadmat, savemat

from pymc_features.io import read_channels, read_record
from pymc_features.io.formats.matlab import load_variables
from support.matlab_files import save_v73
from support.refusals import refusals

ACCELERATION = np.array([0.0, 0.1, -0.25, 0.05])
TIME = 0.02 * np.arange(4)


@pytest.fixture(params=[savemat, save_v73], ids=["v5", "v7.3"])
def save(request, tmp_path):
    def save_and_return_path(**variables):
        path = tmp_path / "motion.mat"
        request.param(path, variables)
        return path

    return save_and_return_path


@pytest.mark.parametrize("values", [ACCELERATION, ACCELERATION[:, None]], ids=["row", "column"])
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_the_only_vector(save, values, dtype):
    record = read_record(save(ag=values.astype(dtype), g=9.81), units="g", dt=0.02)
    assert (record.dt, record.name) == (0.02, "motion")
    expected = 9.81 * ACCELERATION.astype(dtype).astype(float)
    np.testing.assert_allclose(record.acceleration, expected, rtol=1e-15)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "step",
    [
        {"dt": 0.02},
        {"DT": 0.02},
        {"fs": 50.0},
        {"Fs": np.int16(50)},
        {"t": TIME},
        {"time": TIME[:, None]},
        {"Time": 100.0 + TIME.astype(np.float32)},
        {"dt": 0.02, "fs": 50.0, "t": TIME},
    ],
)
def test_step_of_the_file(save, step):
    path = save(ag=ACCELERATION, units="m/s^2", **step)
    record = read_record(path)
    assert record.dt == pytest.approx(0.02, rel=1e-3 if "Time" in step else 1e-9)
    np.testing.assert_array_equal(record.acceleration, ACCELERATION)
    assert read_record(path, units="m/s2", dt=record.dt).dt == record.dt


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_two_columns_are_time_and_acceleration(save, dtype):
    path = save(motion=np.column_stack([TIME, ACCELERATION]).astype(dtype))
    record = read_record(path, units="cm/s^2")
    assert record.dt == pytest.approx(0.02, rel=1e-6)
    np.testing.assert_allclose(record.acceleration, 0.01 * ACCELERATION, rtol=1e-6)


def test_choice_by_name(save):
    path = save(ax=ACCELERATION, ay=2.0 * ACCELERATION, az=np.ones((4, 3)), dt=0.02, units="gal")
    assert read_record(path, column="ay").pga == 0.005
    message = (
        r"`column` must be given, motion.mat has the channels ax \[gal\], ay \[gal\], az 0 \[gal\], az 1"
    )
    with pytest.raises(ValueError, match=message):
        read_record(path)
    with pytest.raises(ValueError, match=r"`column` must be given, .* channels az 0 .*, az 1 .*, az 2"):
        read_record(path, column="az")
    assert read_record(path, column="az 1").pga == 0.01
    with pytest.raises(ValueError, match=r"`column` must be one of the channels of motion.mat .*, got 'aq'"):
        read_record(path, column="aq")


def test_structures(save):
    """What a structure states holds inside it, what the file states everywhere else."""
    path = save(event={"a": 2.0 * ACCELERATION, "dt": 1e-4}, ag=ACCELERATION, dt=0.02)
    assert read_record(path, units="g", column="ag").dt == 0.02
    inside = read_record(path, column="event.a", units="gal")
    assert (inside.dt, inside.pga) == (1e-4, 0.01 * 2.0 * np.abs(ACCELERATION).max())
    assert read_record(save(event={"a": ACCELERATION}), units="g", dt=0.02).n_times == 4


@pytest.mark.parametrize("form", ["4", "5"])
@pytest.mark.parametrize("compressed", [False, True])
def test_numbers_are_those_of_scipy(tmp_path, form, compressed):
    """Every kind of numbers, texts and sparse matrices, beside SciPy's own reader."""
    path, rng = tmp_path / "m.mat", np.random.default_rng(2)
    kinds = ("f8", "f4", "i4", "i2", "u2", "u1", *(("i8", "u8", "i1", "u4") if form == "5" else ()))
    contents = {f"of_{kind}": (100.0 * rng.random((3, 5))).astype(kind) for kind in kinds}
    contents |= {
        "pairs": rng.random((2, 3)) + 1j * rng.random((2, 3)),
        "text": "cm/s^2",
        "words": ["one", "two"],
    }
    contents |= {"K": sparse.csc_array(np.diag([2.0, 0.0, 1.5])), "Z": sparse.csc_array(1j * np.eye(2))}
    savemat(path, contents, format=form, do_compression=compressed and form == "5")
    theirs, ours = loadmat(path, spmatrix=False), load_variables(path)
    assert set(ours) == set(contents)
    for name, value in ours.items():
        pair = [x.toarray() if sparse.issparse(x) else x for x in (value, theirs[name])]
        np.testing.assert_array_equal(*pair, err_msg=name)
    path.write_bytes(path.read_bytes() + b"\0" if form == "5" else path.read_bytes()[:-9])
    with pytest.raises(ValueError, match="m.mat must be a MATLAB .mat file, it cannot be read"):
        load_variables(path)


def test_a_sparse_matrix_beside_channels(tmp_path):
    savemat(tmp_path / "m.mat", {"K": sparse.csc_array(np.eye(3)), "ag": ACCELERATION})
    assert read_record(tmp_path / "m.mat", units="g", dt=0.02).n_times == 4


def test_cells_and_sparse_matrices_are_ignored(tmp_path):
    cells = np.empty(2, dtype=object)
    cells[:] = ["text", ACCELERATION]
    savemat(tmp_path / "m.mat", {"cells": cells, "z": 1j * ACCELERATION, "ag": ACCELERATION})
    assert read_record(tmp_path / "m.mat", units="g", dt=0.02).n_times == 4


def test_hdf5_file_reads_no_other_file(tmp_path):
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["secret"] = ACCELERATION
    (tmp_path / "raw.bin").write_bytes(ACCELERATION.tobytes())
    path = tmp_path / "motion.mat"
    layout = h5py.VirtualLayout(shape=(4,), dtype="f8")
    layout[:] = h5py.VirtualSource(tmp_path / "other.h5", "secret", shape=(4,))
    with h5py.File(path, "w") as file:
        file["linked"] = h5py.ExternalLink(tmp_path / "other.h5", "secret")
        file.create_virtual_dataset("virtual", layout)
        external = [(str(tmp_path / "raw.bin"), 0, 32)]
        file.create_dataset("external", (4,), "f8", external=external)
        file["soft"] = h5py.SoftLink("/ag")
        file["ag"] = 2.0 * ACCELERATION
    assert read_record(path, units="g", dt=0.02).pga == 0.5 * 9.81


@pytest.mark.parametrize("name", ["Ts", "delta", "sampling_interval", "SampleRate", "sampling_frequency"])
def test_names_of_a_step_or_a_rate(save, tmp_path, name):
    """In variables, and in attributes of HDF5 files, whose unit holds for the rows of a matrix."""
    value = 50.0 if name in ("SampleRate", "sampling_frequency") else 0.02
    assert read_record(save(ag=ACCELERATION, units="g", **{name: value})).dt == 0.02
    with h5py.File(tmp_path / "matrix.h5", "w") as file:
        file["ag"] = np.column_stack([ACCELERATION, TIME])
        file["ag"].attrs.update({"unit": "g", name: value})
    record = read_record(tmp_path / "matrix.h5", column="ag 0")
    assert record.dt == 0.02 and record.pga == pytest.approx(9.81 * np.abs(ACCELERATION).max())


def test_arguments_win_over_the_file_with_a_warning(save):
    path = save(ag=ACCELERATION, dt=0.02, units="g")
    with pytest.raises(ValueError, match="those of the file, motion.mat states 'g', got 'gal'"):
        read_record(path, units="gal")
    with pytest.warns(UserWarning, match="motion.mat states a time step of 0.02 s; the argument dt="):
        assert read_record(path, dt=0.01).dt == 0.01


ERROR_MESSAGES = {  # what is said: what is given
    "`units` must be given, motion.mat does not state them": {"ag": ACCELERATION, "dt": 0.02},
    "`dt` must be given, motion.mat does not state the": {"ag": ACCELERATION, "units": "mg"},
    "`units` must be given, .* states 'V/V'": {"ag": ACCELERATION, "dt": 0.02, "units": "V/V"},
    "must hold accelerations, it states 'mm/s', a unit of": {"ag": ACCELERATION, "dt": 0.02, "units": "mm/s"},
    "`dt` must be given, motion.mat does not state the time": {"ag": ACCELERATION, "dt": 0.0},
    "states a time step of 20, too long for seconds": {"ag": ACCELERATION, "dt": 20.0},
    r"contradicts itself \(dt: 0.02 s, fs: 0.01": {"ag": ACCELERATION, "dt": 0.02, "fs": 100.0},
    "motion.mat, `t`, sample .: time steps must be even": {"ag": ACCELERATION, "t": TIME**1.1},
    "motion.mat, `t`, sample 1: time must increase": {"ag": ACCELERATION, "t": -TIME},
    "`column` must be given, motion.mat has the channels ag 0": {"ag": np.column_stack([ACCELERATION, TIME])},
    r"motion.mat, ag: no samples may be missing, 1 are, the first after 0.04 s .nan": {
        "ag": np.where(TIME == 0.04, np.nan, ACCELERATION),
        "dt": 0.02,
        "units": "g",
    },
    "`column` must name a channel of motion.mat": {"t": TIME, "dt": 0.02},
}


@refusals("variables", ERROR_MESSAGES)
def test_error_messages(save, variables, match):
    with pytest.raises(ValueError, match=match):
        read_record(save(**variables))


def test_given_dt_overrules_an_uneven_time_vector(save):
    assert read_record(save(ag=ACCELERATION, t=TIME**1.1), units="g", dt=0.02).dt == 0.02


@pytest.mark.parametrize("content", [b"", b"not a mat file", b"\x80\x04pickle" * 50])
def test_damaged_files(tmp_path, content):
    path = tmp_path / "motion.mat"
    path.write_bytes(content)
    with pytest.raises(ValueError, match="motion.mat must be a MATLAB .mat file, it cannot be read"):
        read_record(path, units="g", dt=0.02)


def test_truncated_file(save):
    path = save(ag=np.arange(1000.0))
    path.write_bytes(path.read_bytes()[:1500])
    with pytest.raises(ValueError, match="motion.mat must be a MATLAB .mat file, it cannot be read"):
        read_record(path, units="g", dt=0.02)


RATES = {  # what the file states: step [s] or what is said
    "a text": ({"Fs": "100 Hz"}, 0.01),
    "kilohertz": ({"fs": "0.1 kHz"}, 0.01),
    "a step in ms": ({"dt": "10 ms"}, 0.01),
    "another name": ({"SampleRate": 100.0}, 0.01),
    "both agree": ({"fs": 100.0, "dt": 0.01}, 0.01),
    "both differ": (
        {"fs": 100.0, "dt": 0.02},
        r"motion.mat contradicts itself \(.*0.01 s.*0.02 s|0.02 s.*0.01",
    ),
    "no unit of time": ({"Fs": "100 Nm"}, "motion.mat, `Fs`: a step or rate must be a number and a unit"),
    "no number": ({"Fs": "fast"}, "motion.mat, `Fs`: a step or rate must be a number and a unit, got 'fast'"),
}


@pytest.mark.parametrize("name", RATES)
@pytest.mark.parametrize("reader", ["record", "channels"])
def test_rates_and_steps_of_a_file(save, name, reader):
    stated, expected = RATES[name]
    path = save(ag=ACCELERATION, **stated)
    if isinstance(expected, str):
        with pytest.raises(ValueError, match=expected):
            read_record(path, units="g") if reader == "record" else read_channels(path, units="g")
    elif reader == "record":
        assert read_record(path, units="g").dt == pytest.approx(expected, rel=1e-12)
    else:
        assert float(read_channels(path, units="g")["time"][1]) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("version", ["4", "5"])
def test_a_variable_that_is_there_twice(tmp_path, version):
    """One of the two would be taken without a word."""
    first, second = tmp_path / "first.mat", tmp_path / "second.mat"
    for path, value in ((first, 1.0), (second, 2.0)):
        savemat(path, {"ag": np.full((4, 1), value)}, format=version)
    header = {"4": 0, "5": 128}[version]
    first.write_bytes(first.read_bytes() + second.read_bytes()[header:])
    with pytest.raises(ValueError, match="cannot be read .a variable is there twice"):
        load_variables(first)


@pytest.mark.parametrize("row", [1.0, 1.5])
def test_places_in_a_sparse_matrix_are_whole_numbers(tmp_path, row):
    path = tmp_path / "k.mat"
    with h5py.File(path, "w") as file:
        group = file.create_group("K")
        group.attrs["MATLAB_sparse"] = np.uint64(2)
        for name, values in {"data": [4.0, 5.0], "ir": [0.0, row], "jc": [0, 1, 2]}.items():
            group.create_dataset(name, data=values)
    if row == 1.0:
        np.testing.assert_array_equal(load_variables(path)["K"].toarray(), [[4.0, 0.0], [0.0, 5.0]])
        return
    with pytest.raises(ValueError, match="places in a sparse matrix must be whole numbers"):
        load_variables(path)
