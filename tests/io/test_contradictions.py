"""What a file says twice, or says in a way that is not known: errors that name both, or questions."""

import numpy as np
import pytest

import pymc_features as pmf
from pymc_features.io.reading.labels import G, Label, role_of
from support.refusals import refusals

ROWS = [(0.01 * k, np.sin(0.7 * k), np.cos(0.4 * k)) for k in range(40)]
A, B = np.array(ROWS).T[1:]


def table(folder, head, form="{:.2f},{:.9f},{:.9f}", rows=ROWS, scale=1.0):
    lines = [form.format(scale * t, *values) for t, *values in rows]
    (folder / "a.csv").write_text("\n".join([head, *lines]) + "\n")
    return folder / "a.csv"


REFUSED = {  # what is said: header, settings
    "it states 'mm/s', a unit of velocity, beside units='g'": ("time [s],v [mm/s],b [mm/s]", {"units": "g"}),
    "it states 'mm', a unit of displacement": ("time [s],laser [mm],b [mm]", {}),
    "it states 'um/m', a unit of strain": ("time [s],gauge [um/m],b [um/m]", {}),
    "it states 'deg/s', a unit of angular velocity": ("time [s],a [g],gyro [deg/s]", {}),
    "it states 'V', a unit of voltage. Pass `sensitivity`": ("time [s],a [V],b [V]", {}),
    "states 'mm/s and g', which is no known unit": ("time,a [mm/s],b\ns,g,g", {}),
    "states 'g and mg', which is no known unit": ("time [s],a [g],b [g]\ns,mg,mg", {}),
    "the label 'velocity' says velocity": ("time [s],velocity,b", {"units": "m/s^2"}),
    "the label 'Force' says force": ("time [s],Force,b", {"units": "m/s^2"}),
    "`clock_units` must be those of the file, a.csv states": ("time [ms],a [g],b [g]", {"clock_units": "s"}),
    "the label 'Temperature' says temperature": ("time [s],Temperature,b", {"units": "m/s^2"}),
    "the label 'gyro_x' says angular velocity": ("time [s],gyro_x,b", {"units": "m/s^2"}),
    "does not say whether 'distance', which runs forward, is the time": ("distance,a,b", {"units": "g"}),
    "does not say whether 'x', which runs forward, is the time": ("x,a,b", {"units": "g"}),
    r"must be a history over time, got a column 'Frequenz'": ("Frequenz,a,b", {"units": "g"}),
    "`dt` must be given": ("Sample No,a [g],b [g]", {"clock": False, "dt": None}),
}


@refusals("head settings", REFUSED)
def test_refusals(tmp_path, head, settings, match):
    with pytest.raises(ValueError, match=match):
        pmf.read_channels(table(tmp_path, head), **settings)


def test_clock_units_of_an_unknown_unit(tmp_path):
    path = table(tmp_path, "time [ticks],a [g],b [g]", scale=100.0)
    with pytest.raises(ValueError, match="`clock_units` must be given, a.csv states 'ticks'"):
        pmf.read_channels(path)
    assert float(pmf.read_channels(path, clock_units=0.01)["time"][1]) == pytest.approx(0.01)


def test_a_direction_is_no_unit(tmp_path):
    found = pmf.read_channels(table(tmp_path, "time [s],acc (N),acc (E)"), units="g")
    np.testing.assert_allclose(found.values, G * np.array([A, B]), rtol=1e-7, atol=1e-12)
    assert list(found["sensor"].values) == ["acc (N)", "acc (E)"]


def test_second_clocks_are_no_channels(tmp_path):
    rows = [(t, t, a) for t, a, _ in ROWS]
    found = pmf.read_channels(table(tmp_path, "timestamp [s],elapsed [s],base [g]", rows=rows))
    assert list(found["sensor"].values) == ["a"] and found.shape == (1, 40)
    rows = [(t, k, a) for k, (t, a, _) in enumerate(ROWS)]
    found = pmf.read_channels(table(tmp_path, "time [s],RECORD,base [g]", "{:.2f},{},{:.9f}", rows=rows))
    assert found.shape == (1, 40)


def test_channels_with_clocks_of_their_own(tmp_path):
    rows = [(t, a, 1.5 * t, b) for t, a, b in ROWS]
    path = table(tmp_path, "time [s],a [g],time [s],b [g]", "{:.2f},{:.9f},{:.3f},{:.9f}", rows=rows)
    with pytest.raises(ValueError, match="has 'time .s.' and 'time .s.', which run apart"):
        pmf.read_channels(path)
    found = pmf.read_channels(path, clock=2, columns=3)
    assert float(found["time"][1]) == pytest.approx(0.015)
    late = [(t, a, t + 0.1, b) for t, a, b in ROWS]  # one channel begins a tenth of a second later
    path = table(tmp_path, "time [s],a [g],time [s],b [g]", "{:.2f},{:.9f},{:.3f},{:.9f}", rows=late)
    with pytest.raises(ValueError, match="which run apart"):
        pmf.read_channels(path)


STAMPS = "05-Mar-2024 10:20:{:05.2f}", "05.03.24 10:20:{:05.2f}", "2024-03-05T10:20:{:05.2f} UTC"


@pytest.mark.parametrize("stamp", STAMPS)
def test_dates(tmp_path, stamp):
    rows = [f"{stamp.format(0.01 * k)};{a:.6f}" for k, a in enumerate(A)]
    (tmp_path / "a.csv").write_text("\n".join(["time;a [g]", *rows]) + "\n")
    found = pmf.read_channels(tmp_path / "a.csv")
    assert (float(found["time"][1]), found.attrs["start"]) == (0.01, 1709634000.0)


def test_words_among_numbers_are_named(tmp_path):
    (tmp_path / "a.csv").write_text("time [s],a [g],status\n" + "".join(f"{t},{a},OK\n" for t, a, _ in ROWS))
    with pytest.raises(ValueError, match="Line 2 has 'OK' among its numbers"):
        pmf.read_channels(tmp_path / "a.csv")


@pytest.mark.parametrize("name", ["frame 1", "channel no 3", "index-2"])
def test_numbered_sensors_are_channels(name):
    assert role_of(Label.of(name).name) is None


SPOILT = {  # what is said: lines
    "line 4: values must be finite numbers, got": ("t [s];a [g]", "0,01;0,5", "0,02;0,7", "0,03;12.345"),
    "line 2: values must be": ("time [s],a [g],b [g]", "O.000,0.1,0.2", "0.01,0.1,0.2", "0.02,0.3,0.1"),
    "line 1: values must be finite numbers, got 'L0.0000'": ("L0.0000 0.156452", "0.01 0.1", "0.02 0.3"),
    "line 1: a row of numbers must not stand above the": ("0,00;0,1", "t [s];a [g]", "0,01;0,1", "0,02;0,3"),
    "dates must be those of a": ("time,a [g]", "2024-03-65T10:00:00.00,1.0", "2024-03-65T10:00:00.01,2.0"),
}


@pytest.mark.parametrize("match", SPOILT)
def test_spoilt_rows(tmp_path, match):
    path = tmp_path / "a.csv"
    path.write_text("\n".join(SPOILT[match]) + "\n")
    with pytest.raises(ValueError, match=match):
        pmf.read_channels(path)


def test_one_column_of_decimal_commas(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("acc [g]\n" + "".join(f"{x:.3f}\n".replace(".", ",") for x in A))
    np.testing.assert_allclose(pmf.read_channels(path, dt=0.01).values[0], G * A, atol=0.006)
    path.write_text("".join(f"{x:.3f}\n".replace(".", ",") for x in A))
    np.testing.assert_allclose(pmf.read_record(path, units="g", dt=0.01).acceleration, G * A, atol=0.006)


def test_separators_at_the_ends_of_rows(tmp_path):
    path = table(tmp_path, "time [s],a [g],b [g],,", "{:.2f},{:.9f},{:.9f},,")
    np.testing.assert_allclose(pmf.read_channels(path).values, G * np.array([A, B]), rtol=1e-7, atol=1e-12)


def test_a_value_of_another_size(tmp_path):
    rows = [list(map(float, row)) for row in ROWS]
    rows[7][1], rows[9][2] = 1e9, 1e-103
    path = table(tmp_path, "time [s],a [g],b [g]", "{:.2f},{!r},{!r}", rows=rows)
    with pytest.warns(UserWarning, match="is of another size than others") as caught:
        pmf.read_channels(path)
    said = [str(warning.message) for warning in caught if "another size" in str(warning.message)]
    assert len(said) == 2 and "e-10" in said[1]


def test_a_peak_of_a_record_that_no_ground_has(tmp_path):
    path = table(tmp_path, "time [s],a [g],b [g]", rows=[(t, 10.0 * a, b) for t, a, b in ROWS])
    with pytest.warns(UserWarning, match="implausible peak of .* 9.95 g. Check `units`"):
        pmf.read_record(path, column="a")


@pytest.mark.parametrize(
    ("text", "volts"),
    [("100 mV/g", 0.1 / G), ("10.2mV/(m/s^2)", 0.0102), ("1.02 V per m/s²", 1.02), ("2e1 mV/Gal", 2.0)],
)
def test_sensitivities(text, volts):
    from pymc_features.io.reading.labels import sensitivity_of

    assert sensitivity_of(text, "acceleration") == pytest.approx(volts, rel=1e-12)
    with pytest.raises(ValueError, match="`sensitivity` must be V per m/s"):
        sensitivity_of(text, "velocity")
