"""The study on springs that yield: its structure, exact posteriors from shared responses, the command."""

import dataclasses
import inspect

import numpy as np
import pytest
import xarray as xr

from pymc_features import cli, sampling_rate_study, simulate
from pymc_features.cli import make_parser
from pymc_features.likelihoods import LIKELIHOODS
from pymc_features.study import STRUCTURES, find_structure, paper, yielding
from pymc_features.study.exact import reference
from pymc_features.study.sampling_rate import SamplingOptions
from pymc_features.study.settings import Study
from pymc_features.study.structures import YIELD_DISPLACEMENT, bouc_wen_chain
from support.straight import Record

pytestmark = pytest.mark.slow

KINDS = ("NORM", "TN", "EXP", "ABC")
QUANTILES = ["q05", "q50", "q95"]


@pytest.mark.parametrize("name", STRUCTURES)
def test_structures_of_the_study(name, record):
    """What every entry of the catalogue must do."""
    entry = find_structure(name)
    nominal, changed = entry.chain(1.0, stiffness=1500.0), entry.chain(1.2, stiffness=1500.0)
    assert nominal.n_dof == paper.N_STOREYS
    np.testing.assert_allclose(nominal.stiffness, 1500.0)
    np.testing.assert_allclose(changed.stiffness, [1800.0] * 3 + [1500.0] * 7)
    np.testing.assert_array_equal(entry.chain().matrices(), paper.chain().matrices())
    assert np.isfinite(simulate(changed, Record(record.acceleration[:50], record.dt))).all()
    assert set(entry.likelihoods) <= set(LIKELIHOODS)
    study = Study(record, random_seed=0, structure=name, likelihoods=["TN"], multipliers=[10.0])
    assert (study.draws, study.chains, study.at(1.1).family) == (entry.draws, entry.chains, changed.family)
    known = inspect.signature(sampling_rate_study).parameters
    assert set(entry.quick) <= {*known, *SamplingOptions.__annotations__}
    softer = find_structure(name, stiffness=1500.0)
    np.testing.assert_array_equal(softer.at(1.2).stiffness, changed.stiffness)
    assert Study(record, structure=softer, likelihoods=["TN"], multipliers=[10.0]).structure == softer
    assert entry.quick["draws"] < entry.draws
    assert name in make_parser()._subparsers._group_actions[0].choices["reproduce"].format_help()


def test_yielding_is_as_stated(record):
    """Ductility from 2 to 5 in several storeys; the drifts stated for El Centro, here by differences."""
    positions = simulate(bouc_wen_chain(), record, quantity="relative_displacement").values
    drifts = np.abs(np.diff(positions, axis=0, prepend=0.0)).max(axis=1)
    ductility = drifts / YIELD_DISPLACEMENT
    assert ((ductility > 2.0) & (ductility < 5.0)).sum() >= 4
    if record.name.startswith("El Centro"):
        np.testing.assert_allclose(ductility[:7], [4.2, 3.6, 3.0, 3.1, 2.9, 2.1, 1.4], atol=0.05)
        assert (ductility[7:] < 1.0).all()
        linear = simulate(paper.chain(), record, quantity="relative_displacement", sensors=[0])
        assert np.abs(linear.values).max() / YIELD_DISPLACEMENT == pytest.approx(5.8, abs=0.05)


@pytest.fixture(scope="module")
def short(record):
    """The first 2.6 s, in which springs yield."""
    return Record(record.acceleration[:131], record.dt, name="beginning")


@pytest.fixture(scope="module")
def study(short):
    return Study(short, random_seed=0, structure="bouc-wen", multipliers=(0.5, 1.0, 5.0))


def direct_sums(study, theta, multiplier):
    """The four sums from a response simulated at the sampling step itself."""
    response = simulate(study.at(theta), study.record, dt=multiplier * study.record.dt).values
    misfit = study.data(multiplier).values - response
    n = misfit.shape[1]
    increments = np.sum(np.diff(misfit, axis=1) ** 2) / n
    return np.array(
        [np.sum(misfit**2) / n, increments, np.sum(misfit[:, 0] ** 2), np.sum(misfit[:, -1] ** 2)]
    )


@pytest.mark.parametrize("theta", [0.6137, 0.99931, 1.0304, 1.377])
def test_shared_responses_serve_every_step(study, theta):
    """1e-6 of S: the integration's error, and the splines' where the posteriors are; further off 1e-4."""
    accuracy = 1e-6 if abs(theta - 1.0) < 0.04 else 1e-4
    for multiplier in study.multipliers:
        expected = direct_sums(study, theta, multiplier)
        got = study.misfit(multiplier).sums(theta)
        np.testing.assert_allclose(got, expected, rtol=accuracy, atol=1e-9 * expected[0])
        # negative control: the data of another step
        other = direct_sums(study, theta, 1.0 if multiplier != 1.0 else 5.0)
        assert abs(got[1] / other[1] - 1.0) > 1e3 * accuracy


def test_uncertainty_does_not_depend_on_the_sampling_rate(study):
    """As of the linear chain: half the step or five times it; NORM is the control."""
    width = {
        kind: np.array([np.ptp(reference(kind, study.misfit(m)).statistics[0, 1:]) for m in (0.5, 1.0, 5.0)])
        for kind in KINDS
    }
    for kind in ("TN", "EXP", "ABC"):
        assert width[kind].max() / width[kind].min() < 1.1
    assert width["NORM"][2] / width["NORM"][0] == pytest.approx(np.sqrt(10.0), rel=0.15)


@pytest.fixture(scope="module")
def folder(short, tmp_path_factory):
    """What the command writes for one sampling step."""
    folder = tmp_path_factory.mktemp("bouc-wen")
    path = folder / "beginning.csv"
    path.write_text("acceleration [m/s^2]\n" + "\n".join(f"{a:.9f}" for a in short.acceleration) + "\n")
    entry = STRUCTURES["bouc-wen"]
    quick = {"draws": 490, "chains": 1, "multipliers": (1.0,)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(STRUCTURES, "bouc-wen", dataclasses.replace(entry, quick=quick))
        assert cli.main(arguments(folder)) == 0
        yield folder


def arguments(folder, *more):
    record = *("--record", str(folder / "beginning.csv")), "--record-dt", "0.02"
    return ["reproduce", "--structure", "bouc-wen", "--quick", *record, "--out", str(folder / "out"), *more]


@pytest.fixture
def result(folder):
    with xr.open_datatree(folder / "out" / "study.nc", engine="h5netcdf") as tree:
        yield tree.load()


def test_command_writes_everything(folder, result):
    names = {path.name for path in (folder / "out").iterdir()}
    assert names == {
        *("fig1_record.png", "fig2_theta.png", "fig3_sigma.png", "fig4_exp_norm_abc.png"),
        *("fig6_widths.png", "fig7_loops.png"),
        *("table.md", "table.csv", "study.nc", "study.json", "parts"),
    }
    assert result["summary"]["likelihood"].values.tolist() == list(KINDS)
    assert (result.attrs["structure"], result.attrs["title"]) == ("bouc-wen", "Bouc-Wen chain")
    table = (folder / "out" / "table.md").read_text()
    assert f"## Springs at the true theta: {yielding(result)}" in table
    assert len(table.split("## Springs")[1].splitlines()) == 4 + paper.N_STOREYS


@pytest.mark.statistical
def test_sampled_quantiles_are_the_exact_ones(result):
    """5, 50 and 95 % within 20 % of the exact 5-95 % width; all ABC draws in the exact set.

    One chain of 490 draws: over 25 other seeds the error of the worst of these quantiles under TN was 5 % of
    the width, root mean square, and 15 % at most; one run in some hundred would fail by chance. The seed is
    fixed. Left out is the 95 % quantile of sigma under TN, in a tail that few draws describe (16 %).
    """
    summary = result["summary"].to_dataset().isel(multiplier=0)
    width = summary["exact"].sel(statistic="q95") - summary["exact"].sel(statistic="q05")
    error = (summary["sampled"] - summary["exact"]).sel(statistic=QUANTILES) / width
    tail = {"likelihood": "TN", "parameter": "sigma", "statistic": "q95"}
    assert abs(float(error.sel(tail))) < 1.0
    error.loc[tail] = np.nan
    assert float(np.abs(error).max()) < 0.2, error.values.round(3)
    low, high = summary["epsilon_interval"].values
    theta = result["ABC/x1/posterior/theta"].values
    assert low * (1 - 1e-6) <= theta.min() <= theta.max() <= high * (1 + 1e-6)
    # negative control: the exact values of another likelihood are far away
    swapped = summary["sampled"].sel(likelihood="TN") - summary["exact"].sel(likelihood="EXP")
    assert float(np.abs(swapped.sel(statistic=QUANTILES) / width.sel(likelihood="EXP")).max()) > 0.4


def test_loops_are_those_of_the_response(short, result):
    """Drift by differences of the displacements, force by the balance of the top masses."""
    loops = result["loops"].to_dataset()
    positions = simulate(bouc_wen_chain(), short, quantity="relative_displacement").values
    np.testing.assert_allclose(loops["drift"], np.diff(positions, axis=0, prepend=0.0), atol=1e-12)
    np.testing.assert_allclose(loops["ductility"], abs(loops["drift"]).max("time") / 0.005)
    acceleration = simulate(bouc_wen_chain(), short).values
    velocity = simulate(bouc_wen_chain(), short, quantity="relative_velocity").values
    _, damping, _ = bouc_wen_chain().matrices()
    inertia = (acceleration + damping @ velocity)[::-1].cumsum(axis=0)[::-1]  # all masses are 1 kg
    np.testing.assert_allclose(loops["force"], -inertia, atol=1e-6 * np.abs(inertia).max())


def test_stopped_run_continues_with_the_same_structure_only(folder, capsys):
    table = (folder / "out" / "table.csv").read_text()
    changed = {path: path.stat().st_mtime_ns for path in (folder / "out" / "parts").iterdir()}
    assert cli.main(arguments(folder)) == 0
    assert "springs: " in capsys.readouterr().err
    assert (folder / "out" / "table.csv").read_text() == table
    assert changed == {path: path.stat().st_mtime_ns for path in (folder / "out" / "parts").iterdir()}
    assert cli.main([*arguments(folder), "--structure", "linear"]) == 2
    error = capsys.readouterr().err
    assert "`out` must be empty or hold the same study" in error
    assert "structure = 'bouc-wen' instead of None" in error
