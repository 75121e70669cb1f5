"""Faults planted in channels of the shaking table are found, and corrected by the lines that are proposed."""

import re
import warnings

import numpy as np
import pytest

from pymc_features import cli, datasets, signals
from pymc_features.exceptions import ChannelWarning, ConfigError
from pymc_features.signals.channels import earlier
from pymc_features.update import read_problem, write_example
from support.update_files import replaced

SENSORS = ("base", "floor1", "floor2", "floor3")
LATE = 0.0125  # s, one and a half samples


def written(folder, planted, data=(), processing=()):
    """A configuration for the shaking table's channels after `planted(values, step)`, with further lines."""
    channels = datasets.mini_shake_table("northridge").sel(sensor=list(SENSORS))
    values = {name: channels.sel(sensor=name).values for name in SENSORS}
    values |= planted(values, signals.sampling_step(channels))
    header = ",".join(["time [s]", *(f"{name} [m/s^2]" for name in SENSORS)])
    rows = np.column_stack([channels["time"].values, *(values[name] for name in SENSORS)])
    np.savetxt(folder / "table.csv", rows, delimiter=",", header=header, comments="", fmt="%.9g")
    path = folder / "table.toml"
    path.unlink(missing_ok=True)
    write_example(path)
    text = replaced(
        path.read_text(),
        [
            ('dataset = "mini_shake_table"', "#"),
            ('event = "northridge"', "\n".join(['files = "table.csv"', *data]) + "\n#"),
            ("check_band = [0.5, 1.8]", "\n".join(processing) + "\n#"),
        ],
    )
    for line in data:
        key = line.partition(" = ")[0]
        if key == "sensors":
            text = text.replace('\nsensors = ["floor1", "floor2", "floor3"]\n', "\n", 1)
    path.write_text(text)
    return path


def nothing(values, step):
    return {}


def swapped(values, step):
    return {"floor1": values["floor3"], "floor3": values["floor1"]}


def inverted(values, step):
    return {"floor2": -values["floor2"]}


def turned(values, step):
    return {"base": -values["base"]}


def late(values, step):
    return {"floor1": earlier(values["floor1"], -LATE / step)}


def told_by(path):
    """What is said about the channels, the lines proposed, and the channels."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        problem = read_problem(path)
    messages = [str(w.message) for w in caught if issubclass(w.category, ChannelWarning)]
    proposed = [m.partition("[data]: ")[2].split("; ") for m in messages if "put into [data]" in m]
    return messages, proposed[0] if proposed else [], problem.measured


@pytest.fixture(scope="module")
def clean(tmp_path_factory, data_dir):
    """The channels without the lags that they have: a third of a sample at the third floor, and less."""
    folder = tmp_path_factory.mktemp("clean")
    _, lines, _ = told_by(written(folder, nothing))
    assert re.fullmatch(r"delay = \{ floor1 = 0\.00056\d*, floor3 = 0\.0025\d* \}", lines[0])
    assert len(lines) == 1
    messages, more, measured = told_by(written(folder, nothing, lines))
    assert not messages
    assert not more
    assert measured.checked.startswith("checked against each other between 0.5")
    return measured


@pytest.mark.slow
@pytest.mark.parametrize(
    ("planted", "line"),
    [
        (swapped, 'sensors = ["floor3", "floor2", "floor1"]'),
        (inverted, "scale = { floor2 = -1.0 }"),
        (turned, "scale = { base = -1.0 }"),
        (late, "delay = { floor1 = 0.01"),
    ],
)
def test_lines_that_are_proposed_correct_the_fault(clean, tmp_path, planted, line):
    messages, lines, _ = told_by(written(tmp_path, planted))
    assert len(messages) > 1
    assert any(proposed.startswith(line) for proposed in lines)
    messages, more, measured = told_by(written(tmp_path, planted, lines))
    assert not messages
    assert not more
    size = np.abs(clean.channels.values).max()
    off = (
        2e-4 if planted is late else 1e-6
    )  # a lag of 12.5 ms is found to 3 us, a third of a thousandth of a sample
    np.testing.assert_allclose(measured.record.acceleration, clean.record.acceleration, atol=off * size)
    np.testing.assert_allclose(measured.channels.values, clean.channels.values, atol=off * size)


def test_clocks_that_are_seconds_apart_are_an_error(tmp_path, data_dir):
    def apart(values, step):
        return {"floor2": np.roll(values["floor2"], round(2.5 / step))}

    path = written(tmp_path, apart)
    with (
        pytest.warns(ChannelWarning),
        pytest.raises(ConfigError, match=r"must have one clock, got floor2 2\.501 s after the base"),
    ):
        read_problem(path)


def test_a_record_too_short_for_the_check_is_said_to_be(tmp_path, data_dir):
    path = written(tmp_path, inverted, ["rows = [1000, 1400]"], ["check_band = false"])
    text = (
        path.read_text().replace("trim = [9.0, 24.0]", "").replace("window = [0.5, 9.5]", "kind = 'constant'")
    )
    path.write_text(text)
    messages, _, measured = told_by(path)
    assert measured.checked == "not checked against each other, as the file says"
    path.write_text(text.replace("check_band = false", ""))
    messages, lines, measured = told_by(path)
    assert messages[0].startswith("floor2 may be inverted: the modes that the priors expect explain")
    assert lines == ["scale = { floor2 = -1.0 }"]
    assert "not checked against each other: `channels` must last at least" in measured.checked
    assert measured.channels.sizes["time"] == 400


def test_command_looks_at_the_data_and_samples_nothing(tmp_path, data_dir, capsys, monkeypatch):
    path = written(tmp_path, inverted)
    monkeypatch.setattr("pymc_features.update.sampling.run_part", None)
    assert cli.main(["check", str(path)]) == 0
    said = capsys.readouterr().err
    assert "put into [data]: scale = { floor2 = -1.0 }; delay = { floor1 = 0.0005" in said
    assert "lag [ms]" in said
    assert "nothing was found wrong" not in said
    assert (tmp_path / "table-check.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "match"),
    [
        ("rows = [10, 10]", r"`data.rows` must hold two rows or more from 0 on, got \[10, 10\]"),
        ("rows = [0, 900000]", r"`data.rows` must lie within the \d+ rows of the files"),
        ('scale = "g"', "`data.scale` must be a factor for all sensors, or a table"),
        ("scale = { attic = -1.0 }", "`scale` must name sensors among base, floor1, floor2, floor3"),
        ("delay = { floor1 = 100.0 }", "`delay` must be at most a quarter of the record"),
    ],
)
def test_bad_corrections(tmp_path, data_dir, line, match):
    with pytest.raises(ConfigError, match=match):
        read_problem(written(tmp_path, nothing, [line]))
