"""The study: what its command writes, samplers against exact posteriors, continuation."""

import contextlib
import dataclasses
import io
import itertools
import re
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

from pymc_features import cli
from pymc_features.likelihoods import abc_tolerance
from pymc_features.simulators import simulate
from pymc_features.storage import PartStore
from pymc_features.study import (
    STRUCTURES,
    as_csv,
    as_markdown,
    find_structure,
    paper,
    sampling_rate_study,
    yielding,
)
from pymc_features.study import sampling_rate as study_module
from pymc_features.study.settings import Study
from pymc_features.study.structures import bouc_wen_chain
from support.blank_figures import blank
from support.straight import Record

pytestmark = pytest.mark.slow

QUICK = {
    "linear": {"draws": 500, "chains": 2, "multipliers": (0.5, 10.0)},
    "bouc-wen": {"draws": 490, "chains": 1, "multipliers": (1.0,)},
}
FIGURES = {"fig1_record", "fig2_theta", "fig3_sigma", "fig4_exp_norm_abc", "fig6_widths"}
TABLES = ("table.md", "table.csv")


@pytest.fixture(scope="module")
def beginning(record):
    """The first 2.6 s, in which springs yield: the rest only adds time to the tests."""
    return Record(record.acceleration[:131], record.dt, name="beginning")


@pytest.fixture(scope="module", params=STRUCTURES)
def command(request, beginning, tmp_path_factory):
    """What the command writes, and says."""
    name, folder = request.param, tmp_path_factory.mktemp("study")
    path, said, out = folder / "beginning.csv", io.StringIO(), folder / "out"
    path.write_text("acceleration [m/s^2]\n" + "\n".join(map(repr, beginning.acceleration.tolist())) + "\n")
    record = *("--record", str(path)), "--record-dt", "0.02"
    words = ["reproduce", "--structure", name, "--quick", *record, "--cores", "1", "--out", str(out)]
    entry = dataclasses.replace(STRUCTURES[name], quick=QUICK[name])
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(STRUCTURES, name, entry)
        if name == "linear":  # the figures of the other are drawn, once
            patch.setattr(Figure, "savefig", blank)
        with contextlib.redirect_stderr(said):
            assert cli.main(words) == 0
        with xr.open_datatree(out / "study.nc", engine="h5netcdf") as tree:
            result = tree.load()
        yield SimpleNamespace(name=name, words=words, out=out, said=said.getvalue(), result=result)


def test_command_writes_everything(command, capsys, monkeypatch):
    """Another seed or structure in the same folder is refused, the same again samples nothing."""
    figures = FIGURES | ({"fig5_correlated"} if command.name == "linear" else {"fig7_loops"})
    written = {path.name for path in command.out.iterdir()}
    assert written == {f"{name}.png" for name in figures} | {"parts", "study.nc", "study.json", *TABLES}
    assert all((command.out / f"{name}.png").read_bytes().startswith(b"\x89PNG") for name in figures)
    assert "record: Record('beginning', 131 samples, dt=0.02 s" in command.said
    stages = [line for line in command.said.splitlines() if line.startswith("[")]
    left, alive = r"(, (\d+ min )?\d+ s left)?", r"(, for \d+ s)?"
    form = re.compile(rf"\[\d+/\d+\] (finished|figures and tables|[\w-]+_x[\d.]+){left}{alive}")
    assert all(form.fullmatch(line) for line in stages), stages
    # nothing else scrolls by but which record it is, what is written, and signs of life
    others = [line for line in command.said.splitlines() if line not in stages]
    if command.name == "linear":
        assert all(line.startswith(("record: ", "wrote ", "loading, ", "reproduce, ")) for line in others), (
            others
        )
        return
    tables = [(command.out / name).read_bytes() for name in TABLES]
    changed = {path: path.stat().st_mtime_ns for path in (command.out / "parts").iterdir()}
    monkeypatch.setattr(Figure, "savefig", blank)
    assert cli.main(command.words) == 0
    assert [(command.out / name).read_bytes() for name in TABLES] == tables
    assert changed == {path: path.stat().st_mtime_ns for path in (command.out / "parts").iterdir()}
    capsys.readouterr()
    for more, said in (["--seed", "1"], "random_seed = "), (["--structure", "linear"], "structure = "):
        assert cli.main([*command.words, *more]) == 2
        error = capsys.readouterr().err
        assert "`out` must be empty or hold the same study" in error and said in error


@pytest.mark.statistical
def test_sampled_quantiles_are_the_exact_ones(command):
    """5, 50 and 95 % within 16 % of the exact 5-95 % width, 20 % if springs yield; ABC in its exact set.

    2 x 500 draws are worth 750 to 1000 independent ones; the standard error of the worst quantile, sigma's
    95 % under TN, is then 4 to 4.5 % of the width: with other seeds one step in 500 would fail by chance. Of
    springs that yield, one chain of 490: over 25 other seeds the error of the worst under TN was 5 %, root
    mean square, and 15 % at most, but for that of sigma (16 %), which is left out. The seeds are fixed.
    """
    least, apart = {"linear": (0.16, 0.2), "bouc-wen": (0.2, 0.4)}[command.name]
    summary, quantiles = command.result["summary"].to_dataset(), ["q05", "q50", "q95"]
    width = summary["exact"].sel(statistic="q95") - summary["exact"].sel(statistic="q05")
    error = (summary["sampled"] - summary["exact"]).sel(statistic=quantiles) / width
    if command.name == "bouc-wen":
        tail = {"likelihood": "TN", "parameter": "sigma", "statistic": "q95"}
        assert float(abs(error.sel(tail)).max()) < 1.0
        error.loc[tail] = np.nan
    assert float(np.abs(error).max()) < least, error.values.round(3)
    assert float(summary["r_hat"].max(skipna=True)) < 1.03 or command.name == "bouc-wen"
    for (low, high), m in zip(summary["epsilon_interval"].values, summary["multiplier"].values, strict=True):
        theta = command.result[f"ABC/x{m:g}/posterior/theta"].values
        assert low * (1 - 1e-6) <= theta.min() <= theta.max() <= high * (1 + 1e-6)
    # negative control: the exact values of another likelihood are far away
    swapped = summary["sampled"].sel(likelihood="TN") - summary["exact"].sel(likelihood="EXP")
    swapped = np.abs(swapped.sel(statistic=quantiles) / width.sel(likelihood="EXP"))
    assert (swapped.max(["parameter", "statistic"]) > apart).all()


def test_summary_and_tables_are_of_the_kept_draws(command):
    result, summary = command.result, command.result["summary"].to_dataset()
    kinds, steps = STRUCTURES[command.name].likelihoods, QUICK[command.name]["multipliers"]
    assert summary["likelihood"].values.tolist() == list(kinds)
    assert summary["multiplier"].values.tolist() == list(steps)
    inferred = 0
    for kind, m in itertools.product(kinds, steps):
        posterior, cell = result[f"{kind}/x{m:g}/posterior"], summary.sel(likelihood=kind, multiplier=m)
        for name in ("theta", "sigma", "tau"):
            values = cell.sel(parameter=name) if name in cell["parameter"] else None
            if name in posterior.data_vars:
                expected = posterior[name].quantile([0.05, 0.5, 0.95]).values
                np.testing.assert_allclose(values["sampled"][1:], expected, rtol=1e-12)
                assert np.isfinite(values["exact"]).all()
                inferred += 1
            elif values is not None:
                assert np.isnan(values["sampled"]).all() and np.isnan(values["exact"]).all()
    posteriors, trends, agreement = as_markdown(result).split("\n## ")[:3]
    csv = as_csv(result).splitlines()
    assert len(csv) == 1 + inferred
    for table, rows in ((posteriors, inferred), (trends, len(kinds)), (agreement, len(steps))):
        lines = [line for line in table.splitlines() if line.startswith("|")]
        assert len(lines) == 2 + rows and len({line.count("|") for line in lines}) == 1
    row = dict(zip(csv[0].split(","), csv[1].split(","), strict=True))
    cell = summary.sel(likelihood="NORM", multiplier=steps[0], parameter="theta")
    assert float(row["exact 5 %"]) == float(cell["exact"].sel(statistic="q05"))
    assert float(row["95 %"]) == float(cell["sampled"].sel(statistic="q95"))


def test_tolerance_follows_from_exp_and_draws_of_abc_are_inside(beginning, command):
    result = command.result
    for m, delta in zip(QUICK[command.name]["multipliers"], result["summary"]["epsilon"].values, strict=True):
        # of 1000 draws: the standard error of the quantile is 2.1 %, of delta 4.2 %; of 490 6 %
        sigma = result[f"EXP/x{m:g}/posterior/sigma"]
        assert delta == pytest.approx(abc_tolerance(sigma, paper.N_STOREYS), rel=0.25)
        assert result[f"ABC/x{m:g}"].attrs["epsilon"] == delta
        measured = result["data"]["measured"]
        measured = paper.decimate(measured, m * beginning.dt).values
        for theta in result[f"ABC/x{m:g}/posterior/theta"].values.ravel()[::100]:
            chain = STRUCTURES[command.name].chain(theta)
            mu = simulate(chain, beginning, dt=m * beginning.dt).values
            assert np.mean((measured - mu) ** 2, axis=1).sum() <= delta * (1 + 1e-9)


def test_loops_are_those_of_the_response(beginning, command):
    """Drift by differences of the displacements, force by the balance of the top masses."""
    if command.name == "linear":
        assert "loops" not in command.result
        return
    loops, result = command.result["loops"].to_dataset(), command.result
    positions = simulate(bouc_wen_chain(), beginning, quantity="relative_displacement").values
    np.testing.assert_allclose(loops["drift"], np.diff(positions, axis=0, prepend=0.0), atol=1e-12)
    np.testing.assert_allclose(loops["ductility"], abs(loops["drift"]).max("time") / 0.005)
    acceleration = simulate(bouc_wen_chain(), beginning).values
    velocity = simulate(bouc_wen_chain(), beginning, quantity="relative_velocity").values
    _, damping, _ = bouc_wen_chain().matrices()
    inertia = (acceleration + damping @ velocity)[::-1].cumsum(axis=0)[::-1]  # all masses are 1 kg
    np.testing.assert_allclose(loops["force"], -inertia, atol=1e-6 * np.abs(inertia).max())
    assert (result.attrs["structure"], result.attrs["title"]) == ("bouc-wen", "Bouc-Wen chain")
    table = (command.out / "table.md").read_text()
    assert f"## Springs at the true theta: {yielding(result)}" in table
    assert len(table.split("## Springs")[1].splitlines()) == 4 + paper.N_STOREYS


@pytest.fixture(scope="module")
def short():
    """A short record, for what is not about numbers."""
    return Record(np.random.default_rng(11).normal(size=150), 0.02, name="short")


def small_study(record, **kwargs):
    """The study with few draws."""
    settings = {"multipliers": (1.0, 2.0), "draws": 60, "chains": 2, "cores": 1, "progressbar": False}
    return sampling_rate_study(record, **settings | {"random_seed": 0} | kwargs)


def test_interrupted_study_continues_with_the_same_numbers(short, tmp_path, monkeypatch):
    """Stopped in the second part: another call samples only what is missing, and the result is the same.

    CAL follows from NORM, which is no part of the result.
    """
    run, calls, settings = study_module.run_part, [], {"likelihoods": ["CAL"], "chains": 1}
    whole = small_study(short, **settings)
    assert whole["summary"]["likelihood"].values.tolist() == ["CAL"] and "NORM" not in whole.children
    assert 0 < whole["CAL/x1/calibration"].attrs["n_eff"] < 2.0 * 10 * 150

    def noted(study, kind, multiplier, *args):
        if len(calls) == 2:
            raise KeyboardInterrupt
        calls.append((kind, multiplier))
        return run(study, kind, multiplier, *args)

    monkeypatch.setattr(study_module, "run_part", noted)
    with pytest.raises(KeyboardInterrupt):
        small_study(short, out=tmp_path, **settings)
    assert sorted(p.name for p in (tmp_path / "parts").glob("*.nc")) == ["CAL_x1.nc", "NORM_x1.nc"]
    assert calls == [("NORM", 1.0), ("CAL", 1.0)]
    calls[:] = [None] * 3
    result = small_study(short, out=tmp_path, **settings)
    assert calls[3:] == [("NORM", 2.0), ("CAL", 2.0)]
    xr.testing.assert_equal(result["summary"]["sampled"], whole["summary"]["sampled"])
    whole.to_netcdf(tmp_path / "study.nc", engine="h5netcdf")
    with xr.open_datatree(tmp_path / "study.nc", engine="h5netcdf") as again:
        for path in ("summary", "data", "CAL/x1/posterior", "CAL/x2/sample_stats"):
            xr.testing.assert_equal(again[path].to_dataset(), whole[path].to_dataset())


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"noise": 0.0}, "`noise` must be positive, got 0.0. Without noise"),
        ({"noise_time": -0.1}, "`noise_time` must be positive or zero, got -0.1. Pass 0 for white noise"),
        ({"draws": 10}, "`draws` must be an integer of at least 50, got 10"),
        ({"chains": 0}, "`chains` must be an integer of at least 1, got 0"),
        ({"random_seed": -1}, "`random_seed` must be an integer of at least 0, got -1"),
        ({"structure": "steel"}, "`structure` must be one of linear, bouc-wen, got 'steel'"),
        ({"likelihoods": ["LAPLACE"]}, "`likelihoods` must be among NORM, TN, EXP, ABC"),
        ({"likelihoods": []}, "`likelihoods` must be among NORM, TN, EXP, ABC"),
        ({"multipliers": []}, r"`multipliers` must be one or several positive numbers, got \[\]"),
        ({"multipliers": [1.0, 50.0]}, "`multipliers` must leave at least 10 samples, got 50"),
        ({"multipliers": [1.0, 1.5]}, "`step` must be an integer multiple of the finest step"),
        ({"multipliers": [0.3]}, "`dt` must be an integer multiple or divisor"),
        ({"structure": find_structure("linear", stiffness=-1.0)}, "`stiffness` must be positive and finite"),
    ],
)
def test_bad_settings(short, kwargs, message):
    with pytest.raises(ValueError, match=message):
        small_study(short, **kwargs)


def test_measurements_have_the_stated_noise_once(short):
    """The same finest history at every step; noise of 5 % of each channel's root mean square."""
    finest = paper.measurements(short, random_seed=4)
    again = paper.measurements(short, random_seed=4)
    np.testing.assert_array_equal(finest, again)
    exact = simulate(paper.chain(), short, dt=0.1 * short.dt).values
    noise = finest.values - exact
    rms = np.sqrt((exact**2).mean(axis=1))
    # 1491 samples: standard error of a standard deviation 1.8 %; ten channels within 5 of them
    np.testing.assert_allclose(noise.std(axis=1), 0.05 * rms, rtol=0.09)
    coarse = paper.decimate(finest, 2.0 * short.dt)
    np.testing.assert_array_equal(coarse.values, finest.values[:, ::20])
    with pytest.raises(ValueError, match="`noise` must be positive or zero, got -0.1"):
        paper.measurements(short, noise=-0.1)


def test_noise_may_persist(short):
    """Unit variance from the first sample on, and the correlation exp(-lag / time) at any step."""
    white = np.random.default_rng(1).standard_normal((20000, 30))
    noise = paper.persistent(white, 0.01, 0.05)
    np.testing.assert_allclose(noise.std(axis=0), 1.0, rtol=0.03)
    lags = np.mean(noise[:, :1] * noise, axis=0)
    np.testing.assert_allclose(lags, np.exp(-0.01 * np.arange(30) / 0.05), atol=0.03)
    assert paper.persistent(white, 0.01, 0.0) is white
    study = Study(short, random_seed=4, noise_time=0.05)
    assert study.title == "linear chain, noise correlated over 0.05 s"
    assert study.settings()["noise_time"] == 0.05
    assert not np.array_equal(study.finest, Study(short, random_seed=4).finest)


def test_arguments_of_samplers_are_known_by_name(short):
    with pytest.raises(
        TypeError,
        match=r"cores, executor, progressbar, noise_time, got 'chain'. Did you mean",
    ):
        small_study(short, chain=1)


def test_a_study_without_a_seed_takes_another_each_time_and_goes_on_with_its_own(short, tmp_path):
    first, second = (Study(short, likelihoods=["TN"]) for _ in range(2))
    assert first.random_seed != second.random_seed
    assert not np.array_equal(first.finest, second.finest)
    assert study_module.seed_in(None) is study_module.seed_in(tmp_path) is None
    PartStore(tmp_path, first.settings())
    assert study_module.seed_in(tmp_path) == first.random_seed
