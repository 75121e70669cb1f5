"""AT2 reader: the header spellings of real files, and ours."""

import json
import re

import numpy as np
import pytest

from pymc_features.io import read_record

G = 9.81
VALUES = [0.0, 0.1, -0.25, 0.003241, 0.05, -0.0625, 0.0]
PEER = "PEER NGA STRONG MOTION DATABASE RECORD"
KOBE = "KOBE 01/16/95 2046, NISHI-AKASHI, 090 (CUE)"
IN_G = "ACCELERATION TIME HISTORY IN UNITS OF G"
BODY = ["  .1000000E+00  -.2500000E+00", "  .5000000E-01"]


def write(folder, lines, end="\n", name="motion.AT2"):
    path = folder / name
    path.write_bytes(end.join([*lines, ""]).encode())
    return path


def formatted(values, per_line=5, form="{:15.7E}"):
    rows = [values[i : i + per_line] for i in range(0, len(values), per_line)]
    return ["".join(form.format(value) for value in row) for row in rows]


def with_count(line, old, new):
    """The header line with its NPTS number replaced, everything else kept."""
    if "NPTS" not in line:
        return line
    return re.sub(rf"(?<![\d.]){old}(?![\d.])", str(new), line, count=1)


@pytest.mark.parametrize("per_line", [1, 5])
@pytest.mark.parametrize("blank_after", [False, True])
def test_every_header_of_the_zoo(reference_dir, tmp_path, per_line, blank_after):
    zoo = json.loads((reference_dir / "at2_header_zoo.json").read_text())
    assert len(zoo) == 31
    for entry in zoo:
        end = "\r\r\n" if entry["crcrlf"] else "\r\n" if entry["crlf"] else "\n"
        header = [with_count(line, entry["npts"], len(VALUES)) for line in entry["header_lines"]]
        assert sum(line != old for line, old in zip(header, entry["header_lines"], strict=True)) == (
            not entry["file"].startswith("Oak")
        )
        trailer = [" ".join(entry["non_numeric_tokens_in_body"])]
        body = formatted(VALUES, per_line)
        path = write(tmp_path, header + [""] * blank_after + body + trailer, end, entry["file"])
        silent = entry["file"].startswith("Oak")  # states neither NPTS nor DT
        if silent:
            with pytest.raises(ValueError, match="`dt` must be given, Oak.* does not state the time"):
                read_record(path)
        record = read_record(path, dt=entry["dt"] if silent else None)
        assert record.dt == entry["dt"], entry["file"]
        np.testing.assert_allclose(record.acceleration, G * np.array(VALUES), rtol=1e-7)


@pytest.mark.parametrize(
    "count_line",
    [
        "NPTS=  3, DT= .02000 SEC",
        "NPTS=   3, dt=  .02000",
        "3    0.0200    NPTS, DT",
        "npts=3,dt=0.02sec",
        "NPTS= 3, DT= 2.0E-02 SEC,      ",
        "NPTS: 3  DT: 2.D-2",
        "NPTS=  3\nDT= .02000 SEC",
    ],
)
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r\r\n", "\r"])
def test_count_and_step_spellings(tmp_path, count_line, end):
    path = write(tmp_path, [PEER, KOBE, IN_G, *count_line.split("\n"), *BODY], end)
    record = read_record(path)
    assert record.dt == 0.02
    assert record.name == KOBE
    np.testing.assert_allclose(record.acceleration, [0.1 * G, -0.25 * G, 0.05 * G], rtol=1e-14)


@pytest.mark.parametrize(
    ("line", "factor"),
    [
        ("ACCELERATION TIME SERIES IN UNITS OF G ", G),
        ("The units are (g)", G),
        ("  Acceleration in g", G),
        ("ACCELERATION TIME HISTORY IN UNITS OF G. FILTER POINTS: HP=0.1 Hz LP=40.0 Hz", G),
        ("UNITS: CM/SEC/SEC", 0.01),
        ("ACCELERATION IN UNITS OF CM/S**2", 0.01),
        ("Acceleration in m/s^2", 1.0),
        ("units (gal)", 0.01),
    ],
)
def test_stated_units(tmp_path, line, factor):
    path = write(tmp_path, ["motion", line, "NPTS= 3, DT= .01", *BODY])
    np.testing.assert_allclose(read_record(path).pga, 0.25 * factor, rtol=1e-14)


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ("-.1234567E-02-.2345678E-02 .3241E-02", [-0.001234567, -0.002345678, 0.003241]),
        (".1D-01 -1.5d0,+2", [0.01, -1.5, 2.0]),
        ("   0.00630   -0.00364\t 1.", [0.0063, -0.00364, 1.0]),
    ],
)
def test_spellings_of_values(tmp_path, row, expected):
    path = write(tmp_path, [IN_G, "NPTS= 3, DT= .01", row])
    np.testing.assert_allclose(read_record(path).acceleration, G * np.array(expected), rtol=1e-14)


def test_values_glued_without_a_sign_are_refused(tmp_path):
    path = write(tmp_path, [IN_G, "NPTS= 3, DT= .01", "0.1234E-02 0.1", "0.1234E-020.5678E-02"])
    with pytest.raises(ValueError, match=r"motion.AT2 \(PEER AT2\), line 4: values must be finite numbers"):
        read_record(path)


def test_name_is_the_file_stem_without_one_event_line(tmp_path):
    assert read_record(write(tmp_path, [IN_G, "NPTS= 3, DT= .01", *BODY])).name == "motion"
    twice = [KOBE, KOBE, IN_G, "NPTS= 3, DT= .01", *BODY]
    assert read_record(write(tmp_path, twice)).name == "motion"


def test_arguments_win_over_the_header_with_a_warning(tmp_path):
    path = write(tmp_path, [IN_G, "NPTS= 3, DT= .02", *BODY])
    with pytest.raises(ValueError, match="`units` must be those of the file, .* states 'G', got 'gal'"):
        read_record(path, units="gal")
    with pytest.warns(UserWarning, match="a time step of 0.02 s; the argument dt=0.01 s is used"):
        assert read_record(path, dt=0.01).dt == 0.01


def test_warning_points_at_the_caller(tmp_path):
    path = write(tmp_path, [IN_G, "NPTS= 3, DT= .02", *BODY])
    with pytest.warns(UserWarning) as caught:
        read_record(path, dt=0.01)
    assert caught[0].filename == __file__


@pytest.mark.filterwarnings("error")
def test_agreeing_arguments_do_not_warn(tmp_path):
    path = write(tmp_path, [IN_G, "NPTS= 3, DT= .02", *BODY])
    assert read_record(path, units="g", dt=0.02).pga == pytest.approx(0.25 * 9.81)
    assert read_record(path, units=9.80665).pga == pytest.approx(0.25 * 9.80665)


@pytest.mark.parametrize(
    ("lines", "arguments", "message"),
    [
        ([PEER, "NPTS= 3, DT= .02", *BODY], {}, '`units` must be given, .* Pass one of "g", "mg", "m/s'),
        (["VELOCITY TIME SERIES IN UNITS OF CM/S", "NPTS= 3, DT= .02", *BODY], {}, "motion.AT2 must hold"),
        ([IN_G, "NPTS= 4, DT= .02", *BODY], {}, "must hold the NPTS = 4 values .* got 3"),
        ([IN_G, "NPTS= 2, DT= .02", *BODY], {}, "must hold the NPTS = 2 values .* got 3"),
        ([IN_G, *BODY], {}, "`dt` must be given, motion.AT2 does not state the time step"),
        ([IN_G, "NPTS= 3, DT= .000", *BODY], {}, "`dt` must be given"),
        ([IN_G, "NPTS= 3, DT= 20.", *BODY], {}, "states a time step of 20, too long for seconds"),
        ([IN_G, "NPTS= 3, DT= .02", *BODY], {"column": 1}, "`column` must be one of the channels of motion"),
        ([IN_G, "NPTS= 3, DT= .02", ".1 x .2"], {}, "must hold values below its header"),
        ([IN_G, "NPTS= 3, DT= .02", ".1", "x .2"], {}, "line 4: values must be finite.*got 'x'"),
        ([IN_G, "NPTS= 3, DT= .02", ".1 NaN .2"], {}, "line 3: values must be finite.*got 'NaN'"),
        ([IN_G, "NPTS= 3, DT= .02", ".1 ", "1e999 .2"], {}, "line 4: .*got '1e999'"),
        ([""], {}, "must hold values below its header, none was found"),
        (["\0\0"], {}, "must be a text file, it holds binary data"),
    ],
)
def test_error_messages(tmp_path, lines, arguments, message):
    with pytest.raises(ValueError, match=message):
        read_record(write(tmp_path, lines), **arguments)


def test_line_of_numbers_above_the_npts_line_is_header(tmp_path):
    record = read_record(write(tmp_path, [IN_G, "5056 32.96", "NPTS= 3, DT= .02", *BODY]))
    assert record.n_times == 3


def test_text_below_the_trailer_is_ignored(tmp_path):
    lines = ["*** Begin data ***", IN_G, "NPTS= 3, DT= .02", *BODY, "*** End Data ***", "notes 1"]
    assert read_record(write(tmp_path, lines)).n_times == 3
