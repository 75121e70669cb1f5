"""The study's result: sampled and exact statistics side by side, what they mean, tables and files."""

import csv
import io
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from pymc_features import plots
from pymc_features.likelihoods import LIKELIHOODS
from pymc_features.simulators import spring_forces
from pymc_features.storage import netcdf_bytes, write_atomically
from pymc_features.study.exact import (
    PARAMETERS,
    PROBABILITIES,
    STATISTICS,
    exact_interval,
    exact_tolerance,
    reference,
)

# a fine step shortens an interval, or lengthens it, by this exponent of the step where it matters at all
NO_TREND = 0.05
BOTH = ["theta", "sigma"]
FIGURES = {  # likelihoods and parameters; those with all their likelihoods in the study are drawn
    "fig2_theta.png": (["TN", "NORM"], ["theta"]),
    "fig3_sigma.png": (["TN", "NORM"], ["sigma"]),
    "fig4_exp_norm_abc.png": (["EXP", "NORM", "ABC"], BOTH),
    "fig5_correlated.png": (["NORM", "CN", "CN-SIGMA", "CN-TAU"], BOTH),
}


def assemble(study, parts: dict, shown) -> xr.DataTree:
    """Put the sampled parts and the exact posteriors side by side; see `study.sampling_rate_study`.

    `shown` is called with what is in work and the number of parts that are finished.
    """
    columns = []
    for j, multiplier in enumerate(study.multipliers):
        shown(f"exact_x{multiplier:g}", len(parts) + j)
        step, has_abc = study.misfit(multiplier), "ABC" in study.likelihoods
        rows = [cell(reference(kind, step), parts[kind, multiplier]) for kind in study.likelihoods]
        column = xr.concat(rows, "likelihood")
        column["epsilon"] = exact_tolerance(step) if has_abc else np.nan
        column["epsilon_interval"] = "end", list(exact_interval(step)) if has_abc else [np.nan, np.nan]
        columns.append(column.assign(step=((), step.dt, {"units": "s"})))
    summary = xr.concat(columns, "multiplier").assign_coords(
        likelihood=list(study.likelihoods),
        multiplier=list(study.multipliers),
        parameter=list(PARAMETERS),
        statistic=list(STATISTICS),
        end=["low", "high"],
    )
    summary = summary.transpose("likelihood", "multiplier", "parameter", "statistic", "end")
    groups = {"/summary": summary, "/data": data_of(study)}
    if not study.at().is_linear:
        groups["/loops"] = loops_of(study)
    tree = xr.DataTree.from_dict(groups)
    for (kind, multiplier), part in parts.items():
        tree[f"/{kind}/x{multiplier:g}"] = part
    tree.attrs = {key: value for key, value in study.settings().items() if not isinstance(value, list)}
    tree.attrs |= {"structure": study.structure.name, "title": study.title}
    return tree


def data_of(study) -> xr.Dataset:
    """The record, and the finest measurements."""
    record = study.record
    return xr.Dataset(
        {
            "ground_acceleration": ("record_time", record.acceleration, {"units": "m/s^2"}),
            "measured": study.finest.drop_attrs(),
        },
        coords={"record_time": ("record_time", record.time, {"units": "s"})},
        attrs={"record": record.name},
    )


def loops_of(study) -> xr.Dataset:
    """Force and drift of every spring at the true theta, and the largest drift over that of yielding."""
    structure = study.at()
    loops = spring_forces(structure, study.record)[["force", "drift"]]
    limit = np.broadcast_to(structure.yield_displacement, structure.n_dof)
    loops["yield_displacement"] = ("spring", limit, {"units": "m"})
    loops["ductility"] = abs(loops["drift"]).max("time") / loops["yield_displacement"]
    return loops


def cell(reference, part) -> xr.Dataset:
    """Statistics of one likelihood at one sampling step, sampled and exact; NaN of what it does not infer.

    The maximum of the draws is the draw of the highest density. There is no R-hat of one chain.
    """
    import arviz as az  # here: half a second that a mere import of the package need not take

    posterior = part["posterior"].to_dataset()
    posterior = posterior[[name for name in PARAMETERS if name in posterior]]
    draws = {name: values.values.ravel() for name, values in posterior.data_vars.items()}
    best = reference.log_density(draws).argmax()
    sampled = {name: [x[best], *np.quantile(x, PROBABILITIES)] for name, x in draws.items()}
    r_hat = az.rhat(posterior) if posterior.sizes["chain"] > 1 else {}
    ess = az.ess(posterior, method="bulk")
    unknown = [np.nan] * len(STATISTICS)
    return xr.Dataset(
        {
            "sampled": (("parameter", "statistic"), [sampled.get(name, unknown) for name in PARAMETERS]),
            "exact": (("parameter", "statistic"), reference.statistics),
            "r_hat": ("parameter", [float(r_hat.get(name, np.nan)) for name in PARAMETERS]),
            "ess_bulk": ("parameter", [float(ess.get(name, np.nan)) for name in PARAMETERS]),
            "seconds": part.attrs["seconds"],
            "log_evidence": reference.log_evidence,
        }
    )


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
    """Effect of a finer sampling on an interval, in words, from its widths at the two smallest steps."""
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


def write_outputs(result: xr.DataTree, folder: Path) -> list[Path]:
    """Write figures, tables and the result into `folder`; return their paths."""

    def save(axes):
        return lambda path: axes[0].figure.savefig(path, dpi=150, format="png")

    figures = {"fig1_record.png": plots.record(result)}
    known = set(result["summary"]["likelihood"].values)
    for name, (likelihoods, parameters) in FIGURES.items():
        if known.issuperset(likelihoods):
            figures[name] = plots.sampling_rate(result, likelihoods, parameters=parameters)
    figures["fig6_widths.png"] = plots.widths(result)
    if "loops" in result.children:
        figures["fig7_loops.png"] = plots.loops(result)
    writers = {name: save(axes) for name, axes in figures.items()}
    writers["table.md"] = lambda path: path.write_text(as_markdown(result), encoding="utf-8")
    writers["table.csv"] = lambda path: path.write_text(as_csv(result), encoding="utf-8")
    writers["study.nc"] = lambda path: path.write_bytes(netcdf_bytes(result))
    for name, write in writers.items():
        write_atomically(folder / name, write)
    plots.close(axes[0] for axes in figures.values())
    return [folder / name for name in writers]
