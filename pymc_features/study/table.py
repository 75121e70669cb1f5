"""What the study says: sampled quantiles beside the exact ones, and in words what they mean."""

import csv
import io
from itertools import product
from typing import NamedTuple

import numpy as np
import xarray as xr

from pymc_features.likelihoods import LIKELIHOODS

# a fine step shortens an interval, or lengthens it, by this exponent of the step where it matters at all
NO_TREND = 0.05


class Table(NamedTuple):
    """A title, the columns with the formats of their values, and rows of values."""

    title: str
    columns: dict[str, str]
    rows: list[list]

    def as_markdown(self) -> str:
        """A heading and a table; numbers to the right."""
        marks = (" --- " if form == "{}" else " ---: " for form in self.columns.values())
        lines = [f"## {self.title}\n", "| " + " | ".join(self.columns) + " |", "|" + "|".join(marks) + "|"]
        for row in self.rows:
            cells = [form.format(value) for form, value in zip(self.columns.values(), row, strict=True)]
            lines.append("| " + " | ".join(cells) + " |")
        return "\n".join(lines) + "\n"


def as_markdown(result: xr.DataTree) -> str:
    """Return all tables in Markdown; theta is dimensionless, sigma in m/s^2, tau and times in seconds."""
    tables = (posteriors(result), trends(result), agreement(result), springs(result))
    return "\n".join(table.as_markdown() for table in tables if table.rows)


def as_csv(result: xr.DataTree) -> str:
    """Return the table of the posteriors as comma-separated values with full precision."""
    text, table = io.StringIO(), posteriors(result)
    csv.writer(text, lineterminator="\n").writerows([list(table.columns), *table.rows])
    return text.getvalue()


def posteriors(result: xr.DataTree) -> Table:
    """One row for each likelihood, sampling step and parameter.

    The error is that of the worst of the three quantiles over the exact 5-95 % width.
    """
    summary, rows = result["summary"].to_dataset(), []
    for kind, multiplier, parameter in product(*(summary[d].values for d in summary["exact"].dims[:3])):
        cell = summary.sel(likelihood=kind, multiplier=multiplier, parameter=parameter)
        sampled, exact = cell["sampled"].values, cell["exact"].values
        if np.isnan(exact[1]):  # ABC has no sigma, and most have no tau
            continue
        error = abs(sampled[1:] - exact[1:]).max() / (exact[3] - exact[1])
        numbers = *sampled, *exact, error, cell["r_hat"], cell["ess_bulk"], cell["seconds"]
        rows.append([str(kind), float(multiplier), str(parameter), *map(float, numbers)])
    statistics = ("MAP", "5 %", "50 %", "95 %")
    columns = {"likelihood": "{}", "step / record step": "{:g}", "parameter": "{}"}
    columns |= {f"{which}{name}": "{:.8g}" for which in ("", "exact ") for name in statistics}
    columns |= {
        "largest error / exact width": "{:.1%}",
        "R-hat": "{:.3f}",
        "ESS": "{:.0f}",
        "seconds": "{:.1f}",
    }
    return Table("Posteriors", columns, rows)


def intervals(result: xr.DataTree, kind: str, values: str = "exact") -> np.ndarray:
    """Ends of the 5-95 % interval of theta (multiplier, 2)."""
    summary = result["summary"].to_dataset()
    return summary[values].sel(likelihood=kind, parameter="theta", statistic=["q05", "q95"]).values


def widths(result: xr.DataTree, kind: str) -> np.ndarray:
    """Exact 5-95 % width of theta at each sampling step (multiplier,)."""
    return np.diff(intervals(result, kind), axis=1)[:, 0]


def trends(result: xr.DataTree) -> Table:
    """For each likelihood its meaning, exact widths of theta, and what they say about the sampling rate."""
    summary = result["summary"].to_dataset()
    steps, rows = summary["multiplier"].values, []
    for kind in map(str, summary["likelihood"].values):
        width = widths(result, kind)
        rows.append([kind, LIKELIHOODS[kind].meaning, *map(float, width), verdict(kind, steps, width)])
    columns = {"likelihood": "{}", "errors": "{}"} | {f"width at {step:g}": "{:.3g}" for step in steps}
    columns["as the step shrinks, the interval"] = "{}"
    return Table("What the sampling rate does to the 5-95 % width of theta (exact)", columns, rows)


def verdict(kind: str, steps, width) -> str:
    """What a finer sampling does to an interval, from its widths at the two smallest steps."""
    if len(steps) < 2:
        return "one sampling step only"
    exponent = np.log(width[1] / width[0]) / np.log(steps[1] / steps[0])
    if abs(exponent) <= NO_TREND:
        return f"settles: {abs(width[0] / width[1] - 1.0):.2%} between the two smallest steps"
    trend = "narrows" if exponent > 0 else "widens"
    reason = LIKELIHOODS[kind].reasons.get(trend)
    return f"{trend} as the step shrinks, like its power {exponent:.2g}" + (f": {reason}" if reason else "")


def agreement(result: xr.DataTree) -> Table:
    """ABC beside EXP and TN at each sampling step; empty without ABC.

    Tolerance, ends of the exact set {theta: rho <= delta}, the smallest and largest draw, the 5-95 %
    intervals of ABC, sampled and exact, and the exact widths of EXP and TN over that of ABC.
    """
    summary, rows = result["summary"].to_dataset(), []
    kinds = list(map(str, summary["likelihood"].values))
    for j, multiplier in enumerate(summary["multiplier"].values if "ABC" in kinds else []):
        draws = result[f"ABC/x{multiplier:g}/posterior"]["theta"].values
        ends = *summary["epsilon_interval"].values[j], draws.min(), draws.max()
        quantiles = *intervals(result, "ABC", "sampled")[j], *intervals(result, "ABC")[j]
        abc = widths(result, "ABC")[j]
        ratios = [widths(result, kind)[j] / abc if kind in kinds else np.nan for kind in ("EXP", "TN")]
        rows.append([*map(float, (multiplier, summary["epsilon"][j], *ends, *quantiles, *ratios))])
    columns = {"step / record step": "{:g}", "delta": "{:.6g}"}
    places = ("set from", "set to", "smallest draw", "largest draw", "5 %", "95 %", "exact 5 %", "exact 95 %")
    columns |= dict.fromkeys(places, "{:.8g}")
    columns |= dict.fromkeys(("width EXP / ABC", "width TN / ABC"), "{:.3f}")
    return Table("ABC beside EXP and TN", columns, rows)


def springs(result: xr.DataTree) -> Table:
    """Number, yield displacement [m], largest drift [m] and their ratio of each spring that can yield."""
    rows = []
    if "loops" in result.children:
        loops = result["loops"].to_dataset()
        peaks = abs(loops["drift"]).max("time")
        values = (loops["spring"], loops["yield_displacement"], peaks, loops["ductility"])
        rows = [[int(i), *map(float, row)] for i, *row in zip(*(v.values for v in values), strict=True)]
    columns = {"spring": "{:d}", "yield displacement [m]": "{:.4g}", "largest drift [m]": "{:.4g}"}
    return Table(f"Springs at the true theta: {yielding(result)}", columns | {"ductility": "{:.3g}"}, rows)


def yielding(result: xr.DataTree) -> str:
    """How far the springs yield, in words; empty if they cannot."""
    if "loops" not in result.children:
        return ""
    ductility = result["loops"]["ductility"].values
    n, most = int((ductility > 1.0).sum()), int(ductility.argmax())
    if n == 0:
        return (
            f"no spring reaches its yield displacement (at most {ductility[most]:.2g} of it, spring {most}): "
            "this says little about structures that yield"
        )
    return (
        f"{n} of {len(ductility)} springs drift beyond their yield displacement, "
        f"at most {ductility[most]:.2g} times as far (spring {most})"
    )
