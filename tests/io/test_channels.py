"""Measured channels from files: raw exports, tables, MATLAB; clocks; broken copies and their messages."""

import pickle
import re
import warnings

import numpy as np
import pytest
import xarray as xr
from scipy.io import savemat

from pymc_features import read_channels, read_record
from pymc_features.exceptions import ChannelWarning
from pymc_features.signals import check_channels
from support.matlab_files import save_v73
from support.refusals import refusals
from support.warned import messages

RNG = np.random.default_rng(11)
N = 60
MOTION = RNG.standard_normal((4, N + 20)).cumsum(axis=1) * 0.3 + 0.1  # (sensor, time) [m/s^2]
TICK = 8333  # [us]
SENSORS = ["base", "floor1", "floor2", "floor3"]


def export(folder, name, history, *, first=0, ticks=None, empty=False, columns=None):
    """A raw sensor export: separator line, preamble, header, integer clock in microseconds."""
    ticks = 991_011_697 + TICK * (first + np.arange(len(history))) if ticks is None else ticks
    lines = [
        "sep=,",
        "DeviceTag:,Sensor 3",
        "StartTime: ,2025-03-06_12:26:07_000 PST",
        "© Maker 2005-2025",
        "",
    ]
    lines.append("PacketCounter,SampleTimeFine,Euler_X,Acc_X,Acc_Z")
    for k, (tick, value) in enumerate(zip(ticks, history, strict=True)):
        value = 0.0 if empty and k == 0 else value
        lines.append(f"{k},{tick},{0.3 * k:.14f},{value:.14f},{9.81 + 0.1 * value:.14f}")
    path = folder / f"{name}.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def group(folder, **settings):
    return {name: export(folder, name, MOTION[k, :N], **settings) for k, name in enumerate(SENSORS)}


def read(files, **settings):
    return read_channels(files, **{"columns": "Acc_X", "units": "m/s^2"} | settings)


@pytest.fixture(autouse=True)
def no_pickle(monkeypatch):
    """No file is read by pickle."""

    def refuse(*args, **kwargs):
        raise AssertionError("a file was unpickled")

    for name in ("load", "loads"):
        monkeypatch.setattr(pickle, name, refuse)


# --- what is read -------------------------------------------------------------------------------


def test_a_group_of_raw_exports(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        channels = read(group(tmp_path, empty=True), skip=1)
    assert (channels.dims, channels.shape, channels.dtype) == (("sensor", "time"), (4, N - 1), float)
    assert list(channels["sensor"].values) == SENSORS
    np.testing.assert_allclose(channels.values, MOTION[:, 1:N], atol=1e-13)
    np.testing.assert_allclose(channels["time"], 0.008333 * np.arange(N - 1), atol=1e-12)
    assert channels.attrs["units"] == "m/s^2"
    assert channels.attrs["start"] == pytest.approx(991.02003, abs=1e-9)
    assert channels["time"].attrs["units"] == "s"


def test_channels_save_to_netcdf(tmp_path):
    channels = read(group(tmp_path))
    channels.to_netcdf(tmp_path / "channels.nc", engine="h5netcdf")
    xr.testing.assert_identical(xr.load_dataarray(tmp_path / "channels.nc", engine="h5netcdf"), channels)


def test_sensors_are_aligned_on_their_clocks(tmp_path):
    starts, lengths = [0, 3, 1, 7], [N, N - 5, N + 4, N]
    files = {
        name: export(tmp_path, name, MOTION[k, start : start + n], first=start)
        for k, (name, start, n) in enumerate(zip(SENSORS, starts, lengths, strict=True))
    }
    assert messages(lambda: read(files)) == []
    channels = read(files)
    np.testing.assert_allclose(channels.values, MOTION[:, 7 : 3 + N - 5], atol=1e-13)
    assert channels.attrs["start"] == pytest.approx((991_011_697 + 7 * TICK) * 1e-6, abs=1e-9)


def test_jittering_integer_clock_is_even(tmp_path):
    """A clock that truncates 1/120 s to microseconds."""
    ticks = (np.arange(N) * 1e6 / 120.0).astype(int)
    channels = read(
        {name: export(tmp_path, name, MOTION[k, :N], ticks=ticks) for k, name in enumerate(SENSORS)}
    )
    assert float(channels["time"][1]) == pytest.approx(1.0 / 120.0, rel=1e-5)


def test_names_of_sensors(tmp_path):
    files = group(tmp_path)
    assert list(read(list(files.values()))["sensor"].values) == SENSORS  # stems
    assert list(read(files["floor1"])["sensor"].values) == ["floor1"]
    assert list(read({"roof": files["floor3"]})["sensor"].values) == ["roof"]
    both = {"columns": ["Acc_X", "Acc_Z"]}
    with pytest.warns(ChannelWarning, match="'Acc_Z' has a mean of .* that of gravity. Is it vertical"):
        assert list(read(files["base"], **both)["sensor"].values) == ["Acc_X", "Acc_Z"]
    assert list(read(files["base"], columns={"table": "Acc_X"})["sensor"].values) == ["table"]
    with pytest.warns(ChannelWarning):
        two = read({"a": files["base"], "b": files["floor1"]}, columns={"x": 3, "z": 4})
    assert list(two["sensor"].values) == ["a x", "a z", "b x", "b z"]
    np.testing.assert_allclose(two.sel(sensor="b x").values, MOTION[1, :N], atol=1e-13)


TABLE = "\n".join(f"{0.02 * k:.2f};{a:.9f};{b:.9f}" for k, (a, b) in enumerate(MOTION[:2].T))


def write(folder, text, name="frame.csv"):
    path = folder / name
    path.write_text(text)
    return path


def test_table_with_its_units(tmp_path):
    """Every column has the unit above it; the file says milliseconds."""
    rows = [f"{20 * k}, {a:.9f}, {b:.9f}" for k, (a, b) in enumerate(MOTION[:2].T)]
    path = write(tmp_path, "\n".join(["time [ms], base [g], roof (cm/s^2)", *rows]))
    channels = read_channels(path)
    assert list(channels["sensor"].values) == ["base", "roof"]
    np.testing.assert_allclose(channels.values, MOTION[:2] * [[9.81], [0.01]], atol=1e-7)
    assert float(channels["time"][1]) == pytest.approx(0.02, rel=1e-12)


@pytest.mark.parametrize("header", ["", "t;base;roof\n", "# of the frame, by its logger\n"])
def test_table_of_semicolons(tmp_path, header):
    channels = read_channels(write(tmp_path, header + TABLE), units="m/s^2")
    np.testing.assert_allclose(channels.values, MOTION[:2], atol=1e-9)
    assert list(channels["sensor"].values) == (
        ["base", "roof"] if header == "t;base;roof\n" else ["column 1", "column 2"]
    )
    one = read_channels(write(tmp_path, header + TABLE), units="m/s^2", columns=2)
    np.testing.assert_allclose(one.values, MOTION[1:2], atol=1e-9)


@pytest.mark.parametrize(
    ("scale", "settings"),
    [
        (1.0, {"clock_units": 0.02}),
        (1.0, {"dt": 0.02}),  # a counter
        (20.0, {"clock_units": "ms"}),
        (20.0, {"dt": 0.02}),
        (20_000.0, {"clock_units": "us"}),
        (0.02, {}),
        (0.02, {"dt": 0.02, "clock": 0}),
    ],
)
def test_units_of_clocks(tmp_path, scale, settings):
    """Clocks of counts and of any unit align files that start at different times."""
    paths = [
        write(tmp_path, "\n".join(f"{scale * k:.12g},{MOTION[i, k]:.9f}" for k in range(i, N)), f"s{i}.csv")
        for i in range(3)
    ]
    channels = read_channels(paths, units="m/s^2", **settings)
    np.testing.assert_allclose(channels.values, MOTION[:3, 2:N], atol=1e-9)
    assert float(channels["time"][1]) == pytest.approx(0.02, rel=1e-9)


def test_sampling_rate(tmp_path):
    """Of all files, or of that of one sensor."""
    path = tmp_path / "a.csv"
    path.write_text("a [m/s^2],b [m/s^2]\n0,1\n1,2\n2,3\n")
    np.testing.assert_allclose(read_channels(path, fs=200.0)["time"], [0.0, 0.005, 0.01])
    sensors = {"a": {"file": path, "column": "a", "fs": 100}, "b": {"file": path, "column": "b", "dt": 0.01}}
    np.testing.assert_allclose(read_channels(sensors)["time"], [0.0, 0.01, 0.02])
    assert read_record(path, column="a", fs=50.0).dt == 0.02
    sensors["a"]["dt"] = 0.01
    with pytest.raises(TypeError, match="`fs` must be left out where `dt` is given"):
        read_channels(sensors)


def test_files_without_clocks_start_together(tmp_path):
    paths = [write(tmp_path, "\n".join(f"{a:.9f}" for a in MOTION[k]), f"s{k}.txt") for k in range(3)]
    channels = read_channels(paths, units="m/s^2", dt=0.02)
    np.testing.assert_allclose(channels.values, MOTION[:3], atol=1e-9)
    assert channels.attrs["start"] == 0.0
    raw = read(group(tmp_path, first=3), clock=False, dt=0.01)
    assert (raw.shape, float(raw["time"][1])) == ((4, N), 0.01)


def test_at2_files(tmp_path):
    header = "PEER\nQUAKE\nACCELERATION TIME SERIES IN UNITS OF G\nNPTS= 40, DT= .0200 SEC\n"
    paths = [
        write(tmp_path, header + "\n".join(f" {a:.7E}" for a in 0.1 * MOTION[k, :40]), f"c{k}.AT2")
        for k in (0, 1)
    ]
    channels = read_channels(paths, skip=5)
    np.testing.assert_allclose(channels.values, 0.981 * MOTION[:2, 5:40], atol=1e-6)
    assert list(channels["sensor"].values) == ["c0", "c1"]


# --- MATLAB -------------------------------------------------------------------------------------


def save(folder, name="frame.mat", version=5, **variables):
    path = folder / name
    (savemat if version == 5 else save_v73)(path, variables)
    return path


TIME = 0.02 * np.arange(N)[:, None]


@pytest.mark.parametrize("version", [5, 7.3])
@pytest.mark.parametrize(
    ("variables", "names"),
    [
        ({"acc": MOTION[:3, :N].T, "t": 5.0 + TIME}, ["acc 0", "acc 1", "acc 2"]),
        ({"acc": MOTION[:3, :N], "fs": 50.0}, ["acc 0", "acc 1", "acc 2"]),
        ({"acc": np.hstack([5.0 + TIME, MOTION[:3, :N].T])}, ["acc 1", "acc 2", "acc 3"]),
        ({"a": MOTION[0, :N], "b": MOTION[1, :N], "c": MOTION[2, :N], "dt": 0.02}, ["a", "b", "c"]),
    ],
)
def test_matlab(tmp_path, version, variables, names):
    channels = read_channels(save(tmp_path, version=version, units="g", **variables), skip=2)
    np.testing.assert_allclose(channels.values, 9.81 * MOTION[:3, 2:N], rtol=1e-12)
    assert list(channels["sensor"].values) == names
    assert float(channels["time"][1]) == pytest.approx(0.02, rel=1e-9)
    assert channels.attrs["start"] == pytest.approx(0.0 if "dt" in variables or "fs" in variables else 5.04)


def test_matlab_variables_by_name_and_clock(tmp_path):
    path = save(tmp_path, a=MOTION[0, :N], b=MOTION[1, :N], ms=20.0 * np.arange(N), note=np.arange(3.0))
    settings = {"units": 1.0, "clock": "ms", "clock_units": "ms"}
    channels = read_channels(path, columns={"base": "a", "roof": "b"}, **settings)
    assert list(channels["sensor"].values) == ["base", "roof"]
    np.testing.assert_allclose(channels.sel(sensor="roof").values, MOTION[1, :N], rtol=1e-12)
    assert read_channels(path, columns="b", **settings)["sensor"].values.tolist() == ["frame"]


MATLAB_REFUSED = {  # what is said: what is given
    "Sensors without clocks must have the same": ({"a": MOTION[0], "b": MOTION[1, :9], "dt": 0.02}, {}),
    "`columns` must be one of the channels of frame.mat": ({"a": MOTION[0], "dt": 0.02}, {"columns": "x"}),
    "`clock` must be one of the columns of frame.mat": ({"a": MOTION[0]}, {"clock": "x"}),
    "`t` must have one time for each sample, got 5 beside a": ({"a": MOTION[0], "t": np.arange(5.0)}, {}),
    r"time must be the longer side of a matrix, got shape \(4, 4\)": ({"a": MOTION[:4, :4], "dt": 0.1}, {}),
    "must hold histories of at least 2 samples": ({"a": MOTION[0], "dt": 0.1}, {"skip": 79}),
    "`t`, sample 30: no": ({"a": MOTION[0, :N], "t": np.delete(0.02 * np.arange(N + 2), [30, 31])}, {}),
}


@refusals("variables settings", MATLAB_REFUSED)
def test_matlab_refused(tmp_path, variables, settings, match):
    with pytest.raises(ValueError, match=match):
        read_channels(save(tmp_path, **variables), units="m/s^2", **settings)


# --- files and arguments that are refused -------------------------------------------------------


def spoil(path, change):
    """Write a changed copy of the data lines of an export."""
    lines = path.read_text(encoding="utf-8").split("\n")
    path.write_text("\n".join(lines[:6] + change(lines[6:])), encoding="utf-8")


def retimed(line, change):
    cells = line.split(",")
    return ",".join([cells[0], str(change(int(cells[1]))), *cells[2:]])


def all_retimed(change):
    """Every line with another clock reading."""
    return lambda rows: [retimed(row, change) if row else row for row in rows]


def in_row_20(change):
    """Another line for the one of sample 20."""
    return lambda rows: [*rows[:20], change(rows[20]), *rows[21:]]


BROKEN = {
    "gap": (
        lambda rows: rows[:20] + rows[23:],
        r"floor2.csv, line 27: no samples may be missing, 3 are, in 1 gap\(s\), the first from 991.1700\d* s "
        r"to 991.20\d* s at a step of 0.008333 s. Cut the file",
    ),
    "two gaps": (
        lambda rows: rows[:20] + rows[21:30] + rows[32:],
        "line 27: no samples may be missing, 3 are, in 2 gap",
    ),
    "repeated": (
        lambda rows: rows[:20] + rows[19:],
        "floor2.csv, line 27: time must increase, it goes from 991.17",
    ),
    "shuffled": (lambda rows: [*rows[:20], rows[21], rows[20], *rows[22:]], "line 28: time must increase"),
    "uneven": (
        in_row_20(lambda row: retimed(row, lambda t: t + 3000)),
        r"floor2.csv, line 2\d: time steps must be even, they vary from 0.005333 s to 0.01133 s",
    ),
    "drifting": (
        all_retimed(lambda t: t + 5 * ((t - 991_011_697) // TICK) ** 2),
        r"floor2.csv, line \d+: time steps must be even",
    ),
    "empty cell": (in_row_20(lambda row: re.sub(r",[^,]*$", ",", row)), "line 27: rows must have 5"),
    "not a number": (in_row_20(lambda row: re.sub(r",[^,]*$", ",NaN", row)), "line 27: values must .*'NaN'"),
    "cut off": (
        lambda rows: [*rows[:20], rows[20][:30]],
        "floor2.csv, line 27: rows must have 5 values like the first, got 3",
    ),
    "empty": (lambda rows: [], "floor2.csv must hold rows of numbers, none was found"),
    "one row": (lambda rows: rows[:1], "floor2.csv must hold at least 2 samples, got 1"),
    "other day": (
        all_retimed(lambda t: t + 10**9),
        "Sensors must have a common clock, these have no time in common: base.csv 991.012 s to .*"
        "floor2.csv 1991.01 s",
    ),
    "other rate": (
        all_retimed(lambda t: 991_011_697 + (t - 991_011_697) // TICK * 10000),
        "Sensors must have a common clock, the step is 0.008333 s in base.csv and 0.01 s in floor2.csv",
    ),
    "dead": (
        lambda rows: [re.sub(r",[^,]*,[^,]*$", ",0.5,1.0", row) for row in rows],
        "Channel 'floor2' must move, all its 60",
    ),
}


@pytest.mark.parametrize("defect", BROKEN)
def test_broken_files_are_refused(tmp_path, defect):
    change, match = BROKEN[defect]
    files = group(tmp_path)
    spoil(files["floor2"], change)
    with pytest.raises(ValueError, match=match):
        read(files)


REFUSED_ARGUMENTS_VALUES = {  # what is said: what is given
    r"`columns` must be one of the channels of base.csv \(Packet.*'Acc_Y'": {"columns": "Acc_Y"},
    "`columns` must be one of the channels.* got 9": {"columns": 9},
    "`columns` must name at least one": {"columns": []},
    r"`columns` must name measurements, column 1 is the clock": {"columns": "SampleTimeFine"},
    "Sensors must have different names, got base Acc_X, base Acc_X": {"columns": ["Acc_X", "Acc_X"]},
    "`units` must be given, base.csv does not state them": {"units": None},
    "`units` must be one of": {"units": "furlong"},
    "`dt` must be positive": {"dt": -1.0},
    "`skip` must be an integer of at least 0, got -1. It counts rows": {"skip": -1},
    "`skip` must be an integer": {"skip": 1.5},
    "must hold at least 2 samples, got 1": {"skip": 59},
    "`clock` must be one of the columns of base.csv.*header name of the times": {"clock": "Time"},
    "`dt` must be given with clock=False": {"clock": False},
    "`clock_units` must be given, the clock of base.csv .column 0. has a step of 1, too": {"clock": 0},
    "`clock_units` must be .*'fortnights'": {"clock_units": "fortnights"},
    "`clock_units` must be": {"clock_units": 0.0},
}
REFUSED_ARGUMENTS_TYPES = {
    "`columns` must be an index or a name, got 1.5": {"columns": 1.5},
    "`clock` must be a column, False or None": {"clock": True},
}


@refusals("settings", REFUSED_ARGUMENTS_VALUES, REFUSED_ARGUMENTS_TYPES)
def test_arguments_are_refused(tmp_path, settings, error, match):
    with pytest.raises(error, match=match):
        read(group(tmp_path), **settings)


def test_files_that_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="`files` must be an existing file"):
        read({"base": tmp_path / "nothing.csv"})
    with pytest.raises(IsADirectoryError, match="`files` must be a file, got the folder"):
        read([tmp_path])
    with pytest.raises(ValueError, match="`files` must name at least one"):
        read([])
    with pytest.raises(TypeError, match="`files` must be a path, several, or a mapping"):
        read(3)
    np.save(tmp_path / "object.npy", np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(ValueError, match="object.npy must be a NumPy file, it cannot be read"):
        read(tmp_path / "object.npy")
    (tmp_path / "bad.mat").write_bytes(b"MATLAB 5.0" + 200 * b"\1")
    with pytest.raises(ValueError, match="bad.mat must be a MATLAB .mat file, it cannot be read"):
        read(tmp_path / "bad.mat")


def test_files_without_clocks_must_fit(tmp_path):
    paths = [write(tmp_path, "\n".join(f"{a:.9f}" for a in MOTION[k, : 40 + k]), f"s{k}.txt") for k in (0, 1)]
    with pytest.raises(ValueError, match="same number of samples, got s0.txt 40, s1.txt 41. Cut them"):
        read_channels(paths, units="m/s^2", dt=0.02)
    with pytest.raises(ValueError, match="`dt` must be given, s0.txt does not state"):
        read_channels(paths, units="m/s^2")
    paths[0] = write(tmp_path, TABLE)
    with pytest.raises(ValueError, match="common clock, s1.txt has none and others do. Pass `clock`"):
        read_channels(paths, units="m/s^2", dt=0.02)


# --- what is suspicious -------------------------------------------------------------------------


def test_clocks_that_are_not_simultaneous(tmp_path):
    files = group(tmp_path)
    files["floor2"] = export(tmp_path, "floor2", MOTION[2, :N], ticks=991_014_697 + TICK * np.arange(N))
    with pytest.warns(ChannelWarning, match=r"floor2.csv: its samples come 3 ms \(0.36 samples\) after"):
        np.testing.assert_allclose(read(files).values, MOTION[:, :N], atol=1e-13)
    with pytest.warns(ChannelWarning, match=r"base.csv: .* 3 ms \(0.36 samples\) before those of floor2.csv"):
        read({"floor2": files["floor2"], "base": files["base"]})
    files["floor2"] = export(tmp_path, "floor2", MOTION[2, :N], ticks=991_017_697 + TICK * np.arange(N))
    with pytest.warns(ChannelWarning, match=r"floor2.csv: .* 2.33 ms \(0.28 samples\) before those of"):
        aligned = read(files)  # nearer to the next sample of the others
    np.testing.assert_allclose(aligned.values[0], MOTION[0, 1:N], atol=1e-13)
    np.testing.assert_allclose(aligned.values[2], MOTION[2, : N - 1], atol=1e-13)
    assert len(messages(lambda: read(files))) == 1


def test_clocks_read_to_a_coarse_tick_are_simultaneous(tmp_path):
    """What the resolution of a clock explains is no lag."""
    ticks = [991_000 + np.round(20.0 * np.arange(N)).astype(int) + late for late in (0, 2)]  # [ms]
    files = [export(tmp_path, f"s{k}", MOTION[k, :N], ticks=tick) for k, tick in enumerate(ticks)]
    assert messages(lambda: read(files, clock_units="ms")) == []


def test_short_window(tmp_path):
    files = group(tmp_path)
    files["floor3"] = export(tmp_path, "floor3", MOTION[3, 40:N], first=40)
    found = messages(lambda: read(files))
    assert len(found) == 3
    assert "base.csv: only 20 of its 60 samples are in the window that all sensors have in common" in found[0]


def test_contradicting_step_is_told(tmp_path):
    with pytest.warns(UserWarning, match="states a time step of 0.008333 s; the argument dt=0.01 s is used"):
        channels = read(group(tmp_path), dt=0.01)
    assert float(channels["time"][1]) == 0.01


SUSPICIOUS = {
    "empty first packet": (
        lambda x: np.r_[0.0, x[1:] + 5.0],
        "first sample of 'c' is exactly zero.*Pass skip=1",
    ),
    "clipped": (lambda x: np.clip(x, -0.5, 0.5), "Channel 'c' looks clipped: .* largest value 0.5 m/s"),
    "clipped below": (lambda x: np.clip(x, -0.5, 5.0), "Channel 'c' looks clipped: .* smallest value -0.5"),
    "held": (
        lambda x: np.r_[x[:200], np.full(30, x[200]), x[230:]],
        "'c' repeats one value amid a motion, .* over 30 samples from sample 200: a gap filled by the logger",
    ),
    "filled with zeros": (
        lambda x: np.r_[x[:205], np.zeros(12), x[217:]],
        "'c' repeats one value .* 0 m/s.2 over 12",
    ),
    "huge": (lambda x: 9.81 * 9.0 * x, r"'c' has an implausible peak of .* m/s.2, \d+.*g. Check `units`"),
    "tiny": (lambda x: 1e-7 * x, "'c' has an implausible peak of .*e-0"),
    "gravity": (lambda x: x + 9.8, "'c' has a mean of 9.8.* m/s.2, that of gravity"),
}


@pytest.mark.parametrize("defect", SUSPICIOUS)
def test_suspicious_channels(tmp_path, defect):
    change, pattern = SUSPICIOUS[defect]
    time = 0.01 * np.arange(1000)
    motion = np.sin(2 * np.pi * 1.3 * time) * np.exp(-((time - 4.0) ** 2) / 8.0) + 0.01 * RNG.standard_normal(
        1000
    )
    path = write(tmp_path, "\n".join(f"{t:.2f},{a:.12g}" for t, a in zip(time, motion, strict=True)), "c.csv")
    assert messages(lambda: read_channels(path, units="m/s^2")) == []
    path = write(
        tmp_path, "\n".join(f"{t:.2f},{a:.12g}" for t, a in zip(time, change(motion), strict=True)), "c.csv"
    )
    [message] = messages(lambda: read_channels(path, units="m/s^2"))
    assert re.search(pattern, message), message


def test_at_rest_is_not_suspicious(tmp_path):
    """Zeros before and after a pulse, a response that starts at rest, and coarse resolution pass."""
    time = 0.01 * np.arange(800)
    pulse = np.where((time > 2) & (time < 3), np.sin(2 * np.pi * (time - 2)) ** 2, 0.0)
    coarse = np.round(np.sin(2 * np.pi * time) * np.exp(-time), 2)
    text = "\n".join(f"{t:.2f},{a:.9g},{b:.9g}" for t, a, b in zip(time, pulse, coarse, strict=True))
    assert messages(lambda: read_channels(write(tmp_path, text), units="m/s^2")) == []


def test_copies(tmp_path):
    files = group(tmp_path)
    files["floor2"].write_bytes(files["floor1"].read_bytes())
    [message] = messages(lambda: read(files))
    assert message.startswith("Channels 'floor1' and 'floor2' are identical to the last bit")


# --- the shaking table, and broken copies of it -------------------------------------------------


@pytest.fixture(scope="module")
def table(data_dir):
    """Lines of the real exports: the preamble, and 30 s with the strong motion."""
    lines = {}
    for name in SENSORS:
        path = data_dir / "mini_shake_table" / f"flexible_northridge_{name}.csv"
        lines[name] = path.read_text(encoding="utf-8").split("\n")
    return {name: (found[:8], found[1200:7200]) for name, found in lines.items()}


def copies(folder, table):
    """The real exports, in files of their own."""
    files = {}
    for name, (head, rows) in table.items():
        files[name] = folder / f"{name}.csv"
        files[name].write_text("\n".join(head + rows), encoding="utf-8")
    return files


BAND = (0.5, 1.8)


def test_real_channels(tmp_path, table):
    files = copies(tmp_path, table)
    channels = read(files)
    assert channels.shape == (4, 6000)
    found = check_channels(channels, BAND)
    assert (np.abs(found["lag"][:3]) < 1e-3).all()
    assert 2e-3 < found["lag"][3] < 4.0 * found["lag_error"][3]  # which is no more than chance may bring
    assert ((found["gain"] > 0.99) & (found["gain"] < 1.25)).all()


def test_swapped_files_of_real_channels(tmp_path, table):
    swapped = table | {"floor1": table["floor3"], "floor3": table["floor1"]}
    found = messages(lambda: check_channels(read(copies(tmp_path, swapped)), BAND))
    assert "Sensors may be swapped" in found[-1]
