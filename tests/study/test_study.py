"""The study: exact posteriors against closed forms, samplers against exact posteriors, continuation."""

import contextlib
import dataclasses
import io
import itertools
import json
import re

import numpy as np
import pytest
import xarray as xr
from scipy import integrate, stats

from pymc_features import abc_tolerance, cli, sampling_rate_study
from pymc_features.exceptions import StudyMismatchError
from pymc_features.likelihoods import LIKELIHOODS
from pymc_features.simulators import simulate
from pymc_features.storage import PartStore
from pymc_features.study import STRUCTURES, as_csv, as_markdown, paper
from pymc_features.study import sampling_rate as study_module
from pymc_features.study.exact import DiscrepancyCurve, exact_posterior, tolerance_interval
from pymc_features.study.settings import Study
from pymc_features.study.structures import find_structure
from support.straight import Record

pytestmark = pytest.mark.slow

KINDS = ("NORM", "TN", "EXP")
ALL_KINDS = (*KINDS, "ABC", "CN", "CN-SIGMA", "CN-TAU", "CAL")
MULTIPLIERS = (0.1, 10.0)
STEPS = (0.1, 1.0, 10.0)  # the finest and the coarsest of `paper.MULTIPLIERS`


@pytest.fixture(scope="module")
def exact(record):
    """Curves and exact posteriors on the whole record at three of the steps."""
    study = Study(record, random_seed=0)
    result = {}
    for multiplier in STEPS:
        data = study.data(multiplier)
        curve = study.misfit(multiplier).curve
        posteriors = {
            kind: exact_posterior(curve, LIKELIHOODS[kind].exponents(*data.shape), paper.SIGMA_RANGE)
            for kind in KINDS
        }
        result[multiplier] = curve, posteriors, data
    return result


def widths(exact, kind, parameter="theta"):
    """Exact 5-95 % width at each sampling step."""
    return np.array([np.ptp(getattr(exact[m][1][kind], parameter).quantile([0.05, 0.95])) for m in STEPS])


@pytest.mark.parametrize("kind", KINDS)
def test_marginal_is_the_student_t_of_the_closed_form(exact, kind):
    """S^(-(m - 1)/2) with quadratic S: a Student-t; at 0.1 % of the 5-95 % width."""
    for curve, posteriors, data in exact.values():
        m = LIKELIHOODS[kind].exponents(*data.shape).m
        scale = np.sqrt(curve.minimum / curve.curvature / (m - 2))
        closed = curve.minimiser + scale * stats.t(m - 2).ppf([0.05, 0.25, 0.5, 0.75, 0.95])
        quantiles = posteriors[kind].theta.quantile([0.05, 0.25, 0.5, 0.75, 0.95])
        width = closed[-1] - closed[0]
        # S is quadratic near its minimum only: the heavier the tail, the more of its cubic part is seen
        np.testing.assert_allclose(np.ptp(quantiles[[0, -1]]), width, rtol=1e-3)
        np.testing.assert_allclose(quantiles, closed, atol=(0.01 if kind != "NORM" else 1e-3) * width)


def test_abc_half_width_is_the_closed_form(exact):
    for curve, posteriors, _ in exact.values():
        delta = 20.0 * float(posteriors["EXP"].sigma.quantile(0.9)) ** 2
        low, high = tolerance_interval(curve, delta)
        closed = np.sqrt((delta - curve.minimum) / curve.curvature)
        assert (high - low) / 2.0 == pytest.approx(closed, rel=1e-3)
        assert curve.total(low) == pytest.approx(delta, rel=1e-9)
        assert curve.total(high) == pytest.approx(delta, rel=1e-9)
        with pytest.raises(ValueError, match="`delta` must exceed the smallest discrepancy"):
            tolerance_interval(curve, 0.999 * curve.minimum)


@pytest.mark.parametrize("kind", KINDS)
def test_quadrature_on_a_parabola_against_adaptive_integration(kind):
    """Independent route: SciPy's adaptive integration of the same density, also for the evidence."""
    minimum, curvature, centre = 0.07, 1700.0, 1.003
    curve = DiscrepancyCurve(lambda t: minimum + curvature * (t - centre) ** 2, (0.5, 1.5), 10 * 50)
    likelihood = LIKELIHOODS[kind].exponents(10, 50)
    posterior = exact_posterior(curve, likelihood, (0.0, 2.0))
    m, c = likelihood.m, likelihood.c
    top = -m * np.log(np.sqrt(c * minimum / m)) - m / 2

    def density(log_sigma, theta):
        total = minimum + curvature * (theta - centre) ** 2
        return np.exp(-m * log_sigma - c * total / (2 * np.exp(2 * log_sigma)) - top + log_sigma)

    def below(theta_end):
        inner = lambda t: integrate.quad(density, -6, np.log(2.0), args=(t,), limit=200, points=[-2.5])[0]  # noqa: E731
        return integrate.quad(inner, 0.5, theta_end, points=[centre - 0.01, centre], limit=200)[0]

    whole = below(1.5)
    quantile = float(posterior.theta.quantile(0.05))
    assert below(quantile) / whole == pytest.approx(0.05, abs=2e-5)
    expected = np.log(whole / 2.0) + top + likelihood.constant
    assert posterior.log_evidence == pytest.approx(expected, abs=1e-4)


def test_exponents_reproduce_the_likelihoods():
    """-m ln sigma - c S / (2 sigma^2) + constant equals SciPy's densities, summed."""
    rng = np.random.default_rng(5)
    misfit, sigma = rng.normal(size=(3, 40)), 0.7
    e = np.mean(misfit**2, axis=1)
    expected = {
        "NORM": stats.norm(scale=sigma).logpdf(misfit).sum(),
        "TN": stats.halfnorm(scale=sigma).logpdf(np.sqrt(e)).sum(),
        "EXP": stats.expon(scale=2 * sigma**2).logpdf(e).sum(),
    }
    for kind, value in expected.items():
        it = LIKELIHOODS[kind].exponents(3, 40)
        got = -it.m * np.log(sigma) - it.c * e.sum() / (2 * sigma**2) + it.constant
        assert got == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize("kind", ["TN", "EXP"])
def test_feature_uncertainty_does_not_depend_on_the_sampling_rate(exact, kind):
    width = widths(exact, kind)
    assert width.max() / width.min() < 1.03


def test_abc_uncertainty_does_not_either(exact):
    """At the tolerance of the exact EXP posterior: width of the exact set, and where it lies."""
    ends = []
    for curve, posteriors, _ in exact.values():
        delta = abc_tolerance(float(posteriors["EXP"].sigma.quantile(0.9)), paper.N_STOREYS)
        ends.append(tolerance_interval(curve, delta))
    width = np.ptp(ends, axis=1)
    assert width.max() / width.min() < 1.03
    # at the 90 % quantile it is wider than TN's interval, and less than twice as wide as EXP's
    assert (0.9 * width > widths(exact, "TN")).all()
    assert (0.9 * width < 2.2 * widths(exact, "EXP")).all()


def test_norm_uncertainty_does(exact):
    """Negative control of the invariance: a hundred times the samples, a tenth of the width."""
    width = widths(exact, "NORM")
    assert width[-1] / width[0] == pytest.approx(10.0, rel=0.1)
    assert (np.diff(width) > 0).all()


# --------------------------------------------------------------------------- one study, by the command


@pytest.fixture(scope="module")
def beginning(record):
    """The first 2.6 s: the rest only adds time to the tests."""
    return Record(record.acceleration[:131], record.dt, name="beginning")


@pytest.fixture(scope="module")
def folder(beginning, tmp_path_factory):
    """What the command writes, and says, for a fine and a coarse step."""
    folder = tmp_path_factory.mktemp("study")
    path = folder / "beginning.csv"
    path.write_text("acceleration [m/s^2]\n" + "\n".join(map(repr, beginning.acceleration.tolist())) + "\n")
    said = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stderr(said):
        quick = {"multipliers": MULTIPLIERS}
        patch.setitem(STRUCTURES, "linear", dataclasses.replace(STRUCTURES["linear"], quick=quick))
        assert cli.main(arguments(folder)) == 0
        (folder / "said").write_text(said.getvalue())
        yield folder


def arguments(folder, *more):
    record = *("--record", str(folder / "beginning.csv")), "--record-dt", "0.02"
    sampling = "--draws", "500", "--chains", "2", "--cores", "1"
    return ["reproduce", "--quick", *record, *sampling, "--out", str(folder / "out"), *more]


@pytest.fixture(scope="module")
def result(folder):
    with xr.open_datatree(folder / "out" / "study.nc", engine="h5netcdf") as tree:
        return tree.load()


def test_command_writes_everything(folder, capsys):
    names = {path.name for path in (folder / "out").iterdir()}
    assert names == {
        *("fig1_record.png", "fig2_theta.png", "fig3_sigma.png", "fig4_exp_norm_abc.png"),
        *("fig5_correlated.png", "fig6_widths.png"),
        *("table.md", "table.csv", "study.nc", "study.json", "parts"),
    }
    for name in names:
        if name.endswith(".png"):
            assert (folder / "out" / name).read_bytes().startswith(b"\x89PNG")
    output = (folder / "said").read_text()
    assert "record: Record('beginning', 131 samples, dt=0.02 s" in output
    stages = [line for line in output.splitlines() if line.startswith("[")]
    assert stages[0] == "[0/19] NORM_x0.1"
    left, alive = r"(, (\d+ min )?\d+ s left)?", r"(, for \d+ s)?"
    form = re.compile(rf"\[\d+/19\] (finished|figures and tables|[\w-]+_x[\d.]+){left}{alive}")
    assert all(form.fullmatch(line) for line in stages[1:]), stages
    # nothing else scrolls by but which record it is, what is written, and signs of life
    others = [line for line in output.splitlines() if line not in stages]
    assert all(line.startswith(("record: ", "wrote ", "loading, ", "reproduce, ")) for line in others), others
    assert cli.main(arguments(folder, "--seed", "1")) == 2
    assert "`out` must be empty or hold the same study" in capsys.readouterr().err


@pytest.mark.statistical
@pytest.mark.parametrize("multiplier", MULTIPLIERS)
def test_sampled_quantiles_are_the_exact_ones(result, multiplier):
    """5, 50 and 95 % of all parameters within 16 % of the exact 5-95 % width; all ABC draws in the exact set.

    2 x 500 draws are worth 750 to 1000 independent ones; the standard error of the worst quantile, sigma's
    95 % under TN, is then 4 to 4.5 % of the width: with other seeds one step in 500 would fail by chance.
    The seeds are fixed.
    """
    summary = result["summary"].to_dataset().sel(multiplier=multiplier)
    quantiles = ["q05", "q50", "q95"]
    width = summary["exact"].sel(statistic="q95") - summary["exact"].sel(statistic="q05")
    error = (summary["sampled"] - summary["exact"]).sel(statistic=quantiles) / width
    assert float(np.abs(error).max()) < 0.16, error.values.round(3)
    assert float(summary["r_hat"].max()) < 1.03
    low, high = summary["epsilon_interval"].values
    theta = result[f"ABC/x{multiplier:g}/posterior/theta"].values
    assert low * (1 - 1e-12) <= theta.min() <= theta.max() <= high * (1 + 1e-12)
    # negative control: the exact values of another likelihood are far away
    swapped = summary["sampled"].sel(likelihood="TN") - summary["exact"].sel(likelihood="EXP")
    assert float(np.abs(swapped.sel(statistic=quantiles) / width.sel(likelihood="EXP")).max()) > 0.2


@pytest.fixture(scope="module")
def short():
    """A short record, for what is not about numbers."""
    rng = np.random.default_rng(11)
    return Record(rng.normal(size=150), 0.02, name="short")


def small_study(record, **kwargs):
    """The study with few draws."""
    settings = {
        "multipliers": (1.0, 2.0),
        "draws": 60,
        "chains": 2,
        "cores": 1,
        "progressbar": False,
        "random_seed": 0,
    } | kwargs
    return sampling_rate_study(record, **settings)


def test_result_has_everything(result):
    summary = result["summary"].to_dataset()
    assert dict(summary["sampled"].sizes) == {
        "likelihood": 8,
        "multiplier": 2,
        "parameter": 3,
        "statistic": 4,
    }
    assert np.isfinite(summary["sampled"].sel(parameter="theta")).all()
    for kind in ALL_KINDS:
        inferred = {"theta", "sigma", "tau"} & set(result[f"{kind}/x10/posterior"].data_vars)
        for parameter in ("theta", "sigma", "tau"):
            for values in ("sampled", "exact"):
                cell = summary[values].sel(likelihood=kind, parameter=parameter)
                assert np.isfinite(cell).all() if parameter in inferred else np.isnan(cell).all()
    assert result["CAL/x10/calibration"].attrs["n_eff"] > 0


def test_abc_draws_are_inside_the_tolerance_and_follow_from_exp(beginning, result):
    tolerance = result["summary"]["epsilon"].values
    for multiplier, delta in zip(MULTIPLIERS, tolerance, strict=True):
        # of 1000 draws: the standard error of the quantile is 2.1 %, of delta 4.2 %
        sigma = result[f"EXP/x{multiplier:g}/posterior/sigma"]
        assert delta == pytest.approx(abc_tolerance(sigma, paper.N_STOREYS), rel=0.2)
        assert result[f"ABC/x{multiplier:g}"].attrs["epsilon"] == delta
        measured = paper.decimate(
            paper.measurements(beginning, multipliers=MULTIPLIERS, random_seed=0), multiplier * beginning.dt
        ).values
        for theta in result[f"ABC/x{multiplier:g}/posterior/theta"].values.ravel()[::100]:
            mu = simulate(paper.chain(theta), beginning, dt=multiplier * beginning.dt).values
            assert np.mean((measured - mu) ** 2, axis=1).sum() <= delta * (1 + 1e-12)


def test_summary_is_of_the_kept_draws(result):
    sampled = result["summary"]["sampled"]
    for kind, multiplier in itertools.product(sampled["likelihood"].values, sampled["multiplier"].values):
        cell = sampled.sel(likelihood=kind, multiplier=multiplier)
        posterior = result[f"{kind}/x{multiplier:g}/posterior"]
        for parameter in set(posterior.data_vars) - {"log_tau"}:
            expected = posterior[parameter].quantile([0.05, 0.5, 0.95]).values
            got = cell.sel(parameter=parameter, statistic=["q05", "q50", "q95"]).values
            np.testing.assert_allclose(got, expected, rtol=1e-12)


def test_table_holds_sampled_and_exact(result):
    posteriors, trends, agreement = as_markdown(result).split("\n## ")
    csv = as_csv(result).splitlines()
    n_rows = 2 * (2 + 2 + 2 + 1 + 1 + 2 + 3 + 2)  # steps x parameters of the eight likelihoods
    assert len(csv) == 1 + n_rows
    for table, rows in ((posteriors, n_rows), (trends, 8), (agreement, 2)):
        lines = [line for line in table.splitlines() if line.startswith("|")]
        assert len(lines) == 2 + rows
        assert len({line.count("|") for line in lines}) == 1
    row = dict(zip(csv[0].split(","), csv[1].split(","), strict=True))
    cell = result["summary"].to_dataset().sel(likelihood="NORM", multiplier=0.1, parameter="theta")
    assert float(row["exact 5 %"]) == float(cell["exact"].sel(statistic="q05"))
    assert float(row["95 %"]) == float(cell["sampled"].sel(statistic="q95"))


def test_interrupted_study_continues_with_the_same_numbers(short, tmp_path, monkeypatch):
    """Stopped in the second part: another call samples only what is missing, and the result is the same."""
    run, calls, kinds = study_module.run_part, [], ["TN"]
    whole = small_study(short, likelihoods=kinds)

    def stop_at_second(study, kind, multiplier, *args):
        if len(calls) == 1:
            raise KeyboardInterrupt
        calls.append((kind, multiplier))
        return run(study, kind, multiplier, *args)

    monkeypatch.setattr(study_module, "run_part", stop_at_second)
    with pytest.raises(KeyboardInterrupt):
        small_study(short, out=tmp_path, likelihoods=kinds)
    assert sorted(p.name for p in (tmp_path / "parts").glob("*.nc")) == ["TN_x1.nc"]

    resumed = []

    def record_calls(study, kind, multiplier, *args):
        resumed.append((kind, multiplier))
        return run(study, kind, multiplier, *args)

    monkeypatch.setattr(study_module, "run_part", record_calls)
    result = small_study(short, out=tmp_path, likelihoods=kinds)
    assert calls == [("TN", 1.0)]
    assert resumed == [("TN", 2.0)]
    xr.testing.assert_equal(result["summary"]["sampled"], whole["summary"]["sampled"])
    whole.to_netcdf(tmp_path / "study.nc", engine="h5netcdf")
    with xr.open_datatree(tmp_path / "study.nc", engine="h5netcdf") as again:
        for path in ("summary", "data", "TN/x1/posterior", "TN/x2/sample_stats"):
            xr.testing.assert_equal(again[path].to_dataset(), whole[path].to_dataset())


def test_folder_of_another_study_is_refused(short, tmp_path):
    (tmp_path / "study.json").write_text(json.dumps({"draws": 7}))
    with pytest.raises(StudyMismatchError, match="`out` must be empty or hold the same study, got"):
        small_study(short, out=tmp_path)


@pytest.mark.parametrize("names", [("linear", "bouc-wen"), ("bouc-wen", "linear")])
def test_folder_of_another_structure_is_refused(short, tmp_path, names):
    first, second = (
        Study(short, random_seed=0, structure=name, likelihoods=["TN"]).settings() for name in names
    )
    PartStore(tmp_path, first)
    PartStore(tmp_path, first)
    with pytest.raises(StudyMismatchError, match="hold the same study, got .* structure = .* instead of"):
        PartStore(tmp_path, second | {key: first[key] for key in first if key != "structure"})


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
