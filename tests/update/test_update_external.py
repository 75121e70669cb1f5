"""`[external]`: a program in place of a structure, against the posterior on a grid."""

import shutil

import numpy as np
import pytest
import xarray as xr
from scipy import stats

from pymc_features import cli
from pymc_features.exceptions import ConfigError
from pymc_features.update import read_problem

pytestmark = pytest.mark.skipif(shutil.which("awk") is None, reason="the program is one of awk")
TRUTH = {"k": 4000.0, "c": 12.0}
MASS, STEP, SIZE, NOISE = 10.0, 0.02, 120, 0.2
PROGRAM = """BEGIN {
    k = {{k}}; c = {{c}}
    w = sqrt(k / 10); z = c / (2 * sqrt(10 * k))
    if (k > 9000) exit 3
    for (i = 0; i < 120; i++) {
        t = 0.02 * i; y = exp(-z * w * t) * cos(w * sqrt(1 - z * z) * t)
        printf "%.15g,%.15g,%.15g\\n", t, y, 0.5 * y > "out.csv"
    }
}
"""
CONFIG = """
[data]
files = "measured.csv"
sensors = ["a1", "a2"]

[external]
program = "awk -f ring.awk"
template = { "ring.awk" = "ring.awk.template" }
output = "out.csv"
columns = [1, 2]
units = { k = "N/m", c = "N s/m" }

[priors]
k = { distribution = "LogNormal", mu = 8.3, sigma = 0.2 }
c = { distribution = "Uniform", lower = 2.0, upper = 40.0 }
s = { distribution = "HalfNormal", sigma = 0.3 }

[likelihood]
kinds = ["NORM"]
sigma = "s"

[sampler]
draws = 200
cores = 2
"""
MODEL = CONFIG[CONFIG.index("[external]") : CONFIG.index("[priors]")]


def rings(k, c):
    """Decay of a mass that is let go (..., time), at stiffness k and damping c."""
    k, c = np.expand_dims(k, -1), np.expand_dims(c, -1)
    w, z = np.sqrt(k / MASS), c / (2.0 * np.sqrt(k * MASS))
    time = STEP * np.arange(SIZE)
    return np.exp(-z * w * time) * np.cos(w * np.sqrt(1.0 - z**2) * time)


def measured() -> np.ndarray:
    y = rings(**TRUTH)
    return np.array([y, 0.5 * y]) + NOISE * np.random.default_rng(1).standard_normal((2, SIZE))


@pytest.fixture
def folder(tmp_path):
    columns = np.column_stack([STEP * np.arange(SIZE), *measured()])
    header = "time [s],a1 [m/s^2],a2 [m/s^2]"
    np.savetxt(tmp_path / "measured.csv", columns, delimiter=",", header=header, comments="")
    (tmp_path / "ring.awk.template").write_text(PROGRAM)
    (tmp_path / "update.toml").write_text(CONFIG)
    return tmp_path


def moments_on_a_grid():
    """Means and standard deviations of k and c under NORM, sigma summed out."""
    k, c, s = np.linspace(3700.0, 4300.0, 81), np.linspace(2.0, 30.0, 81), np.linspace(0.14, 0.28, 41)
    y = rings(*np.meshgrid(k, c, indexing="ij"))
    squares = sum(
        ((row - factor * y) ** 2).sum(-1) for row, factor in zip(measured(), (1.0, 0.5), strict=True)
    )
    log_p = -squares[..., None] / (2.0 * s**2) - 2 * SIZE * np.log(s)
    log_p = log_p + stats.lognorm(0.2, scale=np.exp(8.3)).logpdf(k)[:, None, None]
    log_p = log_p + stats.halfnorm(scale=0.3).logpdf(s)
    p = np.exp(log_p - log_p.max())
    p /= p.sum()
    of_k, of_c = p.sum(axis=(1, 2)), p.sum(axis=(0, 2))
    found = [(x @ w, np.sqrt(x**2 @ w - (x @ w) ** 2)) for x, w in ((k, of_k), (c, of_c))]
    return dict(zip(("k", "c"), found, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("runs", [None, 40])
def test_the_posterior_is_that_of_a_grid(folder, capsys, runs):
    """Means and standard deviations within 4.5 standard errors, one false alarm in 30,000 tests."""
    text = CONFIG.replace("draws = 200", "draws = 150\nchains = 1")
    if runs is not None:
        text = CONFIG.replace("[priors]", f"emulate = {runs}\n\n[priors]", 1)
    (folder / "update.toml").write_text(text)
    assert cli.main(["update", str(folder / "update.toml")]) == 0
    assert "explains the measurements" in capsys.readouterr().err
    result = xr.open_datatree(folder / "update-output" / "update.nc", engine="h5netcdf")
    for name, (mean, sd) in moments_on_a_grid().items():
        draws = result["NORM/posterior"][name]
        assert abs(float(draws.mean()) - mean) < 4.5 * sd / np.sqrt(draws.size)
        assert float(draws.std()) == pytest.approx(sd, rel=4.5 / np.sqrt(2.0 * draws.size))
    response = result["NORM/bands"]["response"].sel(quantile=0.5).values
    np.testing.assert_allclose(response, [rings(**TRUTH), 0.5 * rings(**TRUTH)], atol=0.12)
    assert float(result["NORM/bands"]["coverage"].min()) > 0.8
    page = (folder / "update-output" / "report.html").read_text()
    assert "awk -f ring.awk updated with 2 measured histories over 2.4 s" in page
    if runs is not None:
        assert int(result["NORM/emulation"]["runs"][-1]) <= runs
    result.close()
    (folder / "ring.awk.template").touch()
    assert cli.main(["check", str(folder / "update.toml")]) == 0
    assert "it accounts for" in capsys.readouterr().err


def test_another_program_is_another_problem(folder):
    before = read_problem(folder / "update.toml").settings()
    (folder / "ring.awk.template").write_text(PROGRAM.replace("0.5 * y", "0.6 * y"))
    after = read_problem(folder / "update.toml").settings()
    assert {key for key in before if before[key] != after[key]} == {"program"}


def test_runs_are_kept_and_found(folder, capsys):
    """One that fails is named."""
    for words in ("The program took", "The program came from the cache"):
        assert cli.main(["check", str(folder / "update.toml")]) == 0
        assert words in capsys.readouterr().err
    assert (folder / "simulations.sqlite").exists()
    (folder / "update.toml").write_text(CONFIG.replace("mu = 8.3", "mu = 9.3"))
    assert cli.main(["check", str(folder / "update.toml")]) == 2
    assert "`external.program` must run at the medians of the priors" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (MODEL, "", "`structure` must be given: a table with `type`"),
        ("[data]", '[modal]\nfile = "modes.csv"\nsigma_f = 0.01\n[data]', "`modal` must be left out with"),
        ('units = { k = "N/m", c = "N s/m" }', 'units = { k = "N/m" }', "`priors.c` must be used"),
        ('kinds = ["NORM"]', 'kinds = ["CAL"]', "must not have CAL with .external., for programs"),
        ("columns = [1, 2]", "columns = [1, 2]\nemulate = 3", "`external.emulate` must be a whole number"),
        ("columns = [1, 2]", "columns = [1, 2]\ntimeout = 0", "`external.timeout` must be seconds"),
        ("columns = [1, 2]", "columns = [1, 2]\nretries = -1", "`external.retries`"),
        ('"ring.awk" = "ring.awk.template"', '"ring.awk" = "none.template"', "none.template"),
        ('"ring.awk" = "ring.awk.template"', "", "must have a `template`"),
        ("[priors]", "[processing]\nband_pass = { low = 1.0 }\n[priors]", "`processing.band_pass`"),
        ('sensors = ["a1", "a2"]', 'sensors = ["a1"]\nbase = "a2"', "`data.base` must be left out"),
        ("[likelihood]", "[[predict]]\nquantities = ['base_shear']\n[likelihood]", "`predict` must"),
    ],
)  # fmt: skip
def test_broken_sections_name_the_key(folder, old, new, message):
    assert old in CONFIG
    (folder / "update.toml").write_text(CONFIG.replace(old, new, 1))
    with pytest.raises(ConfigError, match=message):
        read_problem(folder / "update.toml")


def test_a_window_is_compared_and_columns_are_turned(folder):
    """Rows that are sensors, and a part of the histories."""
    text = CONFIG.replace("[priors]", "[processing]\ncompare = [0.2, 1.2]\n\n[priors]")
    (folder / "update.toml").write_text(text)
    data = read_problem(folder / "update.toml").first
    assert data.window == slice(10, 61) and data.simulator.shape == (2, SIZE)
    turned = PROGRAM.replace('printf "%.15g,%.15g,%.15g\\n", t, y, 0.5 * y > "out.csv"', "a[i] = y").replace(
        "    }\n}",
        "    }\n    for (f = 1; f > 0.4; f /= 2) {"
        '\n        for (i = 0; i < 120; i++) printf "%.15g%s", f * a[i], (i < 119 ? "," : "\\n") > "out.csv"'
        "\n    }\n}",
    )
    (folder / "ring.awk.template").write_text(turned)
    (folder / "update.toml").write_text(CONFIG.replace("columns = [1, 2]", "transpose = false"))
    found = read_problem(folder / "update.toml").first.simulator.responses([4000.0], [12.0])[0]
    np.testing.assert_allclose(found, [rings(**TRUTH), 0.5 * rings(**TRUTH)], atol=1e-12)
