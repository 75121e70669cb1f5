"""Updating with the response to forces that nobody measured: messages, what is found, the report."""

import functools
import re
import warnings

import numpy as np
import pymc as pm
import pytest
import xarray as xr
from scipy import signal
from scipy.linalg import eigh

import pymc_features as pmf
from benchmarks import truth
from pymc_features import ModalDamping, SpringMassChain, cli
from pymc_features.ambient import subspace
from pymc_features.ambient.fit import fitted_spectra
from pymc_features.exceptions import AmbientWarning, ConfigError
from pymc_features.signals.spectra import averaged_spectra
from pymc_features.update import read_problem, run_update
from pymc_features.update.kinds.base import declare
from support.browser import check_page, needs_browser
from support.linear import as_linear
from support.refusals import refusals

STEP, N = 0.02, 20_000  # s, samples
MASS, DRAWN = 1e5, np.array([1.2e8, 1e8])  # kg, N/m
TRUE = {"k1": 0.8, "k2": 1.1, "zeta": 0.02, "wind": 1e6, "noise": 1e-6}
FREE = {"k1": (0.0, 0.3), "k2": (0.0, 0.3), "zeta": (-4.0, 0.5), "wind": (13.0, 2.0), "noise": (-13.0, 2.0)}
TEXT = """
[data]
files = "wind.csv"
excitation = "ambient"
units = "m/s^2"
sensors = ["first", "roof"]

[ambient]
force = "wind"
error = "noise"

[structure]
type = "SpringMassChain"
mass = 1e5
stiffness = { groups = [["k1", 1], ["k2", 1]], times = [1.2e8, 1e8] }
damping = { type = "ModalDamping", ratios = "zeta" }

[sampler]
draws = 400
cores = 1

[priors]
"""
LAPLACE = TEXT.replace("draws = 400", 'method = "laplace"\ndraws = 400')


def priors(**changed):
    """Lines of [priors]."""
    law = '{} = {{ distribution = "LogNormal", mu = {}, sigma = {} }}\n'
    return "".join(law.format(name, *values) for name, values in (FREE | changed).items())


def building(k1, k2, zeta):
    """The structure of the file."""
    return SpringMassChain([MASS, MASS], DRAWN * [k1, k2], ModalDamping(zeta))


@functools.cache
def shaken(seed, k1=TRUE["k1"], k2=TRUE["k2"]):
    """Accelerations (2, N) under white forces, with errors [m/s^2].

    From four times as many samples: forces that are straight between them are not white near their end.
    """
    rng, fine = np.random.default_rng(seed), STEP / 4
    forces = np.sqrt(0.5 * TRUE["wind"] / fine) * rng.standard_normal((2, 4 * N))
    chain, _ = as_linear(building(k1, k2, TRUE["zeta"]))
    values = pmf.simulate(chain, pmf.Loading(forces, fine, kind="force")).values
    values = signal.decimate(values, 4, ftype="fir")
    return values + np.sqrt(0.5 * TRUE["noise"] / STEP) * rng.standard_normal(values.shape)


def write(folder, values, text=None):
    """Channels and the configuration."""
    table = np.column_stack([STEP * np.arange(values.shape[1]), *values])
    np.savetxt(folder / "wind.csv", table, "%.8g", ",", header="time,first,roof", comments="")
    path = folder / "wind.toml"
    path.write_text(text or TEXT + priors())
    return path


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write(tmp_path_factory.mktemp("ambient"), shaken(1))


@pytest.fixture(scope="module")
def updated(path):
    out = path.with_name("output")
    said = cli.main(["update", str(path), "--out", str(out)])
    assert said == 0
    problem = read_problem(path)
    return problem, run_update(problem, out=out), out


@pytest.mark.slow
def test_the_structure_is_found(updated):
    """The 99.9 % intervals of all five parameters; one data set of 200 would miss one."""
    _, result, _ = updated
    posterior = result["AMBIENT/posterior"].to_dataset()
    for name, value in TRUE.items():
        low, high = posterior[name].quantile([0.0005, 0.9995])
        assert low < value < high, name
    assert 0.002 < posterior["k1"].std() < 0.02  # of a prior of 0.3


@pytest.mark.slow
def test_what_is_said_of_it(updated, capsys):
    problem, result, out = updated
    found = problem.verdict(result, "AMBIENT")
    assert found.explains
    said = r"The power of the channels is what the model expects in all \d+ parts of the bands"
    assert re.match(said, found.sentences[0])
    assert "all 2 identified modes" in found.sentences[1]
    frequencies = building(TRUE["k1"], TRUE["k2"], 0.02).modes().natural_frequencies
    rows = problem.modal.rows(result["AMBIENT/matched"])
    np.testing.assert_allclose([row.measured for row in rows], frequencies, rtol=0.01)
    assert [row.partner for row in rows] == [1, 2] and all(row.mac[1] > 0.99 for row in rows)
    page = (out / "report.html").read_text()
    for text in (
        *("2 channels of ambient vibration over 400 s", "Nobody measured the forces", "m²/s³"),
        *("proposed from the peaks of the spectra", "from the spectra in the bands"),
    ):
        assert text in page, text
    figures = {p.stem.removeprefix("AMBIENT_") for p in (out / "figures").iterdir()}
    assert figures >= {"spectra", "mac", "shapes"}


@needs_browser
def test_nothing_of_the_page_is_cut_off(updated, browser):
    check_page(browser, updated[2] / "report.html")


@pytest.mark.slow
def test_fitted_spectra_at_the_truth(path):
    """What Welch's method sees of 40 records, and the power of the record at hand, beside their expectation.

    Averages of 40 spectra, each over 40 parts of which half overlap, have scatter of 3 %.
    """
    problem = read_problem(path)
    truth = xr.Dataset({name: (("chain", "draw"), [[value]]) for name, value in TRUE.items()})
    given = problem.first.channels, problem.first.bands, declare(problem, "AMBIENT")
    fitted = fitted_spectra(*given, truth)
    total = 0.0
    for seed in range(100, 140):
        spectra = averaged_spectra(shaken(seed), STEP)
        total = total + spectra.matrices / 40
    seen = np.isin(spectra.frequencies, fitted["frequency"].values)
    values = np.linalg.eigvalsh(total[seen])[:, ::-1]
    off = np.log(fitted["response"].sel(quantile=0.5).values.T / values)
    assert np.abs(off.mean(axis=0)).max() < 0.02 and off.std(axis=0).max() < 0.08
    z = (fitted["ratio"] - 1.0) / fitted["sd"]
    assert np.abs(z).max() < 4.0 and 0.5 < z.std() < 1.5
    changed = fitted_spectra(*given, truth.assign(k1=1.05 * truth["k1"]))
    assert ((changed["ratio"] - 1.0) / changed["sd"]).max() > 6.0


@pytest.mark.slow
def test_a_model_that_cannot_have_the_frequencies(tmp_path):
    """Both springs by one factor: the ratio of the frequencies is wrong by 7 %."""
    text = (LAPLACE + priors()).replace('[["k1", 1], ["k2", 1]]', '[["k1", 2]]')
    text = "\n".join(line for line in text.splitlines() if not line.startswith("k2 ="))
    problem = read_problem(write(tmp_path, shaken(2), text))
    found = problem.verdict(run_update(problem, progressbar=False), "AMBIENT")
    assert not found.explains
    assert any("standard deviations from that of the model" in s for s in found.sentences)


@pytest.mark.slow
def test_a_peak_that_the_model_lacks(tmp_path):
    """A second structure beside a mode, within the band."""
    values = shaken(3) + [[0.3], [1.0]] * shaken(4, k1=0.9, k2=1.3)
    text = (LAPLACE + priors(zeta=(-4.0, 0.1))).replace(
        "[ambient]", "[ambient]\nbands = [[2.5, 4.4], [7.0, 9.0]]"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AmbientWarning)
        problem = read_problem(write(tmp_path, values, text))
    found = problem.verdict(run_update(problem, progressbar=False), "AMBIENT")
    assert not found.explains


def test_model_is_the_one_declared_by_hand(path):
    """The log-likelihood at the truth and beside it."""
    problem = read_problem(path)
    model = declare(problem, "AMBIENT")
    with pm.Model() as by_hand:
        free = {name: pm.LogNormal(name, *FREE[name]) for name in FREE}
        structure = building(free["k1"], free["k2"], free["zeta"])
        response = pmf.ambient.spectral_response(structure, free["wind"])
        given = {"bands": problem.first.bands, "dt": STEP, "observed": problem.first.channels.values}
        pmf.AmbientResponse("y", response, error=free["noise"], **given)
    found, expected = (m.compile_logp(mode="FAST_COMPILE") for m in (model, by_hand))
    for factor in (1.0, 1.02):
        point = {f"{name}_log__": np.log(factor * value) for name, value in TRUE.items()}
        assert found(point) == pytest.approx(expected(point), rel=1e-12)


def test_bands_of_the_file_or_of_the_spectra(path, tmp_path):
    """What is compared is part of what draws are kept by."""
    problem = read_problem(path)
    frequencies = building(TRUE["k1"], TRUE["k2"], 0.02).modes().natural_frequencies
    low, high = problem.first.bands.T
    assert ((low < frequencies) & (frequencies < high)).all() and problem.first.band == (low[0], high[1])
    text = path.read_text().replace("[ambient]", "[ambient]\nbands = [[2.6, 3.6]]")
    other = read_problem(write(tmp_path, shaken(1), text))
    assert other.first.bands.tolist() == [[2.6, 3.6]]
    assert other.settings()["bands_sha256"] != problem.settings()["bands_sha256"]
    assert other.settings()["channels_sha256"] == problem.settings()["channels_sha256"]


def test_one_channel_is_compared_by_frequencies(tmp_path):
    text = (TEXT + priors()).replace('["first", "roof"]', '["roof"]\ndofs = [1]')
    problem = read_problem(write(tmp_path, shaken(1), text))
    assert problem.modal.data.shapes is None and len(problem.modal.data) == 2


def test_processing(tmp_path):
    """Trimmed and decimated; decimation sets an end to the bands."""
    text = (
        TEXT + priors() + '[processing]\ndetrend = { kind = "linear" }\ntrim = [100.0, 300.0]\ndecimate = 2\n'
    )
    problem = read_problem(write(tmp_path, shaken(1), text))
    assert problem.first.channels.sizes == {"sensor": 2, "time": 5000 + 1}
    assert problem.first.step == pytest.approx(2 * STEP)
    too_high = text.replace("[ambient]", "[ambient]\nbands = [[2.6, 3.6], [9.5, 10.5]]")
    with pytest.raises(
        ConfigError, match=r"`ambient.bands` must end below 10 Hz after `processing.decimate`"
    ):
        read_problem(write(tmp_path, shaken(1), too_high))


@pytest.mark.slow
def test_check_says_the_bands_and_draws(path, capfd, drawn):
    assert cli.main(["check", str(path)]) == 0
    said = capfd.readouterr().err
    assert re.search(r"bands = \[\[\d\.\d+, \d\.\d+\], \[\d\.\d+, \d\.\d+\]\]  # Hz", said)
    assert ("subspace identification (pyOMA2) has" in said) == subspace.is_installed()
    assert "all 2 identified modes" in said and "nothing was found wrong" in said
    assert path.with_name("wind-check.png").stat().st_size > 10_000
    assert path.with_name("wind-check-modes.png").stat().st_size > 5_000


@pytest.mark.slow
def test_a_machine_is_told(tmp_path):
    """A sine of the roof between two modes, in a band of its own."""
    values = shaken(1).copy()
    values[1] += 0.05 * np.sin(2.0 * np.pi * 5.3 * STEP * np.arange(N))
    with pytest.warns(AmbientWarning) as caught:
        found = read_problem(write(tmp_path, values)).modal.data
    said = " ".join(str(warning.message) for warning in caught)
    assert "the channels move at 5.3 Hz as by a machine at constant speed" in said
    assert len(found) == 2
    assert (abs(found.frequencies - 5.3) > 1.0).all()


def test_more_modes_than_the_structure_has(tmp_path):
    values = shaken(1) + np.array([[1.0], [0.5]]) * np.sqrt(5.0) * shaken(5, k1=2.4, k2=3.4)
    with pytest.warns(AmbientWarning, match="modes in the bands, more than the structure: it cannot explain"):
        assert read_problem(write(tmp_path, values)).modal is None


@pytest.mark.slow
def test_a_known_motion_of_the_base(tmp_path):
    """What the base moves tells stiffness and damping, and is no residual; by transfer functions of modes."""
    n = N // 4
    motion = truth.motion(1.0 / STEP, (n - 1) * STEP, 4)
    mass, k = MASS * np.eye(2), DRAWN * [TRUE["k1"], TRUE["k2"]]
    stiffness = np.array([[k.sum(), -k[1]], [-k[1], k[1]]])
    squares, shapes = eigh(stiffness, mass)
    damping = mass @ shapes @ np.diag(2.0 * TRUE["zeta"] * np.sqrt(squares)) @ shapes.T @ mass
    frame = truth.Linear(mass, damping, stiffness, np.ones((2, 1)))
    moved = truth.response(frame, motion)["absolute_acceleration"]
    table = np.column_stack([STEP * np.arange(n), motion.values()[0], *(shaken(1)[:, :n] + moved)])
    head = "time,ground,first,roof"
    np.savetxt(tmp_path / "wind.csv", table, "%.8g", ",", header=head, comments="")
    known = {"sensors =": 'base = "ground"\nsensors =', "[ambient]": '[ambient]\nexcitation = "base"'}
    text = LAPLACE + priors()
    for old, new in known.items():
        text = text.replace(old, new)
    path = tmp_path / "wind.toml"
    path.write_text(text)
    result = run_update(read_problem(path), out=tmp_path / "known")
    posterior = result["AMBIENT/posterior"].to_dataset()
    for name in ("k1", "k2", "zeta"):
        z = (float(posterior[name].mean()) - TRUE[name]) / float(posterior[name].std())
        assert abs(z) < 4.0, name
    assert posterior["k1"].std() < 1e-3  # 4.3e-3 from the wind alone
    fitted = result["AMBIENT/spectra"].to_dataset()
    assert np.all(np.abs(fitted["ratio"] - 1.0) < 6.0 * fitted["sd"])
    assert fitted["residual"].std() < 0.5 * moved.std()
    problem = read_problem(path)
    assert problem.verdict(result, "AMBIENT").explains
    assert len(problem.modal.data) == 2


REFUSED = {  # what is said: what is changed, into what
    "`nothing` must be left out, it is no key": ("[ambient]", "[nothing]"),
    "`ambient` must be left out without `data.excitation": ('excitation = "ambient"', ""),
    '`data.excitation` must be "measured" or "ambient"': ('excitation = "ambient"', 'excitation = "wind"'),
    "`ambient.force` must be given: the name of a prior or a positive number": ('force = "wind"', ""),
    r"pairs .from, to. in Hz, got \[\[3.0, 2.0\]\]\.$": ("[ambient]", "[ambient]\nbands = [[3.0, 2.0]]"),
    '`ambient.bands` must be "auto" or a list of rising pairs': ("[ambient]", "[ambient]\nbands = []"),
    r"\[ambient.bands\]: `bands` must be ascending pairs": ("[ambient]", "[ambient]\nbands = [[2.0, 80.0]]"),
    "bands with 8 frequencies of the record": ("[ambient]", "[ambient]\nbands = [[3.0, 3.01]]"),
    "must list `bands` where `error` is a list": ('error = "noise"', 'error = ["noise", 1e-6]'),
    '`ambient.forces` must be "dofs" or "modes"': (
        "[ambient]",
        "[ambient]\nbands = [[2.6, 3.6]]\nforces = 3",
    ),
    "`ambient.error` must be positive, got -1": (
        'error = "noise"',
        'bands = [[2.6, 3.6], [5.0, 6.0]]\nerror = ["noise", -1.0]',
    ),
    "`data.base` must .* be left out without it, got 'first'": (
        '["first", "roof"]',
        '["roof"]\nbase = "first"',
    ),
    "`data.base` must name the sensor on the base": ("[ambient]", '[ambient]\nexcitation = "base"'),
    '`ambient.excitation` must be "unknown" or "base"': ("[ambient]", '[ambient]\nexcitation = "wind"'),
    "`likelihood` must be left out with": ("[sampler]", "[likelihood]\nsigma = 1.0\n[sampler]"),
    "`events` must be left out with": ("[sampler]", '[events]\nfolder = "."\n[sampler]'),
    "`processing.band_pass` must": ("[sampler]", "[processing]\nband_pass = { low = 1.0 }\n[sampler]"),
    "`processing.compare` must be": ("[sampler]", "[processing]\ncompare = [1.0, 9.0]\n[sampler]"),
    "`report.quantities` must be": ("[sampler]", '[report]\nquantities = ["base_shear"]\n[sampler]'),
    "`ambient.force` must be positive, got the prior `priors.wind` with the median -1": (
        'wind = { distribution = "LogNormal", mu = 13.0',
        'wind = { distribution = "Normal", mu = -1.0',
    ),
}


@refusals("change", REFUSED)
def test_bad_configurations(tmp_path, change, match):
    text = TEXT + priors()
    assert change[0] in text
    path = write(tmp_path, shaken(1)[:, :3000], text.replace(*change))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AmbientWarning)
        with pytest.raises(ConfigError, match=match):
            declare(read_problem(path), "AMBIENT")


def test_a_record_without_peaks(tmp_path):
    noise = np.random.default_rng(5).standard_normal((2, 4000))
    with pytest.raises(ConfigError, match=r"\[ambient.bands\]: .* spectra without a peak"):
        read_problem(write(tmp_path, noise))
