"""What labels say: units in the spellings of loggers, roles of columns, clocks, stamps, decimal commas."""

import numpy as np
import pytest

from pymc_features.io import read_channels, read_record
from pymc_features.io.reading.labels import role_of, unit_of

STEPS = 0.01 * np.arange(60)
MOTION = np.sin(2.0 * np.pi * 5.0 * STEPS)

ACCELERATIONS = {  # m/s^2
    9.81: ["g", "G", "gn"],
    9.81e-3: ["mg"],
    9.81e-6: ["ug", "\u00b5g", "\u03bcg"],
    0.01: ["Gal", "cm/s2", "cm/sec/sec", "cm/s**2", "CM/SEC^2", "cm s-2"],
    1.0: ["m/s\u00b2", "M/S/S", "m s^-2", "m\u00b7s\u207b\u00b2", "ms-2", "m/sec2", "m*s^-2"],
    1e-3: ["mm/s2", "mm/s^2"],
    0.0254: ["in/s2", "in/sec^2"],
    0.3048: ["ft/s/s"],
}
OTHERS = {
    ("velocity", 1e-3): ["mm/s", "mm/sec"],
    ("velocity", 0.01): ["cm/s", "kine"],
    ("displacement", 1e-6): ["um", "\u00b5m", "micron"],
    ("displacement", 0.0254): ["in", "inch"],
    ("strain", 1e-6): ["\u00b5m/m", "microstrain", "\u00b5\u03b5"],
    ("force", 1e3): ["kN", "KN"],
    ("force", 1e6): ["MN"],
    ("force", 1e-3): ["mN"],
    ("voltage", 1e-3): ["mV"],
    ("time", 60.0): ["min", "minutes"],
    ("time", 3600.0): ["h", "hours"],
    ("time", 1e-3): ["ms", "msec"],
}
KNOWN = [(text, "acceleration", f) for f, texts in ACCELERATIONS.items() for text in texts]
KNOWN += [(text, *unit) for unit, texts in OTHERS.items() for text in texts]


@pytest.mark.parametrize(("text", "quantity", "factor"), KNOWN)
def test_units_in_the_spellings_of_loggers(text, quantity, factor):
    found = unit_of(text)
    assert found.quantity == quantity and found.factor == pytest.approx(factor, rel=1e-12)


@pytest.mark.parametrize("text", ["", "counts", "N-S", "1", "%", "mn", "filtered", "m/s3", "V/V"])
def test_what_is_no_unit(text):
    assert unit_of(text) is None


def test_roles_of_columns():
    said = {"Time": "time", "time_stamp": "time", "Period": "period", "Freq": "frequency", "PSA": "spectral"}
    assert {label: role_of(label) for label in said} == said
    assert role_of("roof EW") is None


def lines(head, clock, mark=",", form="{:.6f}", comma=False):
    """A table of one channel below a header, its clock as text."""
    rows = [f"{t}{mark}{form.format(a)}" for t, a in zip(clock, MOTION, strict=True)]
    text = "\n".join([head, *rows]) + "\n"
    return text.replace(".", ",") if comma else text


def elapsed(scale, form="{:.9f}"):
    return [form.format(t / scale) for t in STEPS]


def stamps(form):
    """Time stamps that start at 23:59:59.800 of the last day of a month."""
    found = []
    for t in STEPS:
        late = 86399.8 + t
        day, second = ("31", late) if late < 86399.9995 else ("01", late - 86400.0)
        month = "01" if day == "31" else "02"
        hour, rest = divmod(max(second, 0.0), 3600.0)
        minute, s = divmod(rest, 60.0)
        found.append(form.format(day=day, month=month, h=int(hour), m=int(minute), s=s))
    return found


CLOCKS = {
    "minutes": lines("Time [min],a [m/s^2]", elapsed(60.0)),
    "hours": lines("time (h),a [m/s2]", elapsed(3600.0, "{:.12f}")),
    "ms": lines("t [msec];a [m/s^2]", elapsed(1e-3, "{:.1f}"), ";"),
    "iso": lines("time,a [m/s^2]", stamps("2024-{month}-{day}T{h:02d}:{m:02d}:{s:06.3f}Z")),
    "iso, zone": lines("time\ta [m/s^2]", stamps("2024-{month}-{day} {h:02d}:{m:02d}:{s:06.3f}+01:00"), "\t"),
    "quoted": lines("Timestamp,a [m/s^2]", stamps('"2024-{month}-{day} {h:02d}:{m:02d}:{s:06.3f}"')),
    "two columns": lines("Date;Time;a [m/s^2]", stamps("{day}.{month}.2024;{h:02d}:{m:02d}:{s:06.3f}"), ";"),
    "slashes": lines("Date,Time,a [m/s^2]", stamps("{month}/{day}/2024,{h:02d}:{m:02d}:{s:06.3f}")),
    "numbers and stamps": lines(
        "No,Time,a [m/s^2]", stamps("7,2024-{month}-{day}T{h:02d}:{m:02d}:{s:06.3f}")
    ),
    "half days": lines("Time,a [m/s^2]", [f"10:00:{t:06.3f} PM" for t in STEPS]),
    "commas": lines("Zeit [s];a [m/s^2]", elapsed(1.0, "{:.2f}"), ";", comma=True),
    "commas, stamps": lines(
        "Zeit;a [m/s^2]", stamps("{day}#{month}#2024 {h:02d}:{m:02d}:{s:06.3f}"), ";", comma=True
    ).replace("#", "."),
}


@pytest.mark.parametrize("name", CLOCKS)
def test_clocks_as_loggers_write_them(tmp_path, name):
    """Steps of 0.01 s and the values, by both readers, over midnight and the end of a month too."""
    path = tmp_path / "logger.csv"
    path.write_text(CLOCKS[name], encoding="utf-8")
    found = read_channels(path)
    assert float(found["time"][1]) == pytest.approx(0.01, abs=1e-9)
    np.testing.assert_allclose(found.values[0], MOTION, atol=1e-6)
    record = read_record(path, column="a")
    assert record.dt == pytest.approx(0.01, abs=1e-9)
    np.testing.assert_allclose(record.acceleration, MOTION, atol=1e-6)


def test_a_clock_of_midnight_alone_is_of_the_day(tmp_path):
    """Stamps without a date."""
    path = tmp_path / "logger.csv"
    path.write_text(lines("time,a [g]", [f"10:00:{t:05.2f}" for t in STEPS]))
    found = read_channels(path)
    assert found.attrs["start"] == 36000.0 and found["time"].values[-1] == pytest.approx(0.59)
