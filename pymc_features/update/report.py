"""One page with everything: self-contained HTML, figures embedded."""

import base64
import importlib.metadata
from html import escape

import numpy as np

from pymc_features.update.problem import Problem
from pymc_features.update.summary import COLUMNS, kinds_of

MEANING = {
    "NORM": "every sample an independent Gaussian observation, Eq. (2)",
    "TN": "half-normal on the root mean square of each sensor, Eq. (7)",
    "EXP": "exponential on the mean square of each sensor, Eq. (9)",
    "ABC": "likelihood-free: sum of the mean squares within a tolerance, Eqs. (14)-(15)",
}
STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #222; max-width: 60rem }
body { margin: 2rem auto; padding: 0 1rem }
h1 { font-size: 1.6rem } h2 { margin-top: 2.2rem; border-bottom: 1px solid #ccc; font-size: 1.25rem }
table { border-collapse: collapse; margin: .6rem 0 } th, td { padding: .15rem .6rem; text-align: right }
th { border-bottom: 1px solid #888; font-weight: 600 } td.text, th.text { text-align: left }
tr.group td { border-top: 1px solid #ccc }
figure { margin: 1.2rem 0 } img { max-width: 100% } figcaption { color: #444; font-size: .92rem }
pre { background: #f5f5f5; padding: .8rem; overflow-x: auto; font-size: .85rem }
.doubts { background: #fff6e0; border-left: 4px solid #e0a000; padding: .4rem 1rem }
"""
TEXT_COLUMNS = 3  # of the table of the posterior


def report(problem: Problem, result, table, doubts, drawn) -> str:
    """The page.

    Parameters
    ----------
    problem, result
        As of `write_outputs`.
    table : list of Row
        The posterior.
    doubts : list of str
        Warnings.
    drawn : list of (Figure, bytes)
        Figures as PNG.
    """
    title = escape(problem.config.report.title)
    shared = [pair for pair in drawn if "_" not in pair[0].name]
    parts = [
        f"<h1>{title}</h1>",
        f"<p>{escape(opening(problem, result))}</p>",
        section("Warnings", warnings_html(doubts)),
        section("What was fitted", fitted(problem, result)),
        section("Data used", data_used(problem, result) + images(shared[:1])),
        section("Posterior", posterior_table(table) + LEGEND),
        section("Natural frequencies", images(shared[1:])),
    ]
    for kind in kinds_of(result):
        own = [pair for pair in drawn if pair[0].name.startswith(f"{kind}_")]
        parts.append(section(kind, run_of(result[kind]) + fit_of(result[kind]) + images(own)))
    parts.append(section("Configuration", f"<pre>{escape(problem.text)}</pre>{versions()}"))
    body = "\n".join(parts)
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{title}</title>\n'
        f"<style>{STYLE}</style>\n</head>\n<body>\n{body}\n</body>\n</html>\n"
    )


LEGEND = (
    "<p>Intervals are of 5 to 95 %. <i>learned</i>: the share of the prior's variance that the data took "
    "away; near 0 the posterior is the prior. R-hat compares chains (1: they agree); ESS is the effective "
    "number of draws. f1, f2, ... are natural frequencies, of small motions where springs are nonlinear.</p>"
)


def section(title, html) -> str:
    """A heading and what is below it."""
    return f"<h2>{escape(title)}</h2>\n{html}"


def images(drawn) -> str:
    """Figures with captions, embedded."""
    pages = []
    for figure, image in drawn:
        data = base64.b64encode(image).decode("ascii")
        caption = escape(figure.caption)
        pages.append(
            f'<figure><img alt="{escape(figure.name)}" src="data:image/png;base64,{data}">'
            f"<figcaption>{caption}</figcaption></figure>"
        )
    return "\n".join(pages)


def html_table(header, body, text_columns=1, groups=()) -> str:
    """A table; `groups` are the numbers of rows that start a group."""

    def cells(tag, values):
        return "".join(
            f"<{tag}{' class=text' if i < text_columns else ''}>{escape(str(v))}</{tag}>"
            for i, v in enumerate(values)
        )

    lines = [f"<tr>{cells('th', header)}</tr>"]
    for number, row in enumerate(body):
        mark = ' class="group"' if number in groups else ""
        lines.append(f"<tr{mark}>{cells('td', row)}</tr>")
    return "<table>\n" + "\n".join(lines) + "\n</table>"


def opening(problem, result) -> str:
    """What was done, in two sentences."""
    measured, config = problem.measured, problem.config
    return (
        f"{config.structure.type} updated with {len(problem.dofs)} measured accelerations over "
        f"{measured.record.duration:.4g} s, {len(problem.priors)} uncertain parameters, under "
        f"{', '.join(kinds_of(result))}. Accelerations are absolute and in m/s²."
    )


def warnings_html(doubts) -> str:
    """Warnings as a list."""
    if not doubts:
        return "<p>None.</p>"
    return '<ul class="doubts">' + "".join(f"<li>{escape(text)}</li>" for text in doubts) + "</ul>"


def fitted(problem, result) -> str:
    """Likelihoods and priors."""
    uses = problem.config.uses()
    priors = [
        (name, pretty(problem.unit(name)), repr(prior), ", ".join(key for key, _ in uses[name]))
        for name, prior in problem.priors.items()
    ]
    kinds = [
        (kind, MEANING[kind], result[kind].attrs["method"], f"{result[kind].attrs['seconds']:.0f}")
        for kind in kinds_of(result)
    ]
    return html_table(("prior", "unit", "distribution", "used as"), priors, 4) + html_table(
        ("likelihood", "what it takes for the error", "sampler", "seconds"), kinds, 3
    )


def data_used(problem, result) -> str:
    """Sensors, window and processing."""
    measured, channels = problem.measured, problem.measured.channels
    asked = problem.config.processing
    steps = [f"source: {measured.source}"]
    if asked.detrend is not None:
        over = (
            f" of {asked.detrend.window[0]:g} to {asked.detrend.window[1]:g} s"
            if asked.detrend.window
            else ""
        )
        steps.append(f"less the {asked.detrend.kind} trend{over}")
    if asked.band_pass is not None:
        sides = ("above", asked.band_pass.low), ("below", asked.band_pass.high)
        corners = [f"{side} {corner:g} Hz" for side, corner in sides if corner is not None]
        steps.append(f"filtered to {' and '.join(corners)}")
    if asked.trim is not None:
        steps.append(f"window {asked.trim[0]:g} to {asked.trim[1]:g} s")
    rate = f"{channels.sizes['time']} samples at {measured.step:.6g} s; base at {measured.record.dt:.6g} s"
    header = ("sensor", "degree of freedom", "peak [m/s²]", "rms [m/s²]")
    body = [("base", "", *levels(measured.record.acceleration))]
    for name, dof, values in zip(channels["sensor"].values, problem.dofs, channels.values, strict=True):
        body.append((name, dof, *levels(values)))
    html = f"<p>{escape('; '.join(steps))}. {escape(rate)}.</p>" + html_table(header, body)
    if measured.gains is None:
        return html
    gains = measured.gains
    columns = (
        gains["sensor"].values,
        gains["gain"].values,
        1e3 * gains["lag"].values,
        gains["coherence"].values,
    )
    checked = [(n, f"{g:.3f}", f"{t:.2f}", f"{c:.3f}") for n, g, t, c in zip(*columns, strict=True)]
    band = f"{asked.check_band[0]:g} to {asked.check_band[1]:g} Hz"
    return f"{html}<p>Against the base, in the band {band}:</p>" + html_table(
        ("sensor", "gain [-]", "lag [ms]", "coherence [-]"), checked
    )


def levels(values) -> tuple[str, str]:
    """Peak and root mean square."""
    return f"{np.abs(values).max():.4g}", f"{np.sqrt(np.mean(values**2)):.4g}"


def pretty(unit) -> str:
    """A unit with raised exponents."""
    return unit.replace("^2", "²").replace("^3", "³")


def posterior_table(table) -> str:
    """All parameters under all likelihoods."""
    body, groups = [], []
    for number, row in enumerate(table):
        if number and table[number - 1].kind != row.kind:
            groups.append(number)
        numbers = [number_text(v) for v in (row.mean, row.sd, row.q05, row.q50, row.q95)]
        taught = "" if np.isnan(row.taught) else f"{row.taught:.2f}"
        r_hat = "" if np.isnan(row.r_hat) else f"{row.r_hat:.3f}"
        ess = "" if np.isnan(row.ess) else f"{row.ess:.0f}"
        body.append((row.kind, row.name, pretty(row.unit), *numbers, taught, r_hat, ess))
    return html_table(COLUMNS, body, TEXT_COLUMNS, groups)


def number_text(value) -> str:
    """Four digits, without an exponent where it is not needed."""
    return f"{value:.4g}" if 1e-4 < abs(value) < 1e4 or value == 0.0 else f"{value:.3e}"


def run_of(part) -> str:
    """What the sampler says of itself."""
    posterior = part["posterior"]
    told = [f"{part.attrs['method']}, {posterior.sizes['chain']} chains of {posterior.sizes['draw']} draws"]
    stats = part["sample_stats"].to_dataset() if "sample_stats" in part.children else {}
    if "evaluations" in stats:
        told.append(f"{int(stats['evaluations'].sum())} evaluations")
    if "epsilon" in part.attrs:
        told.append(f"tolerance {part.attrs['epsilon']:.4g} m²/s⁴")
    if "log_marginal_likelihood" in stats:
        values = stats["log_marginal_likelihood"].values
        told.append(f"log evidence {', '.join(f'{v:.2f}' for v in np.ravel(values))}")
    if "efficiency" in stats:
        told.append(f"efficiency of the approximation {100 * float(stats['efficiency'][0]):.0f} %")
    return f"<p>{escape('; '.join(told))}.</p>"


def fit_of(part) -> str:
    """Errors and coverage of each sensor, and peaks of other responses."""
    bands = part["bands"].to_dataset()
    header, body = ["sensor", "rms error / measured rms"], []
    if "coverage" in bands:
        header.append("samples in the 90 % band")
    for sensor in bands["sensor"].values:
        one = bands.sel(sensor=sensor)
        row = [sensor, f"{float(one['normalised_error']):.2f}"]
        body.append([*row, f"{100 * float(one['coverage']):.0f} %"] if "coverage" in bands else row)
    html = html_table(header, body)
    for name in bands.data_vars:
        if not str(name).endswith("_peak"):
            continue
        peaks, label = bands[name], str(name).removesuffix("_peak").replace("_", " ")
        values = np.reshape(peaks.transpose("quantile", ...).values, (peaks.sizes["quantile"], -1))
        dim = next((d for d in peaks.dims if d != "quantile"), None)
        names = [] if dim is None else [f"{label}, {dim.rpartition('_')[2]} {v}" for v in peaks[dim].values]
        places = names or [label]
        rows = [(place, *(f"{v:.4g}" for v in row)) for place, row in zip(places, values.T, strict=True)]
        unit = pretty(peaks.attrs.get("units", ""))
        html += html_table((f"largest [{unit}]", "5 %", "50 %", "95 %"), rows)
    return html


def versions() -> str:
    """What it was computed with."""
    names = ("pymc-features", "pymc", "pytensor", "numba", "numpy", "arviz")
    found = []
    for name in names:
        try:
            found.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            continue
    return f"<p>{escape(', '.join(found))}</p>"
