"""The study as a table: sampled quantiles beside the exact ones."""

import csv
import io

import xarray as xr

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
    for kind in summary["likelihood"].values:
        for multiplier in summary["multiplier"].values:
            for parameter in summary["parameter"].values:
                cell = summary.sel(likelihood=kind, multiplier=multiplier, parameter=parameter)
                sampled, exact = cell["sampled"].values, cell["exact"].values
                if exact[1] != exact[1]:  # NaN: ABC has no sigma
                    continue
                error = abs(sampled[1:] - exact[1:]).max() / (exact[3] - exact[1])
                rows.append(
                    [
                        str(kind),
                        float(multiplier),
                        str(parameter),
                        *map(float, sampled),
                        *map(float, exact),
                        float(error),
                        float(cell["r_hat"]),
                        float(cell["ess_bulk"]),
                        float(cell["seconds"]),
                    ]
                )
    return rows


def as_markdown(result: xr.DataTree) -> str:
    """Return the table in Markdown; theta is dimensionless, sigma in m/s^2, times in seconds."""
    formats = ("{}", "{:g}", "{}", *["{:.8g}"] * 8, "{:.1%}", "{:.3f}", "{:.0f}", "{:.1f}")
    lines = [
        "| " + " | ".join(COLUMNS) + " |",
        "|" + "|".join(" --- " if i in (0, 2) else " ---: " for i in range(len(COLUMNS))) + "|",
    ]
    for row in study_rows(result):
        cells = [form.format(value) for form, value in zip(formats, row, strict=True)]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def as_csv(result: xr.DataTree) -> str:
    """Return the table as comma-separated values with full precision."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(study_rows(result))
    return text.getvalue()
