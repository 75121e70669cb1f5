"""Frequency response functions of files: parts, units, places, and files that are broken."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from pymc_features import read_channels
from pymc_features.io import read_frequency_response

pytestmark = pytest.mark.filterwarnings("error::UserWarning")

F = np.arange(1.0, 13.0)
H = (F - 6.5) + 1j * (1.0 + F**2)  # no value is zero, no part without a sign
OTHER = H * np.exp(0.3j) / 7.0
DATA = Path(os.environ.get("PYMC_FEATURES_DATA", "/none"))
real_data = pytest.mark.skipif(not DATA.is_dir(), reason="without the data")


def table(path, labels, *columns, cut=","):
    """A table of labelled columns; cells of complex numbers as 1+2j."""
    rows = [cut.join(f"{x:.17g}" for x in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([labels, *rows]) + "\n")
    return path


def pairs(h):
    return h.real, h.imag


def values(path, **arguments):
    """The function of a file with a single one."""
    return read_frequency_response(path, **arguments)["frequency_response"].values[0, 0]


PLACES = {"response": "5:+z", "reference": "3:-x"}
SI = PLACES | {"units": "(m/s^2)/N"}


# --- tables -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("labels", "columns"),
    [
        ("frequency [Hz],real [(m/s^2)/N],imaginary", pairs(H)),
        ("Freq (Hz),Re [m/s^2/N],Im [m/s^2/N]", pairs(H)),
        ("f,imag [(m/s²)(N)],real", pairs(H)[::-1]),
        ("f [Hz],magnitude [(m/s^2)/N],phase [deg]", (abs(H), np.degrees(np.angle(H)))),
        ("f [Hz],magnitude [(m/s^2)/N],phase [rad]", (abs(H), np.angle(H))),
        ("f [Hz],magnitude [dB re 1 (m/s^2)/N],phase (°)", (20 * np.log10(abs(H)), np.degrees(np.angle(H)))),
        ("f [Hz],magnitude [dB re 1e-6 (m/s^2)/N],phase [rad]", (20 * np.log10(abs(H)) + 120.0, np.angle(H))),
        ("f [Hz],H [(1/N)*(m/s^2)]", (H,)),
    ],
)
@pytest.mark.parametrize("cut", [",", "\t", ";"])
def test_parts_of_a_table(tmp_path, labels, columns, cut):
    path = table(tmp_path / "beam.csv", labels.replace(",", cut), F, *columns, cut=cut)
    data = read_frequency_response(path, **PLACES)
    np.testing.assert_allclose(data["frequency_response"].values[0, 0], H, rtol=1e-13)
    assert data.attrs["quantity"] == "accelerance" and data.attrs["excitation"] == "force"
    np.testing.assert_array_equal(data["frequency"], F)


@pytest.mark.parametrize("unit, factor", [("kHz", 1e3), ("rad/s", 0.5 / np.pi)])
def test_frequencies_are_in_hertz(tmp_path, unit, factor):
    path = table(tmp_path / "beam.csv", f"frequency [{unit}],real,imaginary", F, *pairs(H))
    np.testing.assert_allclose(read_frequency_response(path, **SI)["frequency"], factor * F, rtol=1e-15)


@pytest.mark.parametrize(
    ("unit", "quantity", "excitation", "factor"),
    [
        ("g/N", "accelerance", "force", 9.81),
        ("mm/s/N", "mobility", "force", 1e-3),
        ("(m/s)/kN", "mobility", "force", 1e-3),
        ("um/N", "receptance", "force", 1e-6),
        ("in/lbf", "receptance", "force", 0.0254 / 4.4482216152605),
        ("g/g", "accelerance", "base", 1.0),
        ("mm/(m/s^2)", "receptance", "base", 1e-3),
    ],
)
def test_units_say_the_quantity(tmp_path, unit, quantity, excitation, factor):
    stated = table(tmp_path / "a.csv", f"frequency [Hz],real [{unit}],imaginary", F, *pairs(H))
    silent = table(tmp_path / "b.csv", "frequency [Hz],real,imaginary", F, *pairs(H))
    for data in (
        read_frequency_response(stated, **PLACES),
        read_frequency_response(silent, units=unit, **PLACES),
    ):
        np.testing.assert_allclose(data["frequency_response"].values[0, 0], factor * H, rtol=1e-13)
        assert (data.attrs["quantity"], data.attrs["excitation"]) == (quantity, excitation)


def test_what_the_data_set_says(tmp_path):
    """Of a file nothing is known about averages, records and windows."""
    path = table(tmp_path / "beam.csv", "frequency [Hz],real,imaginary", F, *pairs(H))
    data = read_frequency_response(path, **SI)
    assert list(data) == ["frequency_response"] and data["frequency_response"].dtype == np.complex128
    assert data["frequency_response"].dims == ("response", "reference", "frequency")
    assert data["response"].values.tolist() == ["5:+z"] and data["reference"].values.tolist() == ["3:-x"]
    known = {"quantity": "accelerance", "excitation": "force", "units": "(m/s^2)/N", "n_averages": 0}
    assert {k: v for k, v in data.attrs.items() if v == v} == known | {"decay": 0.0}
    assert set(data.attrs) == {*known, "decay", "duration", "dt", "blow"}


def test_labels_of_columns_and_coherence(tmp_path):
    labels = "f [Hz],5:+z/3z real [g/N],5:+z/3z imag,5:+z/3z coherence,6:-y/3:+z real [g/N],imag"
    path = table(tmp_path / "beam.csv", labels, F, *pairs(H), 1.0 / F, *pairs(OTHER))
    data = read_frequency_response(path)
    assert data["response"].values.tolist() == ["5:+z", "6:-y"] and data["reference"].item() == "3:+z"
    np.testing.assert_allclose(data["frequency_response"].values[:, 0] / 9.81, [H, OTHER], rtol=1e-13)
    np.testing.assert_allclose(data["coherence"].values[0, 0], 1.0 / F, rtol=1e-13)
    assert np.isnan(data["coherence"].values[1]).all()


def test_places_by_the_names_of_files(tmp_path):
    scales = {"5+z_1x": 9, "5+z_2x": 1, "6-z_1x": 2, "6-z_2x": 3}
    paths = [
        table(tmp_path / f"{name}.txt", "f [Hz],real [m/N],imag", F, *pairs(scale * H))
        for name, scale in scales.items()
    ]
    data = read_frequency_response(paths[::-1]).sel(response=["5:+z", "6:-z"], reference=["1:+x", "2:+x"])
    np.testing.assert_allclose(data["frequency_response"][..., 0] / H[0], [[9, 1], [2, 3]], rtol=1e-13)
    listed = read_frequency_response([table(tmp_path / "a.csv", "f,real [m/N],imag", F, *pairs(H))], **PLACES)
    assert listed["response"].item() == "5:+z"


def test_columns_that_have_no_labels(tmp_path):
    path = table(tmp_path / "beam.csv", "1,2,3", F, *pairs(H))
    path.write_text("\n".join(path.read_text().split("\n")[1:]))
    with pytest.raises(
        ValueError, match='must have a label of each of 3 columns, one "frequency", got none. Say so by'
    ):
        read_frequency_response(path, **SI)
    found = values(path, columns=["frequency [Hz]", "real", "imaginary"], **SI)
    np.testing.assert_allclose(found, H, rtol=1e-13)


# --- other files ------------------------------------------------------------------------------------


@pytest.mark.parametrize("names", [("H",), ("H_real", "H_imag"), ("H_mag", "H_phase_deg")])
@pytest.mark.parametrize("suffix", [".mat", ".npz"])
def test_arrays(tmp_path, suffix, names):
    grid = np.array([[H, OTHER, 2 * H], [3 * H, 4 * OTHER, 5 * H]])  # (response, reference, frequency)
    parts = {1: (grid,), 2: (grid.real, grid.imag)}[len(names)]
    if "phase" in names[-1]:
        parts = abs(grid), np.degrees(np.angle(grid))
    path = tmp_path / f"beam{suffix}"
    arrays = dict(zip(names, parts, strict=True)) | {"frequency": F, "units": "g/N"}
    (savemat if suffix == ".mat" else lambda path, arrays: np.savez(path, **arrays))(path, arrays)
    data = read_frequency_response(path, response=["5:+z", "6:+z"], reference=["1:+x", "2:+x", "3:+x"])
    np.testing.assert_allclose(data["frequency_response"].values, 9.81 * grid, rtol=1e-13)
    with pytest.raises(
        ValueError, match="`response, reference` must be one place, or one for each of 6 functions"
    ):
        read_frequency_response(path, response=["5:+z", "6:+z"], reference="1:+x")


def test_frequencies_first_in_an_array(tmp_path):
    np.savez(tmp_path / "beam.npz", mobility=np.array([H, OTHER]).T, f=F)
    data = read_frequency_response(tmp_path / "beam.npz", units="(m/s)/N", response="1", reference=["a", "b"])
    np.testing.assert_array_equal(data["frequency_response"].values, [[H, OTHER]])
    with pytest.raises(ValueError, match="must be velocity as it says, got units m/N"):
        read_frequency_response(tmp_path / "beam.npz", units="m/N", response="1", reference=["a", "b"])
    np.savez(tmp_path / "beam.npz", mobility=H)
    with pytest.raises(ValueError, match="must hold a vector `frequency`, got mobility"):
        read_frequency_response(tmp_path / "beam.npz", **SI)


@real_data
def test_an_export_of_signalcalc_is_read_as_it_was_written():
    path = DATA / "hammer_beam" / "signalcalc_excerpt.txt"
    data = read_frequency_response(path, response="4:-x", reference="1:+x")
    found, written = data["frequency_response"].values[0, 0], path.read_text(encoding="latin-1").split("\n")
    assert len(written) == 1001 and found.size == 991  # below nine lines
    rows = [[float(cell) for cell in line.split("\t")] for line in written[9:-1]]
    np.testing.assert_array_equal(np.array(rows), np.array([data["frequency"], *pairs(found)]).T)
    assert found[1] == -0.1366724 + 0.007331555j and data["frequency"][1] == 1.0 / 51.2
    assert data.attrs["units"] == "(m/s^2)/N" and data.attrs["quantity"] == "accelerance"
    with pytest.raises(
        ValueError, match=r"`units` must be .*, got 'g/N', signalcalc_excerpt.txt states '\(m/s²\)\(N\)'"
    ):
        read_frequency_response(path, units="g/N", **PLACES)


@real_data
def test_functions_of_a_beam_are_those_of_the_file():
    path = DATA / "hammer_beam" / "frf.npz"
    points = [f"{k}:+x" for k in range(1, 10)]
    data = read_frequency_response(path, units="(m/s^2)/N", response="4:-x", reference=points)
    with np.load(path) as stored:
        np.testing.assert_array_equal(data["frequency_response"].values[0], stored["accelerance"])
        np.testing.assert_array_equal(data["frequency"], stored["frequency"])
    assert data["reference"].values.tolist() == points


# --- Universal Files --------------------------------------------------------------------------------


def universal(path, *sets):
    """Data sets 58 by pyuff, each some changes of a function of response 5:+z and reference 3:-x."""
    pyuff = pytest.importorskip("pyuff")
    path.write_bytes(b"")
    for changes in sets:
        one = {"type": 58, "func_type": 4, "rsp_node": 5, "rsp_dir": 3, "ref_node": 3, "ref_dir": -1}
        one |= {"data": H, "x": F, "abscissa_spacing": 1, "binary": 0, "abscissa_spec_data_type": 18}
        one |= {
            "ordinate_axis_units_lab": "m/s^2",
            "orddenom_axis_units_lab": "N",
            "abscissa_axis_units_lab": "Hz",
        }
        one |= {"ordinate_spec_data_type": 12, "orddenom_spec_data_type": 13} | changes
        pyuff.UFF(str(path)).write_sets(one, mode="add")
    return path


@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("even", [0, 1])
def test_universal_files(tmp_path, binary, even):
    form = {"binary": binary, "abscissa_spacing": even}
    sets = [{"data": H}, {"data": OTHER, "rsp_node": 6, "rsp_dir": -5}, {"func_type": 6, "data": 1.0 / F}]
    data = read_frequency_response(universal(tmp_path / "a.uff", *(form | one for one in sets)))
    assert data["response"].values.tolist() == ["5:+z", "6:-ry"] and data["reference"].item() == "3:-x"
    np.testing.assert_allclose(data["frequency_response"].values[:, 0], [H, OTHER], rtol=1e-10)
    np.testing.assert_allclose(data["coherence"].values[0, 0], 1.0 / F, rtol=1e-10)
    np.testing.assert_allclose(data["frequency"], F, rtol=1e-5)


def test_an_axis_that_was_rounded(tmp_path):
    """Six digits are printed of uneven axes: steps of 8 mHz at 1000 Hz are steps of 0 and 10 mHz there."""
    x = 1000.0 + 0.0078125 * np.arange(200.0)
    path = universal(tmp_path / "a.uff", {"x": x, "data": np.full(200, 1.0 + 1.0j), "abscissa_spacing": 0})
    np.testing.assert_allclose(read_frequency_response(path)["frequency"], x, rtol=2e-6)


def test_several_universal_files(tmp_path):
    paths = [universal(tmp_path / f"{k}.uff", {"ref_node": k, "data": k * H}) for k in (2, 7)]
    data = read_frequency_response(paths)
    assert data["reference"].values.tolist() == ["2:-x", "7:-x"]
    np.testing.assert_allclose(data["frequency_response"].values[0], [2 * H, 7 * H], rtol=1e-10)


@pytest.mark.parametrize(
    ("changes", "arguments", "match"),
    [
        ({"ordinate_axis_units_lab": "mm/s"}, {}, "must be acceleration per force as it says, got units"),
        ({"ordinate_axis_units_lab": "NONE"}, {}, "`units` must be a ratio .*, got None, .* states ''"),
        ({}, {"units": "g/N"}, r"`units` must be a ratio .*, got 'g/N', .* states '\(m/s\^2\)/\(N\)'"),
        ({}, {"units": "furlong/N"}, "`units` must be a ratio .*, got 'furlong/N'"),
        ({}, {"response": "6:+z"}, r"`response` must be the place .*, got '6:\+z', .* states '5:\+z'"),
        ({"ref_node": 0, "ref_dir": 0}, {}, "`reference` must be the place .*, got '', a.uff, .* states ''"),
        (
            {"func_type": 1, "data": H.real},
            {},
            "must hold frequency response functions, .* type 4, got type 1",
        ),
        ({"data": H.real}, {}, "must be complex, got real parts alone"),
        ({"abscissa_axis_units_lab": "s"}, {}, "must have frequencies in Hz or rad/s, got 's'"),
    ],
)
def test_contradictions_in_universal_files(tmp_path, changes, arguments, match):
    with pytest.raises(ValueError, match=match):
        read_frequency_response(universal(tmp_path / "a.uff", changes), **arguments)


def test_arguments_say_what_a_universal_file_leaves_open(tmp_path):
    silent = {"ref_node": 0, "ref_dir": 0, "rsp_node": 0, "rsp_dir": 0, "rsp_ent_name": "tip"}
    silent |= {"ordinate_axis_units_lab": "NONE", "orddenom_axis_units_lab": "NONE"}
    data = read_frequency_response(universal(tmp_path / "a.uff", silent), units="g/N", reference="3:-x")
    assert data["response"].item() == "tip"
    np.testing.assert_allclose(data["frequency_response"].values[0, 0], 9.81 * H, rtol=1e-10)
    other = universal(
        tmp_path / "a.uff", {"ordinate_axis_units_lab": "V/V", "orddenom_axis_units_lab": "NONE"}
    )
    with pytest.warns(UserWarning, match="states the units 'V/V'; the argument units='m/s\\^2/N' is used"):
        read_frequency_response(other, units="m/s^2/N")


@real_data
def test_a_universal_file_of_an_analyser():
    """In Latin-1, with a ratio as its unit, and without nodes."""
    path = DATA / "uff" / "non_ascii_header.uff"
    data = read_frequency_response(path, response="2", reference="1")
    np.testing.assert_allclose(
        data["frequency_response"][0, 0, :2], [0.407994, -0.0599924 - 0.055326j], rtol=1e-12
    )
    assert data.attrs["units"] == "(m/s^2)/N"
    for call in (
        lambda: read_channels(path),
        lambda: read_channels(DATA / "hammer_beam" / "signalcalc_excerpt.txt"),
    ):
        with pytest.raises(ValueError, match="io.read_frequency_response"):
            call()


# --- broken files -----------------------------------------------------------------------------------

DB = 20.0 * np.log10(abs(H) / 100.0)


@pytest.mark.parametrize(
    ("labels", "columns", "arguments", "match"),
    [
        (
            "f,magnitude,phase [deg]",
            (DB, F),
            {},
            "magnitudes that are not negative, got -.*, as of dB. Say so by",
        ),
        (
            "f,magnitude,phase",
            (abs(H), F),
            {},
            "must say whether its phase is in deg or rad, got 'phase'. Say",
        ),
        ("f,real", (H.real,), {}, "must have complex numbers, real and imaginary parts, .*, got real alone"),
        ("f,magnitude", (abs(H),), {}, "or magnitude and phase, got magnitude alone"),
        ("f,real,imaginary", (H.real, 0 * F), {}, "must be complex, got real parts alone"),
        ("f,H", (H.real,), {}, "must be complex, got real parts alone"),
        (
            "f,real,imaginary",
            pairs(H),
            {"columns": ["f", "magnitude", "phase [deg]"]},
            "`columns` must say what",
        ),
        (
            "f,real [g/N],imaginary",
            pairs(H),
            {"columns": ["f", "real [m/N]", "imaginary"]},
            "`columns` must say what",
        ),
        ("time,real,imaginary", pairs(H), {}, 'one "frequency", got time, real, imaginary. Say so by'),
    ],
)
def test_tables_that_are_broken(tmp_path, labels, columns, arguments, match):
    with pytest.raises(ValueError, match=match):
        read_frequency_response(table(tmp_path / "beam.csv", labels, F, *columns), **SI | arguments)


def test_two_sided_functions(tmp_path):
    path = table(tmp_path / "beam.csv", "f,real,imaginary", F - F.mean(), *pairs(H))
    with pytest.raises(ValueError, match="must have no negative frequencies, got -"):
        read_frequency_response(path, **SI)


def test_what_the_argument_says_of_a_column(tmp_path):
    path = table(tmp_path / "beam.csv", "f,magnitude,phase", F, DB, np.degrees(np.angle(H)))
    found = values(path, columns=["f [Hz]", "magnitude [dB re 100 (m/s^2)/N]", "phase [deg]"], **PLACES)
    np.testing.assert_allclose(found, H, rtol=1e-13)


def test_lines_that_are_missing(tmp_path):
    keep = (F < 4.0) | (F > 6.0)
    path = table(
        tmp_path / "beam.csv",
        "f,real,imaginary",
        np.r_[F[keep], 13:40],
        *pairs(np.r_[H[keep], np.full(27, 1j)]),
    )
    with pytest.warns(UserWarning, match="lines at or before 7.0 Hz are missing. Were"):
        read_frequency_response(path, **SI)
    with pytest.warns(UserWarning, match="lines at or before 4.0, 5.0 Hz are missing. Were"):
        read_frequency_response(
            universal(tmp_path / "a.uff", {"data": np.where((F == 4.0) | (F == 5.0), 0.0, H)})
        )
    np.savez(tmp_path / "a.npz", f=F, H=np.where(F == 4.0, np.nan, H))
    with pytest.raises(ValueError, match=r"a.npz, H must be finite, got NaN at \[4.\] Hz"):
        read_frequency_response(tmp_path / "a.npz", **SI)
    path = table(tmp_path / "beam.csv", "f,real,imaginary", np.geomspace(1, 100, 12), *pairs(H))
    read_frequency_response(path, **SI)  # an axis that is nowhere even
    path = table(tmp_path / "beam.csv", "f,real,imaginary", F[::-1], *pairs(H))
    with pytest.raises(ValueError, match="two or more rising frequencies"):
        read_frequency_response(path, **SI)
    path.write_text("f,real,imaginary\n1,2,3\n2,x,3\n3,4,5\n")
    with pytest.raises(ValueError, match="beam.csv, line 3: values must be finite numbers, got 'x'"):
        read_frequency_response(path, **SI)
    path.write_text("f,H\n1,2+3j\n2,x\n3,4-2j\n")
    with pytest.raises(ValueError, match="beam.csv must be a whole CSV file, NumPy cannot read it"):
        read_frequency_response(path, **SI)


def test_functions_that_do_not_belong_together(tmp_path):
    a = universal(tmp_path / "a.uff", {})
    for changes, match in (
        ({"rsp_node": 6, "ref_node": 4}, r"Functions must have each pair once, 5:\+z / 4:-x, got it 0 times"),
        ({}, r"Functions must have each pair once, 5:\+z / 3:-x, got it 2 times"),
        ({"rsp_node": 6, "x": 2 * F}, "must have the 12 lines to 12 Hz of a.uff, 5.*, got 12 to 24 Hz"),
        (
            {"rsp_node": 6, "x": F[1:], "data": H[1:]},
            "must have the 12 lines to 12 Hz of a.uff, 5.*, got 11 to",
        ),
        (
            {"rsp_node": 6, "ordinate_axis_units_lab": "m/s", "ordinate_spec_data_type": 11},
            "Functions must be of one quantity",
        ),
    ):
        with pytest.raises(ValueError, match=match):
            read_frequency_response([a, universal(tmp_path / "b.uff", changes)])


@pytest.mark.parametrize("files", [[], None, 3])
def test_no_files(files):
    with pytest.raises(ValueError, match="`files` must be a path, or several"):
        read_frequency_response(files)


@pytest.mark.processes
def test_little_is_imported_to_read_a_function(tmp_path):
    path = table(tmp_path / "beam.csv", "f,real [m/N],imaginary", F, *pairs(H))
    code = f"""if True:
        import sys
        from pymc_features.io import read_frequency_response
        read_frequency_response({str(path)!r}, response="1", reference="2")
        print([name for name in ("pymc", "pytensor", "arviz") if name in sys.modules])
    """
    assert re.search(
        r"^\[\]$", subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout, re.M
    )
