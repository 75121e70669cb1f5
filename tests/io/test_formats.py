"""Formats of recordings: files as their specifications lay them out, and what is read from them."""

import re
import warnings

import numpy as np
import pytest

from pymc_features import read_channels, read_record
from pymc_features.io import FORMATS
from pymc_features.io.formats import TEXT
from pymc_features.io.reading.recording import Opening
from support import record_files as files
from support.record_examples import COUNTS, EXAMPLES, FILM, KNET_GAL, MOTION, N, named

pytestmark = pytest.mark.filterwarnings("error")

each_example = pytest.mark.parametrize("name", EXAMPLES)


def write(folder, name, text=None, suffix=None):
    example = EXAMPLES.get(name)
    path = folder / f"{name}{example.suffix if suffix is None else suffix}"
    path.write_text(example.text if text is None else text, encoding="latin-1")
    return path


# --- what is read -------------------------------------------------------------------------------


@each_example
def test_record(tmp_path, name):
    """Number of samples, step, unit and values of each channel, by index and by name."""
    example = EXAMPLES[name]
    path = write(tmp_path, name)
    for index, (channel, expected) in enumerate(example.channels.items()):
        for column in (index, channel):
            record = read_record(path, column=column)
            assert (record.n_times, record.dt) == (len(expected), pytest.approx(example.dt, rel=1e-12))
            digits = 2e-5 if name == "smc" else 1e-9
            np.testing.assert_allclose(record.acceleration, expected, rtol=digits, atol=1e-8)
    if len(example.channels) == 1:
        assert read_record(path).pga == pytest.approx(np.abs(expected).max(), rel=1e-4)
    else:
        with pytest.raises(ValueError, match=f"`column` must be given, {path.name} .*{channel}"):
            read_record(path)


@each_example
def test_channels(tmp_path, name):
    """All channels of a file on its clock, which is an absolute one where the file states the time."""
    example = EXAMPLES[name]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a walk is no acceleration to the checks of channels
        found = read_channels(write(tmp_path, name))
    expected = np.array(list(example.channels.values()))
    digits = 2e-5 if name == "smc" else 1e-9
    np.testing.assert_allclose(found.values, expected, rtol=digits, atol=1e-8)
    names = list(example.channels) if len(expected) > 1 else [name]
    assert list(found["sensor"].values) == names
    assert found.attrs["start"] == pytest.approx(example.start or 0.0, abs=1e-6)


@each_example
@pytest.mark.parametrize("end", ["\r\n", "\r\r\n", "\r"])
def test_line_ends(tmp_path, name, end):
    text = EXAMPLES[name].text
    path = write(tmp_path, name, text.rstrip("\n").replace("\n", end))
    path.write_bytes(text.rstrip("\n").replace("\n", end).encode("latin-1"))
    expected = read_record(write(tmp_path / "..", name), column=0).acceleration
    np.testing.assert_array_equal(read_record(path, column=0).acceleration, expected)


@each_example
def test_no_format_is_taken_for_another(tmp_path, name):
    """By its first lines alone, whatever the suffix; CSV, text and MATLAB are not taken for any."""
    opening = Opening.of(write(tmp_path, name, suffix=".dat"))
    found = [entry.name for entry in FORMATS if entry is not TEXT and opening.begins(entry.begins)]
    assert len(found) == 1
    assert found[0].startswith(EXAMPLES[name].format_name)


@pytest.mark.parametrize(
    "text",
    ["time [s],acc [g]\n0.0,0.1\n", "# Origin\n1 2\n", "1\n2\n", "Corrected\n1,2\n", "*\n", "", "\0\1\2"],
)
def test_other_files_are_of_no_format(tmp_path, text):
    path = tmp_path / "motion.csv"
    path.write_text(text)
    opening = Opening.of(path)
    assert [entry.name for entry in FORMATS if opening.begins(entry.begins)] == [TEXT.name]
    assert Opening(".mat", b"").begins(FORMATS[0].begins)


def test_units_and_step_that_contradict_the_file(tmp_path):
    path = write(tmp_path, "esm")
    with pytest.raises(ValueError, match="`units` must be those of the file, .* states 'cm/s.2', got 'g'"):
        read_record(path, units="g")
    with pytest.warns(UserWarning, match="states a time step of 0.005 s; the argument dt=0.01 s is used"):
        assert read_record(path, dt=0.01).dt == 0.01


# --- one by one ---------------------------------------------------------------------------------


def test_knet_is_in_gal_and_not_every_eighth_count(tmp_path):
    """The example of the answers on K-NET: 16515 counts of 2000/8388608 gal are 3.94 gal."""
    counts = np.r_[16515, -16515, np.zeros(98, dtype=int)]
    path = tmp_path / "answer.NS"
    path.write_text(files.knet(counts, scale="2000(gal)/8388608"))
    assert read_record(path).pga == pytest.approx(0.0394, abs=5e-5)
    assert read_record(path).name == "MYG002 N-S, 2006/01/18 23:25:46"


def test_files_of_one_station_share_a_clock(tmp_path):
    """A file that starts a second later is shifted by as many samples."""
    (tmp_path / "a.NS").write_text(files.knet(COUNTS))
    (tmp_path / "a.EW").write_text(files.knet(COUNTS, start="2006/01/18 23:25:47"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = read_channels({"NS": tmp_path / "a.NS", "EW": tmp_path / "a.EW"})
    assert found.sizes["time"] == N - 100
    np.testing.assert_allclose(found.values[0], 0.01 * KNET_GAL[100:])
    np.testing.assert_allclose(found.values[1], 0.01 * KNET_GAL[:100])


@pytest.mark.parametrize("kind", ["smc", "csmip"])
def test_film(tmp_path, kind):
    """Uneven pairs need a step, and are read off the straight lines between them."""
    values = np.round(0.1 * np.sin(2.0 * FILM), 3)
    path = tmp_path / f"film.{kind}"
    if kind == "smc":
        pairs = np.column_stack([FILM, values]).ravel()
        path.write_text(files.smc(pairs, None, title="1 UNCORRECTED ACCELEROGRAM"))
        factor = 0.01
    else:
        path.write_text(files.csmip_film(FILM, values))
        factor = 0.981  # tenths of g
    with pytest.raises(ValueError, match="`dt` must be given, the times of film.* are uneven"):
        read_record(path)
    record = read_record(path, dt=0.002)
    even = 0.002 * np.arange(record.n_times)
    assert FILM[-1] - 0.002 < even[-1] <= FILM[-1] + 1e-9
    np.testing.assert_allclose(record.acceleration, factor * np.interp(even, FILM, values), rtol=1e-4)
    with pytest.raises(ValueError, match="`dt` must not be a hundredth"):
        read_record(path, dt=1e-6)


def test_film_whose_peak_is_lost_at_the_step(tmp_path):
    values = np.zeros(FILM.size)
    values[80] = 0.5
    (tmp_path / "film.raw").write_text(files.csmip_film(FILM, values))
    with pytest.warns(UserWarning, match=r"at dt=0.011 s the peak of its uneven values falls from 0.05 to"):
        read_record(tmp_path / "film.raw", dt=0.011)


def test_film_that_is_even(tmp_path):
    times = 0.02 * np.arange(100)
    (tmp_path / "film.raw").write_text(files.csmip_film(times, np.sin(times)))
    assert read_record(tmp_path / "film.raw").dt == 0.02


def test_cosmos_counts_need_the_user(tmp_path):
    path = write(tmp_path, "cosmos", files.cosmos(named(1.0, "340 deg"), 0.005, unit="counts (50)"))
    with pytest.raises(ValueError, match="`units` must be given, .* states 'counts', which is no known unit"):
        read_record(path)
    with pytest.warns(UserWarning, match="states the units 'counts'"):
        np.testing.assert_allclose(read_record(path, units=2.0).acceleration, 2.0 * MOTION[0], rtol=1e-9)


def test_other_units_of_a_header(tmp_path):
    path = write(tmp_path, "csmip 2", files.csmip_2(named(0.001, "Up"), 0.005, unit="g"))
    np.testing.assert_allclose(read_record(path).acceleration, 9.81e-3 * MOTION[0], atol=5e-6)
    path = write(tmp_path, "esm", files.esm(MOTION[0], 0.005, units="mm/s^2"))
    np.testing.assert_allclose(read_record(path).acceleration, 1e-3 * MOTION[0], atol=5e-6)
    path = write(tmp_path, "esm", files.esm(MOTION[0], 0.005, units="furlong/s^2"))
    with pytest.raises(ValueError, match="`units` must be given, .* states 'furlong/s.2', which is no known"):
        read_record(path)


# --- what is refused ----------------------------------------------------------------------------


def edited(name, old, new):
    text = EXAMPLES[name].text
    assert text.count(old) >= 1, f"{name} has no {old!r}"
    return text.replace(old, new, 1)


REFUSED = {  # example, what is changed, to what: what is said
    (
        "knet",
        "100Hz",
        "0Hz",
    ): "line 17: the header must state the sampling frequency, a positive number, got 0",
    ("knet", "Duration Time(s)  2", "Duration Time(s)  3"): "must hold 300 values, frequency times duration",
    ("knet", "Duration Time(s)  2", "Duration Time(s)  1"): "frequency times duration that it announces",
    ("knet", "3920(gal)", "3920(cm)"): "the header must state the scale factor, as 3920",
    ("knet", "Scale Factor", "Scale Facter"): r"\(K-NET\), line 17: the header must state scale f",
    ("knet", "Memo.", "Mema."): "line 17 must be the memo",
    (
        "cosmos",
        "    200 accel",
        "    201 accel",
    ): r"\(COSMOS\), line 72: values must fill columns of 10 .* 36 ch",
    (
        "cosmos",
        "   20.000000",
        "   10.000000",
    ): "200 samples at 0.01 s must take the time of the header, got 4 s",
    ("cosmos", "100 Real", "10x Real"): "the number of real header values or lines must stand here",
    (
        "csmip 2",
        "   200 points of accel",
        "   208 points of accel",
    ): "values must fill columns|values must be fin",
    (
        "csmip 2",
        "spaced at 0.005",
        "spaced at x.005",
    ): "the header must state the step, a positive number, got N",
    (
        "smc",
        "       200    -32768",
        "       199    -32768",
    ): "must hold the 199 values that it announces, got 200",
    (
        "geonet 2",
        "at 0.020 sec",
        "at 0.010 sec",
    ): "must state one number of points and one step, in numbers 200",
    (
        "geonet 2",
        "Number of points   200",
        "Number of points   199",
    ): "must state one number of points and one s",
    ("geonet 2", "mm/s/s at", "cm/s/s at"): "accelerations must be in mm/s/s",
    ("esm", "NDATA: 200", "NDATA: 199"): r"\(ESM\), line 219: nothing may follow the 199 values, NDATA",
    (
        "esm",
        "NDATA: 200",
        "NDATA: 999999999999",
    ): "999999999999 samples at 0.005 s must take the time of the header, got 1 s",
    ("esm", "DATA_TYPE: ACC", "DATA_TYPE: VEL"): "DATA_TYPE must be ACCELERATION, got 'VELELERATION'",
    ("esm", "SAMPLING_INTERVAL_S", "SAMPLING_INTERVAL_"): "the header must state SAMPLING_INTERVAL_S, a pos",
    (
        "nsmn",
        "NUMBER OF DATA          : 200",
        "NUMBER OF DATA          : 198",
    ): "nothing may follow the 198 rows",
    ("nsmn", "        E-W", "           "): "lines must hold 2 values, got 3",
    (
        "unam",
        "MUESTRAS, C1-C6          : /200",
        "MUESTRAS, C1-C6          : /201",
    ): "one number of samples and one interval for all channels",
    ("unam", "/0.005/0.005/0.005", "/0.01/0.01/0.01"): "200 samples at 0.01 s must take the time of the he",
}


@pytest.mark.parametrize(("change", "message"), REFUSED.items(), ids=[" ".join(c[:2]) for c in REFUSED])
def test_damaged_headers_are_refused(tmp_path, change, message):
    name, old, new = change
    with pytest.raises(ValueError, match=message):
        read_record(write(tmp_path, name, edited(name, old, new)), column=0)


PEAKS = {  # example: what the header says of the peak, without the number
    "knet": r"Max. Acc. \(gal\)   ",
    "csmip 2": r"Peak acceleration = *",
    "geonet 2": r"peak *",
    "esm": r"PGA_CM/S\^2: -?",
    "unam": r"ACEL. MAX.\(Gal\), C1-C6 *: /-?",
}


@pytest.mark.parametrize("name", PEAKS)
def test_peak_that_is_not_that_of_the_header(tmp_path, name):
    text = re.sub(rf"({PEAKS[name]})[0-9]+", r"\g<1>12345", EXAMPLES[name].text, count=1)
    with pytest.warns(UserWarning, match=r"states a peak of 1\.23.*e\+04, its values have .* damaged"):
        read_record(write(tmp_path, name, text), column=0)


@pytest.mark.parametrize("name", ["cosmos", "smc"])
def test_peak_that_is_not_one_of_the_numbers_in_the_header(tmp_path, name):
    """A sample in the file is ten times larger than the peak that its header states."""
    peak = np.abs(MOTION[0]).max()
    values = np.where(np.abs(MOTION[0]) == peak, 10.0 * MOTION[0], MOTION[0])
    if name == "smc":
        first, second = (text.split("|ref") for text in (EXAMPLES[name].text, files.smc(values, 200.0)))
        text = first[0] + "|ref" + second[1]
    else:
        first = files.cosmos({"x": MOTION[0]}, 0.02).split("Comment line")
        text = first[0] + "Comment line" + files.cosmos({"x": values}, 0.02).split("Comment line")[1]
    with pytest.warns(UserWarning, match="the file states a peak of"):
        assert read_record(write(tmp_path, name, text)).pga == pytest.approx(0.1 * peak, rel=1e-4)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (files.csmip_3(), r"\(CSMIP\), line 0: the file must hold accelerations, got spectra \(V3\). Read"),
        (
            files.cosmos(named(1.0, "x"), 0.02).replace("Corrected acceleration", "Response spectra"),
            r"\(COSMOS\), line 1: the file must hold accelerations, got spectra \(V3\)",
        ),
        (files.smc(MOTION[0], 200.0, title="3 VELOCITY"), r"\(SMC\) must hold an acceleration, got '3 VELOC"),
        (files.cosmos(named(1.0, "x"), 0.02, quantity="velocity"), r"\(COSMOS\) must hold an acceleration"),
    ],
)
def test_files_without_acceleration(tmp_path, text, message):
    path = tmp_path / "spectra.v3"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        read_record(path)


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("cosmos", "acceleration pts, approx", "accleration pts, approx", "their units and quantity, as"),
        ("knet", "    9139", "    9.39", r"values must be counts, whole numbers, got '9.39'"),
    ],
)
def test_a_spoilt_byte_does_not_give_another_channel(tmp_path, name, old, new, message):
    text = EXAMPLES[name].text
    assert old in text
    with pytest.raises(ValueError, match=message):
        read_record(write(tmp_path, name, text.replace(old, new, 1)), column=0)


def test_wrapped_is_for_text(tmp_path):
    with pytest.raises(ValueError, match="`wrapped` must be None for esm.ASC, got True. It is a ESM"):
        read_record(write(tmp_path, "esm"), wrapped=True)
