"""Files in which samples are missing: empty cells, NaN, rows that the clock passes over."""

import numpy as np
import pytest
from scipy.io import savemat

from pymc_features import read_channels
from pymc_features.io import read_channels_with_gaps
from support.warned import messages

N = 60
MOTION = np.random.default_rng(11).standard_normal((3, N)).cumsum(axis=1) * 0.3 + 0.1  # [m/s^2]
NAMES = ["base", "floor", "roof"]


def table(folder, rows=None, name="frame.csv", separator=",", missing=None):
    """A table of the motion, with the text `missing` in cells of the roof, and some rows alone."""
    lines = [separator.join(["time [s]", *(f"{sensor} [m/s^2]" for sensor in NAMES)])]
    for k in range(N) if rows is None else rows:
        cells = [f"{3.0 + 0.02 * k:.2f}", *(f"{x:.9f}" for x in MOTION[:, k])]
        if missing is not None and 20 <= k < 25:
            cells[3] = missing
        lines.append(separator.join(cells))
    path = folder / name
    path.write_text("\n".join(lines) + "\n")
    return path


def expected(gap=(), sensors=slice(None)):
    values = MOTION.copy()
    values[sensors, list(gap)] = np.nan
    return values


@pytest.mark.parametrize(
    ("separator", "missing"), [(",", ""), (";", ""), (",", "nan"), (",", " NaN"), ("\t", "nan"), (" ", "NaN")]
)
def test_cells_without_a_number(tmp_path, separator, missing):
    path = table(tmp_path, separator=separator, missing=missing)
    with pytest.raises(ValueError, match="line 22: (values must be finite numbers|rows must have 4 values)"):
        read_channels(path)
    channels = read_channels_with_gaps(path)
    np.testing.assert_allclose(channels.values, expected(range(20, 25), 2), atol=1e-9)
    np.testing.assert_allclose(channels["time"], 0.02 * np.arange(N), atol=1e-12)
    assert messages(lambda: read_channels_with_gaps(path)) == []


def test_rows_that_are_missing(tmp_path):
    gap = [7, 30, 31, 32]
    path = table(tmp_path, [k for k in range(N) if k not in gap])
    with pytest.raises(ValueError, match="line 9: no samples may be missing, 4 are, in 2 gap"):
        read_channels(path)
    channels = read_channels_with_gaps(path, columns=["base", "roof"], clock="time")
    np.testing.assert_allclose(channels.values, expected(gap)[[0, 2]], atol=1e-9)
    np.testing.assert_allclose(channels["time"], 0.02 * np.arange(N), atol=1e-12)


def test_without_gaps_the_channels_are_the_same(tmp_path):
    path = table(tmp_path)
    assert read_channels_with_gaps(path).identical(read_channels(path))


def test_files_with_gaps_of_their_own(tmp_path):
    """Each with a clock that starts at another time."""
    files = {
        "low": table(tmp_path, [k for k in range(N) if k != 40], "low.csv"),
        "high": table(tmp_path, [k for k in range(4, N) if not 10 <= k < 15], "high.csv"),
    }
    channels = read_channels_with_gaps(files, columns="roof")
    low, high = expected([40])[2, 4:], expected(range(10, 15))[2, 4:]
    np.testing.assert_allclose(channels.values, [low, high], atol=1e-9)


@pytest.mark.parametrize("with_clock", [False, True])
def test_matlab(tmp_path, with_clock):
    path, rows = tmp_path / "frame.mat", np.delete(np.arange(N), [5, 6] if with_clock else [])
    values = expected(range(20, 25), 2)[:, rows]
    clock = {"time": 0.02 * rows} if with_clock else {"dt": 0.02}
    savemat(path, dict(zip(NAMES, values, strict=True)) | clock | {"units": "m/s^2"})
    with pytest.raises(ValueError, match="values must be finite numbers, got nan|no samples may be missing"):
        read_channels(path)
    found = read_channels_with_gaps(path).values
    np.testing.assert_allclose(
        found, np.where(np.isin(np.arange(N), rows), expected(range(20, 25), 2), np.nan)
    )


def broken(folder, changes):
    """The table with other lines, by their number."""
    lines = table(folder).read_text().splitlines()
    for number, line in changes.items():
        lines[number - 1] = line
    path = folder / "broken.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({5: "3.06,inf,0.1,0.2"}, "broken.csv, line 5: values must be finite numbers, got 'inf'"),
        ({5: "3.06,1e999,0.1,0.2"}, "line 5: values must be finite numbers, got '1e999'"),
        ({5: "3.06,-,0.1,0.2"}, "line 5: values must be finite numbers, got '-'"),
        ({5: "3.06,0.1,0.2"}, "line 5: rows must have 4 values like the first, got 3"),
        ({5: "nan,0.1,0.1,0.2"}, "line 5: the clock must have a time in every row, got none. Cut the row"),
        ({5: ",0.1,0.1,0.2"}, "line 5: the clock must have a time in every row"),
        ({2: "3.00,,0.1,0.2"}, "line 2: values must be finite numbers, got an empty cell"),
        ({61: "9.00,0.1,0.1,0.2"}, "line 61: no samples may be missing, 241 are"),
        ({61: "1e12,0.1,0.1,0.2"}, "line 61: (no samples may be missing|time steps must be even)"),
    ],
)
def test_what_is_refused(tmp_path, changes, match):
    with pytest.raises(ValueError, match=match):
        read_channels_with_gaps(broken(tmp_path, changes))


def test_a_sensor_without_any_sample(tmp_path):
    rows = {number: f"{3.0 + 0.02 * (number - 2):.2f},0.1,{number}.5," for number in range(3, N + 2)}
    path = broken(tmp_path, rows | {2: "3.00,0.2,1.5,nan"})
    with pytest.raises(ValueError, match="Channel 'roof' must move, all its 0 samples"):
        read_channels_with_gaps(path)


def test_arguments_are_those_of_read_channels(tmp_path):
    with pytest.raises(ValueError, match="`dt` must be given with clock=False"):
        read_channels_with_gaps(table(tmp_path), clock=False)
