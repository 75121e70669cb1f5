"""Text reader, and what all formats share: units, steps, paths."""

import os
from pathlib import Path

import numpy as np
import pytest

from pymc_features.io import read_channels, read_record
from pymc_features.io.reading.labels import unit_factor
from pymc_features.records import Record

ACCELERATION = np.array([0.0, 0.1, -0.25, 0.05])
ROWS = [f"{0.02 * k:.2f},{a}" for k, a in enumerate(ACCELERATION)]


def write(folder, content, name="elcentro.csv", encoding="utf-8"):
    path = folder / name
    text = content if isinstance(content, str) else "\n".join(content) + "\n"
    path.write_bytes(text.encode(encoding))
    return path


# --- layouts ------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".csv", ".txt", ".dat", ".tsv", ".acc", ".TXT", ".v1", ""])
@pytest.mark.parametrize("separator", [",", ", ", ";", "\t", "  ", " \t "])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r\r\n"])
def test_separators_line_ends_and_suffixes(tmp_path, suffix, separator, end):
    rows = [row.replace(",", separator) for row in ROWS]
    path = write(tmp_path, end.join(rows) + 3 * end, f"elcentro{suffix}")
    record = read_record(path, units="m/s^2")
    assert isinstance(record, Record)
    assert (record.dt, record.name) == (0.02, "elcentro")
    np.testing.assert_array_equal(record.acceleration, ACCELERATION)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_encodings(tmp_path, encoding):
    path = write(tmp_path, ["Zeit [s];a für x [m/s²]", *ROWS], encoding=encoding)
    assert read_record(path).pga == 0.25


@pytest.mark.parametrize(
    "header",
    [
        [],
        ["# El Centro, NS", "% second", "// third"],
        ["sep=,", "Device: A", "", "time,acc"],
        ["time [s],acc [m/s^2]"],
        ['"time","acc"'],
    ],
)
def test_headers_are_skipped(tmp_path, header):
    record = read_record(write(tmp_path, [*header, *ROWS, "# end"]), units="m/s^2")
    np.testing.assert_array_equal(record.acceleration, ACCELERATION)


def test_trailing_separator_quotes_and_blank_lines(tmp_path):
    rows = ['"0.00","0.1",', "", '"0.02","0.2",', "# note", '"0.04","-0.3",', "  ", ""]
    np.testing.assert_array_equal(
        read_record(write(tmp_path, rows), units=1.0).acceleration, [0.1, 0.2, -0.3]
    )


@pytest.mark.parametrize("values", [ACCELERATION, -ACCELERATION])
def test_one_column_needs_dt(tmp_path, values):
    path = write(tmp_path, [f" {value:.3E}" for value in values])
    record = read_record(path, units="gal", dt=0.005)
    np.testing.assert_allclose(record.acceleration, 0.01 * values, rtol=1e-14)
    assert record.dt == 0.005
    with pytest.raises(ValueError, match="`dt` must be given, elcentro.csv does not state the time"):
        read_record(path, units="gal")


def test_wide_table_by_index_and_name(tmp_path):
    rows = ["time [s],ux [m],ax [cm/s^2]"] + [f"{0.01 * k:.2f},{k},{10 * k}" for k in range(5)]
    path = write(tmp_path, rows)
    for column in (2, "ax", "ax [cm/s^2]", np.int64(2)):
        record = read_record(path, column=column)
        np.testing.assert_allclose(record.acceleration, 0.1 * np.arange(5))
        assert record.dt == 0.01
    with pytest.raises(ValueError, match=r"has the channels ux \[m\], ax \[cm/s\^2\]"):
        read_record(path)


def test_blanks_in_the_names_of_tab_separated_columns(tmp_path):
    rows = ["time in s\tfloor 1 [m/s2]\tfloor 2 [g]"] + [f"{0.1 * k}\t0\t-{k}" for k in range(4)]
    assert read_record(write(tmp_path, rows), column="floor 2").pga == 3 * 9.81


def test_first_column_that_is_no_time(tmp_path):
    rows = [f"{a},{b}" for a, b in [(0.1, 1.0), (-0.2, 2.0), (0.3, 3.0)]]
    path = write(tmp_path, rows)
    np.testing.assert_array_equal(read_record(path, units=1, dt=0.1, column=1).acceleration, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(read_record(path, units=1, dt=0.1, column=0).acceleration, [0.1, -0.2, 0.3])
    with pytest.raises(ValueError, match="`dt` must be given"):
        read_record(path, units=1, column=1)
    with pytest.raises(ValueError, match="`dt` must be given"):
        read_record(path, units=1, column=0)
    with pytest.raises(ValueError, match="`column` must be given, .* has the channels column 0, column 1"):
        read_record(path, units=1, dt=0.1)


@pytest.mark.filterwarnings("error")
def test_raw_sensor_export(data_dir):
    path = data_dir / "mini_shake_table" / "flexible_northridge_base.csv"
    record = read_record(path, units="m/s^2", column="Acc_X")  # its clock counts microseconds
    assert record.dt == pytest.approx(1 / 120, rel=1e-4)
    np.testing.assert_allclose(record.acceleration[:3], [0.0, 0.08530480414629, 0.10867324471474], rtol=1e-13)


@pytest.mark.filterwarnings("error")
def test_el_centro_file(data_dir):
    record = read_record(data_dir / "elcentro.dat", units="g")
    assert (record.n_times, record.dt) == (1560, 0.02)
    assert record.pga == pytest.approx(0.31882 * 9.81, rel=1e-14)
    raw = np.loadtxt(data_dir / "elcentro.dat", usecols=1)  # another reader, the same numbers
    np.testing.assert_allclose(record.acceleration, 9.81 * raw, rtol=1e-15)


# --- time steps ---------------------------------------------------------------------------------


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("dt", "form"),
    [
        (1 / 120, "{:.3f}"),
        (1 / 120, "{:.6f}"),
        (0.02, "{:.2f}"),
        (0.02, "{:g}"),
        (0.02, "{:.4E}"),
        (0.02, "{!r}"),
        (1 / 256, "{:g}"),
    ],
)
def test_rounding_of_printed_times_is_tolerated(tmp_path, dt, form):
    rows = [f"{form.format(k * dt)} {(-1) ** k}" for k in range(1, 1001)]
    assert read_record(write(tmp_path, rows), units="g").dt == pytest.approx(dt, rel=2e-4)


def uneven_rows(n_rows=900, at=870, shift=2e-4):
    times = 0.02 * np.arange(n_rows)
    times[at] += shift
    return [f"{t:.4f},{(-1) ** k}" for k, t in enumerate(times)]


def test_uneven_steps_name_the_line(tmp_path):
    message = (
        r"^elcentro.csv, line 871: time steps must be even, they vary from 0.0198 s to 0.0202 s. "
        r"Resample the record first.$"
    )
    with pytest.raises(ValueError, match=message):
        read_record(write(tmp_path, uneven_rows()), units="g")
    with pytest.raises(ValueError, match="line 874"):  # lines are counted in the file
        read_record(write(tmp_path, ["a", "", "#", *uneven_rows()]), units="g")
    with pytest.warns(UserWarning, match="must be even.* The argument dt=0.02 s is used"):
        assert read_record(write(tmp_path, uneven_rows()), units="g", dt=0.02).dt == 0.02


@pytest.mark.parametrize("shift", [1e-4, -1e-4, 0.01])
def test_one_printed_digit_is_no_rounding_where_the_step_is_a_multiple(tmp_path, shift):
    with pytest.raises(ValueError, match="time steps must be even"):
        read_record(write(tmp_path, uneven_rows(shift=shift)), units="g")


def test_change_of_step_within_the_record(tmp_path):
    times = np.cumsum(np.r_[np.full(50, 0.01), np.full(50, 0.0101)])
    with pytest.raises(ValueError, match="must be even, they vary from 0.01 s to 0.0101 s"):
        read_record(write(tmp_path, [f"{t:.6f} 1.0" for t in times]), units="g")


def test_milliseconds(tmp_path):
    rows = [f"{5 * k} {0.1 * k}" for k in range(9)]
    with pytest.raises(ValueError, match="has a step of 5, too long for seconds"):
        read_record(write(tmp_path, rows), units="g")
    assert read_record(write(tmp_path, ["time [ms] acc", *rows]), units="g").dt == 0.005


STATEMENTS = {
    "fs = 100 Hz": 0.01,
    "# Sampling rate: 0.1 kHz": 0.01,
    "fs,100": 0.01,
    "Sampling rate 200 Hz, 4 channels": 0.005,
    "Sample Frequency (Hz);51.2": 1.0 / 51.2,
    "Sampling interval (ms): 5": 0.005,
    "dt=.0050 SEC": 0.005,
    "sampling interval 5 of 12": None,
    "load step 1": None,
    "offset = 100": None,
}


@pytest.mark.parametrize(("line", "dt"), STATEMENTS.items())
def test_steps_and_rates_above_the_numbers(tmp_path, line, dt):
    path = write(tmp_path, [line, "roof (g)", *(f"{0.1 * k:.2f}" for k in range(9))])
    if dt is None:
        with pytest.raises(ValueError, match="`dt` must be given"):
            read_record(path)
    else:
        assert read_record(path).dt == pytest.approx(dt)


@pytest.mark.parametrize("line", ["# units: g", "Unit;g", "Einheit = g"])
@pytest.mark.parametrize("labels", [["time [s] roof"], []])
def test_the_unit_of_all_columns(tmp_path, line, labels):
    rows = [f"{0.02 * k} {0.1 * k:.2f}" for k in range(9)]
    assert read_record(write(tmp_path, [line, *labels, *rows])).pga == pytest.approx(0.8 * 9.81)
    with pytest.raises(ValueError, match="states 'g', got"):
        read_record(write(tmp_path, [line, *labels, *rows]), units="gal")


def test_rates_beside_clocks(tmp_path):
    """Numbers of samples take the step; a clock must agree; two lines must agree."""
    rows = [f"{k} {0.1 * k:.2f}" for k in range(9)]
    assert read_record(write(tmp_path, ["fs: 50 Hz", "Sample roof(g)", *rows])).dt == 0.02
    with pytest.raises(
        ValueError, match="contradicts itself, it states a step of 0.02 s and its clock 0.01 s"
    ):
        read_record(write(tmp_path, ["fs: 50 Hz", "t(ms) roof(g)", *(f"{10 * k} 0.1" for k in range(9))]))
    with pytest.raises(ValueError, match=r"more than one time step \(line 1: 0.02 s, line 2: 0.01 s"):
        read_record(write(tmp_path, ["fs: 50 Hz", "dt: 0.01", "Sample roof(g)", *rows]))


def test_clocks_of_days_and_of_counts_since_1970(tmp_path):
    days = [f"{45000.5 + k / 8640000:.10f} {0.1 * k:.2f}" for k in range(9)]
    with pytest.raises(ValueError, match="has a step of 1.16e-07, as days do from 45000.5 on"):
        read_record(write(tmp_path, ["Date roof(g)", *days]))
    found = read_channels(write(tmp_path, ["Date roof(g)", *days]), clock_units="d")
    assert float(found["time"][1]) == pytest.approx(0.01, rel=1e-4)
    for counts in (10**3, 10**6):
        rows = [f"{1_700_000_000 * counts + k * counts // 100} 0.1" for k in range(9)]
        assert read_record(write(tmp_path, ["timestamp roof(g)", *rows])).dt == pytest.approx(0.01)


def test_dt_that_contradicts_the_time_column(tmp_path):
    path = write(tmp_path, ROWS)
    with pytest.warns(UserWarning, match="elcentro.csv states a time step of 0.02 s; the argument"):
        assert read_record(path, units="g", dt=0.01).dt == 0.01


# --- units --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("units", "factor"),
    [
        ("G", 9.81),
        (" g ", 9.81),
        ("m/s2", 1.0),
        ("M/S/S", 1.0),
        ("m/s**2", 1.0),
        ("m/s²", 1.0),
        ("m / sec^2", 1.0),
        ("CM/SEC/SEC", 0.01),
        ("cm/s2", 0.01),
        ("Gal", 0.01),
        (9.80665, 9.80665),
        (np.float32(2.0), 2.0),
        (3, 3.0),
    ],
)
def test_unit_spellings(tmp_path, units, factor):
    assert unit_factor(units) == factor
    assert read_record(write(tmp_path, ROWS), units=units).pga == 0.25 * factor


@pytest.mark.parametrize(
    ("header", "factor"),
    [
        ("time [s],acc [g]", 9.81),
        ("# t (s), a (m/s^2)", 1.0),
        ("time [s] acc [cm/s2]", 0.01),
        ("t,a\n[s],[Gal]", 0.01),
        ("t,a\ns,Gal", 0.01),
        ("time_s,acc_mg", 9.81e-3),
        ("# Imperial Valley, El Centro, 180, values in [g]", 9.81),
    ],
)
@pytest.mark.filterwarnings("error")
def test_units_of_the_header(tmp_path, header, factor):
    path = write(tmp_path, [*header.split("\n"), *ROWS])
    assert read_record(path).pga == pytest.approx(0.25 * factor, rel=1e-15)
    assert read_record(path, units=factor).pga == 0.25 * factor


def test_units_of_another_column_do_not_count(tmp_path):
    path = write(tmp_path, ["t [s],a [g],b"] + [f"{row},1" for row in ROWS])
    assert read_record(path, column="a").pga == 0.25 * 9.81
    with pytest.raises(ValueError, match="`units` must be given, elcentro.csv does not state them"):
        read_record(path, column="b")


def test_units_that_contradict_the_header(tmp_path):
    path = write(tmp_path, ["t [s],a [g]", *ROWS])
    with pytest.raises(ValueError, match="`units` must be those of the file, .* states 'g', got 'm/s2'"):
        read_record(path, units="m/s2")


@pytest.mark.parametrize("line", ["gain,1.02", ",1", "ch. 1,2.5 V", "12:00:00.5,0"])
def test_a_line_between_labels_and_numbers(tmp_path, line):
    """Units, gains, numbers of sensors: no row of numbers that is spoilt."""
    path = write(tmp_path, f"t,a\n{line}\n0.0,0.1\n0.02,0.2\n0.04,0.1\n")
    np.testing.assert_allclose(read_record(path, units=1.0).acceleration, [0.1, 0.2, 0.1])


# --- errors -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "elcentro.csv must hold at least 2 samples, it is empty"),
        ("\n\r\n  \n", "it is empty"),
        ("0.0,0.1\n", "must hold at least 2 samples, got 1"),
        ("time,acc\n", "must hold rows of numbers, none was found in its 1 lines"),
        ("0.0 s;0.1\n0.02 s;0.2\n", "must hold rows of numbers.* A row is numbers, or a time stamp and"),
        ("0,1\n0.02,abc\n", "elcentro.csv, line 2: values must be finite numbers, got 'abc'"),
        ("t,a\n0.0,?\n0.02,0.1\n0.04,0.2\n", "line 2: values must be finite numbers, got '\\?'"),
        ("0,1\n0.02,NaN\n", "line 2: values must be finite numbers, got 'NaN'"),
        ("0,nan\n0.02,1\n", "line 1: values must be finite numbers, got 'nan'"),
        ("0,1\n\n0.02,-inf\n", "line 3: values must be finite numbers, got '-inf'"),
        ("0,1\n0.02,1e999\n", "line 2: values must be finite numbers, got '1e999'"),
        ("0,1,2\n0.02,,3\n", "line 2: values must be finite numbers, got an empty cell"),
        ("0,1\n0.02,1_0\n", "line 2: values must be finite numbers, got '1_0'"),
        ("0,1\n0.02,0x10\n", "line 2: values must be finite numbers, got '0x10'"),
        ("0,1\n0.02,1,3\n", "line 2: rows must have 2 values like the first, got 3"),
        ("0 1\n0.02\n", "line 2: rows must have 2 values like the first, got 1"),
        ("0 1\n0.02 1\nend of file\n", "line 3: values must be finite numbers, got 'end'"),
        ("t,a\n0.0x,0.1\n0.02,0.2\n0.04,0.1\n", "line 2: values must be finite numbers, got '0.0x'"),
        ("t,a\n,0.1\n0.02,0.2\n0.04,0.1\n", "line 2: values must be finite numbers, got an empty cell"),
        ("t,a\n0.0,,0.1\n0.02,0.2\n0.04,0.1\n", "line 2: values must be finite numbers, got an empty cell"),
        ("0.;00 0.1\n0.02 0.2\n0.04 0.1\n", "line 1: values must be finite numbers, got '0.;00'"),
        ("PK\0\0", "elcentro.csv must be a text file, it holds binary data"),
    ],
)
def test_malformed_files(tmp_path, content, message):
    with pytest.raises(ValueError, match=message):
        read_record(write(tmp_path, content), units="g")


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({}, ValueError, '`units` must be given, .* one of "g", "mg", "m/s\\^2", "cm/s\\^2", "gal"'),
        ({"units": "mm/s"}, ValueError, "`units` must be one of \"g\", .* got 'mm/s'"),
        ({"units": 0.0}, ValueError, "`units` must be positive, got 0.0"),
        ({"units": float("nan")}, ValueError, "`units` must be positive, got nan"),
        ({"units": [9.81]}, TypeError, r"`units` must be a number, got \[9.81\]"),
        ({"units": True}, TypeError, "`units` must be a number, got True"),
        ({"units": "g", "dt": -0.02}, ValueError, "`dt` must be positive, got -0.02"),
        ({"units": "g", "dt": "0.02"}, TypeError, "`dt` must be a number, got '0.02'"),
        ({"units": "g", "column": 2}, ValueError, r"one of the channels of elcentro.csv \(column 0, column"),
        ({"units": "g", "column": -1}, ValueError, "`column` must be one of the channels"),
        ({"units": "g", "column": "acc"}, ValueError, "`column` must be one .* got 'acc'"),
        ({"units": "g", "column": 1.5}, TypeError, "`column` must be an index or a name, got 1.5"),
    ],
)
def test_inadmissible_arguments(tmp_path, arguments, error, message):
    with pytest.raises(error, match=message):
        read_record(write(tmp_path, ROWS), **arguments)


def test_name_that_occurs_twice(tmp_path):
    path = write(tmp_path, ["t,a,a"] + [f"{row},1" for row in ROWS])
    with pytest.raises(ValueError, match=r"one of the channels of elcentro.csv \(t, a, a\), got 'a'"):
        read_record(path, units="g", column="a")


@pytest.mark.parametrize("suffix", [".at2", ".mat", ".txt", ".csv", ".dat", ".tsv", ".acc"])
def test_paths_that_cannot_be_read(tmp_path, monkeypatch, suffix):
    path = tmp_path / f"motion{suffix}"
    with pytest.raises(FileNotFoundError, match=r"`path` must be an existing file, got .*motion"):
        read_record(path)
    with pytest.raises(IsADirectoryError, match="`path` must be a file, got the folder"):
        read_record(str(tmp_path))
    os.mkfifo(path)  # which would be waited for
    with pytest.raises(OSError, match="`path` must be a file, got the device or pipe .*motion"):
        read_record(path)
    path.unlink()
    path.touch()

    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(PermissionError, match="`path` must be readable, got .*: Permission denied"):
        read_record(path)


def test_nothing_in_a_file_is_evaluated(tmp_path):
    bait = tmp_path / "bait"
    path = write(tmp_path, ["0,1", f"0.02,open({str(bait)!r}; 'w')"])
    with pytest.raises(ValueError, match="line 2: values must be finite numbers"):
        read_record(path, units="g")
    assert not bait.exists()


# --- wrapped lines ------------------------------------------------------------------------------


WRAPPED = np.round(np.random.default_rng(4).standard_normal(43).cumsum(), 3)


def wrapped(per_line, values=WRAPPED, header=()):
    rows = [values[k : k + per_line] for k in range(0, len(values), per_line)]
    return [*header, *("".join(f"{x:10.3f}" for x in row) for row in rows)]


@pytest.mark.parametrize("per_line", [5, 8])
@pytest.mark.parametrize(
    "header",
    [[], ["Kobe 1995, recorded at Takatori"], ["one two three four five"], ["Eight words stand here " * 2]],
)
@pytest.mark.parametrize("n_values", [40, 43])
def test_one_series_along_the_lines(tmp_path, per_line, header, n_values):
    """Without a word of the caller it is refused; a column of it would be every fifth or eighth sample."""
    path = write(tmp_path, wrapped(per_line, WRAPPED[:n_values], header), "kobe.acc")
    for column in (None, 2):
        with pytest.raises(ValueError, match="wrapped"):
            read_record(path, units="gal", dt=0.01, column=column)
    with pytest.raises(ValueError, match="wrapped"):
        read_channels(path, units="gal", dt=0.01, clock=False)
    record = read_record(path, units="gal", dt=0.01, wrapped=True)
    np.testing.assert_allclose(record.acceleration, 0.01 * WRAPPED[:n_values], rtol=1e-12)
    found = read_channels({"base": path}, units=1.0, dt=0.01, wrapped=True)
    np.testing.assert_allclose(found.values, WRAPPED[None, :n_values], rtol=1e-12)


def test_a_spoilt_first_line_of_wrapped_values(tmp_path):
    path = write(tmp_path, "a motion\n0.1 0.2x 0.3 0.4\n0.5 0.6 0.7 0.8\n")
    with pytest.raises(ValueError, match="line 2: values must be finite numbers, got '0.2x'"):
        read_record(path, units="g", dt=0.02, wrapped=True)


def test_times_and_values_in_turn(tmp_path):
    """Four pairs to a line; the first column runs evenly forward, with every fourth sample beside it."""
    times = 0.02 * np.arange(40)
    path = write(tmp_path, wrapped(8, np.column_stack([times, WRAPPED[:40]]).ravel()))
    with pytest.raises(ValueError, match="`wrapped` must be given, elcentro.csv has lines of 8 values"):
        read_record(path, units="gal", column=1)
    record = read_record(path, units="gal", wrapped=True)
    assert record.dt == 0.02
    np.testing.assert_allclose(record.acceleration, 0.01 * WRAPPED[:40], rtol=1e-12)


def test_columns_that_are_series(tmp_path):
    """The caller says so, or labels or a clock do."""
    table = WRAPPED[:40].reshape(-1, 4)
    rows = [" ".join(f"{x:.3f}" for x in row) for row in table]
    given = {"units": 1.0, "dt": 0.01}
    cases = [
        (rows, {"column": 2, "wrapped": False}),
        (["a b c d", *rows], {"column": "c"}),
        (["a [1] b [1] c [1] d [1]", *rows], {"column": 2}),
        (["a,b,c,d", *(row.replace(" ", ",") for row in rows)], {"column": 2}),
        ([f"{0.01 * k:.2f} {row}" for k, row in enumerate(rows)], {"column": 3}),
    ]
    for lines, arguments in cases:
        record = read_record(write(tmp_path, lines), **given, **arguments)
        np.testing.assert_array_equal(record.acceleration, table[:, 2])


def test_a_short_line_among_wrapped_ones(tmp_path):
    lines = wrapped(5)
    lines[3] = lines[3][:30]
    with pytest.raises(ValueError, match="line 5: only the last line of wrapped values may be shorter"):
        read_record(write(tmp_path, lines), units="g", dt=0.01, wrapped=True)
