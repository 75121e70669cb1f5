"""`[hierarchical]`: mean and scatter of specimens, against quadrature."""

import re

import numpy as np
import pytest
import xarray as xr
from scipy import stats

from pymc_features import cli

MASS, ERROR = 1000.0, 0.02
FREQUENCIES = {"a": 1.00, "b": 1.06, "c": 0.97}  # of three specimens [Hz]
CONFIG = """
[modal]
file = "a.csv"
sigma_f = 0.02

[structure]
type = "SpringMassChain"
mass = [1000.0]
stiffness = ["k"]

[priors]
k = { distribution = "LogNormal", mu = 10.6, sigma = 0.5 }

[hierarchical.members]
b = { modal = { file = "b.csv" } }
c = { modal = { file = "c.csv" } }

[hierarchical.population.k]
mean = { distribution = "LogNormal", mu = 10.6, sigma = 0.3 }
scatter = { distribution = "HalfNormal", sigma = 0.2 }

[sampler]
draws = 300
chains = 2
"""


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    folder = tmp_path_factory.mktemp("population")
    for name, frequency in FREQUENCIES.items():
        (folder / f"{name}.csv").write_text(f"mode,frequency [Hz]\n1,{frequency}\n")
    (folder / "labs.toml").write_text(CONFIG)
    return folder / "labs.toml"


def by_quadrature() -> dict:
    """Probabilities of mean and scatter on a grid: ln k of a specimen is normal, and so is the population."""
    measured = np.log((2.0 * np.pi * np.array(list(FREQUENCIES.values()))) ** 2 * MASS)
    mean, scatter = np.linspace(10.2, 11.0, 401), np.linspace(1e-4, 0.6, 400)
    total = np.sqrt(scatter**2 + (2.0 * ERROR) ** 2)
    log_p = stats.norm(10.6, 0.3).logpdf(mean)[:, None] + stats.halfnorm(scale=0.2).logpdf(scatter)
    log_p = log_p + stats.norm.logpdf(measured, mean[:, None, None], total[:, None]).sum(axis=-1)
    p = np.exp(log_p - log_p.max())
    return {"k_mean": (np.exp(mean), p.sum(axis=1)), "k_scatter": (scatter, p.sum(axis=0))}


@pytest.mark.slow
def test_mean_and_scatter_are_those_of_quadrature(path, capsys):
    """Quantiles of 600 draws within 4 standard errors, 10 % of the 5-95 % width."""
    assert cli.main(["update", str(path)]) == 0
    told = capsys.readouterr().err
    assert "Mean, scatter and members" in told and "the next one" in told
    with xr.open_datatree(path.with_name("labs-output") / "update.nc", engine="h5netcdf") as tree:
        found = tree["hierarchical/MODAL"].load()
    for name, (values, weights) in by_quadrature().items():
        cdf = np.cumsum(weights) / weights.sum()
        low, middle, high = np.interp([0.05, 0.5, 0.95], cdf, values)
        draws = np.quantile(found["population"][name].values, [0.05, 0.5, 0.95])
        np.testing.assert_allclose(draws, [low, middle, high], atol=0.1 * (high - low))
    members = found["members"]["k"].median(["chain", "draw"])
    alone = {name: (2.0 * np.pi * f) ** 2 * MASS for name, f in FREQUENCIES.items()}
    assert members["event"].values.tolist() == ["[structure]", "b", "c"]
    middle = float(found["population"]["k_mean"].median())
    for name, value in zip(("[structure]", "b", "c"), alone.values(), strict=True):
        got = float(members.sel(event=name))
        assert min(middle, value) - 0.01 * value < got < max(middle, value) + 0.01 * value
    assert float(found["next"]["k"].std()) > float(found["population"]["k_mean"].std())
    assert "Population</h2>" in (path.with_name("labs-output") / "report.html").read_text()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[hierarchical.population.k]", "[hierarchical.population.m]", "must name parameters of the struct"),
        ('modal = { file = "c.csv" }', 'modal = { file = "x.csv" }', "hierarchical.members.c.*x.csv"),
        ('modal = { file = "c.csv" }', 'modals = { file = "x.csv" }', "hierarchical.members.c.*`modals`"),
        ('scatter = { distribution = "HalfNormal", sigma = 0.2 }', "", "`hierarchical.population.k.scatter`"),
        ('mean = { distribution = "LogNormal"', 'distribution = "Gamma"\nmean = { distribution = "LogNormal"',
         '`hierarchical.population.k.distribution` must be "Normal" or "LogNormal"'),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_before_anything_is_sampled(path, capsys, old, new, message):
    assert old in CONFIG
    other = path.with_name("wrong.toml")
    other.write_text(CONFIG.replace(old, new, 1))
    assert cli.main(["update", str(other)]) == 2
    assert re.search(message, capsys.readouterr().err)
    assert not list(path.parent.glob("wrong-output/*.nc"))
