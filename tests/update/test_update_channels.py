"""Channels with gaps and with faults: what is left out, refused, proposed and reported."""

import json
import re
import warnings

import numpy as np
import pytest

from pymc_features import cli, datasets, signals
from pymc_features.exceptions import ChannelWarning, ConfigError
from pymc_features.signals.channels import earlier
from pymc_features.update import read_problem, run_update, sampling, write_example, write_outputs
from pymc_features.update.kinds.base import declare
from pymc_features.update.report.document import document_of, summary
from pymc_features.update.sampling import Running
from support.report_pages import words
from support.update_files import replaced

KINDS = 'kinds = ["CAL", "NORM", "TN", "EXP", "ABC"]'
QUICK = [
    (KINDS, 'kinds = ["CAL", "NORM", "EXP"]'),
    ('method = "auto"', 'method = "laplace"'),
    ("draws = 1000", "draws = 400"),
    ("chains = 2", "chains = 1"),
    ('["inter_storey_drift", "base_shear"]', "[]"),
]
LEAVE_OUT = 'gaps = "leave_out"'


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    """The example with simulated data, its lines of numbers, and the header above."""
    path = tmp_path_factory.mktemp("gaps") / "frame.toml"
    write_example(path, synthetic=True)
    header, *rows = path.with_name("frame-measured.csv").read_text().splitlines()
    return path.read_text(), header, rows


def problem_file(folder, example, rows, lines=(), changes=QUICK, data="frame-measured.csv"):
    """The example with other rows and further lines of [data]."""
    text, header, _ = example
    (folder / data).write_text("\n".join([header, *rows]) + "\n")
    path = folder / "frame.toml"
    path.write_text(replaced(text, [*changes, ("\nbase = ", "\n" + "\n".join([*lines, "base = "]))]))
    return path


def without(rows, column, span):
    """Rows with empty cells."""
    result = list(rows)
    for k in span:
        cells = result[k].split(",")
        cells[column] = ""
        result[k] = ",".join(cells)
    return result


def test_the_default_refuses_and_proposes(example, tmp_path):
    rows = without(example[2], 2, range(300, 340))
    with pytest.raises(ConfigError, match=r'\[data\]: frame-measured.csv, line .* by gaps = "leave_out"'):
        read_problem(problem_file(tmp_path, example, rows))
    problem = read_problem(problem_file(tmp_path, example, rows, [LEAVE_OUT]))
    assert problem.measured.left_out.endswith("% of floor1")
    assert problem.settings()["data.gaps"] == "leave_out"
    # where leaving out is of no use nothing is proposed
    rows[400] = "what,is,this,line,for"
    with pytest.raises(ConfigError) as error:
        read_problem(problem_file(tmp_path, example, rows))
    assert "leave_out" not in str(error.value)


def test_the_base_must_be_whole(example, tmp_path):
    rows = [row for k, row in enumerate(example[2]) if not 300 <= k < 310]
    with pytest.raises(ConfigError, match="no samples may be missing, 10 are.* leave out what is missing"):
        read_problem(problem_file(tmp_path, example, rows))
    match = "`data.base` must have no gaps, .* got 10 samples missing in base, the first at 3 s. Cut"
    with pytest.raises(ConfigError, match=match):
        read_problem(problem_file(tmp_path, example, rows, [LEAVE_OUT]))
    path = problem_file(tmp_path, example, rows, [LEAVE_OUT, "rows = [310, 1000]"])
    assert read_problem(path).measured.left_out == ""


def test_errors_correlated_in_time_take_no_gaps(example, tmp_path):
    rows = without(example[2], 2, range(300, 340))
    changes = [
        (KINDS, 'kinds = ["NORM", "CN-TAU"]'),
        ('sigma = "sigma" ', 'correlation_time = "sigma"\nsigma = "sigma" '),
    ]
    match = "`likelihood.kinds` must not have CN-TAU where samples are missing, got gaps of .*% of floor1: it"
    with pytest.raises(ConfigError, match=match):
        read_problem(problem_file(tmp_path, example, rows, [LEAVE_OUT], changes))
    changes.append(("# trim = [0.0, 10.0]", "compare = [4.0, 9.0]  #"))
    assert read_problem(problem_file(tmp_path, example, rows, [LEAVE_OUT], changes)).measured.left_out == ""


def test_a_sensor_without_samples_in_the_window(example, tmp_path):
    rows = without(example[2], 2, range(300, 700))
    changes = [*QUICK, ("# trim = [0.0, 10.0]", "compare = [4.0, 6.0]  #")]
    with pytest.raises(ConfigError, match="got a gap from end to end of floor1 .* Leave it out"):
        read_problem(problem_file(tmp_path, example, rows, [LEAVE_OUT], changes))


def test_files_of_their_own(example, tmp_path):
    """Rows missing in the file of one sensor are gaps of that sensor alone."""
    text, header, rows = example
    names = [name.split(" [")[0].strip() for name in header.split(",")]
    for j, name in enumerate(names[1:], start=1):
        kept = [row for k, row in enumerate(rows) if name != "floor2" or not 300 <= k < 340]
        lines = [",".join([header.split(",")[0], header.split(",")[j]])]
        lines += [",".join([row.split(",")[0], row.split(",")[j]]) for row in kept]
        (tmp_path / f"{name}.csv").write_text("\n".join(lines) + "\n")
    files = ", ".join(f'{name} = "{name}.csv"' for name in names[1:])
    path = tmp_path / "frame.toml"
    lines = f"files = {{ {files} }}\n{LEAVE_OUT}"
    path.write_text(re.sub('files = "frame-measured.csv".*', lines, replaced(text, QUICK)))
    missing = np.isnan(read_problem(path).measured.channels.values)
    assert missing[1, 296:344].all() and missing.sum() == 48  # wider by a period of the filter, 4 samples


@pytest.fixture(scope="module")
def updated(example, tmp_path_factory, blank_module):
    """Problem, result and outputs of data with a gap."""
    folder = tmp_path_factory.mktemp("updated")
    rows = without(example[2], 3, range(300, 500))
    problem = read_problem(problem_file(folder, example, rows, [LEAVE_OUT]))
    result = run_update(problem, progressbar=False)
    paths = write_outputs(problem, result, folder / "out")
    return problem, result, paths


@pytest.mark.slow
def test_numbers_of_the_report_are_those_of_what_was_measured(updated):
    problem, result, _ = updated
    data = problem.measured.channels.values
    kept = ~np.isnan(data)
    assert 0 < (~kept[1]).sum() < kept.shape[1] and kept[[0, 2]].all()
    for kind in ("NORM", "EXP"):
        bands = result[kind]["bands"].to_dataset()
        median = bands["response"].sel(quantile=0.5).values
        low, high = bands["predictive"].isel(quantile=[0, -1]).values
        for j, k in enumerate(kept):
            error = np.sqrt(np.mean((data[j, k] - median[j, k]) ** 2) / np.mean(data[j, k] ** 2))
            assert float(bands["normalised_error"][j]) == pytest.approx(error, rel=1e-9)
            inside = np.mean((data[j, k] >= low[j, k]) & (data[j, k] <= high[j, k]))
            assert float(bands["coverage"][j]) == pytest.approx(inside, rel=1e-9)
    assert float(result["NORM"]["bands"]["coverage"][1]) > 0.8
    np.testing.assert_array_equal(np.isnan(result["EXP"]["observed_data"]["y"].values), ~kept)


@pytest.mark.slow
def test_the_report_says_what_was_left_out(updated):
    problem, result, paths = updated
    share = 100.0 * np.isnan(problem.measured.channels.values[1]).mean()
    sentence = f"Left out as gaps: {share:.2g} % of floor2."
    found = document_of(problem, result)
    assert sentence in [part for part, _ in summary(found) if isinstance(part, str)]
    html = words(paths[-1].read_text())
    assert sentence in html
    assert "nan" not in html.lower().replace("resonan", "")
    assert found["verdict"]["explains"]


@pytest.mark.slow
def test_the_truth_is_found(updated):
    """k = 385, 420, 600 N/m within four standard deviations: EXP's are wide, NORM's and CAL's are not.

    Below its filter's corner the noise is white: the residuals support about half as many observations as
    NORM claims, all samples that were measured, for the corner is at half of the frequencies, and fewer
    where frequency bands disagree by chance.
    """
    problem, result, _ = updated
    n = problem.measured.samples.sum()
    assert 0.2 * n < result["CAL"]["calibration"].attrs["n_eff"] < 0.8 * n
    for kind in ("CAL", "NORM", "EXP"):
        posterior = result[kind]["posterior"]
        for name, truth in (("k1", 385.0), ("k2", 420.0), ("k3", 600.0)):
            assert abs(float(posterior[name].mean()) - truth) < 4.0 * float(posterior[name].std())


def test_check_says_and_draws(example, tmp_path, capsys):
    path = problem_file(tmp_path, example, without(example[2], 2, range(300, 340)), [LEAVE_OUT])
    assert cli.main(["check", str(path)]) == 0
    assert "left out as gaps" in capsys.readouterr().err
    assert (tmp_path / "frame-check.png").exists()


# --------------------------------------------------------------------------- the shaking table

SENSORS = ("base", "floor1", "floor2", "floor3")
LATE = 0.0125  # s, one and a half samples


def written(folder, planted, data=(), processing=(), changes=()):
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
    pairs = [
        ('dataset = "mini_shake_table"', "#"),
        ('event = "northridge"', "\n".join(['files = "table.csv"', *data]) + "\n#"),
        ("check_band = [0.5, 1.8]", "\n".join(processing) + "\n#"),
    ]
    if any(line.startswith("sensors") for line in data):
        pairs.append(('\nsensors = ["floor1", "floor2", "floor3"]\n', "\n"))
    path.write_text(replaced(path.read_text(), [*pairs, *changes]))
    return path


PLANTED = {  # the lines that correct what is planted into the channels, of a step
    'sensors = ["floor3", "floor2", "floor1"]': lambda v, _: {"floor1": v["floor3"], "floor3": v["floor1"]},
    "scale = { floor2 = -1.0 }": lambda v, _: {"floor2": -v["floor2"]},
    "scale = { base = -1.0 }": lambda v, _: {"base": -v["base"]},
    "delay = { floor1 = 0.01": lambda v, step: {"floor1": earlier(v["floor1"], -LATE / step)},
}
INVERTED = PLANTED["scale = { floor2 = -1.0 }"]


def nothing(values, step):
    return {}


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
@pytest.mark.parametrize("line", PLANTED)
def test_lines_that_are_proposed_correct_the_fault(clean, tmp_path, line):
    planted = PLANTED[line]
    messages, lines, _ = told_by(written(tmp_path, planted))
    assert len(messages) > 1
    assert any(proposed.startswith(line) for proposed in lines)
    messages, more, measured = told_by(written(tmp_path, planted, lines))
    assert not messages
    assert not more
    size = np.abs(clean.channels.values).max()
    off = 2e-4 if "delay" in line else 1e-6  # a lag of 12.5 ms is found to 3 us, 0.0003 samples
    np.testing.assert_allclose(measured.record.acceleration, clean.record.acceleration, atol=off * size)
    np.testing.assert_allclose(measured.channels.values, clean.channels.values, atol=off * size)


def test_an_offset_that_nothing_takes_off_is_said(tmp_path, data_dir):
    def raised(values, step):
        return {"floor2": values["floor2"] + 0.2}

    path = written(tmp_path, raised)
    messages, _, _ = told_by(path)  # the example takes it off
    assert not [m for m in messages if "offset" in m]
    path.write_text(replaced(path.read_text(), [("\ndetrend =", "\n# detrend =")]))
    messages, _, _ = told_by(path)
    [said] = [m for m in messages if "is an offset of the sensor" in m]
    assert re.search(r"floor2 \(0\.[12]\d* m/s\^2\)", said)


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
    path = written(tmp_path, INVERTED, ["rows = [1000, 1400]"], ["check_band = false"])
    pairs = ("trim = [9.0, 24.0]", ""), ("window = [0.5, 9.5]", "kind = 'constant'")
    path.write_text(text := replaced(path.read_text(), pairs))
    messages, _, measured = told_by(path)
    assert measured.checked == "not checked against each other, as the file says"
    path.write_text(text.replace("check_band = false", ""))
    messages, lines, measured = told_by(path)
    assert messages[0].startswith("floor2 may be inverted: the modes that the priors expect explain")
    assert lines == ["scale = { floor2 = -1.0 }"]
    assert "not checked against each other: `channels` must last at least" in measured.checked
    assert measured.channels.sizes["time"] == 400


def test_command_looks_at_the_data_and_samples_nothing(tmp_path, data_dir, capsys, monkeypatch):
    path = written(tmp_path, INVERTED)
    monkeypatch.setattr("pymc_features.update.sampling.run_part", None)
    assert cli.main(["check", str(path), "--json"]) == 0
    printed, said = capsys.readouterr()
    assert "put into [data]: scale = { floor2 = -1.0 }; delay = { floor1 = 0.0005" in said
    found = json.loads(printed)
    assert found["checked"] and any("put into [data]: scale" in text for text in found["warnings"])
    assert "lag [ms]" in said
    assert "nothing was found wrong" not in said
    assert (tmp_path / "table-check.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pymc_features.exceptions.ChannelWarning")
@pytest.mark.filterwarnings("ignore::pymc_features.exceptions.LaplaceWarning")
def test_a_gap_in_the_shaking_table(data_dir, tmp_path):
    """The second with a third of the energy of a sensor: medians within a fifth of EXP's standard deviation.

    Not so if a logger writes zeros there, and they are taken for measurements.
    """
    found = {}
    for name, value in (("clean", None), ("gap", np.nan), ("zeros", 0.0)):

        def planted(values, step, value=value):
            first, last = round(21.0 / step), round(22.0 / step)
            with_gap = np.array(values["floor2"])
            with_gap[first:last] = with_gap[first:last] if value is None else value
            return {"floor2": with_gap}

        path = written(tmp_path, planted, [LEAVE_OUT], ["check_band = [0.5, 1.8]"], QUICK)
        problem = read_problem(path)
        assert bool(problem.measured.left_out) == (name == "gap")
        model = declare(problem, "EXP")
        found[name] = sampling.sample(problem, "EXP", model, Running(cores=1))["posterior"].to_dataset()
    scale = found["clean"].std()
    off = {name: abs(found[name].median() - found["clean"].median()) / scale for name in ("gap", "zeros")}
    names = ["k1", "k2", "k3", "zeta", "sigma"]
    assert all(float(off["gap"][name]) < 0.2 for name in names)
    assert max(float(off["zeros"][name]) for name in names) > 0.4, off["zeros"]
