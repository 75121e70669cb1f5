"""Several events in one configuration: order, continuation, alarms, and what is refused."""

import shutil

import numpy as np
import pytest
import xarray as xr

from pymc_features import cli, structures
from pymc_features.events import sequence as sequence_run
from pymc_features.exceptions import ChannelWarning, ConfigError, StudyMismatchError
from pymc_features.ground_motion import synthetic_earthquake
from pymc_features.simulators import simulate
from pymc_features.update import read_problem, run_update
from pymc_features.update.kinds import events
from pymc_features.update.kinds.base import declare
from pymc_features.update.kinds.events import by_numbers, event_rows
from pymc_features.update.sampling import seed_of

pytestmark = pytest.mark.slow

SOUND, DAMAGED = (400.0, 400.0, 400.0), (400.0, 300.0, 400.0)
NOISE, DAMPING = 0.5, structures.ModalDamping(0.02)  # m/s^2
ASKED = []  # models and settings of the last sequence, and its last state
TOML = """
[events]
folder = "events"
change = 0.01

[data]
base = "base"
sensors = ["floor1", "floor2", "floor3"]

[structure]
type = "SpringMassChain"
mass = 0.15
stiffness = ["k1", "k2", 400.0]
damping = { type = "ModalDamping", ratios = 0.02 }

[priors]
k1 = { distribution = "LogNormal", mu = 6.0, sigma = 0.2 }
k2 = { distribution = "LogNormal", mu = 6.0, sigma = 0.2 }
sigma = { distribution = "HalfNormal", sigma = 0.5 }

[likelihood]
kinds = ["NORM"]
sigma = "sigma"

[sampler]
draws = 100
chains = 2
random_seed = 3
"""


def write_event(path, stiffness, seed, dt=0.02):
    """A file with four channels: a chain under an earthquake of its own, and white noise."""
    base = synthetic_earthquake(12.0, dt, random_seed=seed, pga=2.0)
    floors = simulate(structures.SpringMassChain([0.15] * 3, stiffness, DAMPING), base).values
    noise = np.random.default_rng(seed).standard_normal(floors.shape)
    columns = np.vstack([base.time, base.acceleration, floors + NOISE * noise])
    header = "time [s],base [m/s^2],floor1 [m/s^2],floor2 [m/s^2],floor3 [m/s^2]"
    np.savetxt(path, columns.T, "%.6f", ",", header=header, comments="")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A configuration, and three events of which the last is of a damaged structure.

    The run is killed in the second event, and continued.
    """
    folder = tmp_path_factory.mktemp("events")
    (folder / "events").mkdir()
    for number, stiffness in ((8, SOUND), (9, SOUND), (10, DAMAGED)):
        write_event(
            folder / "events" / f"event-{number}.csv", stiffness, number, dt=0.02 if number < 10 else 0.01
        )
    (folder / "bridge.toml").write_text(TOML)
    calls, one_event, in_sequence = [], sequence_run.one_event, events.states_in_sequence

    def stopped(before, model, i, *rest):
        calls.append(i)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return one_event(before, model, i, *rest)

    def noted(models, **settings):
        for state in in_sequence(models, **settings):
            ASKED[:] = [models, settings, state]
            yield state

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sequence_run, "one_event", stopped)
        patch.setattr(events, "states_in_sequence", noted)
        assert cli.main(["update", str(folder / "bridge.toml"), "--cores", "1"]) == 130
        assert cli.main(["update", str(folder / "bridge.toml"), "--cores", "1"]) == 0
    assert calls == [0, 1, 1, 2]
    return folder


def copied(made, tmp_path, *changes, text=TOML):
    """Configuration and events in another folder, without results."""
    shutil.copytree(made / "events", tmp_path / "events")
    for old, new in changes:
        assert text.count(old) == 1
        text = text.replace(old, new)
    path = tmp_path / "bridge.toml"
    path.write_text(text)
    return path


def results(folder):
    with xr.open_datatree(folder / "bridge-output" / "update.nc", engine="h5netcdf") as tree:
        return tree["NORM"].load()


def test_a_change_is_reported(made):
    part = results(made)
    record = part["sequence"].to_dataset()
    assert record["name"].values.tolist() == ["event-8.csv", "event-9.csv", "event-10.csv"]
    assert record["alarm"].values.tolist() == [0, 0, 1]
    k2 = record["mean"].sel(parameter="k2").values
    assert abs(k2[1] - SOUND[1]) < 20.0 and abs(k2[2] - DAMAGED[1]) < 20.0
    page = (made / "bridge-output" / "report.html").read_text()
    assert "Alarm: under NORM the structure has changed before event-10.csv (probability" in page
    assert "probability of a change</th>" in page and "events of 12, 12, 12 s" in page
    assert (made / "bridge-output" / "figures" / "NORM_events.png").stat().st_size > 10_000


def test_the_posterior_is_that_of_the_sequence(made):
    """Of one model for each event, with the settings of the file: its last state is what is saved."""
    problem, (models, settings, state) = read_problem(made / "bridge.toml"), ASKED
    assert [event.step for event in problem.first.events.values()] == [0.02, 0.02, 0.01]
    for model, event in zip(models, problem.first.events.values(), strict=True):
        data = model.rvs_to_values[model["y"]].data
        np.testing.assert_array_equal(data, event.channels.values)
    expected = {"draws": 100, "chains": 2, "random_seed": seed_of(problem, "NORM"), "change": 0.01}
    assert expected.items() <= settings.items()
    found = results(made)
    for name in ("k1", "k2", "sigma"):
        np.testing.assert_array_equal(found["posterior"][name], state["posterior"][name])
    # what is drawn is the response to the last event
    assert found["observed_data"]["y"].sizes["time"] == problem.first.channels.sizes["time"]


def test_one_event_more_samples_one_event(made, tmp_path, monkeypatch, capsys):
    path, calls = copied(made, tmp_path), []
    shutil.copytree(made / "bridge-output", tmp_path / "bridge-output")
    write_event(tmp_path / "events" / "event-11.csv", DAMAGED, 11)
    one_event = sequence_run.one_event

    def counted(before, model, i, *rest):
        calls.append(i)
        return one_event(before, model, i, *rest)

    monkeypatch.setattr(sequence_run, "one_event", counted)
    assert cli.main(["update", str(path), "--cores", "1"]) == 0
    assert calls == [3]
    assert results(tmp_path)["sequence"]["alarm"].values.tolist() == [0, 0, 1, 0]
    assert "Alarm: under NORM" in capsys.readouterr().err
    # an event that was there is no other one now
    write_event(tmp_path / "events" / "event-9.csv", SOUND, 99)
    with pytest.raises(StudyMismatchError, match="must hold the same events, .* another one at place 1"):
        run_update(read_problem(path), out=tmp_path / "bridge-output", cores=1, progressbar=False)
    # after another walk of the parameters all are sampled again, and what was there is moved aside
    path.write_text(TOML.replace("change = 0.01", "change = 0.01\ndrift = { k1 = 5.0 }"))
    monkeypatch.setattr(sequence_run, "one_event", None)
    with pytest.raises(TypeError, match="not callable"):
        run_update(read_problem(path), out=tmp_path / "bridge-output", cores=1, progressbar=False)
    assert (tmp_path / "bridge-output-1" / "sequence").is_dir()


def test_check_draws_each_event(made, tmp_path, capsys):
    path = copied(made, tmp_path)
    assert cli.main(["check", str(path)]) == 0
    for k in (1, 2, 3):
        assert (tmp_path / f"bridge-check-{k}.png").exists()
    said = capsys.readouterr().err
    assert said.index("event-9.csv: data:") < said.index("event-10.csv: data:")


def test_a_folder_for_each_event(made, tmp_path):
    path = copied(made, tmp_path, ("[data]", '[data]\nfiles = "motion.csv"'))
    for file in list((tmp_path / "events").iterdir()):
        (tmp_path / "events" / file.stem).mkdir()
        file.rename(tmp_path / "events" / file.stem / "motion.csv")
    problem = read_problem(path)
    assert list(problem.first.events) == ["event-8", "event-9", "event-10"]
    of_files = read_problem(made / "bridge.toml")
    for one, other in zip(problem.first.events.values(), of_files.first.events.values(), strict=True):
        np.testing.assert_array_equal(one.channels, other.channels)
    # a motion of the base beside them, of its own in each folder
    text = path.read_text().replace('base = "base"\n', "")
    path.write_text(text + '\n[record]\npath = "motion.csv"\ncolumn = "base"\n')
    np.testing.assert_array_equal(
        read_problem(path).first.record.acceleration,
        of_files.first.record.acceleration,
    )


def test_warnings_and_errors_name_the_event(made, tmp_path):
    path = copied(made, tmp_path)
    file = tmp_path / "events" / "event-9.csv"
    numbers = np.loadtxt(file, delimiter=",", skiprows=1)
    numbers[:, 3] *= -1.0
    header = file.read_text().splitlines()[0]
    np.savetxt(file, numbers, "%.6f", ",", header=header, comments="")
    with pytest.warns(ChannelWarning, match="event-9.csv: Channel 'floor2' is inverted against 'base'"):
        read_problem(path)
    file.write_text(file.read_text().replace("floor3", "roof"))
    with pytest.raises(ConfigError, match="event event-9.csv: `data.sensors` must be among .* got 'floor3'"):
        read_problem(path)
    file.write_text("nothing here")
    with pytest.raises(ConfigError, match=r"event event-9.csv: \[data\]: event-9.csv"):
        read_problem(path)


def test_observations_of_all_events_count(made, tmp_path):
    path = copied(made, tmp_path, ('["NORM"]', '["EXP"]'))
    problem = read_problem(path)
    assert problem.first.foretold(problem) == []  # 3 events of 3 sensors, two for each: 18 for 2 parameters
    path.write_text(path.read_text().replace('"EXP"', '"TN"').replace("change = 0.01", 'pattern = "*-8.csv"'))
    problem = read_problem(path)
    [sentence] = problem.first.foretold(problem)
    assert sentence.startswith("TN counts 3 observations for 2 unknown") and "CAL" not in sentence


def test_numbers_in_names_are_ordered():
    names = ["b-2", "a-10", "a-9", "a", "10", "9", "a-9-x", "1" * 5000]
    expected = ["9", "10", "1" * 5000, "a", "a-9", "a-9-x", "a-10", "b-2"]
    assert sorted(names, key=by_numbers) == expected


DATASET = 'dataset = "mini_shake_table"'
FOLDER = 'folder = "events"'
LAW = '[likelihood]\nkinds = ["NORM"]\nsigma = "sigma"\n'
MODES = '\n[modal]\nfile = "modes.csv"\nsigma_f = 0.01\nshapes = false\n'
REFUSED = {  # what is said: what is changed, into what
    r"`likelihood` must be given with \[events\]: a table": (LAW, ""),
    "`events` must have one of the keys `folder` and `files`, got both or neither": (FOLDER, ""),
    "`events` must have `pattern` only with `folder`": (
        FOLDER,
        'files = ["events/event-8.csv"]\npattern = "*"',
    ),
    r"`events` must name each event once, got \['a', 'a'\]": (FOLDER, 'files = ["a", "a"]'),
    "`events.folder` must be an existing folder, got 'nowhere'": (FOLDER, 'folder = "nowhere"'),
    r"`events.folder` must hold an event or more, got none with a name like '\*.mat'": (
        "change = 0.01",
        'pattern = "*.mat"',
    ),
    "event missing.csv: .*missing.csv": (FOLDER, 'files = ["missing.csv"]'),
    "`events.change` must be a probability between 0 and 1, got 1.5": ("change = 0.01", "change = 1.5"),
    "`events.forgetting` must be a number above 0 and at most 1, got": ("change = 0.01", "forgetting = 0.0"),
    "`events.drift` must name priors of the file, got 'k9'": ("change = 0.01", "drift = { k9 = 5.0 }"),
    "`events.drift` must be a table of priors to deviations": ("change = 0.01", "drift = { k1 = -5.0 }"),
    "`likelihood.kinds` must not have CAL with .events.*Take NORM, TN, EXP,": ('["NORM"]', '["NORM", "CAL"]'),
    "`likelihood.kinds` must not have ABC with .events.": ('["NORM"]', '["EXP", "ABC"]'),
    "`sampler.method` must be \"auto\" with .events., got 'nuts'": ("draws = 100", 'method = "nuts"'),
    "`sampler.draws` must be at least 100 with .events., got 50": ("draws = 100", "draws = 50"),
    "`data.files` must be left out where events are files": ("[data]", '[data]\nfiles = "motion.csv"'),
    "`record` must be left out where events are files": ('base = "base"', "[record]\npath = 'a.csv'\n[data]"),
    "`data.files` must be given where events are folders": (FOLDER, 'files = ["events"]'),
    "`data.dataset` must be left out with .events., got it. Name": ("[data]", f"[data]\n{DATASET}"),
    r"`events` must be left out without \[data\], got it. .* rows of one table.": (
        '[data]\nbase = "base"\nsensors = ["floor1", "floor2", "floor3"]\n',
        MODES,
    ),
    "`data` must have one of the keys `files` and `dataset`, got neither. Or give .events.": (
        '[events]\nfolder = "events"\nchange = 0.01',
        "",
    ),
}


def test_identified_modes_count_once(made, tmp_path):
    """With the first event, of several or alone; the posterior has what they say."""
    path = copied(made, tmp_path, ("change = 0.01", 'pattern = "event-[89].csv"'))
    exact = structures.SpringMassChain([0.15] * 3, SOUND, DAMPING).modes()
    f = exact.natural_frequencies[:2, None] * [0.99999, 1.00001]
    rows = "\n".join(f"{a:.6f},{b:.6f}" for a, b in f.T)
    (path.parent / "modes.csv").write_text(f"f1 [Hz],f2 [Hz]\n{rows}\n")
    text = path.read_text() + MODES.replace("0.01", "1e-4")
    path.write_text(text)
    problem = read_problem(path)
    models = [declare(problem.first.at(problem, one), "NORM") for one in problem.first.events.values()]
    assert [[v.name for v in model.observed_RVs] for model in models] == [["y", "modal"], ["y"]]
    path.write_text(text.replace("[89]", "8"))
    assert cli.main(["update", str(path), "--cores", "1"]) == 0
    page = (tmp_path / "bridge-output" / "report.html").read_text()
    assert "One event, event-8.csv: there is nothing yet to compare it with." in page
    tree = results(tmp_path)
    assert tree["matched"].sizes["identified"] == 4
    springs = np.column_stack([tree["posterior"][k].values.ravel() for k in ("k1", "k2")])
    chains = [structures.SpringMassChain([0.15] * 3, [*k, 400.0], DAMPING) for k in springs]
    found = np.array([chain.modes().natural_frequencies[:2] for chain in chains])
    assert (found.std(axis=0) < 2e-4 * f.mean(axis=1)).all()


@pytest.mark.parametrize("match", REFUSED)
def test_what_is_refused(made, tmp_path, match):
    path = copied(made, tmp_path)
    old, new = REFUSED[match]
    text = path.read_text()
    if "[record]" in new:
        text = text.replace("[data]\n", "", 1)
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))
    with pytest.raises(ConfigError, match=match):
        read_problem(path)


def test_a_score_of_which_no_draw_tells_is_not_told():
    """The error of e^19 that a single draw leaves is no error."""
    values = {
        "name": ["first", "second", "third"],
        "log_score": [-1.5, -400.0, np.nan],
        "log_score_se": [0.04, 229205921.53, np.nan],
        "log_score_fresh": [-1.5, -2.0, -3.0],
        "probability_changed": [0.0, 1.0, 0.0],
        "alarm": [0, 1, 0],
    }
    record = xr.Dataset({name: ("event", value) for name, value in values.items()})
    rows = event_rows(record)
    assert rows[0] == ("first", "-1.50", "0.04", "-1.50", "0.000", "")
    assert rows[1] == ("second", "cannot be told", "cannot be told", "-2.00", "1.000", "alarm")
    assert rows[2][1:3] == ("nan", "nan")
