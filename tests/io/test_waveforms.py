"""Seismograms that ObsPy writes, and what is read from them beside ObsPy's own reading."""

import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import obspy
import pytest
from obspy.io.nied import knet as nied

from pymc_features import read_channels, read_record
from pymc_features.io import FORMATS, read_channels_with_gaps
from pymc_features.io.formats import TEXT
from pymc_features.io.formats.libraries import KINDS, read_waveforms
from pymc_features.io.reading.recording import Opening
from support import record_files
from support.commands import ROOT

RNG = np.random.default_rng(8)
COUNTS = (1e4 * RNG.standard_normal((3, 300))).astype(np.int32)
START = obspy.UTCDateTime("2016-11-13T11:02:56.5")


def trace(values, channel, start=START):
    header = {"network": "NZ", "station": "WTMC", "channel": channel, "delta": 0.005, "starttime": start}
    return obspy.Trace(np.ascontiguousarray(values), header)


def save(folder, kind, traces, name="motion"):
    path = folder / f"{name}.{kind.lower()}"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        obspy.Stream(traces).write(str(path), format=kind)
    return path


def one(kind):
    return trace(COUNTS[0].astype(np.float32) if kind.startswith("SAC") else COUNTS[0], "HNE")


@pytest.mark.parametrize("kind", KINDS)
def test_record_is_that_of_obspy(tmp_path, kind):
    path = save(tmp_path, kind, [one(kind)])
    theirs = obspy.read(str(path), format=kind)[0]
    ours = read_record(path, units=1e-4)
    assert ours.n_times == theirs.stats.npts == 300
    assert ours.dt == pytest.approx(theirs.stats.delta, rel=1e-6)
    np.testing.assert_array_equal(ours.acceleration, 1e-4 * theirs.data.astype(float))
    with pytest.raises(ValueError, match=f"`units` must be given, motion.{kind.lower()} does not state"):
        read_record(path)


@pytest.mark.parametrize("kind", KINDS)
def test_no_format_is_taken_for_another(tmp_path, kind):
    opening = Opening.of(save(tmp_path, kind, [one(kind)]))
    assert [kind for kind, begins in KINDS.items() if opening.begins(begins)] == [kind]
    assert [f.read for f in FORMATS if f is not TEXT and opening.begins(f.begins)] == [read_waveforms]


def test_sac_of_either_byte_order(tmp_path):
    path = tmp_path / "big.sac"
    one("SAC").write(str(path), format="SAC", byteorder=">")
    np.testing.assert_array_equal(read_record(path, units=1.0).acceleration, COUNTS[0])


def test_channels_and_their_clock(tmp_path):
    path = save(tmp_path, "MSEED", [trace(COUNTS[k], code) for k, code in enumerate(("HNE", "HNN", "HNZ"))])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = read_channels(path, units=1e-4)
    np.testing.assert_array_equal(found.values, 1e-4 * COUNTS)
    assert list(found["sensor"].values) == ["HNE", "HNN", "HNZ"]
    assert found.attrs["start"] == pytest.approx(START.timestamp, abs=1e-6)
    with pytest.raises(ValueError, match="`column` must be given, .* has the channels HNE, HNN, HNZ"):
        read_record(path, units=1.0)
    assert read_record(path, units=1.0, column="HNZ").acceleration[0] == COUNTS[2, 0]


def test_what_follows_without_a_gap_is_joined(tmp_path):
    later = START + 0.005 * 100
    parts = [trace(COUNTS[0, :100], "HNE"), trace(COUNTS[0, 100:], "HNE", later)]
    path = save(tmp_path, "MSEED", parts)
    np.testing.assert_array_equal(read_record(path, units=1.0).acceleration, COUNTS[0])
    parts[1].stats.starttime = later + 0.05
    path = save(tmp_path, "MSEED", parts)
    with pytest.raises(ValueError, match="HNE: no samples may be missing, 10 are, the first after 0.5 s"):
        read_record(path, units=1.0)
    found = read_channels_with_gaps(path, units=1.0).values[0]
    assert np.flatnonzero(np.isnan(found)).tolist() == list(range(100, 110))
    np.testing.assert_array_equal(found[110:], COUNTS[0, 100:])
    parts[1] = trace(COUNTS[0, 90:], "HNE", START + 0.005 * 90)  # overlaps and agrees
    path = save(tmp_path, "MSEED", parts)
    np.testing.assert_array_equal(read_record(path, units=1.0).acceleration, COUNTS[0])


def test_channels_that_start_at_different_times(tmp_path):
    """Cut to what they have in common, by whole samples."""
    parts = [trace(COUNTS[0], "HNE"), trace(COUNTS[1], "HNN", START + 0.015)]
    found = read_channels(save(tmp_path, "MSEED", parts), units=1.0)
    np.testing.assert_array_equal(found.values, [COUNTS[0, 3:], COUNTS[1, :-3]])
    assert found.attrs["start"] == pytest.approx(START.timestamp + 0.015, abs=1e-6)


@pytest.mark.parametrize("rate", [100.0, 128.0, 200.0, 250.0, 500.0, 1024.0])
def test_rates_of_sac_in_single_precision(tmp_path, rate):
    one = trace(COUNTS[0].astype(np.float32), "HNE")
    one.stats.delta = 1.0 / rate
    assert read_record(save(tmp_path, "SAC", [one]), units=1.0).dt == pytest.approx(1.0 / rate, rel=1e-6)


RUNAWAYS = [(4e-3, 40, True), (-1e-3, 40, True), (0.0, 40, False), (4e-3, 2, False)]


@pytest.mark.parametrize(("off", "n", "told"), RUNAWAYS)
def test_a_clock_that_runs_away(tmp_path, off, n, told):
    """By the times of a file's records, three or more, if they are off by half a sample at the end."""
    path = tmp_path / "drift.mseed"
    with path.open("wb") as file:
        for k in range(n):
            part = trace(COUNTS[0, :100], "HNE", START + 100 * k * 0.005 * (1.0 + off))
            obspy.Stream([part]).write(file, format="MSEED", reclen=512)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        step = read_record(path, units=1.0).dt
    assert any(f"of its {n} records" in str(w.message) for w in caught) == told
    assert step == pytest.approx(0.005 * (1.0 + off * told), rel=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_name_their_format(tmp_path, kind):
    path = save(tmp_path, kind, [one(kind)])
    raw = path.read_bytes()
    path.write_bytes(raw[: len(raw) * 2 // 3] if kind not in ("TSPAIR", "SLIST") else raw[:200] + b"\n1 x\n")
    with pytest.raises(ValueError, match=f"motion.* must be a whole {kind} file, "):
        read_record(path, units=1.0)


def test_sac_that_announces_more_than_it_has(tmp_path):
    path = save(tmp_path, "SAC", [one("SAC")])
    raw = bytearray(path.read_bytes())
    raw[316:320] = (2**30).to_bytes(4, "little")
    path.write_bytes(raw)
    with pytest.raises(ValueError, match="Actual and theoretical file size are inconsistent"):
        read_record(path, units=1.0)


def test_pickles_are_not_opened(tmp_path):
    """ObsPy's own detection would open them."""
    path = tmp_path / "motion.mseed"
    obspy.Stream([one("MSEED")]).write(str(path), format="PICKLE")
    with pytest.raises(ValueError, match="must be a text file, it holds binary data"):
        read_record(path, units=1.0)


@pytest.mark.slow
def test_without_obspy_the_extra_is_named(tmp_path):
    path = save(tmp_path, "SAC", [one("SAC")])
    code = "import sys; sys.modules['obspy'] = None; from pymc_features.io import read_record"
    code = f"{code}; read_record({str(path)!r})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert (
        "ObsPy must be installed to read motion.sac, a SAC file, got none. Install it with: " in done.stderr
    )
    assert 'python -m pip install "pymc-features[seismic]"' in done.stderr


def test_knet_beside_obspy(tmp_path):
    """Of our own file, and of the file of NIED's that ObsPy tests itself with: step, start, gal, peak."""
    counts = RNG.integers(-9000, 9000, 300)
    path = tmp_path / "ours.NS"
    path.write_text(record_files.knet(counts))
    published = Path(nied.__file__).parent / "tests" / "data" / "test.knet"
    for file in (path, *([published] if published.exists() else [])):
        theirs = obspy.read(str(file), format="KNET")[0]
        ours = read_record(file)
        data = theirs.stats.calib * theirs.data
        np.testing.assert_allclose(ours.acceleration, data - data.mean(), rtol=1e-12, atol=1e-15)
        assert ours.dt == pytest.approx(theirs.stats.delta, rel=1e-12)
        assert ours.pga == pytest.approx(0.01 * theirs.stats.knet.accmax, abs=1e-5)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            start = read_channels(file).attrs["start"]
        assert start == pytest.approx(theirs.stats.starttime.timestamp)
