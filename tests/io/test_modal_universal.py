"""Universal Files: modes as they are specified and as pyuff writes them, and measured functions."""

import sys
import time
import warnings

import numpy as np
import pytest
import pyuff

from pymc_features import read_channels, read_modal, read_record
from pymc_features.exceptions import ModalDataWarning
from pymc_features.io import FORMATS
from pymc_features.io.formats import TEXT
from pymc_features.io.formats.libraries import UNIVERSAL
from pymc_features.io.reading.recording import Opening
from support import modal_files as files
from support.modal_files import DAMPING, FREQUENCIES, IMAGINARY, SHAPES
from support.refusals import refusals

Z = ("1Z", "7Z", "12Z")
NORMAL = files.geometry_15() + "".join(files.normal_55(mode) for mode in range(3))
COMPLEX = SHAPES + 1j * IMAGINARY


def save(folder, text, name="modes.uff"):
    path = folder / name
    path.write_text(text)
    return path


# --- modes --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text", [files.UNIVERSAL, "".join(files.analysis_2414(mode) for mode in range(3))], ids=["55", "2414"]
)
def test_normal_modes(tmp_path, text):
    """Six digits are printed. Directions that are zero in all modes were not measured (note 15)."""
    modal = read_modal(save(tmp_path, text))
    np.testing.assert_allclose(modal.frequencies, FREQUENCIES, rtol=1e-6)
    np.testing.assert_allclose(modal.damping_ratios, DAMPING, rtol=1e-6)
    np.testing.assert_allclose(modal.shapes, SHAPES, rtol=1e-6)
    assert (modal.channels, modal.frequency_sd) == (Z, None)


@pytest.mark.parametrize("end", ["\r\n", "\r"])
def test_line_ends(tmp_path, end):
    path = tmp_path / "modes.unv"
    path.write_bytes(files.UNIVERSAL.replace("\n", end).encode())
    np.testing.assert_allclose(read_modal(path).shapes, SHAPES, rtol=1e-6)


def test_blank_lines_between_data_sets(tmp_path):
    """Any number of them, in time proportional to it."""
    path = save(
        tmp_path, files.UNIVERSAL + "\n" * 200_000 + files.normal_55(0, numbers=(9.0, 1.0, 0.01, 0.0))
    )
    start = time.process_time()
    assert len(read_modal(path)) == 4
    assert time.process_time() - start < 2.0


@pytest.mark.parametrize("analysis", [3, 7])
def test_complex_modes(tmp_path, analysis):
    """f = |lambda| / (2 pi) and zeta = -Re(lambda) / |lambda| of eigenvalues in rad/s."""
    text = "".join(files.complex_55(mode, analysis=analysis) for mode in range(3))
    kept = read_modal(save(tmp_path, text), real=False)
    np.testing.assert_allclose(kept.frequencies, FREQUENCIES, rtol=1e-5)
    np.testing.assert_allclose(kept.damping_ratios, DAMPING, rtol=1e-4)
    np.testing.assert_allclose(kept.shapes, COMPLEX, rtol=1e-6)
    turned = read_modal(save(tmp_path, text))
    np.testing.assert_allclose(turned.shapes, kept.real().shapes)
    assert not turned.is_complex
    again = read_modal(
        save(tmp_path, "".join(files.analysis_2414(mode, True) for mode in range(3))), real=False
    )
    np.testing.assert_allclose(again.shapes, COMPLEX, rtol=1e-6)
    np.testing.assert_allclose(again.damping_ratios, DAMPING, rtol=1e-4)


def test_conjugates_are_left_out(tmp_path):
    poles = [files.eigenvalue(f, d) for f, d in zip(FREQUENCIES, DAMPING, strict=True)]
    pairs = [
        (0, COMPLEX[0], poles[0]),
        (0, COMPLEX[0].conj(), poles[0].conjugate()),
        (2, COMPLEX[2], poles[2]),
    ]
    text = "".join(files.complex_55(mode, shape, pole) for mode, shape, pole in pairs)
    np.testing.assert_allclose(read_modal(save(tmp_path, text)).frequencies, FREQUENCIES[[0, 2]], rtol=1e-5)


def test_phases_that_differ(tmp_path):
    """Warned of with the frequency, unless complex shapes are kept."""
    wild = files.complex_55(1, SHAPES[1] * np.exp(1j * np.array([0.0, 1.0, 2.0])))
    path = save(tmp_path, files.complex_55(0) + wild)
    with pytest.warns(ModalDataWarning, match="modes.uff: the phases of some shapes differ .*3.47 Hz"):
        read_modal(path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_modal(path, real=False)
        read_modal(save(tmp_path, files.complex_55(0)))


def test_rotations_and_single_values(tmp_path):
    values = np.arange(1.0, 19.0).reshape(3, 6)
    values[:, 4] = 0.0
    modal = read_modal(save(tmp_path, files.normal_55(0, values=values)))
    assert modal.channels[:5] == ("1X", "1Y", "1Z", "1RX", "1RZ")
    np.testing.assert_array_equal(modal.shapes[0], np.delete(values, 4, axis=1).ravel())
    modal = read_modal(save(tmp_path, files.normal_55(0, values=SHAPES[0][:, None])))
    assert modal.channels == ("1", "7", "12")


def test_a_node_that_a_mode_does_not_have(tmp_path):
    """Its sensor failed: it is not known. The format lets zeros be left out, too, which is not told apart."""
    text = files.normal_55(0) + files.normal_55(1, nodes=(1, 12), values=files.in_z(SHAPES[1, [0, 2]]))
    modal = read_modal(save(tmp_path, text))
    np.testing.assert_allclose(modal.shapes[1], [SHAPES[1, 0], np.nan, SHAPES[1, 2]], rtol=1e-6)


def test_damping_that_is_not_stated(tmp_path):
    zero = files.normal_55(0, numbers=(1.0, 1.0, 0.0, 0.0))
    assert read_modal(save(tmp_path, zero)).damping_ratios is None
    hysteretic = files.normal_55(1, numbers=(2.0, 1.0, 0.0, 0.04))  # zeta = eta / 2
    np.testing.assert_array_equal(
        read_modal(save(tmp_path, zero + hysteretic)).damping_ratios, [np.nan, 0.02]
    )


def test_numbers_that_touch(tmp_path):
    """Columns of 13 characters without a blank between, exponents of three digits, and Fortran's D."""
    text = files.normal_55(0)
    line = files.reals(0.0, 0.0, SHAPES[0, 0])
    touching = "-1.234567E-01-1.234567E-01-1.234567E+00\n"
    short = read_modal(save(tmp_path, text.replace(line, touching)))
    np.testing.assert_allclose(short.select(channels=["1X", "1Z"]).shapes[0], [-0.1234567, -1.234567])
    fortran = read_modal(save(tmp_path, text.replace(line, " 0.00000D+00 0.00000D+00 3.30000D-01\n")))
    assert fortran.shapes[0, 0] == 0.33


def of_pyuff(mode, **more):
    return {
        "type": 55,
        "analysis_type": 2,
        "data_ch": 2,
        "spec_data_type": 8,
        "r1": 0.0 * SHAPES[mode],
        "r2": 0.0 * SHAPES[mode],
        "r3": SHAPES[mode],
        "node_nums": np.array(files.NODES),
        "load_case": 1,
        "mode_n": mode + 1,
        "freq": FREQUENCIES[mode],
        "modal_m": 1.0,
        "modal_damp_vis": DAMPING[mode],
        "modal_damp_his": 0.0,
    } | more


def test_what_pyuff_writes(tmp_path):
    path = tmp_path / "theirs.uff"
    pyuff.UFF(str(path)).write_sets([of_pyuff(mode) for mode in range(3)], "overwrite")
    modal = read_modal(path)
    np.testing.assert_allclose(modal.shapes, SHAPES, rtol=1e-5)
    np.testing.assert_allclose(modal.frequencies, FREQUENCIES, rtol=1e-5)
    np.testing.assert_allclose(modal.damping_ratios, DAMPING, rtol=1e-5)
    pole = files.eigenvalue(FREQUENCIES[0], DAMPING[0])
    zeros = np.zeros(3, dtype=complex)
    pyuff.UFF(str(path)).write_sets(
        [of_pyuff(0, analysis_type=3, r1=zeros, r2=zeros, r3=COMPLEX[0], eig=pole)], "overwrite"
    )
    kept = read_modal(path, real=False)
    np.testing.assert_allclose(kept.shapes[0], COMPLEX[0], rtol=1e-5)
    np.testing.assert_allclose(kept.damping_ratios, DAMPING[:1], rtol=1e-3)


@pytest.mark.parametrize("text", [NORMAL, files.UNIVERSAL_COMPLEX], ids=["normal", "complex"])
def test_pyuff_reads_the_same(tmp_path, text):
    """An independent parser of the files that these tests are made of."""
    path = save(tmp_path, text)
    theirs = [found for found in pyuff.UFF(str(path)).read_sets() if found["type"] == 55]
    ours = read_modal(path, real=False)
    np.testing.assert_array_equal(ours.shapes, [found["r3"] for found in theirs])
    np.testing.assert_array_equal(theirs[0]["node_nums"], files.NODES)
    frequencies = [
        found["freq"] if "freq" in found else abs(found["eig"]) / (2.0 * np.pi) for found in theirs
    ]
    np.testing.assert_allclose(ours.frequencies, frequencies, rtol=1e-15)


FRF = files.block(58, "a function, whatever it says\n" * 13)
ONE = files.normal_55(0)
NODE_7 = files.integers(7)
REFUSED = {
    "must hold modes, in data sets 55 or 2414 of normal or complex modes, got the": files.geometry_15() + FRF,
    "got the data sets 15, 55 .analysis of type 5, no": files.geometry_15() + files.normal_55(0, analysis=5),
    "55 .modes of data of type 3, no motion.": files.normal_55(0, quantity=3),
    "line 24: the file must hold|must hold -1 at the end of the data set": files.geometry_15()[:-7],
    "must hold the number of a node, or -1 at the end of the data set, it ends at line 16": ONE[:-7],
    "line 12: the values of a node must be 3 finite numbers": ONE.replace(" 3.30000E-01", ""),
    "line 12: the values of a node must be 3 finite numbers, got '.*nan'": ONE.replace("3.30000E-01", "nan"),
    "line 13: the number of a node must stand alone, got '7": ONE.replace(NODE_7, "         7         8\n"),
    "line 13: the number of a node must be there, got an empty line": ONE.replace(NODE_7, "\n"),
    "nodes must be there once, got 1 again. Leave out one of them": ONE.replace(NODE_7, files.integers(1)),
    "line 8: what the data are must be said by": ONE.replace("         2         8", "         2       8.5"),
    "a node must have 1, 3 or 6 values, got 9. Export": files.normal_55(0, values=np.ones((3, 9))),
    "line 10: the frequency must stand in a line of at least 2": ONE.replace("1.21000E+00", "1.2l000E+00"),
    "`frequencies` must be positive, got 0.0 Hz of mode 0": files.normal_55(0, numbers=(0.0, 1.0, 0.0, 0.0)),
    "the eigenvalue must not be zero": files.complex_55(0, of_eigenvalue=0j),
    "`damping_ratios` must be fractions": files.complex_55(0, of_eigenvalue=files.eigenvalue(1.0, -0.01)),
    "must hold shapes that are not zero, got zeros": files.normal_55(0, values=np.zeros((3, 3))),
    "must have the same number of values at each node in": ONE + files.normal_55(1, values=np.ones((3, 1))),
    "line 19: the number of a data set must be there, got ''": ONE + "    -1\n\n    55\n",
    "a data set must begin with -1, got 'nonsense'": ONE + "nonsense\n",
    "holds binary data sets .58b.. Export the modes alone": ONE + files.block(58, "\0\0\n"),
}


@refusals("text", REFUSED)
def test_refusals(tmp_path, text, match):
    path = save(tmp_path, text)
    with pytest.raises(ValueError, match=f"modes.uff.*{match}" if "|" not in match else match):
        read_modal(path)


def test_shapes_much_larger_than_the_file(tmp_path):
    """Thousands of modes, each at a node of its own, are refused before memory is taken for them."""
    text = "".join(files.normal_55(0, nodes=(k,), values=np.ones((1, 6))) for k in range(1, 2501))
    with pytest.raises(ValueError, match="modes.uff must not hold arrays of more than 20 times its size"):
        read_modal(save(tmp_path, text))


def test_names_are_those_of_the_file(tmp_path):
    path = save(tmp_path, files.UNIVERSAL)
    modal = read_modal(path, channels={"roof": "12Z", "first": "1Z"})
    assert modal.channels == ("roof", "first")
    np.testing.assert_allclose(modal.shapes, SHAPES[:, [2, 0]], rtol=1e-6)
    with pytest.raises(ValueError, match=r"modes.uff: `channels` must be among .*1Z, 7Z, 12Z.*got '12X'"):
        read_modal(path, channels=["12X"])
    with pytest.raises(ValueError, match="`names` must be left out, got omega: modes.uff, a Universal File"):
        read_modal(path, names={"omega": "w"})


# --- functions, data set 58 ---------------------------------------------------------------------


RNG = np.random.default_rng(4)
HISTORIES = RNG.standard_normal((3, 200))
STEP = 0.01


def history(k, **more):
    return {
        "type": 58,
        "binary": 0,
        "func_type": 1,
        "rsp_node": 10 + k,
        "rsp_dir": -3 if k == 2 else 3,
        "ref_node": 1,
        "ref_dir": 3,
        "data": HISTORIES[k],
        "x": STEP * np.arange(200),
        "abscissa_spacing": 1,
        "abscissa_spec_data_type": 17,
        "ordinate_spec_data_type": 12,
        "orddenom_spec_data_type": 0,
        "ordinate_axis_units_lab": "m/s^2",
    } | more


def write_58(folder, *sets):
    path = folder / "motion.uff"
    path.unlink(missing_ok=True)
    pyuff.UFF(str(path)).write_sets(list(sets), "add")
    return path


@pytest.mark.parametrize("binary", [0, 1])
def test_time_histories(tmp_path, binary):
    path = write_58(tmp_path, *(history(k, binary=binary) for k in range(3)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # noise is no acceleration to the checks of channels
        found = read_channels(path)
    assert list(found["sensor"].values) == ["10Z", "11Z", "12-Z"]
    np.testing.assert_allclose(found.values, HISTORIES, atol=1e-10)
    assert found.attrs["units"] == "m/s^2"
    record = read_record(path, column="11Z")
    assert (record.dt, record.n_times) == (pytest.approx(STEP), 200)


def test_uneven_spacing_and_units_that_are_not_stated(tmp_path):
    path = write_58(tmp_path, history(0, abscissa_spacing=0, ordinate_axis_units_lab="NONE"))
    with pytest.raises(ValueError, match="`units` must be given, motion.uff does not state them"):
        read_record(path)
    record = read_record(path, units="g")
    assert record.dt == pytest.approx(STEP)
    np.testing.assert_allclose(record.acceleration, 9.81 * HISTORIES[0], atol=1e-9)


def test_no_format_is_taken_for_another(tmp_path):
    opening = Opening.of(write_58(tmp_path, history(0)))
    assert [entry.begins for entry in FORMATS if entry is not TEXT and opening.begins(entry.begins)] == [
        UNIVERSAL
    ]
    for text in ("-1\n55\n2\n", "    -1\n    0.5\n", "    -1\n"):
        assert not Opening(".uff", text.encode()).begins(UNIVERSAL)


@pytest.mark.parametrize(
    ("more", "match"),
    [
        ({"func_type": 4, "data": HISTORIES[0] + 0j}, "10Z: functions must be time histories, type 1, got"),
        ({"ordinate_spec_data_type": 8}, "must hold accelerations, the data set '10Z' says displacement"),
    ],
)
def test_other_functions(tmp_path, more, match):
    with pytest.raises(ValueError, match=f"motion.uff .*{match}"):
        read_record(write_58(tmp_path, history(0, **more)))


def test_files_that_are_cut(tmp_path):
    path = write_58(tmp_path, history(0), history(1))
    text = path.read_text()
    path.write_text(text[:-500])
    with pytest.raises(ValueError, match="motion.uff .Universal File. must end in a line of -1, it does"):
        read_channels(path)
    lines = text.splitlines(keepends=True)
    path.write_text("".join(lines[:20] + lines[21:]))
    with pytest.raises(ValueError, match="the 200 samples of its header must be there, got 196"):
        read_channels(path)


def test_binary_numbers_that_are_shifted(tmp_path):
    """A byte too many, of which pyuff makes other numbers of the same count."""
    path = write_58(tmp_path, history(0, binary=1))
    raw = path.read_bytes()
    place = raw.index(HISTORIES[0, 100].tobytes())
    path.write_bytes(raw[:place] + b"\x41" + raw[place:])
    with pytest.raises(ValueError, match="10Z: binary numbers must .* reach to the end of their data set"):
        read_record(path)


def test_byte_orders(tmp_path):
    path = write_58(tmp_path, history(0, binary=1))
    raw = path.read_bytes()
    start = raw.index(b"58b")
    path.write_bytes(raw[: start + 3] + b"     3" + raw[start + 9 :])
    with pytest.raises(ValueError, match="10Z: binary numbers must be IEEE, 2, of byte order 1 or 2, .* got"):
        read_record(path)
    place = raw.index(HISTORIES[0].tobytes())
    big = HISTORIES[0].astype(">f8").tobytes()
    path.write_bytes(raw[: start + 3] + b"     2" + raw[start + 9 : place] + big + raw[place + len(big) :])
    np.testing.assert_array_equal(read_record(path).acceleration, HISTORIES[0])


def test_modes_are_no_histories(tmp_path):
    with pytest.raises(ValueError, match="must hold time histories in data sets 58, got the data sets 15"):
        read_record(save(tmp_path, NORMAL))


def test_without_pyuff(tmp_path, monkeypatch):
    """Modes are read all the same."""
    path = write_58(tmp_path, history(0))
    monkeypatch.setitem(sys.modules, "pyuff", None)
    with pytest.raises(ImportError, match="pyuff must be installed to read"):
        read_record(path)
    assert len(read_modal(save(tmp_path, files.UNIVERSAL))) == 3
