"""NumPy arrays, spreadsheets and files packed by gzip say what the same numbers do as text."""

import gzip
import zipfile
from datetime import datetime, timedelta

import numpy as np
import pandas as pd
import pytest

import pymc_features as pmf
from support.record_files import at2

TIMES = 0.01 * np.arange(50)
ROOF = np.sin(20.0 * TIMES)
TABLE = pd.DataFrame({"time [s]": TIMES, "roof [g]": ROOF, "floor [g]": 0.5 * ROOF})
STAMPS = [datetime(2024, 1, 2, 3, 4, 5) + timedelta(milliseconds=10 * k) for k in range(len(TIMES))]
DATED = TABLE.rename(columns={"time [s]": "Date"}).assign(Date=STAMPS)
ABOUT = pd.DataFrame({"operator": ["A. N. Other"], "serial number": [4711]})


def save_sheets(path, **sheets):
    with pd.ExcelWriter(path) as book:
        for name, frame in sheets.items():
            frame.to_excel(book, sheet_name=name, index=False)


FILES = {
    "t.csv.gz": lambda path: TABLE.to_csv(path, index=False),
    "t.xlsx": lambda path: save_sheets(path, about=ABOUT, data=TABLE),
    "dated.xlsx": lambda path: save_sheets(path, data=DATED),
    "t.npz": lambda path: np.savez(path, t=TIMES, roof=ROOF, floor=0.5 * ROOF, units="g"),
    "rate.npz": lambda path: np.savez(path, fs=100.0, a=TABLE.to_numpy()[:, 1:], units="g"),
}


@pytest.mark.parametrize("name", FILES)
def test_what_is_read(tmp_path, name):
    FILES[name](tmp_path / name)
    channels = pmf.read_channels(tmp_path / name)
    np.testing.assert_allclose(channels.values, 9.81 * np.array([ROOF, 0.5 * ROOF]), atol=1e-12)
    np.testing.assert_allclose(channels["time"], TIMES, atol=1e-12)
    if name == "dated.xlsx":
        assert channels.attrs["start"] == pd.Timestamp(STAMPS[0]).timestamp()


def test_an_array_alone_states_nothing(tmp_path):
    np.save(tmp_path / "roof.npy", ROOF)
    with pytest.raises(ValueError, match="`dt` must be given, roof.npy does not state"):
        pmf.read_record(tmp_path / "roof.npy", units="g")
    record = pmf.read_record(tmp_path / "roof.npy", units="g", dt=0.01)
    np.testing.assert_allclose(record.acceleration, 9.81 * ROOF)


def test_a_packed_file_of_strong_motion(tmp_path):
    (packed := tmp_path / "motion.AT2.gz").write_bytes(gzip.compress(at2(ROOF, 0.01).encode()))
    record = pmf.read_record(packed)
    assert (record.dt, len(record.acceleration)) == (0.01, 50)
    np.testing.assert_allclose(record.acceleration, 9.81 * ROOF, atol=1e-5)


def cut(name):
    def save(path):
        FILES[name](whole := path.parent / f"whole-{name}")
        path.write_bytes(whole.read_bytes()[:800])

    return save


def zipped(path):
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("a.csv", "0.0,1.0\n0.1,2.0\n")


REFUSED = {
    "two.xlsx must have its numbers in one sheet, got 'a', 'b'. Save": (
        "two.xlsx",
        lambda path: save_sheets(path, a=TABLE, b=TABLE),
    ),
    "a.zip must be a text file, got a zip file of 1 files. Unpack it": ("a.zip", zipped),
    "t.csv.gz must be a whole gzip file, gzip cannot read it": ("t.csv.gz", cut("t.csv.gz")),
    "t.xlsx must be a whole spreadsheet .* Save one sheet as CSV": ("t.xlsx", cut("t.xlsx")),
    "t.npz must be a NumPy file, it cannot be read": ("t.npz", cut("t.npz")),
    "zeros.csv.gz must not hold arrays of more than": (
        "zeros.csv.gz",
        lambda path: path.write_bytes(gzip.compress(bytes(10**8))),
    ),
    "objects.npz must be a NumPy file, it cannot be read .Object arrays": (
        "objects.npz",
        lambda path: np.savez(path, a=np.array([{}, {}])),
    ),
}


@pytest.mark.parametrize("match", REFUSED)
def test_refusals(tmp_path, match):
    name, save = REFUSED[match]
    save(tmp_path / name)
    with pytest.raises(ValueError, match=match):
        pmf.read_channels(tmp_path / name)
