"""Slips that a file betrays are told, and layouts of loggers that look like slips are read."""

import contextlib
import datetime
import re

import numpy as np
import pytest

from pymc_features import read_channels, read_modal, read_record
from pymc_features.modal import ModalData, write_modal

RNG = np.random.default_rng(3)
A, B = np.round(RNG.normal(size=(2, 40)), 5)
TABLE = "time [s],a [m/s^2],b [m/s^2]\n" + "".join(
    f"{0.01 * k:.3f},{a:.5f},{b:.5f}\n" for k, (a, b) in enumerate(zip(A, B, strict=True))
)
STAMPS = [
    datetime.datetime(2024, 1, 31, 23, 59, 59) + datetime.timedelta(milliseconds=50 * k) for k in range(40)
]
AT2 = "PEER\nA, 1/17/1994, B, 90\nACCELERATION TIME SERIES IN UNITS OF G\nNPTS=   60, DT=   .0050 SEC,\n"
VALUES = 0.1 * RNG.normal(size=60)
AT2 += "".join("".join(f"{value:15.7E}" for value in row) + "\n" for row in VALUES.reshape(12, 5))


def save(folder, content, name="a.csv"):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize(
    "content",
    [
        TABLE.replace(",", "|"),
        TABLE.replace(",", " | "),
        TABLE.encode("utf-16-le"),
        TABLE.encode("utf-16-be"),
        TABLE.encode("utf-16"),
        TABLE.encode("utf-8-sig"),
        TABLE.removesuffix("\n"),
    ],
    ids=["bars", "bars and blanks", "UTF-16", "big-endian", "with its mark", "UTF-8 with a mark", "no end"],
)
def test_separators_and_encodings(tmp_path, content):
    channels = read_channels(save(tmp_path, content))
    assert list(channels.sensor.values) == ["a", "b"]
    np.testing.assert_array_equal(channels.values, [A, B])


@pytest.mark.parametrize("form", ["%Y%m%dT%H%M%S.%f", "%Y%m%dT%H%M%S.%fZ", "%Y%m%d%H%M%S.%f"])
def test_compact_time_stamps(tmp_path, form):
    rows = [f"{stamp.strftime(form)},{a}" for stamp, a in zip(STAMPS, A, strict=True)]
    channels = read_channels(save(tmp_path, "\n".join(["time,a [m/s^2]", *rows, ""])))
    assert channels.time.values[1] == pytest.approx(0.05, rel=1e-9)
    assert channels.attrs["start"] == STAMPS[0].replace(tzinfo=datetime.UTC).timestamp()
    np.testing.assert_array_equal(channels.values, [A])


def test_loggers_of_campbell(tmp_path):
    """TOA5: a line about the station, names, units, and how each column was averaged."""
    header = (
        '"TOA5","CR6","CR6","1234","CR6.Std.01","CPU:p.CR6","7","Table1"\n"TIMESTAMP","RECORD","a","heat"\n'
        '"TS","RN","m/s^2","W/m^2"\n"","","Smp","Avg"\n'
    )
    rows = [f'"{stamp.isoformat(" ", "milliseconds")}",{k},{A[k]},7.5' for k, stamp in enumerate(STAMPS)]
    channels = read_channels(save(tmp_path, header + "\n".join(rows) + "\n", "t.dat"), columns={"x": "a"})
    np.testing.assert_array_equal(channels.values, [A])
    with pytest.raises(ValueError, match=r"`units` must be given, t.dat states 'W/m\^2'"):
        read_channels(tmp_path / "t.dat")


@pytest.mark.parametrize("lost", [2, 4, 6])
@pytest.mark.parametrize("decimal", [".", ","])
def test_a_file_cut_in_its_last_number(tmp_path, lost, decimal):
    text = TABLE if decimal == "." else TABLE.replace(",", ";").replace(".", ",")
    with pytest.raises(ValueError, match=r"a.csv: the last line must be whole, it ends in .* Fetch the file"):
        read_channels(save(tmp_path, text[:-lost]))


@pytest.mark.parametrize("place", [0, 1, 2, 3])
def test_a_column_of_texts(tmp_path, place):
    header, *rows = [line.split(",") for line in TABLE.splitlines()]
    rows = [[*row[:place], "OK", *row[place:]] for row in rows]
    lines = [",".join(row) for row in ([*header[:place], "state", *header[place:]], *rows)]
    with pytest.raises(ValueError, match="Line 2 has 'OK' among its numbers: leave such columns out"):
        read_channels(save(tmp_path, "\n".join(lines) + "\n"))


def test_a_mark_before_the_first_row(tmp_path):
    """Not a title: all numbers of a row stand in it."""
    bare = "".join(f"{0.01 * k:9.4f}  {a:12.6f}\n" for k, a in enumerate(A))
    assert len(read_record(save(tmp_path, bare, "r.txt"), units="g")) == 40
    with pytest.raises(ValueError, match="line 1: values must be finite numbers"):
        read_record(save(tmp_path, "\xb5".encode("latin-1") + bare[1:].encode(), "r.txt"), units="g")


SLIPS = ["digit lost", "exponent lost", "sign lost", "digit added"]


@pytest.mark.parametrize("slip", SLIPS)
def test_widths_of_columns_of_at2(tmp_path, slip, recwarn):
    assert len(read_record(save(tmp_path, AT2, "r.at2"))) == 60
    assert not recwarn.list
    head, tail = AT2[:420], AT2[420:]
    spoilt = re.sub(r"-?\d\.\d{7}E[-+]\d\d", lambda found: _slip(slip, found[0]), tail, count=1)
    assert len(spoilt) != len(tail)
    with pytest.warns(UserWarning, match=r"r.at2 .*line \d+: numbers must fill their columns"):
        read_record(save(tmp_path, head + spoilt, "r.at2"))


def _slip(name, token):
    """A number with a slip in it."""
    if name == "exponent lost":
        return token[:-1]
    if name == "digit lost":
        return token.replace(token[3], "", 1)
    return f"-{token}" if name == "sign lost" and token[0] != "-" else token.replace(".", ".7", 1)


def test_a_plus_sign_where_others_have_none(tmp_path):
    """A minus that was changed: its column is as wide as before."""
    spoilt = re.sub(r" -(?=\d)", " +", AT2[400:], count=1)
    with pytest.warns(UserWarning, match=r"r.at2 .*line \d+: a number has a plus sign, others have none"):
        read_record(save(tmp_path, AT2[:400] + spoilt, "r.at2"))


def test_free_columns_have_no_width(tmp_path, recwarn):
    """Left-aligned numbers of any length are no slip."""
    rows = [" ".join(f"{value:.6g}" for value in row) for row in VALUES.reshape(12, 5)]
    read_record(save(tmp_path, "\n".join([*AT2.splitlines()[:4], *rows]) + "\n", "r.at2"))
    assert not recwarn.list


def test_widths_of_columns_of_universal_files(tmp_path):
    pyuff = pytest.importorskip("pyuff")
    path = tmp_path / "h.uff"
    facts = {"type": 58, "func_type": 1, "rsp_node": 1, "rsp_dir": 3, "ref_node": 0, "ref_dir": 0}
    facts |= {"abscissa_spacing": 1, "ord_data_type": 4, "binary": 0, "ordinate_spec_data_type": 12}
    facts |= {"abscissa_axis_units_lab": "s", "ordinate_axis_units_lab": "m/s^2", "id1": "a"}
    facts |= {"orddenom_spec_data_type": 0, "data": np.round(VALUES, 6), "x": 0.01 * np.arange(60)}
    pyuff.UFF(str(path)).write_sets(facts, mode="overwrite")
    text = path.read_text()
    lines = text.split("\n")
    assert read_channels(path).shape == (1, 60)
    lines[17] = lines[17][:-5] + lines[17][-4:]
    with pytest.warns(UserWarning, match="h.uff, line 18: numbers must fill their columns"):
        read_channels(save(tmp_path, "\n".join(lines), "h.uff"))
    for number, old, new in (
        (7, "         1   3", "          1   3"),  # node and direction moved by a character
        (7, "         1   3", "         1 nan"),
        (8, "         1  0.0", "        1   0.0"),
    ):
        lines = text.split("\n")
        assert old in lines[number]
        lines[number] = lines[number].replace(old, new, 1)
        with (
            pytest.warns(
                UserWarning, match=f"h.uff, record {number - 1} .* numbers must stand at the right ends"
            ),
            contextlib.suppress(ValueError),
        ):
            read_channels(save(tmp_path, "\n".join(lines), "h.uff"))


def modes(folder):
    shapes = np.round(RNG.normal(size=(3, 6)), 3)
    names = [f"{node}{axis}" for node in (11, 12) for axis in "XYZ"]
    path = folder / "modes.unv"
    write_modal(ModalData([2.1, 6.5, 11.8], shapes, names, damping_ratios=[0.012, 0.009, 0.02]), path)
    return path, path.read_text().split("\n")


@pytest.mark.parametrize(
    ("line", "old", "new", "said"),
    [
        (9, "  1.00000E+00", "", "the frequency must stand among 4 numbers"),
        (9, "E+00  1.2", "E+0\t0  1.2", "the frequency must stand among 4 numbers"),
        (7, "         1", "     4   1", "what the data are must be said by 6 whole numbers"),
    ],
)
def test_header_of_a_mode(tmp_path, line, old, new, said):
    path, lines = modes(tmp_path)
    assert old in lines[line]
    lines[line] = lines[line].replace(old, new, 1)
    with pytest.raises(ValueError, match=f"modes.unv .*line {line + 1}: {said}"):
        read_modal(save(tmp_path, "\n".join(lines), path.name))


def test_widths_of_columns_of_modes(tmp_path):
    """Of a mode with ten nodes."""
    names = [f"{node}{axis}" for node in range(10) for axis in "XYZ"]
    path = tmp_path / "modes.unv"
    write_modal(ModalData([2.1], np.round(RNG.normal(size=(1, 30)), 3), names), path)
    lines = path.read_text().split("\n")
    assert read_modal(path).shapes.shape == (1, 30)
    lines[13] = lines[13][:-1]
    with pytest.warns(UserWarning, match="modes.unv .*line 14: numbers must fill their columns"):
        read_modal(save(tmp_path, "\n".join(lines), path.name))
