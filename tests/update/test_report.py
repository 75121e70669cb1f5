"""The page of a report is made from the saved result alone; numbers as people read them."""

import csv
import json
import math
import sys

import numpy as np
import pytest
import xarray as xr

from pymc_features import cli
from pymc_features.update.report import page
from pymc_features.update.report.page import density, extremes, page_of, payload_of, write_page
from pymc_features.update.templates.numbers import (
    COLUMNS,
    Row,
    as_latex,
    cells,
    fixed,
    interval_texts,
    scale_of,
)
from support.commands import run
from support.report_pages import payload, unpacked, words
from support.report_results import large_result

MEGABYTE = 1e6


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A large result as a file."""
    path = tmp_path_factory.mktemp("saved") / "update.nc"
    large_result().to_netcdf(path, engine="h5netcdf")
    return path


@pytest.fixture(scope="module")
def html(saved):
    assert cli.main(["report", str(saved)]) == 0
    return saved.with_name("report.html").read_text()


def test_a_large_page_stays_small(html):
    """10 sensors, 10,000 samples of noise, two likelihoods."""
    assert len(html.encode()) < 6.0 * MEGABYTE
    data = payload(html)
    assert len(json.dumps(data, separators=(",", ":"))) < 1.2 * MEGABYTE
    all_of_them, most = data["measured"]["samples"]
    assert all_of_them == 10_000 and 1000 < most < 10_000  # thinned, and the page says so


def test_plotly_is_there_once_and_nothing_is_loaded(html):
    assert html.count("plotly.js v") == 1
    assert not any(text in words(html) for text in ("http://", "https://", "<link", "src="))
    assert "&lt;/script&gt;&lt;script&gt;throw 1" in html  # of the configuration


@pytest.mark.processes
def test_it_needs_neither_pymc_nor_pytensor(saved, tmp_path):
    code = (
        "import sys\nfrom pymc_features.cli import main\n"
        f"assert main(['report', {str(saved)!r}, '--out', {str(tmp_path / 'again.html')!r}]) == 0\n"
        "print(sorted({'pymc', 'pytensor', 'arviz', 'numba', 'matplotlib'} & set(sys.modules)))"
    )
    assert run(sys.executable, "-c", code).strip() == "[]"
    assert (tmp_path / "again.html").read_text() == saved.with_name("report.html").read_text()


def test_its_numbers_are_those_of_the_table(html):
    table = list(csv.reader(payload(html, "files")["table.csv"].splitlines()))[1:]
    text = words(html)
    part = text[text.index("<table>") : text.index("</table>")]
    rows = [[cell.partition("</td>")[0] for cell in row.split("<td>")[1:]] for row in part.split("<tr")[2:]]
    assert [row[:2] for row in rows] == [row[:2] for row in table]
    for shown, number in zip(rows, table, strict=True):
        assert shown[2] == "MN/m"
        half = np.array([0.5 * 10.0 ** -len(cell.partition(".")[2]) for cell in shown[3:8]])
        assert (abs(np.array(shown[3:8], float) - 1e-6 * np.array(number[3:8], float)) <= 1.001 * half).all()


def test_series_of_the_page_are_those_of_the_result(html, saved):
    data, result = payload(html), xr.open_datatree(saved, engine="h5netcdf").load()
    time, observed = result["NORM/observed_data"]["time"].values, result["NORM/observed_data"]["y"].values
    low, median, _ = result["NORM/bands"]["response"].values
    for k in (0, 7):
        at = np.rint(unpacked(data["measured"]["time"][k]) / 0.005).astype(int)
        assert (np.diff(at) > 0).all() and at[-1] < time.size
        np.testing.assert_allclose(unpacked(data["measured"]["values"][k]), observed[k, at], atol=2e-4)
        one = data["of"]["NORM"]["responses"]["sensors"][k]
        np.testing.assert_allclose(unpacked(one["median"]), median[k, at], atol=2e-4)
        np.testing.assert_allclose(unpacked(one["low"]), (median - low)[k, at], atol=0.02)
    draws = data["of"]["NORM"]["draws"]
    assert draws["known"] == 200 and draws["names"] == [f"k{k}" for k in range(6)]
    first = result["NORM/posterior"]["k0"].sel(chain=1, draw=10).item()  # the second of the second chain
    assert unpacked(draws["values"][0])[101] == pytest.approx(1e-6 * first, rel=1e-4)


def test_what_is_no_result_is_refused(tmp_path, capsys):
    assert cli.main(["report", str(tmp_path / "nothing.nc")]) == 2
    assert "`RESULT` must be an existing file" in capsys.readouterr().err
    (tmp_path / "text.nc").write_text("no netCDF")
    with pytest.raises(ValueError, match="`RESULT` must be the update.nc of an update"):
        write_page(tmp_path / "text.nc")
    xr.DataTree(xr.Dataset({"x": 1.0})).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    with pytest.raises(ValueError, match="`RESULT` must hold the words of its report, .*has none"):
        write_page(tmp_path / "other.nc")


def test_a_long_document_is_saved_whole(tmp_path):
    """An attribute of HDF5 holds 64 KiB, unless it is a text of variable length."""
    result = large_result(("NORM",), sensors=1, samples=300)
    result.attrs["document"] = result.attrs["document"].replace("All of it", "x" * 300_000)
    result.to_netcdf(tmp_path / "long.nc", engine="h5netcdf")
    assert "x" * 300_000 in write_page(tmp_path / "long.nc").read_text()


def test_groups_that_are_missing_are_left_out():
    result = large_result(("NORM",), sensors=2, samples=400)
    of_figures = ["bands", "histories", "modal", "mode_shapes", "sample_stats", "sequence"]
    result["NORM"] = result["NORM"].drop_nodes(of_figures)
    result = result.drop_nodes(["data", "geometry"])
    data = payload_of(result)
    assert not {"measured", "geometry", "data", "spectra"} & set(data)
    assert {name for name, value in data["of"]["NORM"].items() if value} == {"parameters", "draws", "ranks"}
    assert 'data-figure="response"' not in page_of(result)


# ---- arrays ----


def test_thinned_series_keep_every_extreme():
    """In each part of the record; taking every n-th sample, the negative control, misses them."""
    rng = np.random.default_rng(1)
    rows = rng.standard_normal((2, 10_000))
    kept = extremes(rows, 800)
    assert kept.size <= 800 and (np.diff(kept) > 0).all()
    edges = np.linspace(0, 10_000, 201).astype(int)
    even = np.arange(0, 10_000, 13)

    def misses(chosen):
        parts = [(row[a:b], row[chosen[(chosen >= a) & (chosen < b)]]) for row in rows for a, b in pairs]
        return sum(whole.max() > some.max() or whole.min() < some.min() for whole, some in parts)

    pairs = list(zip(edges[:-1], edges[1:], strict=True))
    assert misses(kept) == 0 and misses(even) > 300
    assert extremes(rows[:, :300], 800).tolist() == list(range(300))


def test_density_is_that_of_the_draws():
    """Of a normal and of a uniform distribution, whose edges a kernel without mirror would lower by half."""
    rng = np.random.default_rng(2)
    x, y = density(rng.normal(3.0, 0.5, 200_000))
    np.testing.assert_allclose(y, np.exp(-0.5 * ((x - 3.0) / 0.5) ** 2), atol=0.03)
    x, y = density(rng.uniform(0.0, 1.0, 200_000))
    assert y[0] > 0.9 and y[-1] > 0.9


def test_the_budget_is_shared_by_all_likelihoods():
    sizes = []
    for kinds in (("CAL",), ("CAL", "NORM", "EXP", "TN", "ABC")):
        result = large_result(kinds, sensors=4, samples=6000)
        data = payload_of(result)
        sizes.append(sum(len(json.dumps(data["of"][kind]["responses"])) for kind in kinds))
        assert len(json.dumps(data)) < 1.2 * MEGABYTE
    assert max(sizes) < 1.2 * page.BUDGET


# ---- numbers ----

NONE = math.nan
STIFFNESS = Row("CAL", "k_1", "N/m", 2.187e7, 2.1994e7, 2.21e7, 2.2e7, 1.5e5, 0.98, 1.0002, 1931.2, 0.1)
FREQUENCY = Row("CAL", "f1", "Hz", 1.30214, 1.30220, 1.30231, 1.3022, 9e-5, NONE, NONE, NONE, NONE)


@pytest.mark.parametrize(
    ("value", "sd", "unit", "text"),
    [
        (2.1994e7, 1.5e5, "N/m", "21.99 MN/m"),
        (3.4e-4, 2e-5, "-", "340 10⁻⁶"),
        (1.05e6, 2e4, "N^2/Hz", "1.050 10⁶ N²/Hz"),
        (8e-3, 8.4e-5, "m", "8.000 mm"),
        (1.6e5, 2e3, "kg", "160.0 t"),
        (0.14, 0.01, "kg", "140 g"),
        (0.0855, 1.1e-3, "m/s^2", "0.0855 m/s²"),
        (0.02, 1e-3, "s", "20.0 ms"),
        (-5e3, 1e2, "N", "-5.00 kN"),
        (0.0, 1e-3, "m/s^2", "0.0000 m/s²"),
        (1.3, 0.0, "Hz", "1.300 Hz"),
    ],
)
def test_a_value_with_its_unit(value, sd, unit, text):
    scale = scale_of(value, unit)
    [number] = fixed([value], sd, scale)
    assert f"{number} {scale.unit}" == text


def test_rows_have_two_digits_of_the_standard_deviation():
    """And one prefix under all likelihoods, whatever the sign of the mean."""
    stiffness, frequency = cells([STIFFNESS, FREQUENCY])
    assert stiffness[1:] == (
        "k_1",
        "MN/m",
        "21.87",
        "21.99",
        "22.10",
        "22.00",
        "0.15",
        "0.98",
        "1.000",
        "1931",
    )
    assert frequency[1:8] == ("f1", "Hz", "1.302140", "1.302200", "1.302310", "1.302200", "0.000090")
    assert frequency[8:] == ("", "", "")
    other = STIFFNESS._replace(kind="TN", q05=4e5, q50=9e5, q95=9.9e5)
    assert [row[2] for row in cells([STIFFNESS, other])] == ["MN/m", "MN/m"]
    assert scale_of(-2e7, "N/m") == scale_of(2e7, "N/m")
    assert interval_texts((-2e-3, 0.0, 2e-3), "m") == ("mm", ["-2.0", "0.0", "2.0"])


def test_quantiles_that_differ_are_shown_to_differ():
    """Heavy tails: the standard deviation alone would round two of them to zero."""
    heavy = Row("TN", "q", "-", 1e-3, 2e-3, 40.0, 10.0, 90.0, 0.0, 1.0, 500.0, 0.9)
    assert cells([heavy])[0][3:6] == ("0.001", "0.002", "40.000")
    equal = Row("TN", "q", "-", 1.0, 1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 500.0, 0.0)
    assert cells([equal])[0][3:6] == ("1.000", "1.000", "1.000")


def test_latex_needs_no_package():
    text = as_latex([STIFFNESS, FREQUENCY._replace(unit="m^2/s^3", q05=1e-6, q50=2e-6, q95=3e-6, sd=1e-6)])
    assert text.startswith("\\begin{tabular}{lllrrrrrrrr}") and text.rstrip().endswith("\\end{tabular}")
    assert "CAL & k\\_1 & MN/m & 21.87 & 21.99 & 22.10 & 22.00 & 0.15 & 0.98 & 1.000 & 1931 \\\\" in text
    assert "10$^{-6}$ m$^{2}$/s$^{3}$" in text and "5 \\%" in text
    assert {line.count("&") for line in text.splitlines() if "&" in line} == {len(COLUMNS) - 1}
