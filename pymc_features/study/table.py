"""The study as a table: sampled quantiles beside the exact ones."""

import csv
import io
from itertools import product

import numpy as np
import xarray as xr

from pymc_features.study.findings import (
    AGREEMENT_COLUMNS,
    DUCTILITY_COLUMNS,
    agreement_rows,
    ductility_rows,
    trend_rows,
    yielding,
)

COLUMNS = (
    "likelihood",
    "step / record step",
    "parameter",
    "MAP",
    "5 %",
    "50 %",
    "95 %",
    "exact MAP",
    "exact 5 %",
    "exact 50 %",
    "exact 95 %",
    "largest error / exact width",
    "R-hat",
    "ESS",
    "seconds",
)


def study_rows(result: xr.DataTree) -> list[list]:
    """Return one row for each likelihood, sampling step and parameter, in the order of `COLUMNS`.

    The error is that of the worst of the three quantiles over the exact 5-95 % width.
    """
    summary = result["summary"].to_dataset()
    rows = []
    for kind, multiplier, parameter in product(*(summary[d].values for d in summary["exact"].dims[:3])):
        cell = summary.sel(likelihood=kind, multiplier=multiplier, parameter=parameter)
        sampled, exact = cell["sampled"].values, cell["exact"].values
        if np.isnan(exact[1]):  # ABC has no sigma, and most have no tau
            continue
        error = abs(sampled[1:] - exact[1:]).max() / (exact[3] - exact[1])
        numbers = *sampled, *exact, error, cell["r_hat"], cell["ess_bulk"], cell["seconds"]
        rows.append([str(kind), float(multiplier), str(parameter), *map(float, numbers)])
    return rows


def as_markdown(result: xr.DataTree) -> str:
    """Return all tables in Markdown; theta is dimensionless, sigma in m/s^2, tau and times in seconds."""
    summary = result["summary"].to_dataset()
    steps = [f"width at {m:g}" for m in summary["multiplier"].values]
    tables = [
        (
            "Posteriors",
            COLUMNS,
            ("{}", "{:g}", "{}", *["{:.8g}"] * 8, "{:.1%}", "{:.3f}", "{:.0f}", "{:.1f}"),
            study_rows(result),
        ),
        (
            "What the sampling rate does to the 5-95 % width of theta (exact)",
            ("likelihood", "errors", *steps, "as the step shrinks, the interval"),
            ("{}", "{}", *["{:.3g}"] * len(steps), "{}"),
            trend_rows(result),
        ),
        (
            "ABC beside EXP and TN",
            AGREEMENT_COLUMNS,
            ("{:g}", "{:.6g}", *["{:.8g}"] * 8, "{:.3f}", "{:.3f}"),
            agreement_rows(result),
        ),
        (
            f"Springs at the true theta: {yielding(result)}",
            DUCTILITY_COLUMNS,
            ("{:d}", "{:.4g}", "{:.4g}", "{:.3g}"),
            ductility_rows(result),
        ),
    ]
    return "\n".join(markdown_table(*table) for table in tables if table[-1])


def markdown_table(title, columns, formats, rows) -> str:
    """A heading and a table; numbers to the right."""
    marks = (" --- " if form == "{}" else " ---: " for form in formats)
    lines = [f"## {title}\n", "| " + " | ".join(columns) + " |", "|" + "|".join(marks) + "|"]
    for row in rows:
        cells = [form.format(value) for form, value in zip(formats, row, strict=True)]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def as_csv(result: xr.DataTree) -> str:
    """Return the table as comma-separated values with full precision."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([COLUMNS, *study_rows(result)])
    return text.getvalue()
