"""Time histories in Universal Files as analysers write them: clocks, padded lines, other channels."""

import numpy as np
import pytest

from pymc_features import read_channels, read_record

VALUES = np.array([1.0, -2.0, 3.0, -4.0, 5.0, -6.0, 7.0])


def data_set(values=VALUES, *, node=1, unit="m/s^2", quantity=12, x0=0.0, dx=0.01, x_unit="s", padded=0):
    """One data set 58 in text; its last line is filled with so many zeros."""
    head = ["    -1", "    58", "NONE", "NONE", "01-Jan-24 10:00:00", "NONE", "NONE"]
    head.append(f"{1:5d}{1:10d}{1:5d}{0:10d} {'NONE':10}{node:10d}{3:4d} {'NONE':10}{0:10d}{0:4d}")
    head.append(f"{2:10d}{len(values):10d}{1:10d}{x0:13.5e}{dx:13.5e}{0.0:13.5e}")
    axes = (17, "Time", x_unit), (quantity, "Signal", unit), (0, "NONE", "NONE"), (0, "NONE", "NONE")
    head += [f"{kind:10d}{0:5d}{0:5d}{0:5d} {name:20} {label:20}" for kind, name, label in axes]
    values = np.append(values, np.zeros(padded))
    lines = ["".join(f"{v:13.5e}" for v in values[i : i + 6]) for i in range(0, len(values), 6)]
    return "\n".join([*head, *lines, "    -1"]) + "\n"


@pytest.fixture
def file(tmp_path):
    def write(*sets):
        path = tmp_path / "test.uff"
        path.write_text("".join(sets))
        return path

    return write


@pytest.mark.parametrize(
    ("dx", "label", "step"),
    [
        (0.01, "s", 0.01),
        (10.0, "ms", 0.01),
        (0.5, "msec", 0.0005),
        (500.0, "us", 0.0005),
        (0.01, "NONE", 0.01),
    ],
)
def test_the_label_of_the_clock_counts(file, dx, label, step):
    assert read_record(file(data_set(dx=dx, x_unit=label))).dt == pytest.approx(step, rel=1e-9)


@pytest.mark.parametrize("label", ["Hz", "frames", "m"])
def test_a_clock_in_no_unit_of_time_is_refused(file, label):
    with pytest.raises(ValueError, match=f"1Z: times must be in a unit of time, got '{label}'. Export sec"):
        read_record(file(data_set(x_unit=label)))


def test_a_last_line_that_is_filled_up(file):
    np.testing.assert_array_equal(read_record(file(data_set(padded=5))).acceleration, VALUES)
    with pytest.raises(ValueError, match="the 7 samples of its header must be there, got 14"):
        read_record(file(data_set(padded=7)))


def test_channels_that_are_not_asked_for_do_not_block(file):
    """A hammer, and what it moves."""
    path = file(data_set(10.0 * VALUES, node=9, unit="N", quantity=13), data_set(node=1))
    for columns in ("1Z", {"a": 1}):
        np.testing.assert_array_equal(read_channels(path, columns=columns).values[0], VALUES)
    np.testing.assert_array_equal(read_record(path, column="1Z").acceleration, VALUES)
    for columns in (None, "9Z"):
        with pytest.raises(ValueError, match="hold accelerations, the data set '9Z' says force"):
            read_channels(path, columns=columns)


def test_sensors_of_several_quantities_in_one_file(file):
    path = file(data_set(), data_set(node=2, quantity=8, unit="mm"))
    sensors = {
        "top": {"file": path, "column": "1Z"},
        "lvdt": {"file": path, "column": "2Z", "quantity": "displacement"},
    }
    np.testing.assert_allclose(read_channels(sensors).values, [VALUES, 1e-3 * VALUES], rtol=1e-15)
    with pytest.raises(ValueError, match="must hold accelerations, the data set '2Z' says displacement"):
        read_channels(path)


def test_units_of_the_label(file):
    np.testing.assert_allclose(read_record(file(data_set(unit="mm/s2"))).pga, 7e-3)
    with pytest.raises(ValueError, match="must hold accelerations, it states 'mm/s', a unit of velocity"):
        read_record(file(data_set(unit="mm/s")))


def test_histories_that_begin_at_different_times(file):
    """Cut to what they have in common."""
    path = file(data_set(), data_set(10.0 * VALUES, node=2, x0=0.02))
    np.testing.assert_array_equal(read_channels(path).values, [VALUES[2:], 10.0 * VALUES[:-2]])


def test_exponents_of_double_precision(file):
    """As Fortran writes them, which pyuff does not read."""
    text = data_set()
    head, numbers = text[: text.index("\n  1.0")], text[text.index("\n  1.0") :]
    np.testing.assert_array_equal(read_record(file(head + numbers.replace("e", "D"))).acceleration, VALUES)
