"""Chains that ended far below the best are left out, with a warning; all others count."""

import json
import warnings

import numpy as np
import pymc as pm
import pytest
import xarray as xr

from pymc_features import cli
from pymc_features.exceptions import ChainsDisagreeWarning
from pymc_features.inference.sample import without_lost_chains
from pymc_features.update import write_example
from support.update_files import replaced

PLACES = np.array([20.0, 20.0, -20.0, 20.0])  # of the chains


def two_modes(lower, width=1.0, size=10):
    """Gaussian modes at 20 and, lower in log density and perhaps wider, at -20, with a positive parameter."""
    with pm.Model() as model:
        pm.HalfNormal("scale", 1.0)
        x = pm.Flat("x", shape=size)
        high, low = (-0.5 * ((x - place) ** 2 / sd**2).sum() for place, sd in ((20.0, 1.0), (-20.0, width)))
        pm.Potential("modes", pm.math.logaddexp(high, low - lower))
    return model


def drawn(places=PLACES, width=1.0, size=10):
    """Chains of 300 draws around some places."""
    rng = np.random.default_rng(0)
    sd = np.where(places > 0.0, 1.0, width)[:, None, None]
    x = places[:, None, None] + sd * rng.standard_normal((len(places), 300, size))
    scale = np.abs(rng.standard_normal(x.shape[:2]))
    columns = {"x": (("chain", "draw", "entry"), x), "scale": (("chain", "draw"), scale)}
    coords = {"chain": np.arange(len(places)), "draw": np.arange(300)}
    ess = ("chain", 10.0 * np.arange(1, len(places) + 1))
    stats = xr.Dataset({"ess": ess}, coords={"chain": coords["chain"]}, attrs={"ess": 100.0, "advice": ""})
    return xr.DataTree.from_dict({"posterior": xr.Dataset(columns, coords=coords), "sample_stats": stats})


def test_a_chain_in_a_mode_without_weight_is_left_out():
    told = "below that of chain [013]: chain 2 by (29|30|31). Increase `draws`"
    with pytest.warns(ChainsDisagreeWarning, match=told):
        kept = without_lost_chains(drawn(), two_modes(lower=30.0))
    assert kept["posterior"]["chain"].values.tolist() == [0, 1, 3]
    assert (kept["posterior"]["x"] > 0.0).all()
    stats = kept["sample_stats"]
    assert stats["ess"].values.tolist() == [10.0, 20.0, 40.0]
    assert (stats.attrs["ess"], stats.attrs["advice"]) == (70.0, "")


@pytest.mark.parametrize(("lower", "width"), [(0.0, 1.0), (15.0, 1.0), (30.0, 10.0)])
def test_modes_with_weight_are_kept(lower, width):
    """As high, a little lower, or lower but of as much mass: ten widths of 10 outweigh exp(-23)."""
    idata = drawn(width=width)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert without_lost_chains(idata, two_modes(lower, width)) is idata


def test_most_chains_lost():
    """One chain alone has nothing to be compared with."""
    told = r"chain 0 by 40, .*Rely on none, for 3 of 4 went astray\."
    with pytest.warns(ChainsDisagreeWarning, match=told):
        kept = without_lost_chains(drawn(-PLACES), two_modes(lower=40.0))
    assert kept["posterior"]["chain"].values.tolist() == [2]
    idata = drawn(PLACES[:1])
    assert without_lost_chains(idata, None) is idata


@pytest.mark.slow
def test_lost_chains_of_an_update(tmp_path, capsys):
    """TMCMC with 50 particles and wide priors ends anywhere: the report pools the best only, and says it."""
    path, out = tmp_path / "few.toml", tmp_path / "out"
    write_example(path, synthetic=True)
    changes = [
        ('kinds = ["CAL", "NORM", "TN", "EXP", "ABC"]', 'kinds = ["NORM"]'),
        ('method = "auto"', 'method = "smc"\nkernel = "TMCMC"'),
        ("draws = 1000", "draws = 50"),
        ("chains = 2", "chains = 4"),
    ]
    path.write_text(replaced(path.read_text().replace("sigma = 0.2 }", "sigma = 0.6 }"), changes))
    assert cli.main(["update", str(path), "--out", str(out), "--cores", "1"]) == 0
    said = "NORM: Chains are left out that ended in modes without weight"
    assert f"warning: {said}" in capsys.readouterr().err
    assert said in (out / "report.html").read_text()
    with xr.open_datatree(out / "update.nc", engine="h5netcdf") as tree:
        part = tree["NORM"]
        chains = part["posterior"]["chain"].values.tolist()
        assert 1 <= len(chains) < 4
        assert part["sample_stats"]["chain"].values.tolist() == chains
        assert part["modal"]["chain"].values.tolist() == chains
        [warning] = [text for text in json.loads(part.attrs["warnings"]) if "left out" in text]
    assert [k for k in range(4) if f"chain {k} by" in warning] == [k for k in range(4) if k not in chains]
