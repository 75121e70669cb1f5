"""Numbers as people read them: prefixes, digits from the standard deviation, the table as CSV and LaTeX."""

import csv
import math

import numpy as np
import pytest

from pymc_features.update.templates.numbers import (
    COLUMNS,
    Row,
    as_csv,
    as_latex,
    cells,
    fixed,
    interval_texts,
    scale_of,
)

NONE = math.nan
STIFFNESS = Row("CAL", "k_1", "N/m", 2.187e7, 2.1994e7, 2.21e7, 2.2e7, 1.5e5, 0.98, 1.0002, 1931.2, 0.1)
FREQUENCY = Row("CAL", "f1", "Hz", 1.30214, 1.30220, 1.30231, 1.3022, 9e-5, NONE, NONE, NONE, NONE)


@pytest.mark.parametrize(
    ("value", "sd", "unit", "text"),
    [
        (2.1994e7, 1.5e5, "N/m", "21.99 MN/m"),
        (430.0, 5.2, "N/m", "430.0 N/m"),
        (0.0203, 3e-4, "-", "0.02030 -"),
        (3.4e-4, 2e-5, "-", "340 10⁻⁶"),
        (1.05e6, 2e4, "N^2/Hz", "1.050 10⁶ N²/Hz"),
        (8e-3, 8.4e-5, "m", "8.000 mm"),
        (0.15, 0.01, "m", "0.150 m"),
        (1.6e5, 2e3, "kg", "160.0 t"),
        (0.14, 0.01, "kg", "140 g"),
        (1200.0, 30.0, "-", "1200 -"),
        (0.0855, 1.1e-3, "m/s^2", "0.0855 m/s²"),
        (1.302, 9e-5, "Hz", "1.302000 Hz"),
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


def test_columns_begin_with_the_quantiles():
    assert COLUMNS[3:] == ("5 %", "50 %", "95 %", "mean", "sd", "learned", "R-hat", "ESS")


def test_rows_have_two_digits_of_the_standard_deviation():
    stiffness, frequency = cells([STIFFNESS, FREQUENCY])
    assert stiffness == (
        *("CAL", "k_1", "MN/m", "21.87", "21.99", "22.10", "22.00", "0.15"),
        *("0.98", "1.000", "1931"),
    )
    assert frequency == (
        *("CAL", "f1", "Hz", "1.302140", "1.302200", "1.302310", "1.302200", "0.000090"),
        *("", "", ""),
    )


def test_quantiles_that_differ_are_shown_to_differ():
    """Heavy tails: the standard deviation alone would round two of them to zero."""
    heavy = Row("TN", "q", "-", 1e-3, 2e-3, 40.0, 10.0, 90.0, 0.0, 1.0, 500.0, 0.9)
    assert cells([heavy])[0][3:6] == ("0.001", "0.002", "40.000")
    equal = Row("TN", "q", "-", 1.0, 1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 500.0, 0.0)
    assert cells([equal])[0][3:6] == ("1.000", "1.000", "1.000")


def test_a_parameter_has_one_prefix_under_all_likelihoods():
    other = STIFFNESS._replace(kind="TN", q05=4e5, q50=9e5, q95=9.9e5)
    assert [row[2] for row in cells([STIFFNESS, other])] == ["MN/m", "MN/m"]


def test_the_sign_of_the_mean_does_not_choose_the_prefix():
    assert scale_of(-2e7, "N/m") == scale_of(2e7, "N/m")
    assert interval_texts((-2e-3, 0.0, 2e-3), "m") == ("mm", ["-2.0", "0.0", "2.0"])


def test_rounded_numbers_are_those_of_the_file():
    """Random rows: each text is the number of `table.csv` to half of its last digit."""
    rng = np.random.default_rng(3)
    table = []
    for unit in ("N/m", "Hz", "-", "m/s^2", "kg", "m", "s", "m^2/s^3"):
        for _ in range(40):
            middle = 10.0 ** rng.uniform(-8, 10)
            draws = middle * np.exp(10.0 ** rng.uniform(-6, 0.5) * rng.standard_normal(100))
            quantiles = np.quantile(draws, [0.05, 0.5, 0.95])
            name = f"p{len(table)}"
            table.append(Row("EXP", name, unit, *quantiles, draws.mean(), draws.std(), 0.5, 1.0, 99.0, 0.5))
    told = list(csv.reader(as_csv(table).splitlines()))
    assert tuple(told[0]) == COLUMNS
    for row, shown, saved in zip(table, cells(table), told[1:], strict=True):
        factor = scale_of(max(map(abs, row[3:6])), row.unit).factor
        for text, number in zip(shown[3:8], map(float, saved[3:8]), strict=True):
            half = 0.5 * 10.0 ** -len(text.partition(".")[2])
            assert abs(float(text) - number / factor) <= 1.001 * half + 1e-9 * abs(number / factor), (
                row,
                shown,
            )
        assert len(set(shown[3:6])) == 3


def test_latex_needs_no_package():
    text = as_latex([STIFFNESS, FREQUENCY._replace(unit="m^2/s^3", q05=1e-6, q50=2e-6, q95=3e-6, sd=1e-6)])
    assert text.startswith("\\begin{tabular}{lllrrrrrrrr}") and text.rstrip().endswith("\\end{tabular}")
    assert "CAL & k\\_1 & MN/m & 21.87 & 21.99 & 22.10 & 22.00 & 0.15 & 0.98 & 1.000 & 1931 \\\\" in text
    assert "10$^{-6}$ m$^{2}$/s$^{3}$" in text and "5 \\%" in text
    assert {line.count("&") for line in text.splitlines() if "&" in line} == {len(COLUMNS) - 1}
