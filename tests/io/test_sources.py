"""Channels in memory, of binary loggers, of single sensors; other rates; quantities."""

import subprocess
import sys

import h5py
import numpy as np
import obspy
import pandas as pd
import pytest
import xarray as xr

import pymc_features as pmf
from pymc_features.io.reading.labels import G
from support.refusals import refusals

N = 400
TIME = 0.01 * np.arange(N)
RNG = np.random.default_rng(3)
BASE, ROOF = RNG.normal(size=(2, N))
FRAME = pd.DataFrame({"time [ms]": 1e3 * TIME, "base [g]": BASE, "roof [mg]": 1e3 * ROOF})
EXPECTED = G * np.array([BASE, ROOF])


def sep005(name, values, **changes):
    return {"data": values, "name": name, "unit_str": "g", "fs": 100.0, "quantity": "acceleration"} | changes


STREAM = obspy.Stream(
    [
        obspy.Trace(values, {"delta": 0.01, "channel": name, "starttime": 1e9})
        for name, values in (("base", BASE), ("roof", ROOF))
    ]
)
NEW_YEAR = "2024-12-31T23:59:59+00:00"
DATES = pd.date_range("2024-12-31 23:59:59", periods=N, freq="10ms")
SOURCES = {
    "frame": (FRAME, {}, 0.0),
    "frame over dates": (FRAME.set_index(DATES).drop(columns="time [ms]"), {}, 1735689599.0),
    "frame over durations": (FRAME.set_index(DATES - DATES[0]).drop(columns="time [ms]"), {}, 0.0),
    "frame over times": (FRAME.rename(columns={"time [ms]": "time_ms"}).set_index("time_ms"), {}, 0.0),
    "array": (
        xr.DataArray([BASE, ROOF], {"sensor": ["base", "roof"], "time": TIME}, attrs={"units": "g"}),
        {},
        0.0,
    ),
    "array over dates": (
        xr.DataArray([BASE, ROOF], {"sensor": ["base", "roof"], "time": DATES}, attrs={"units": "g"}).T,
        {},
        1735689599.0,
    ),
    "stream": (STREAM, {"units": "g"}, 1e9),
    "sep005": ([sep005("base", BASE), sep005("roof", ROOF)], {}, 0.0),
    "sep005 with times": (
        [sep005(*one, time=TIME, start_timestamp=NEW_YEAR) for one in (("base", BASE), ("roof", ROOF))],
        {},
        1735689599.0,
    ),
}


@pytest.mark.parametrize("case", SOURCES)
def test_what_is_in_memory(case):
    source, settings, start = SOURCES[case]
    found = pmf.read_channels(source, **settings)
    np.testing.assert_allclose(found.values, EXPECTED, rtol=1e-12)
    assert list(found["sensor"].values) == ["base", "roof"]
    assert (found.attrs["units"], found.attrs["start"]) == ("m/s^2", pytest.approx(start, abs=1e-6))
    np.testing.assert_allclose(found["time"], TIME, atol=1e-9)
    record = pmf.read_record(source, column="base", **settings)
    np.testing.assert_allclose(record.acceleration, EXPECTED[0], rtol=1e-12)


def test_binary_tables(tmp_path):
    FRAME.to_parquet(tmp_path / "frame.parquet")
    with h5py.File(tmp_path / "frame.h5", "w") as file:
        group = file.create_group("run")
        group.attrs["fs"] = 100.0
        for name, values in (("base", BASE), ("roof", ROOF)):
            group.create_dataset(name, data=values).attrs["units"] = "g"
    for name, sensors in (("frame.parquet", ["base", "roof"]), ("frame.h5", ["run.base", "run.roof"])):
        found = pmf.read_channels(tmp_path / name)
        np.testing.assert_allclose(found.values, EXPECTED, rtol=1e-12)
        assert list(found["sensor"].values) == sensors and float(found["time"][1]) == pytest.approx(0.01)
    (tmp_path / "broken.parquet").write_bytes((tmp_path / "frame.parquet").read_bytes()[:200])
    (tmp_path / "broken.h5").write_bytes((tmp_path / "frame.h5").read_bytes()[:200])
    (tmp_path / "broken.tdms").write_bytes(b"TDSm" + bytes(30))
    for name in ("broken.parquet", "broken.h5", "broken.tdms"):
        with pytest.raises(ValueError, match=f"{name} "):
            pmf.read_channels(tmp_path / name, units="g")


def test_tdms(data_dir):
    """Scaled as npTDMS scales them; volts need a sensitivity."""
    from nptdms import TdmsFile

    path = data_dir / "daq" / "raw1.tdms"
    volts = TdmsFile.read(path).groups()[0].channels()[0][:]
    with pytest.raises(ValueError, match="states 'Volts', a unit of voltage. Pass `sensitivity`"):
        pmf.read_channels(path)
    found = pmf.read_channels({"a": {"file": path, "column": 0, "sensitivity": "500 mV/g"}})
    np.testing.assert_allclose(found.values[0], volts / 0.5 * G, rtol=1e-12)
    assert float(found["time"][1]) == pytest.approx(2e-5)
    assert pmf.read_channels(data_dir / "daq" / "big_endian.tdms", units=1.0).shape == (2, 3500)


@pytest.mark.parametrize(
    ("library", "name", "extra"), [("nptdms", "a.tdms", "daq"), ("pyuff", "a.uff", "modal")]
)
def test_extras_are_named(tmp_path, library, name, extra):
    content = "TDSm" if name.endswith("tdms") else "    -1\n    58\n    -1\n"
    (tmp_path / name).write_text(content)
    code = f"import sys; sys.modules[{library!r}] = None; from pymc_features.io import read_channels\n"
    code += f"try: read_channels({str(tmp_path / name)!r})\nexcept ImportError as error: print(error)"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert f"pymc-features[{extra}]" in said


def tone(time, frequency=3.0):
    """A smooth burst."""
    return np.sin(2.0 * np.pi * frequency * time) * np.exp(-(((time - 10.0) / 4.0) ** 2))


def saved(folder, name, times, values, header):
    rows = [f"{t:.9f};{v:.9f}" for t, v in zip(times, values, strict=True)]
    (folder / name).write_text("\n".join([header, *rows]) + "\n")
    return folder / name


def test_other_rates_and_clocks(tmp_path):
    """Three loggers of one motion, 200, 128 and 90.3 Hz; one inverted, one late, one whose clock drifts."""
    a, b, c = 0.005 * np.arange(4000), np.arange(2560) / 128.0 + 0.0031, np.arange(1806) / 90.3
    files = {
        "a": saved(tmp_path, "a.csv", a, 2.0 + tone(a), "time [s];x [m/s^2]"),
        "b": {
            "file": saved(tmp_path, "b.csv", b, -1e3 * (2.0 + tone(b - 0.02)), "time [s];x [mm/s^2]"),
            "scale": -1.0,
        },
        "c": {
            "file": saved(tmp_path, "c.csv", 1.001 * c + 5.0, 2.0 + tone(c), "time [s];x [m/s^2]"),
            "anchors": [[5.0, 0.0], [5.0 + 1.001 * 20.0, 20.0]],
        },
    }
    found = pmf.read_channels(files, resample=100.0)
    time = found["time"].values + found.attrs["start"]
    assert float(found["time"][1]) == 0.01 and found.attrs["start"] == 0.0031
    inner = (time > 1.0) & (time < 19.0)
    for name, late in (("a", 0.0), ("b", 0.02), ("c", 0.0)):
        off = found.sel(sensor=name).values - 2.0 - tone(time - late)
        assert np.abs(off[inner]).max() < 1e-3, name
    with pytest.raises(ValueError, match="Sensors must have a common clock, the step is .* Pass `resample`"):
        pmf.read_channels({"a": files["a"], "b": files["b"]})
    with pytest.raises(ValueError, match="`resample` must be given with `anchors` of 'c', got none"):
        pmf.read_channels(files)
    files["b"]["delay"] = 0.02
    found = pmf.read_channels(files, resample=100.0)
    time = found["time"].values + found.attrs["start"]
    inner = (time > 1.0) & (time < 19.0)
    assert np.abs(found.sel(sensor="b").values - 2.0 - tone(time))[inner].max() < 1e-3


def test_a_delay_without_other_rates(tmp_path):
    a = 0.005 * np.arange(4000)
    late = {"file": saved(tmp_path, "b.csv", a, tone(a - 0.0123), "time [s];x [m/s^2]"), "delay": 0.0123}
    found = pmf.read_channels({"a": saved(tmp_path, "a.csv", a, tone(a), "time [s];x [m/s^2]"), "b": late})
    np.testing.assert_allclose(found.values[0, 20:-20], found.values[1, 20:-20], atol=1e-4)


def test_a_delay_of_many_samples(tmp_path):
    """The window is what both have, nothing is made up at an end."""
    a = 0.005 * np.arange(4000)
    late = {"file": saved(tmp_path, "b.csv", a, 1.0 + tone(a - 1.0), "time [s];x [m/s^2]"), "delay": 1.0}
    found = pmf.read_channels(
        {"a": saved(tmp_path, "a.csv", a, 1.0 + tone(a), "time [s];x [m/s^2]"), "b": late}
    )
    assert found.sizes["time"] == 3800
    np.testing.assert_allclose(found.values[0], found.values[1], atol=1e-8)


def test_aliases_are_filtered():
    """A tone above half the new rate is gone, not folded down."""
    time = 0.002 * np.arange(5000)
    frame = pd.DataFrame(
        {"time [s]": time, "a [m/s^2]": tone(time, 3.0) + np.sin(2.0 * np.pi * 170.0 * time)}
    )
    found = pmf.read_channels(frame, resample=100.0)
    at = found["time"].values
    inner = (at > 1.0) & (at < 9.0)
    assert np.abs(found.values[0] - tone(at))[inner].max() < 1e-3


def test_quantities(tmp_path):
    files = {
        "base": {"file": FRAME, "column": "base"},
        "laser": {"file": pd.DataFrame({"t [s]": TIME, "u [mm]": BASE}), "quantity": "displacement"},
        "gauge": {"file": pd.DataFrame({"t [s]": TIME, "e [um/m]": ROOF}), "quantity": "strain"},
    }
    found = pmf.read_channels(files)
    np.testing.assert_allclose(found.values, [G * BASE, 1e-3 * BASE, 1e-6 * ROOF], rtol=1e-12)
    assert list(found["units"].values) == ["m/s^2", "m", "m/m"]
    assert list(found["quantity"].values) == ["acceleration", "displacement", "strain"]
    record = pmf.Record.from_channel(found, "base")
    np.testing.assert_allclose(record.acceleration, G * BASE)
    with pytest.raises(ValueError, match="must have attrs"):
        pmf.Record.from_channel(found, "laser")


REFUSED = {
    r"`files` must be `file` and any of column, .* of 'a', got colum": {"file": FRAME, "colum": 1},
    "`files` must be `file` and any of": {"column": 1},
    "`scale` must not be zero, got 0 for 'a'": {"file": FRAME, "scale": 0},
    r"`anchors` must be two pairs of a reading": {"file": FRAME, "anchors": [[0.0, 0.0], [0.0, 1.0]]},
    "`quantity` must be one of": {"file": FRAME, "quantity": "mass"},
    r"`sensitivity` must be V per m/s\^2, or a text such as \"100": {"file": FRAME, "sensitivity": "100 mV"},
    "must hold displacements, it states 'g'": {"file": FRAME, "column": "base", "quantity": "displacement"},
    "must hold voltages, it states 'g'": {"file": FRAME, "column": "base", "sensitivity": 10.0},
}


@refusals("given", REFUSED)
def test_what_is_refused_of_a_sensor(given, match):
    with pytest.raises(ValueError, match=match):
        pmf.read_channels({"a": given}, resample=50.0)


def test_sources_that_are_refused():
    with pytest.raises(ValueError, match="got a DataFrame with note. Drop these"):
        pmf.read_channels(FRAME.assign(note="ok"))
    with pytest.raises(ValueError, match="must be a DataArray"):
        pmf.read_channels(xr.DataArray(np.ones((2, 3)), dims=("x", "time")))
    with pytest.raises(ValueError, match="must be dicts with data, name, unit_str and `fs` or `time`"):
        pmf.read_channels([{"data": BASE, "name": "a"}])
    with pytest.raises(ValueError, match="`dt` must be given"):
        pmf.read_channels([sep005("a", BASE, fs=np.inf)])
    with pytest.raises(ValueError, match="`start_timestamp` must be an ISO date, got 'noon'"):
        pmf.read_channels([sep005("a", BASE, start_timestamp="noon")])
