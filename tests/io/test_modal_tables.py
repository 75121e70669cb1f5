"""Modes in tables, MATLAB files, JSON, mappings and results of pyOMA2."""

import csv
import json
import time
from dataclasses import dataclass

import h5py
import numpy as np
import pytest
from scipy.io import loadmat, savemat

from pymc_features import read_modal
from pymc_features.exceptions import ModalDataWarning
from pymc_features.modal import ModalData
from support import modal_files as files
from support.modal_files import DAMPING, FREQUENCIES, IMAGINARY, SHAPES
from support.refusals import refusals

pytestmark = pytest.mark.filterwarnings("error")

COMPLEX = SHAPES + 1j * IMAGINARY
CHANNELS = ["floor 1", "floor 2", "roof"]
OMEGA = 2.0 * np.pi * FREQUENCIES
SD = np.array([0.01, 0.02, 0.03])


def save(folder, text, name="modes.csv"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


# --- text ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_table(tmp_path, separator):
    """Beside an independent parser, the one of Python's csv module."""
    path = save(tmp_path, "# a frame\n" + files.TABLE.replace(",", separator))
    modal = read_modal(path)
    rows = list(csv.DictReader(path.read_text().splitlines()[1:], delimiter=separator))
    for name, values in (
        ("frequency [Hz]", modal.frequencies),
        ("frequency_sd", modal.frequency_sd),
        ("damping", modal.damping_ratios),
        ("floor 1", modal.shapes[:, 0]),
        ("roof", modal.shapes[:, 1]),
        ("floor 1_sd", modal.shape_sd[:, 0]),
    ):
        np.testing.assert_array_equal(values, [float(row[name]) for row in rows])
    assert modal.channels == ("floor 1", "roof")
    assert np.isnan(modal.shape_sd[:, 1]).all()
    assert len(modal) == len(rows) == 3


def rows_of(header, *columns):
    lines = [header, *(",".join(map(str, row)) for row in zip(*columns, strict=True))]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("label", "values", "spread"),
    [
        ("frequency", FREQUENCIES, SD),
        ("Frequency [Hz]", FREQUENCIES, SD),
        ("frequency_hz", FREQUENCIES, SD),
        ("omega", OMEGA, 2.0 * np.pi * SD),
        ("omega_rad_s", OMEGA, 2.0 * np.pi * SD),
        ("omega (rad/s)", OMEGA, 2.0 * np.pi * SD),
        ("frequency [rad/s]", OMEGA, 2.0 * np.pi * SD),
        ("eigenvalue", OMEGA**2, 2.0 * OMEGA * 2.0 * np.pi * SD),  # d(omega^2) = 2 omega d(omega)
    ],
)
def test_units_of_frequencies(tmp_path, label, values, spread):
    base, bracket, unit = label.partition(" ")
    modal = read_modal(
        save(tmp_path, rows_of(f"{label},{base}_sd{bracket}{unit},roof", values, spread, SHAPES[:, 2]))
    )
    np.testing.assert_allclose(modal.frequencies, FREQUENCIES, rtol=1e-12)
    np.testing.assert_allclose(modal.frequency_sd, SD, rtol=1e-12)
    assert modal.channels == ("roof",)


@pytest.mark.parametrize("label", ["damping [%]", "damping_percent", "Damping ratio (percent)"])
def test_damping_in_percent(tmp_path, label):
    modal = read_modal(save(tmp_path, rows_of(f"frequency,{label}", FREQUENCIES, 100.0 * DAMPING)))
    np.testing.assert_allclose(modal.damping_ratios, DAMPING)
    assert (modal.shapes, modal.channels) == (None, ())


def test_entries_that_were_not_measured(tmp_path):
    text = "frequency,damping,a,b\n1.0,,0.5,nan\n2.0,0.01,,1.0\n"
    modal = read_modal(save(tmp_path, text))
    np.testing.assert_array_equal(modal.shapes, [[0.5, np.nan], [np.nan, 1.0]])
    np.testing.assert_array_equal(modal.damping_ratios, [np.nan, 0.01])


@pytest.mark.parametrize("unit", ["i", "j"])
def test_complex_entries(tmp_path, unit):
    text = f"frequency,a,b,c\n1.0,0.3-0.1{unit},1e-1 + 2E-2{unit},1\n"
    modal = read_modal(save(tmp_path, text), real=False)
    np.testing.assert_array_equal(modal.shapes, [[0.3 - 0.1j, 0.1 + 0.02j, 1.0]])
    assert not read_modal(save(tmp_path, text)).is_complex


@pytest.mark.parametrize(
    "text",
    [
        "frequency,a re,a im,b_real,b_imag\n1,0,0.5,-1,0\n",
        "frequency,a mag,a phase [deg],b,b.angle (rad)\n1,0.5,90,1,3.141592653589793\n",
    ],
)
def test_complex_entries_in_two_columns(tmp_path, text):
    modal = read_modal(save(tmp_path, text), real=False)
    assert modal.channels == ("a", "b")
    np.testing.assert_allclose(modal.shapes, [[0.5j, -1.0]], atol=1e-15)
    np.testing.assert_allclose(read_modal(save(tmp_path, text), channels=["b"], real=False).shapes, [[-1.0]])


@pytest.mark.parametrize("names", [",first,second\n", ""])
def test_a_table_on_its_side(tmp_path, names):
    modal = read_modal(
        save(tmp_path, f"{names}frequency [Hz],1,3\ndamping [%],2,4\nroof,1,-0.5\nbase,0,0.5\n")
    )
    np.testing.assert_array_equal(modal.frequencies, [1.0, 3.0])
    np.testing.assert_array_equal(modal.damping_ratios, [0.02, 0.04])
    assert modal.channels == ("roof", "base")
    np.testing.assert_array_equal(modal.shapes, [[1.0, 0.0], [-0.5, 0.5]])


def test_indicators_are_no_channels(tmp_path):
    """What programs of identification write beside shapes; it can be asked for."""
    labels = ["MPC", "model order", "Mean Phase [deg]", "MSV", "Period [s]", "Quality"]
    rows = "1.0,0.9,40,3,0.1,1.0,7,1.0,0.5\n2.0,0.8,44,4,0.2,0.5,8,-1.0,0.5\n"
    path = save(tmp_path, ",".join(["frequency", *labels, "a", "b"]) + "\n" + rows)
    assert read_modal(path).channels == ("a", "b")
    assert read_modal(path, channels=["a", "MPC"]).channels == ("a", "MPC")


def test_names_and_channels(tmp_path):
    text = "f1,comment,s,roof [mm],attic\n1.0,first,0.01,0.5,9\n2.0,second,0.02,1.0,9\n"
    path = save(tmp_path, text)
    names = {"frequency": "f1", "frequency_sd": "s"}
    with pytest.raises(ValueError, match="modes.csv, line 2: the column 'comment' must hold numbers, got"):
        read_modal(path, names=names)
    modal = read_modal(path, names=names, channels=["roof"])
    assert modal.channels == ("roof",)
    np.testing.assert_array_equal(modal.frequency_sd, [0.01, 0.02])
    modal = read_modal(path, names=names, channels={"upper": "attic", "lower": "roof"})
    assert modal.channels == ("upper", "lower")
    np.testing.assert_array_equal(modal.shapes[:, 1], [0.5, 1.0])


TABLES = {
    "modes.csv must have .frequency. .Hz., .omega. .rad/s. or .eigenvalue. .*": ("f1,roof\n1.0,2.0\n", {}),
    "modes.csv: units must be hz, rad/s, got 'frequency .kHz.'": ("frequency [kHz],roof\n1.0,2.0\n", {}),
    "modes.csv: channels must have different names, got roof more than": ("frequency,roof,roof\n1,2,3\n", {}),
    "the standard deviation of a must be there once, got 'a_sd' and 'a std'": (
        "frequency,a,a_sd,a std\n1,2,3,4\n",
        {},
    ),
    "modes.csv: columns must have names, number 3 of the header has none": ("frequency,roof,\n1,2,3\n", {}),
    "frequency must be there once, got 'frequency' and 'Frequency": ("frequency,Frequency [Hz]\n1,1\n", {}),
    "frequency and omega must agree, got 6.283 and 1 Hz of the": ("frequency,omega\n6.2832,6.2832\n", {}),
    "frequency and omega must agree, got 1 and 1.432 Hz of the first mode": ("frequency,omega\n1,9\n", {}),
    "frequency_sd must stand beside frequency, got omega, frequency_sd": ("omega,frequency_sd\n6,1\n", {}),
    "each channel must have a column of its own, got 'shapes' for shapes": ("frequency,shapes\n1,1\n", {}),
    "damping must be there once, got fractions and": ("frequency,damping,damping [%]\n1,0.01,1\n", {}),
    "must have the names of its columns in the first line, got the number '1.0'": ("1.0,2.0\n3.0,4.0\n", {}),
    "the column 'std .Hz.' must be a channel, its unit is one of frequency. L": (
        "frequency,std (Hz),a\n1,0.1,1\n",
        {},
    ),
    "must say whether the phase 'a phase' is in degrees or": ("frequency,a mag,a phase\n1,1,180\n", {}),
    "modes.csv, line 3: rows must have 2 cells like the header, got 3": ("frequency,roof\n1,2\n1,5,2\n", {}),
    "modes.csv, line 2: the column 'roof' must hold numbers, got 'high'": ("frequency,roof\n1,high\n", {}),
    "line 2: the column 'frequency' must hold numbers, got '1.0-0.1j'": ("frequency,roof\n1.0-0.1j,1\n", {}),
    "modes.csv: `frequencies` must be positive, got -1.0 Hz": ("frequency,roof\n-1,1\n", {}),
    "modes.csv: `frequencies` must be finite, got nan": ("frequency,roof\n,1\n", {}),
    "modes.csv: omega must be positive, got 0.0 of mode 1": ("omega,roof\n1,1\n0,1\n", {}),
    "modes.csv: `damping_ratios` must be fractions from 0 to 1, got 1.2": ("frequency,damping\n1,1.2\n", {}),
    "modes.csv must hold modes, there is none below its header": ("frequency,roof\n", {}),
    "modes.csv must hold modes, it is empty": ("\n\n", {}),
    "`channels` must be among those of modes.csv .roof": ("frequency,roof\n1,2\n", {"channels": ["attic"]}),
    "`names` must have keys among frequency, .*, got": ("frequency,roof\n1,2\n", {"names": {"f": "roof"}}),
    "`names` must give names of modes.csv .frequency": ("frequency,roof\n1,2\n", {"names": {"omega": "f"}}),
    "`channels` must be left out, got some for": ("frequency,damping\n1,0.1\n", {"channels": {"roof": 0}}),
}
TYPES = {
    "`names` must be a mapping of quantities to names in the file, got 'f'": (
        "frequency\n1\n",
        {"names": "f"},
    ),
    "`channels` must be a sequence of names, or a mapping .*, got 'roof'": (
        "frequency,roof\n1,2\n",
        {"channels": "roof"},
    ),
    "`real` must be True or False, got 'no'": ("frequency\n1\n", {"real": "no"}),
}


@refusals("text options", TABLES, TYPES)
def test_tables_that_are_refused(tmp_path, text, options, error, match):
    with pytest.raises(error, match=match):
        read_modal(save(tmp_path, text), **options)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("frequency,damping\n1,0.5\n", "modes.csv: a damping ratio of 0.5 of critical is implausible. Name"),
        ("frequency,frequency_sd\n1,0.6\n", "modes.csv: a standard deviation of 0.6 Hz for a frequency of 1"),
    ],
)
def test_probably_another_unit(tmp_path, text, match):
    with pytest.warns(ModalDataWarning, match=match):
        read_modal(save(tmp_path, text))


# --- variables ----------------------------------------------------------------------------------

VARIABLES = {
    "frequency": FREQUENCIES,
    "damping": DAMPING,
    "shapes": SHAPES.T,
    "note": "a frame",
    "other": np.eye(2),
}


def same(modal, channels=("channel 0", "channel 1", "channel 2")):
    np.testing.assert_allclose(modal.frequencies, FREQUENCIES)
    np.testing.assert_allclose(modal.damping_ratios, DAMPING)
    np.testing.assert_allclose(modal.shapes, SHAPES)
    assert modal.channels == tuple(channels)


def test_matlab(tmp_path):
    """Columns are modes, as in MATLAB; names by `channels`, or in the rows of a text."""
    path = tmp_path / "modes.mat"
    savemat(path, VARIABLES)
    same(read_modal(path))
    same(read_modal(path, channels=CHANNELS), CHANNELS)
    savemat(path, VARIABLES | {"channels": np.array(CHANNELS)})
    same(read_modal(path), CHANNELS)
    picked = read_modal(path, channels=["roof"])
    np.testing.assert_array_equal(picked.shapes, SHAPES[:, 2:])


def test_matlab_complex(tmp_path):
    path = tmp_path / "modes.mat"
    savemat(path, {"omega": OMEGA, "phi": COMPLEX.T})
    kept = read_modal(path, names={"shapes": "phi"}, real=False)
    np.testing.assert_array_equal(kept.shapes, COMPLEX)
    np.testing.assert_array_equal(read_modal(path, names={"shapes": "phi"}).shapes, kept.real().shapes)


def test_matlab_73(tmp_path):
    """The layout MATLAB writes: transposed arrays, complex numbers as pairs of real and imag."""
    path = tmp_path / "modes.mat"
    pairs = np.zeros(SHAPES.shape, dtype=[("real", "f8"), ("imag", "f8")])
    pairs["real"], pairs["imag"] = SHAPES, IMAGINARY
    with h5py.File(path, "w") as file:
        file.create_dataset("frequency", data=FREQUENCIES[:, None]).attrs["MATLAB_class"] = np.bytes_(
            "double"
        )
        file.create_dataset("shapes", data=pairs).attrs["MATLAB_class"] = np.bytes_("double")
    np.testing.assert_array_equal(read_modal(path, real=False).shapes, COMPLEX)


def lists(**more):
    return {
        "frequency": FREQUENCIES.tolist(),
        "damping": DAMPING.tolist(),
        "shapes": SHAPES.T.tolist(),
    } | more


def test_json(tmp_path):
    path = save(tmp_path, json.dumps(lists(channels=CHANNELS, note={"by": "us"})), "modes.json")
    same(read_modal(path), CHANNELS)
    path.write_bytes(b"\xef\xbb\xbf  " + path.read_bytes())  # as some editors save it
    same(read_modal(path), CHANNELS)
    gaps = lists(damping=[0.012, None, 0.02], shapes=[[0.1, None, 1.0], [1.0, 1.0, None]])
    modal = read_modal(save(tmp_path, json.dumps(gaps), "modes.json"))
    np.testing.assert_array_equal(modal.shapes, [[0.1, 1.0], [np.nan, 1.0], [1.0, np.nan]])
    np.testing.assert_array_equal(modal.damping_ratios, [0.012, np.nan, 0.02])


def test_imaginary_parts(tmp_path):
    path = save(tmp_path, json.dumps(lists(shapes_imaginary=IMAGINARY.T.tolist())), "modes.json")
    np.testing.assert_array_equal(read_modal(path, real=False).shapes, COMPLEX)


def test_mapping():
    same(read_modal(VARIABLES, channels=CHANNELS), CHANNELS)
    one = read_modal({"frequency": 2.0, "shapes": [0.5, 1.0], "shape_sd": [0.1, 0.0]})
    np.testing.assert_array_equal(one.shapes, [[0.5, 1.0]])
    np.testing.assert_array_equal(one.shape_sd, [[0.1, 0.0]])


WRONG = {
    "a row for each channel and a column for each of the 3 modes": (lists(shapes=SHAPES[:, :2].tolist()), {}),
    "shapes must have a row .*, got shape .4, 2.. Pass `names`": (lists(shapes=np.ones((4, 2)).tolist()), {}),
    "shapes must be a matrix of numbers": (lists(shapes=[[1.0], [1.0, 2.0]]), {}),
    "shapes_imaginary must stand beside real shapes of its size": (lists(shapes_imaginary=[[1.0] * 3]), {}),
    "frequency must hold real numbers, got str": (lists(frequency="high"), {}),
    "frequency must have one number for each mode, got shape .3, 3.": (lists(frequency=SHAPES.tolist()), {}),
    "all must have one number for each mode, got frequency 3, damping 2": (lists(damping=[0.1, 0.1]), {}),
    "channels must be texts, got list": (lists(channels=[1, 2, 3]), {}),
    "channels must name the 3 rows of shapes, got 2 names. Correct": (lists(channels=["a", "b"]), {}),
    "`channels` must have different names, got a more than once": (lists(channels=["a", "b", "a"]), {}),
    "must hold named arrays, got objects inside: one, two. Pass one": ({"one": lists(), "two": lists()}, {}),
    "must have .frequency. .Hz., .*, got wn, phi. Rename one": ({"wn": [1.0], "phi": [[1.0]]}, {}),
    "`channels` must name all 3 channels of shapes without names, got 2": (lists(), {"channels": ["a", "b"]}),
    "must be among those of the source .0 to 2, without names., got": (lists(), {"channels": {"a": "roof"}}),
    "must be among those of the source .0 to 2, without names., got 3": (lists(), {"channels": {"a": 3}}),
}


@refusals("variables options", WRONG)
def test_variables_that_are_refused(tmp_path, variables, options, match):
    path = save(tmp_path, json.dumps(variables), "modes.json")
    with pytest.raises(ValueError, match=f"modes.json.*{match}"):
        read_modal(path, **options)
    with pytest.raises(ValueError, match=f"`source`.*{match}"):
        read_modal(variables, **options)


def test_many_columns(tmp_path):
    """In time proportional to them, as long as a line may be."""
    names = [f"n{k}" for k in range(25_000)]
    text = "frequency," + ",".join(names) + "\n1.0," + ",".join(["1"] * len(names)) + "\n"
    start = time.process_time()
    modal = read_modal(save(tmp_path, text), channels=names[::-1])
    assert modal.channels == tuple(names[::-1])
    assert time.process_time() - start < 2.0


JSON = {
    "modes.json must be a JSON file, it cannot be read": '{"frequency": [1.0,',
    "the key '' is no name. Correct it": '{"frequency": 1.0, "": 2.0}',
    "cannot be read .a name is there twice": '{"frequency": 1.0, "frequency": 2.0}',
    "must hold one JSON object of named arrays, got a list": "[1.0, 2.0]",
    "modes.json must be a JSON file, it cannot be read ": '{"frequency": ' + "[" * 100_000,
    "modes.json: `frequencies` must be finite, got inf": '{"frequency": 1e999}',
    "must be a matrix of numbers": '{"frequency": 1.0, "shapes": [1' + "0" * 400 + "]}",
}


@refusals("text", JSON)
def test_json_that_is_refused(tmp_path, text, match):
    with pytest.raises(ValueError, match=match):
        read_modal(save(tmp_path, text, "modes.json"))


def test_other_objects(tmp_path):
    with pytest.raises(TypeError, match="`source` must be a path, a mapping of arrays or a result of pyOMA2"):
        read_modal(3)
    with pytest.raises(FileNotFoundError, match="`source` must be an existing file"):
        read_modal(tmp_path / "none.csv")
    with pytest.raises(ValueError, match="modes.mat must be a MATLAB .mat file, it cannot be read"):
        read_modal(save(tmp_path, "frequency,roof\n1,2\n", "modes.mat"))


# --- pyOMA2 -------------------------------------------------------------------------------------


@dataclass
class SSIResult:
    """The attributes that the documentation of pyOMA2 1.4 states, besides those of all poles."""

    Fn: np.ndarray | None = None
    Phi: np.ndarray | None = None
    Xi: np.ndarray | None = None
    Fn_std: np.ndarray | None = None
    Xi_std: np.ndarray | None = None
    Phi_std: np.ndarray | None = None


@dataclass
class Algorithm:
    result: object


def oma(**more):
    values = {"Fn": FREQUENCIES, "Phi": COMPLEX.T, "Xi": DAMPING, "Fn_std": SD, "Xi_std": 0.1 * DAMPING}
    return SSIResult(**(values | {"Phi_std": 0.01 * np.abs(SHAPES.T)} | more))


@pytest.mark.parametrize(
    "wrap", [lambda r: r, Algorithm, lambda r: Algorithm({"SSI": r}), lambda r: {"SSI": r}]
)
def test_results_of_pyoma2(wrap):
    modal = read_modal(wrap(oma()), channels=CHANNELS, real=False)
    np.testing.assert_array_equal(modal.frequencies, FREQUENCIES)
    np.testing.assert_array_equal(modal.frequency_sd, SD)
    np.testing.assert_array_equal(modal.damping_ratios, DAMPING)
    np.testing.assert_array_equal(modal.damping_sd, 0.1 * DAMPING)
    np.testing.assert_array_equal(modal.shapes, COMPLEX)
    np.testing.assert_array_equal(modal.shape_sd, 0.01 * np.abs(SHAPES))
    assert modal.channels == tuple(CHANNELS)


def test_results_without_standard_deviations():
    modal = read_modal(oma(Xi=None, Fn_std=None, Xi_std=None, Phi_std=None))
    assert (modal.damping_ratios, modal.frequency_sd, modal.shape_sd, modal.is_complex) == (
        None,
        None,
        None,
        False,
    )
    assert modal.channels == ("channel 0", "channel 1", "channel 2")


OMA = {
    "`source` must have picked modes, got SSIResult without frequencies or shapes. Call": (SSIResult(), {}),
    "`source` must be one result, got Algorithm with 'FDD'": (Algorithm({"FDD": oma(), "SSI": oma()}), {}),
    "SSIResult: shapes must have a row for each channel and a column for each of the 3 modes, got shape": (
        oma(Phi=COMPLEX[:, :2]),
        {},
    ),
    "`names` must be left out, got frequency: a result of pyOMA2": (oma(), {"names": {"frequency": "f"}}),
    "SSIResult: `channels` must name all 3 channels": (oma(), {"channels": ["roof"]}),
    "SSIResult: `frequencies` must be finite, got nan at index 2": (oma(Fn=np.array([1.0, 2.0, np.nan])), {}),
}


@refusals("source options", OMA)
def test_results_that_are_refused(source, options, match):
    with pytest.raises(ValueError, match=match):
        read_modal(source, **options)


# --- measured modes -----------------------------------------------------------------------------


def test_four_storeys(data_dir, reference_dir):
    """Beside SciPy's reader, and the printed numbers."""
    path = data_dir / "modal" / "four_storey" / "FourStoryStructure.mat"
    modal = read_modal(path, names={"frequency": "test_frequency", "shapes": "test_mode"})
    theirs = loadmat(path)
    np.testing.assert_array_equal(modal.frequencies, theirs["test_frequency"].ravel())
    np.testing.assert_array_equal(modal.shapes, theirs["test_mode"].T)
    published = json.loads((reference_dir / "modal_published.json").read_text())["four_storey"]
    np.testing.assert_allclose(modal.frequencies, published["frequencies_hz"], rtol=1e-12)
    np.testing.assert_allclose(modal.shapes, np.transpose(published["shapes_columns_are_modes"]), rtol=1e-12)
    with pytest.raises(ValueError, match="FourStoryStructure.mat must have .frequency.*got test_frequency"):
        read_modal(path)


def test_eighteen_storeys(reference_dir, tmp_path):
    found = json.loads((reference_dir / "measured_modal_data.json").read_text())["edefense_18storey"]
    names = {"frequency": "freq_hz", "damping": "zeta", "shapes": "mode_shapes"}
    floors = [f"floor {k}" for k in found["measured_dofs"]]
    for source in (found, save(tmp_path, json.dumps(found), "modes.json")):
        modal = read_modal(source, names=names, channels=floors)
        assert modal.channels == ("floor 3", "floor 6", "floor 9", "floor 12", "floor 15", "floor 18")
        np.testing.assert_array_equal(modal.frequencies, found["freq_hz"])
        np.testing.assert_array_equal(modal.damping_ratios, found["zeta"])
        np.testing.assert_array_equal(modal.shapes, np.transpose(found["mode_shapes"]))
    whole = reference_dir / "measured_modal_data.json"
    with pytest.raises(ValueError, match="must hold named arrays, got objects inside: edefense_18storey"):
        read_modal(whole)


def test_a_table_with_a_row_for_each_test(tmp_path):
    """A column for each mode, empty where a test missed it; other columns are not read."""
    path = tmp_path / "tests.csv"
    path.write_text("test,date,f1 [Hz],f2 [Hz]\na,3 May,1.20,3.40\nb,4 May,1.22,\n")
    modal = read_modal(path)
    np.testing.assert_array_equal(modal.frequencies, [1.2, 3.4, 1.22])
    assert list(modal.labels) == ["1", "2", "1"] and list(modal.select([2, 1]).labels) == ["1", "2"]
    path.write_text("f1,f2\n1.2\n")
    with pytest.raises(ValueError, match="line 2: rows must have 2 cells like the header, got 1. Complete"):
        read_modal(path)
    path.write_text("f1,f2\n,\n")
    with pytest.raises(ValueError, match="must hold modes, there is none below .* Add a row for each test"):
        read_modal(path)


def test_a_mode_in_several_rows_is_a_label(tmp_path):
    path = tmp_path / "modes.csv"
    path.write_text("mode,frequency [Hz],roof,floor\nfirst,1.2,1,0.5\nsecond,3.4,1,-1\nfirst,1.22,1,0.6\n")
    assert list(read_modal(path).labels) == ["first", "second", "first"]
    path.write_text("mode,frequency [Hz]\n1,1.2\n2,3.4\n")
    assert read_modal(path).labels is None
    with pytest.raises(ValueError, match="`labels` must be 2 names, one for each mode, got 1"):
        ModalData([1.0, 2.0], labels=["a"])
