"""Updating from a configuration file: numbers of the report, continuation, structures and their files."""

import html as html_module
import inspect
import re
import shutil
import tomllib
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import scipy.linalg
import scipy.stats
import xarray as xr

from pymc_features import cli, datasets, simulate, structures, update
from pymc_features.exceptions import ConfigError, DatasetUnavailableError
from pymc_features.smc.workers import workers
from pymc_features.smc.workers.workers import Spread
from pymc_features.update import read_problem, run_update, sampling, write_example
from pymc_features.update.config import structures as structure_sections
from pymc_features.update.config.structures import StructureOf
from pymc_features.update.kinds.model import declare, thinned
from pymc_features.update.kinds.responses import measured_gain
from pymc_features.update.report import document
from support.update_files import SIGMA, replaced, variant


def test_every_structure_has_an_example_below():
    assert {*SECTIONS, "AffineStructure"} == set(structure_sections.STRUCTURES)


@pytest.mark.parametrize("cls", [*structures.STRUCTURES, *structures.DAMPINGS])
def test_structures_and_dampings_state_all_their_arguments(cls):
    assert set(cls.inputs) == set(inspect.signature(cls).parameters)


@pytest.fixture(scope="module")
def finished(example):
    """A run of the example, stopped before ABC and continued."""
    sample, out = sampling.sample, example.with_name("out")

    def stopped(problem, kind, *rest):
        if kind == "ABC":
            raise KeyboardInterrupt
        return sample(problem, kind, *rest)

    def only_abc(problem, kind, *rest):
        assert kind == "ABC", f"{kind} is sampled again"
        return sample(problem, kind, *rest)

    with pytest.MonkeyPatch.context() as patch:
        command = ["update", str(example), "--out", str(out), "--cores", "1"]
        patch.setattr(sampling, "sample", stopped)
        assert cli.main(command) == 130
        assert [path.name for path in (out / "parts").glob("*.nc")] == ["EXP.nc"]
        patch.setattr(sampling, "sample", only_abc)
        assert cli.main(command) == 0
    return out


@pytest.mark.slow
def test_an_executor_gives_the_same_draws(example, finished, tmp_path, capsys, monkeypatch):
    """A thread does what a worker does; what is no executor is refused before anything is sampled."""
    spread, elsewhere, out = [], Spread.elsewhere, tmp_path / "out"

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
    for name in ("HERE", "ELSEWHERE"):  # every population is worth a message
        monkeypatch.setattr(workers, name, 0.0)
    monkeypatch.setattr(Spread, "some_are_ready", lambda self, work: True)
    monkeypatch.setattr(Spread, "elsewhere", counted)
    with ThreadPoolExecutor(1) as pool:
        run_update(read_problem(example), out=out, cores=1, executor=pool, progressbar=False)
    assert sum(spread) > 1000
    for kind in ("EXP", "ABC"):
        paths = [folder / "parts" / f"{kind}.nc" for folder in (finished, out)]
        one, two = (xr.open_dataset(path, group="posterior", engine="h5netcdf").load() for path in paths)
        assert one.equals(two)


@pytest.mark.slow
def test_outputs(finished):
    names = {path.name for path in finished.iterdir()}
    written = {"figures", "parts", "report.html", "table.csv", "table.tex", "update.json", "update.nc"}
    assert names == written | {".update.lock"}
    figures = {path.stem for path in (finished / "figures").iterdir()}
    of_each = {"prior_posterior", "response", "response_zoom", "stages"}
    assert figures == {"record", "frequencies", *(f"{k}_{name}" for k in ("EXP", "ABC") for name in of_each)}


@pytest.mark.slow
def test_another_report_samples_nothing_and_makes_rows_once(example, finished, capsys, monkeypatch):
    """And the terminal says what the report says."""
    monkeypatch.setattr(sampling, "sample", None)
    text, table, calls = example.read_text(), (finished / "table.csv").read_text(), []

    def counted(name):
        function = getattr(document, name)

        def count(*arguments):
            calls.append(name)
            return function(*arguments)

        return count

    for name in ("rows_of_result", "findings_of"):
        monkeypatch.setattr(document, name, counted(name))
    try:
        example.write_text(replaced(text, [("Simulated, three storeys", "Another <title>, 1/2")]))
        assert cli.main(["update", str(example), "--out", str(finished)]) == 0
    finally:
        example.write_text(text)
    assert sorted(calls) == ["findings_of", "rows_of_result"]
    html = (finished / "report.html").read_text()
    assert "<h1>Another &lt;title&gt;, 1/2</h1>" in html
    assert (finished / "table.csv").read_text() == table
    told = capsys.readouterr().err
    said = [line.removeprefix("warning: ") for line in told.splitlines() if line.startswith("warning: EXP")]
    assert said
    assert all(sentence in html_module.unescape(html) for sentence in said)


def test_force_starts_anew(example, finished, tmp_path, capsys, monkeypatch):
    def stopped(*_, **__):
        raise KeyboardInterrupt

    folder = tmp_path / "copy"
    shutil.copytree(finished, folder)
    monkeypatch.setattr(sampling, "run_part", stopped)
    assert cli.main(["update", str(example), "--out", str(folder), "--force"]) == 130
    assert "deleted 2 finished parts" in capsys.readouterr().err
    assert not list((folder / "parts").iterdir())


def table_of(html, after):
    """Cells of the first table after a heading."""
    part = html[html.index(f"<h2>{after}</h2>") :]
    part = part[part.index("<table>") : part.index("</table>")]
    found = [re.findall(r"<t[dh][^>]*>(.*?)</t[dh]>", row) for row in part.split("<tr")[1:]]
    return found[0], found[1:]


def test_report_has_the_numbers_of_the_posterior(finished):
    html = (finished / "report.html").read_text()
    header, body = table_of(html, "Posterior")
    assert header[:8] == ["likelihood", "parameter", "unit", "5 %", "50 %", "95 %", "mean", "sd"]
    cells = {(row[0], row[1]): row[2:] for row in body}
    units = {"k1": "N/m", "k3": "N/m", "zeta": "-", "sigma": "m/s²", "f1": "Hz"}
    with xr.open_datatree(finished / "update.nc", engine="h5netcdf") as tree:
        for kind, name in (("EXP", "k1"), ("EXP", "zeta"), ("EXP", "sigma"), ("ABC", "k3"), ("EXP", "f1")):
            posterior = tree[f"{kind}/posterior"].to_dataset()
            if name == "f1":
                draws = tree[f"{kind}/modal"]["natural_frequency"].sel(mode=1).values
            else:
                draws = posterior[name].values
            unit, *numbers = cells[kind, name][:6]
            assert unit == units[name]
            expected = [*np.quantile(draws, [0.05, 0.5, 0.95]), draws.mean(), draws.std()]
            np.testing.assert_allclose([float(v) for v in numbers], expected, atol=0.05 * draws.std())
    assert ("ABC", "sigma") not in cells
    with xr.open_datatree(finished / "update.nc", engine="h5netcdf") as tree:
        told = tree["EXP/sample_stats"].attrs
        assert tree["EXP"].attrs["method"] == "sample"
        assert tree["EXP/modes"].sizes["mode"] == told["n_modes"]
    for sentence in (
        f"log evidence is {told['log_evidence']:.2f} with a standard error",
        f"draws are worth {told['ess']:.0f} independent ones",
        f"Pareto k of the weights is {told['pareto_k']:.2f}",
        f"It found {told['n_modes']} mode",
        "close to Laplace&#39;s approximation?",
    ):
        assert sentence in html, sentence
    assert "3 measured accelerations over 6 s, 5 uncertain parameters, under EXP, ABC" in html


def test_posterior_finds_the_structure_and_its_modes(example, finished):
    """The frequencies of a draw by dense algebra; true ones within the posterior."""
    problem = read_problem(example)
    with xr.open_datatree(finished / "update.nc", engine="h5netcdf") as tree:
        posterior, modal = tree["EXP/posterior"].to_dataset(), tree["EXP/modal"].to_dataset()
        draw = int(modal["draw"][3])
        k1, k2, k3 = (float(posterior[f"k{i}"].sel(chain=0, draw=draw)) for i in (1, 2, 3))
        stiffness = np.array([[k1 + k2, -k2, 0.0], [-k2, k2 + k3, -k3], [0.0, -k3, k3]])
        omega2 = scipy.linalg.eigvalsh(stiffness, np.diag([0.1601, 0.1601, 0.1421]))
        own = modal["natural_frequency"].sel(chain=0, draw=draw)
        np.testing.assert_allclose(own, np.sqrt(omega2) / (2.0 * np.pi), rtol=1e-10)
        low, high = modal["natural_frequency"].quantile([0.005, 0.995], dim=["chain", "draw"]).values
        true = tree["data"]["given_frequency"].values
        assert (low < true).all()
        assert (true < high).all()
        # Eq. (16), from the sampled posterior
        sigma = float(np.quantile(posterior["sigma"], 0.9))
        assert tree["ABC"].attrs["epsilon"] == pytest.approx(6.0 * sigma**2)
        # draws of ABC lie within it
        last = tree["ABC/posterior"].to_dataset().isel(chain=0, draw=-1)
        built = problem.structure(**{n: float(last[n]) for n in problem.structure.names})
        off = simulate(built, problem.measured.record).values - problem.measured.channels.values
        assert (off**2).mean(axis=1).sum() <= tree["ABC"].attrs["epsilon"]


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


def test_bands_hold_what_they_say(finished):
    with xr.open_datatree(finished / "update.nc", engine="h5netcdf") as tree:
        bands, y = tree["EXP/bands"].to_dataset(), tree["EXP/observed_data"]["y"]
        low, middle, high = bands["response"].values
        error = np.sqrt(((y.values - middle) ** 2).mean(axis=1) / (y.values**2).mean(axis=1))
        np.testing.assert_allclose(bands["normalised_error"], error)
        assert error.max() < 0.2
        below, _, above = bands["predictive"].values
        inside = (y.values >= below) & (y.values <= above)
        np.testing.assert_allclose(bands["coverage"], inside.mean(axis=1))
        assert inside.mean() > 0.8
        assert (above - below).mean() > (high - low).mean()
        assert "predictive" not in tree["ABC/bands"]
        drift = bands["inter_storey_drift_peak"]
        assert drift.attrs["units"] == "m"
        assert drift.sizes == {"quantile": 3, "inter_storey_drift_storey": 3}


def test_thinned_draws_are_spread_over_the_chain():
    posterior = xr.Dataset({"x": (("chain", "draw"), np.arange(20.0).reshape(2, 10))})
    assert thinned(posterior, 6)["x"].values.tolist() == [[0, 3, 6], [10, 13, 16]]


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
    monkeypatch.setattr(sampling, "by_sampler", lambda *_: few)
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


MATRICES = """
type = "AffineStructure"
mass = { file = "frame.npz", name = "M" }
stiffness = { file = "frame.npz", name = "K0" }
stiffness_terms = [{ file = "frame.npz", name = "K1" }, { file = "frame.npz", name = "K2" }]
theta = ["k1", { prior = "k2", times = 2.0 }]
damping = { type = "RayleighDamping", alpha = 0.1, beta = "zeta" }
"""


def test_matrices_come_from_files(example, tmp_path):
    lower, upper = np.diag([1.0, 0.0, 0.0]), np.array([[1.0, -1, 0], [-1, 1, 0], [0, 0, 0]])
    top = 600.0 * np.array([[0.0, 0, 0], [0, 1, -1], [0, -1, 1]])
    masses = np.diag([0.1601, 0.1601, 0.1421])
    np.savez(tmp_path / "frame.npz", M=masses, K0=top, K1=lower, K2=upper)
    text = example.read_text()
    section = text[text.index("[structure]") + len("[structure]") : text.index("[priors]")]
    k3 = next(line for line in text.splitlines() if line.startswith("k3 ="))
    drift = '"inter_storey_drift", '
    path = variant(example, tmp_path, (section, MATRICES), (k3, ""), (drift, ""))
    problem = read_problem(path)
    assert problem.structure.names == ["k1", "k2", "zeta"]
    assert [problem.unit(name) for name in ("k1", "k2", "zeta")] == ["-", "-", "s"]
    mass, damping, stiffness = problem.structure(k1=385.0, k2=210.0, zeta=1e-3).matrices()
    expected = top + 385.0 * lower + 420.0 * upper
    np.testing.assert_allclose(stiffness, expected)
    np.testing.assert_allclose(damping, 0.1 * masses + 1e-3 * expected)
    assert "frame.npz_sha256" in problem.settings()
    model = declare(problem, "ABC", 1.0)
    assert {rv.name for rv in model.free_RVs} == {"k1", "k2", "zeta"}
    wrong = variant(example, tmp_path, (section, MATRICES.replace('"K1"', '"K9"')), (k3, ""), (drift, ""))
    with pytest.raises(ConfigError, match=r"`structure.stiffness_terms\[0\].name` must be one of the"):
        read_problem(wrong)
    with pytest.raises(ConfigError, match="must not have inter_storey_drift for a structure without"):
        read_problem(variant(example, tmp_path, (section, MATRICES), (k3, "")))


CHAIN = """
type = "{}"
mass = 0.15
stiffness = ["k1", "k2", "k3"]
damping = {{ type = "ModalDamping", ratios = ["zeta", 0.02, 0.01] }}
"""
FRAME = """
type = "LinearStructure"
mass = [0.1, 0.1, 0.1]
stiffness = [[800.0, -400.0, 0.0], [-400.0, 800.0, -400.0], [0.0, -400.0, 400.0]]
damping = { type = "RayleighDamping", alpha = "zeta", beta = 1e-4 }
"""
SECTIONS = {
    "SpringMassChain": CHAIN,
    "HystereticChain": f"{CHAIN}yield_displacement = 0.01\npost_yield_ratio = 0.1\n",
    "DuffingChain": f'{CHAIN}cubic = {{{{ prior = "k1", times = 100.0 }}}}\n',
    "LinearStructure": FRAME.replace("{", "{{").replace("}", "}}"),
}


@pytest.mark.parametrize("name", SECTIONS)
def test_structures_by_name(name):
    raw = tomllib.loads(SECTIONS[name].format(name))
    built = StructureOf(structure_sections.STRUCTURES[name].model_validate(raw), ".")
    values = {
        n: v for n, v in {"k1": 385.0, "k2": 420.0, "k3": 600.0, "zeta": 0.3}.items() if n in built.names
    }
    structure = built(**values)
    assert type(structure) is getattr(structures, name)
    if name == "LinearStructure":
        mass, damping, stiffness = structure.matrices()
        np.testing.assert_allclose(damping, 0.3 * mass + 1e-4 * stiffness)
        return
    assert structure.mass.tolist() == 0.15
    assert structure.stiffness.tolist() == [385.0, 420.0, 600.0]
    assert structure.damping.ratios.tolist() == [0.3, 0.02, 0.01]
    if name == "DuffingChain":
        assert structure.cubic == 38500.0


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


@pytest.mark.slow
def test_laplace_and_a_sigma_for_each_sensor(example, tmp_path):
    path = variant(
        example,
        tmp_path,
        ('method = "auto"', 'method = "laplace"'),
        ('["EXP", "ABC"]', '["NORM"]'),
        (SIGMA, 'sigma = ["sigma", { prior = "sigma", times = 1.3 }, 0.3] '),
        (', "base_shear"', ""),
    )
    problem = read_problem(path)
    result = run_update(problem, progressbar=False)
    assert result["NORM"].attrs["method"] == "Laplace"
    low, high = np.quantile(result["NORM/posterior"]["k1"], [0.001, 0.999])
    assert low < 385.0 < high
    assert high - low < 20.0


CORRELATED = {  # names in the file to the lines that it needs, and the distribution of the observed variable
    "CN": "sigma = 0.15\ncorrelation_time = 0.02\n#",
    "CN-SIGMA": f"{SIGMA}\ncorrelation_time = [0.02, 0.02, 0.03]\n#",
    "CN-TAU": f'{SIGMA}\ncorrelation_time = {{ prior = "tau", times = 2.0 }}\n#',
}
TAU = 'tau = { distribution = "LogNormal", mu = -4.6, sigma = 0.5 }\n'


@pytest.mark.slow
@pytest.mark.parametrize("kind", CORRELATED)
def test_errors_correlated_in_time(example, tmp_path, kind):
    """What is inferred; of the last also a posterior where the truth is, the report, and a unit."""
    pairs = [('["EXP", "ABC"]', f'["{kind}"]'), (SIGMA, CORRELATED[kind]), (', "base_shear"', "")]
    sigma_line = next(line for line in example.read_text().splitlines() if line.startswith("sigma = {"))
    if kind == "CN":
        pairs.append((sigma_line, ""))
    if kind == "CN-TAU":
        pairs.append((sigma_line, f"{sigma_line}\n{TAU}"))
    path = variant(example, tmp_path, *pairs)
    inferred = {"CN": set(), "CN-SIGMA": {"sigma"}, "CN-TAU": {"sigma", "tau"}}[kind]
    problem = read_problem(path)
    model = declare(problem, kind)
    assert model["y"].owner.op.name == "CorrelatedNormal"
    assert {rv.name for rv in model.free_RVs} == {"k1", "k2", "k3", "zeta"} | inferred
    if kind != "CN-TAU":
        return
    assert cli.main(["update", str(path), "--cores", "1", "--out", str(tmp_path / "out")]) == 0
    with xr.open_datatree(tmp_path / "out" / "update.nc", engine="h5netcdf") as tree:
        posterior = tree[f"{kind}/posterior"].to_dataset().load()
    assert inferred <= set(posterior.data_vars)
    low, high = np.quantile(posterior["k1"], [0.005, 0.995])
    assert low < 385.0 < high
    html = (tmp_path / "out" / "report.html").read_text()
    assert "errors correlated in time; tau" in html
    assert problem.unit("tau") == "-"  # of a prior that is multiplied
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
    assert problem.dofs == [0, 1, 2]
