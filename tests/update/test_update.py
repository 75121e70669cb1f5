"""Updating from a configuration file: numbers of the report, continuation, structures and their files."""

import html as html_module
import json
import re
import shutil
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import scipy.linalg
import scipy.stats
import xarray as xr

from pymc_features import cli, datasets, simulate, update
from pymc_features.calibration.sandwich import sentence as of_growth
from pymc_features.exceptions import CalibrationWarning, ConfigError, DatasetUnavailableError
from pymc_features.smc import workers
from pymc_features.smc.workers import Run
from pymc_features.update import read_problem, run_update, sampling, write_example
from pymc_features.update.kinds.base import declare
from pymc_features.update.kinds.responses import measured_gain
from pymc_features.update.report.document import rows_of_result
from pymc_features.update.sampling import Running
from support.update_files import SIGMA, SMALL, replaced, variant

RUN = [
    ('kinds = ["CAL", "NORM", "TN", "EXP", "ABC"]', 'kinds = ["EXP", "ABC", "CAL"]'),
    ("draws = 1000", "draws = 200"),
    *SMALL[2:],
]
ALL = '["EXP", "ABC", "CAL"]'
DOUBT = "the errors of y persist for 3 s of a record of 6 s"


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    """The example with simulated data, few draws of CAL, EXP and ABC."""
    path = tmp_path_factory.mktemp("update") / "frame.toml"
    paths, sentence = write_example(path, synthetic=True)
    assert paths == [path, path.with_name("frame-measured.csv"), path.with_name("frame.schema.json")]
    assert sentence == "data: simulated, in frame-measured.csv, as asked"
    path.write_text(replaced(path.read_text(), RUN))
    return path


@pytest.fixture(scope="module")
def finished(example):
    """A run of the example, stopped before ABC and CAL, and continued; its errors are said to persist."""
    sample, calibrate, out = sampling.sample, sampling.calibrate, example.with_name("out")

    def stopped(problem=None, kind="CAL", *rest, **settings):
        if kind in ("ABC", "CAL"):
            raise KeyboardInterrupt
        return sample(problem, kind, *rest)

    def only_abc(problem, kind, *rest):
        assert kind == "ABC", f"{kind} is sampled again"
        return sample(problem, kind, *rest)

    def doubtful(*arguments, **settings):
        warnings.warn(DOUBT, CalibrationWarning, stacklevel=2)
        return calibrate(*arguments, **settings)

    def kept():
        return {path.stem for path in (out / "parts").glob("*.nc")}

    with pytest.MonkeyPatch.context() as patch:
        command = ["update", str(example), "--out", str(out), "--cores", "1"]
        patch.setattr(sampling, "sample", stopped)
        assert cli.main(command) == 130 and kept() == {"EXP", "NORM"}
        patch.setattr(sampling, "sample", only_abc)
        patch.setattr(sampling, "calibrate", lambda *_, **__: stopped())
        assert cli.main(command) == 130 and kept() == {"EXP", "NORM", "ABC"}
        patch.setattr(sampling, "sample", None)
        patch.setattr(sampling, "calibrate", doubtful)
        assert cli.main(command) == 0
    return out


@pytest.fixture(scope="module")
def result(finished):
    with xr.open_datatree(finished / "update.nc", engine="h5netcdf") as tree:
        return tree.load()


@pytest.mark.slow
def test_an_executor_gives_the_same_draws(example, finished, tmp_path, capsys, monkeypatch):
    """A thread does what a worker does; what is no executor is refused before anything is sampled."""
    spread, elsewhere, out = [], Run.elsewhere, tmp_path / "out"

    def counted(self, logp, which, particles):
        spread.append(len(particles))
        return elsewhere(self, logp, which, particles)

    def stopped(*_, executor, **__):
        spread.append(executor)
        raise KeyboardInterrupt

    command = ["update", str(example), "--out", str(out), "--executor"]
    assert cli.main([*command, "0"]) == 2
    assert "`executor` must be something that runs simulations, got 0" in capsys.readouterr().err
    with monkeypatch.context() as patch:
        patch.setattr(update, "run_update", stopped)
        assert cli.main([*command, "2"]) == 130 and spread == [2]
    path = variant(example, tmp_path, (ALL, '["EXP"]'))
    for name in ("HERE", "ELSEWHERE"):  # every population is worth a message
        monkeypatch.setattr(workers, name, 0.0)
    monkeypatch.setattr(Run, "some_are_ready", lambda self, work: True)
    monkeypatch.setattr(Run, "elsewhere", counted)
    with ThreadPoolExecutor(1) as pool:
        parts, _ = sampling.run_parts(read_problem(path), Running(cores=1, executor=pool))
    assert sum(spread) > 300
    with xr.open_dataset(finished / "parts" / "EXP.nc", group="posterior", engine="h5netcdf") as expected:
        assert expected.load().equals(parts["EXP"]["posterior"].to_dataset())


@pytest.mark.slow
def test_outputs(finished, result):
    names = {path.name for path in finished.iterdir()}
    written = {"figures", "parts", "report.html", "table.csv", "table.tex", "update.json", "update.nc"}
    assert names == written | {".update.lock"}
    figures = {path.stem for path in (finished / "figures").iterdir()}
    of_each = {"prior_posterior", "response", "response_zoom"}
    found = {f"{kind}_{name}" for kind in ("CAL", "EXP", "ABC") for name in of_each}
    assert figures == {"record", "frequencies", "EXP_stages", "ABC_stages", *found}
    assert set(result.children) == {"CAL", "EXP", "ABC", "data", "geometry"}
    assert result["CAL"].attrs["method"] == "calibrate"
    assert result["CAL/calibration"]["sensor"].values.tolist() == ["floor1", "floor2", "floor3"]


@pytest.mark.slow
def test_another_report_samples_nothing(example, finished, capsys, monkeypatch):
    """And the terminal says what the report says."""
    monkeypatch.setattr(sampling, "sample", None)
    text, table = example.read_text(), (finished / "table.csv").read_text()
    try:
        example.write_text(replaced(text, [("Simulated, three storeys", "Another <title>, 1/2")]))
        assert cli.main(["update", str(example), "--out", str(finished)]) == 0
    finally:
        example.write_text(text)
    html = (finished / "report.html").read_text()
    assert "<h1>Another &lt;title&gt;, 1/2</h1>" in html
    assert (finished / "table.csv").read_text() == table
    told = capsys.readouterr().err
    said = [line.removeprefix("warning: ") for line in told.splitlines() if line.startswith("warning: CAL")]
    assert said
    assert all(sentence in html_module.unescape(html) for sentence in said)


def test_force_starts_anew(example, finished, tmp_path, capsys, monkeypatch):
    def stopped(*_, **__):
        raise KeyboardInterrupt

    folder = tmp_path / "copy"
    shutil.copytree(finished, folder)
    monkeypatch.setattr(sampling, "run_part", stopped)
    assert cli.main(["update", str(example), "--out", str(folder), "--force"]) == 130
    assert "deleted 4 finished parts" in capsys.readouterr().err
    assert not list((folder / "parts").iterdir())


def table_of(html, after):
    """Cells of the first table after a heading."""
    part = html[html.index(f"<h2>{after}</h2>") :]
    part = part[part.index("<table>") : part.index("</table>")]
    found = [re.findall(r"<t[dh][^>]*>(.*?)</t[dh]>", row) for row in part.split("<tr")[1:]]
    return found[0], found[1:]


def test_report_has_the_numbers_of_the_posterior(finished, result):
    html = (finished / "report.html").read_text()
    header, body = table_of(html, "Posterior")
    assert header[:8] == ["likelihood", "parameter", "unit", "5 %", "50 %", "95 %", "mean", "sd"]
    cells = {(row[0], row[1]): row[2:] for row in body}
    units = {"k1": "N/m", "k3": "N/m", "zeta": "-", "sigma": "m/s²", "f1": "Hz"}
    for kind, name in (("EXP", "k1"), ("EXP", "zeta"), ("EXP", "sigma"), ("ABC", "k3"), ("EXP", "f1")):
        columns = result[f"{kind}/posterior"].to_dataset()
        columns["f1"] = result[f"{kind}/modal"]["natural_frequency"].sel(mode=1)
        unit, *numbers = cells[kind, name][:6]
        assert unit == units[name]
        draws = columns[name].values[np.isfinite(columns[name].values)]
        expected = [*np.quantile(draws, [0.05, 0.5, 0.95]), draws.mean(), draws.std()]
        np.testing.assert_allclose([float(v) for v in numbers], expected, atol=0.05 * draws.std())
    assert ("ABC", "sigma") not in cells
    told = result["EXP/sample_stats"].attrs
    assert result["EXP"].attrs["method"] == "sample"
    assert result["EXP/modes"].sizes["mode"] == told["n_modes"]
    for sentence in (
        f"log evidence is {told['log_evidence']:.2f} with a standard error",
        f"draws are worth {told['ess']:.0f} independent ones",
        f"Pareto k of the weights is {told['pareto_k']:.2f}",
        f"It found {told['n_modes']} mode",
        "close to Laplace&#39;s approximation?",
    ):
        assert sentence in html, sentence
    assert "3 measured accelerations over 6 s, 5 uncertain parameters, under CAL, EXP, ABC" in html


def test_posterior_finds_the_structure_and_its_modes(example, result):
    """The frequencies of a draw by dense algebra; true ones within the posterior."""
    problem = read_problem(example)
    posterior, modal = result["EXP/posterior"].to_dataset(), result["EXP/modal"].to_dataset()
    draw = int(modal["draw"][3])
    k1, k2, k3 = (float(posterior[f"k{i}"].sel(chain=0, draw=draw)) for i in (1, 2, 3))
    stiffness = np.array([[k1 + k2, -k2, 0.0], [-k2, k2 + k3, -k3], [0.0, -k3, k3]])
    omega2 = scipy.linalg.eigvalsh(stiffness, np.diag([0.1601, 0.1601, 0.1421]))
    own = modal["natural_frequency"].sel(chain=0, draw=draw)
    np.testing.assert_allclose(own, np.sqrt(omega2) / (2.0 * np.pi), rtol=1e-10)
    low, high = modal["natural_frequency"].quantile([0.005, 0.995], dim=["chain", "draw"]).values
    true = result["data"]["given_frequency"].values
    assert (low < true).all() and (true < high).all()
    # Eq. (16), from the sampled posterior
    sigma = float(np.quantile(posterior["sigma"], 0.9))
    assert result["ABC"].attrs["epsilon"] == pytest.approx(6.0 * sigma**2)
    # draws of ABC lie within it
    last = result["ABC/posterior"].to_dataset().isel(chain=0, draw=-1)
    built = problem.structure(**{n: float(last[n]) for n in problem.structure.names})
    off = simulate(built, problem.measured.record).values - problem.measured.channels.values
    assert (off**2).mean(axis=1).sum() <= result["ABC"].attrs["epsilon"]


def test_gain_peaks_at_the_natural_frequencies(example, tmp_path):
    problem = read_problem(variant(example, tmp_path, ("trim = [0.0, 6.0]", "")))
    gain, peaks = measured_gain(problem.measured)
    true = np.array(problem.config.report.natural_frequencies)
    resolution = 1.0 / 4.0  # Hz, of windows of a third of 12 s
    assert np.abs(peaks[:, None] - true).min(axis=0).max() < resolution
    slow = gain.sel(frequency=slice(0.5, 2.5))
    mass, damping, stiffness = problem.structure(k1=385.0, k2=420.0, k3=600.0, zeta=0.01).matrices()
    exact = []
    for omega in 2.0 * np.pi * slow["frequency"].values:
        dynamic = stiffness - omega**2 * mass + 1j * omega * damping
        exact.append(np.abs(1.0 + omega**2 * np.linalg.solve(dynamic, mass.sum(axis=1))))
    np.testing.assert_allclose(slow, np.transpose(exact), rtol=0.1)


def test_bands_hold_what_they_say(result):
    bands, y = result["EXP/bands"].to_dataset(), result["EXP/observed_data"]["y"]
    low, middle, high = bands["response"].values
    error = np.sqrt(((y.values - middle) ** 2).mean(axis=1) / (y.values**2).mean(axis=1))
    np.testing.assert_allclose(bands["normalised_error"], error)
    assert error.max() < 0.2
    below, _, above = bands["predictive"].values
    inside = (y.values >= below) & (y.values <= above)
    np.testing.assert_allclose(bands["coverage"], inside.mean(axis=1))
    assert inside.mean() > 0.8
    assert (above - below).mean() > (high - low).mean()
    assert "predictive" not in result["ABC/bands"]
    drift = bands["inter_storey_drift_peak"]
    assert drift.attrs["units"] == "m"
    assert drift.sizes == {"quantile": 3, "inter_storey_drift_storey": 3}


# --------------------------------------------------------------------------- CAL and GAMMA


def test_report_leads_with_it_and_says_why(finished, result):
    html = (finished / "report.html").read_text()
    n_eff = result["CAL/calibration"].attrs["n_eff"]
    assert 100 < n_eff < 1803
    sentence = (
        f"The residuals support {n_eff:,.0f} independent observations; NORM claims 1,803, EXP 6. CAL comes"
    )
    assert html.count(sentence) == 1
    assert html.index(sentence) < html.index("<h2>Warnings</h2>")
    assert "under CAL, EXP, ABC. Accelerations" in html
    _, body = table_of(html, "Posterior")
    assert list(dict.fromkeys(row[0] for row in body)) == ["CAL", "EXP", "ABC"]
    assert "NORM was sampled" not in html
    assert "Its likelihood is that of NORM to the power " in html
    told = html[html.index("CAL was sampled") : html.index("EXP was sampled")]
    assert "log evidence" not in told  # that of a stretched likelihood must not be compared
    assert f"<li>CAL: {DOUBT[:1].upper()}{DOUBT[1:]}</li>" in html


def test_draws_are_as_wide_as_the_residuals_support(finished, result):
    """On the scale of the logarithms, which is sampled; NORM claims less, EXP knows of six observations.

    200 draws: the standard error of a standard deviation is 5 %.
    """
    found = result["CAL/calibration"].to_dataset()
    with xr.open_datatree(finished / "parts" / "NORM.nc", engine="h5netcdf") as norm:
        claimed = np.log(norm["posterior"]["k1"].values).std()
    calibrated, wide = (np.log(result[f"{kind}/posterior"]["k1"].values).std() for kind in ("CAL", "EXP"))
    assert (found["time_constant"] < 0.2).all()  # s, of noise that is white before it is filtered
    expected = found["standard_deviation"].sel(parameter="k1")
    assert calibrated == pytest.approx(float(expected), rel=0.2)
    assert claimed < calibrated < 0.2 * wide


def told(problem, result, explains=True):
    """What is said of the width."""
    return " ".join(text for text, _ in problem.first.sentences(problem, result, explains))


def test_it_needs_a_scale(example, tmp_path):
    path = variant(example, tmp_path, (ALL, '["CAL"]'), ('sigma = "sigma" ', "#"))
    with pytest.raises(ConfigError, match="`likelihood` must have the key `sigma` for CAL, got none."):
        read_problem(path)


def test_data_that_tell_no_width_are_refused_by_the_key(example, monkeypatch):
    def refused(*_, **__):
        raise ValueError("the residuals of y must not vanish, got none at sensor 1.")

    monkeypatch.setattr(sampling, "calibrate", refused)
    wanted = "`likelihood.kinds` must have CAL only where residuals can tell a width: the residuals of y must"
    with pytest.raises(ConfigError, match=wanted):
        sampling.calibrated(read_problem(example), "CAL", None, None, Running(cores=1))


def test_gamma_takes_its_observations_as_they_are_given(example, tmp_path):
    for given in ([2.0, 3.0, 4.5], 7.5):
        pairs = (ALL, '["GAMMA"]'), ("# m = 10.0 ", f"m = {given} #")
        model = declare(problem := read_problem(variant(example, tmp_path, *pairs)), "GAMMA")
        *_, m = model["y"].owner.inputs
        assert model["y"].owner.op.name == "GammaFeature" and problem.kinds == ["GAMMA"]
        assert m.eval().tolist() == given
        assert {rv.name for rv in model.free_RVs} == {"k1", "k2", "k3", "zeta", "sigma"}


def test_order_of_sampling_and_of_the_report(example, tmp_path):
    assert read_problem(example).kinds == ["EXP", "NORM", "ABC", "CAL"]
    problem = read_problem(variant(example, tmp_path, (ALL, '["TN", "ABC", "CAL", "EXP", "NORM"]')))
    assert problem.kinds == ["TN", "EXP", "NORM", "ABC", "CAL"]
    assert problem.reported == ["CAL", "TN", "ABC", "EXP", "NORM"]


def test_what_is_finished_is_reported_where_it_cannot_be_had(example, finished, tmp_path, monkeypatch):
    """The others are shown with the reason; if it was the only one asked for, what it is made from."""

    def refused(*_, **__):
        raise np.linalg.LinAlgError("Eigenvalues did not converge")

    monkeypatch.setattr(sampling, "calibrate", refused)
    monkeypatch.setattr(sampling, "sample", None)  # what is finished is not sampled again
    for changes, shown in (([], ["EXP", "ABC"]), ([(ALL, '["CAL"]')], ["NORM"])):
        path = example.with_name("changed.toml")
        path.write_text(replaced(example.read_text(), changes))
        out = tmp_path / f"out-{shown[0]}"
        shutil.copytree(finished, out)
        (out / "parts" / "CAL.nc").unlink()
        assert cli.main(["update", str(path), "--out", str(out), "--cores", "1"]) == 0
        html = (out / "report.html").read_text()
        assert "CAL only where residuals can tell a width: Eigenvalues did not converge" in html
        assert list(dict.fromkeys(row[0] for row in table_of(html, "Posterior")[1])) == shown


def test_no_interval_comes_first_of_a_model_that_does_not_explain(example, result):
    problem = read_problem(example)
    assert told(problem, result.drop_nodes("CAL")) == ""
    assert "CAL comes first, for its intervals" in told(problem, result)
    said = told(problem, result, explains=False)
    assert "comes first" not in said
    assert "No interval can be relied on where the model does not explain the measurements." in said


def test_intervals_at_a_bound_are_the_shortest_and_said_to_be(example, result):
    """k1 of a run, as if its prior ended at its median; its growth, as if bands disagreed."""
    changed, k1 = result.copy(), result["CAL/posterior"]["k1"]
    bound = float(k1.quantile(0.999))
    known = json.loads(result["CAL"].attrs["calibration"])
    assert set(known["parameters"]) == {"k1", "k2", "k3", "zeta", "sigma"}
    known["parameters"]["k1"] |= {"near_bound": True, "bound": bound, "room": 0.5}
    known["sentence"] = of_growth(2.4)
    changed["CAL"].attrs["calibration"] = json.dumps(known)
    problem = read_problem(example)
    said = told(problem, changed)
    assert f"Next to a bound of its prior the 90 % interval is the shortest one: k1 ({bound:.4g})." in said
    assert "disagree about the parameters by a factor of 2.4" in said
    [row] = [r for r in rows_of_result(problem, changed) if (r.kind, r.name) == ("CAL", "k1")]
    [before] = [r for r in rows_of_result(problem, result) if (r.kind, r.name) == ("CAL", "k1")]
    assert row.q95 - row.q05 <= before.q95 - before.q05
    assert row.q50 == before.q50


# --------------------------------------------------------------------------- other settings


@pytest.mark.slow
def test_another_tolerance_samples_abc_alone(finished, example, tmp_path, capsys, monkeypatch):
    """One that is out of reach is refused, and the rest stays."""
    path, out = example.with_name("tolerance.toml"), tmp_path / "out"
    path.write_text(replaced(example.read_text(), [("# epsilon = 5.0 ", "epsilon = 1e-9 ")]))
    shutil.copytree(finished, out)
    asked, sample = [], sampling.sample

    def counted(problem, kind, *rest):
        asked.append(kind)
        return sample(problem, kind, *rest)

    monkeypatch.setattr(sampling, "sample", counted)
    assert cli.main(["update", str(path), "--cores", "1", "--out", str(out)]) == 2
    assert "`likelihood.epsilon` must be within reach of the model" in capsys.readouterr().err
    assert asked == ["ABC"]
    assert (out / "parts" / "EXP.nc").exists()


@pytest.mark.slow
def test_what_a_stopped_sampler_returns_is_not_kept(finished, example, tmp_path, monkeypatch):
    with xr.open_datatree(finished / "parts" / "EXP.nc", engine="h5netcdf") as tree:
        few = tree.load().isel(draw=slice(60), missing_dims="ignore")
    monkeypatch.setattr(sampling.inference, "sample", lambda **_: few)
    with pytest.raises(KeyboardInterrupt):
        run_update(read_problem(example), out=tmp_path, cores=1, progressbar=False)
    assert not list((tmp_path / "parts").iterdir())


def test_motion_from_a_file_of_its_own(example, tmp_path):
    channels = np.loadtxt(example.with_name("frame-measured.csv"), delimiter=",", skiprows=1)
    lines = "\n".join(f"{v / 9.81:.8f}" for v in channels[:, 1])
    (tmp_path / "motion.csv").write_text(f"acceleration\n{lines}\n")
    record = '[record]\npath = "motion.csv"\nunits = "g"\ndt = 0.01\n\n[processing] '
    changes = ('base = "base" ', "#"), ("[processing] ", record)
    alone = read_problem(variant(example, tmp_path, *changes)).measured
    together = read_problem(example).measured
    np.testing.assert_allclose(alone.record.acceleration, together.record.acceleration, atol=1e-6)
    np.testing.assert_allclose(alone.channels, together.channels, rtol=1e-12)
    both = variant(example, tmp_path, ("[processing] ", record))
    with pytest.raises(ConfigError, match=r"`record` must be left out with `data.base`"):
        read_problem(both)


def test_decimated_sensors_keep_the_motion(example, tmp_path):
    problem = read_problem(variant(example, tmp_path, ("# decimate = 2", "decimate = 2")))
    assert problem.measured.step == pytest.approx(0.02)
    assert problem.measured.record.dt == pytest.approx(0.01)
    assert problem.measured.channels.shape == (3, 301)
    assert declare(problem, "EXP")["y"].shape.eval().tolist() == [3, 301]


def test_files_of_sensors_and_a_floor_without_one(tmp_path, data_dir):
    """Raw exports by their names give what the data set gives; the first floor is left out."""
    path = tmp_path / "table.toml"
    write_example(path)
    folder = data_dir / "mini_shake_table"
    names = {"base": "base", "low": "floor1", "top": "floor3"}
    files = ", ".join(f'{k} = "{folder}/flexible_northridge_{v}.csv"' for k, v in names.items())
    own = f'files = {{ {files} }}\ncolumns = "Acc_X"\nunits = "m/s^2"\nskip = 1\n#'
    pairs = [
        ('dataset = "mini_shake_table" ', own),
        ('event = "northridge"', ""),
        ('["floor1", "floor2", "floor3"]', '["top"]'),
        ("# dofs = [0, 1, 2]", "dofs = [2]"),
        ("check_band", "# check_band"),
    ]
    measured = read_problem(path_of(tmp_path, replaced(path.read_text(), pairs))).measured
    with pytest.warns(UserWarning, match="Channel 'floor3' comes"):
        expected = read_problem(path).measured
    np.testing.assert_allclose(measured.record.acceleration, expected.record.acceleration, atol=1e-12)
    np.testing.assert_allclose(measured.channels[0], expected.channels[2], atol=1e-12)


def path_of(folder, text):
    """Text as a configuration in a folder."""
    path = folder / "changed.toml"
    path.write_text(text)
    return path


CORRELATED = {  # names in the file to the lines that it needs, and what is inferred
    "CN": ("sigma = 0.15\ncorrelation_time = 0.02\n#", set()),
    "CN-SIGMA": (f"{SIGMA}\ncorrelation_time = [0.02, 0.02, 0.03]\n#", {"sigma"}),
    "CN-TAU": (
        'sigma = ["sigma", { prior = "sigma", times = 1.3 }, 0.3]\n'
        'correlation_time = { prior = "tau", times = 2.0 }\n#',
        {"sigma", "tau"},
    ),
}
TAU = 'tau = { distribution = "LogNormal", mu = -4.6, sigma = 0.5 }\n'


@pytest.mark.slow
@pytest.mark.parametrize("kind", CORRELATED)
def test_errors_correlated_in_time(example, tmp_path, kind):
    """What is inferred; of the last also Laplace's posterior where the truth is, the report, and a unit."""
    lines, inferred = CORRELATED[kind]
    pairs = [
        (ALL, f'["{kind}"]'),
        (SIGMA, lines),
        (', "base_shear"', ""),
        ('"auto"', '"laplace"'),
    ]
    sigma_line = next(line for line in example.read_text().splitlines() if line.startswith("sigma = {"))
    pairs.append((sigma_line, {"CN": "", "CN-TAU": f"{sigma_line}\n{TAU}"}.get(kind, sigma_line)))
    path = variant(example, tmp_path, *pairs)
    problem = read_problem(path)
    model = declare(problem, kind)
    assert model["y"].owner.op.name == "CorrelatedNormal"
    assert {rv.name for rv in model.free_RVs} == {"k1", "k2", "k3", "zeta"} | inferred
    if kind != "CN-TAU":
        return
    assert cli.main(["update", str(path), "--cores", "1", "--out", str(tmp_path / "out")]) == 0
    with xr.open_datatree(tmp_path / "out" / "update.nc", engine="h5netcdf") as tree:
        assert tree[kind].attrs["method"] == "Laplace"
        posterior = tree[f"{kind}/posterior"].to_dataset().load()
    assert inferred <= set(posterior.data_vars)
    low, high = np.quantile(posterior["k1"], [0.001, 0.999])
    assert low < 385.0 < high < low + 40.0
    html = (tmp_path / "out" / "report.html").read_text()
    assert "errors correlated in time; tau" in html
    assert problem.units["tau"] == "-"  # of a prior that is multiplied
    assert "likelihood.correlation_time" in html


def test_init_says_which_data(tmp_path, monkeypatch, capsys):
    def unavailable(event):
        raise DatasetUnavailableError("no network")

    monkeypatch.setattr(datasets, "mini_shake_table", unavailable)
    path = tmp_path / "mine.toml"
    assert cli.main(["init", str(path)]) == 0
    told = capsys.readouterr().err
    assert "data: simulated, in mine-measured.csv, since the shaking table's could not be had here" in told
    assert f"run: pymc-features update {path}" in told
    assert cli.main(["init", str(path)]) == 2
    assert f"`CONFIG` must be a new file, got {path}" in capsys.readouterr().err
    assert read_problem(path).config.likelihood.kinds == ["CAL", "NORM", "TN", "EXP", "ABC"]


def test_init_takes_the_shaking_table(tmp_path, data_dir):
    path = tmp_path / "table.toml"
    written, sentence = write_example(path)
    assert written == [path, path.with_name("table.schema.json")]
    assert "measured, a three-storey model on a shaking table" in sentence
    with pytest.warns(UserWarning, match="Channel 'floor3' comes 2.43 ms"):
        problem = read_problem(path)
    assert problem.measured.record.duration == pytest.approx(14.99, abs=0.01)
    assert problem.first.dofs == [0, 1, 2]
