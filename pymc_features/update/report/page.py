"""One page with everything: self-contained HTML, figures embedded. Its words are in templates/report.html."""

import base64
import contextlib
import importlib.metadata

import numpy as np

from pymc_features.update.config.sections import MEASURED
from pymc_features.update.kinds import KINDS
from pymc_features.update.kinds.ambient import ambient_section
from pymc_features.update.kinds.cyclic import loops_section
from pymc_features.update.kinds.events import CANNOT_BE_TOLD, UNTOLD, event_rows
from pymc_features.update.kinds.events import COLUMNS as EVENT_COLUMNS
from pymc_features.update.kinds.events import MEANING as EVENT_MEANING
from pymc_features.update.kinds.modal import COLUMNS as MODE_COLUMNS
from pymc_features.update.kinds.modal import MEANING
from pymc_features.update.problem import Problem
from pymc_features.update.report.findings import Findings
from pymc_features.update.report.summary import COLUMNS, kinds_of
from pymc_features.update.templates import TEMPLATES

PACKAGES = ("pymc-features", "pymc", "pytensor", "numba", "numpy", "arviz")


def report(problem: Problem, result, found: Findings, drawn) -> str:
    """The page.

    Parameters
    ----------
    problem, result
        As of `write_outputs`.
    found : Findings
        From `findings`, perhaps with more doubts.
    drawn : list of (Figure, bytes)
        Figures as PNG.
    """
    config = problem.config
    figures = [
        {"name": figure.name, "caption": figure.caption, "data": base64.b64encode(image).decode("ascii")}
        for figure, image in drawn
    ]
    return TEMPLATES.get_template("report.html").render(
        title=config.report.title,
        structure=config.structure.type,
        used=" and ".join(data.used for data in problem.data),
        measures=measures_sentence(problem),
        supported=found.supported,
        verdict=found.verdict,
        sequence=found.events,
        is_unchanged=found.is_unchanged,
        event_columns=EVENT_COLUMNS,
        event_meaning=EVENT_MEANING,
        doubts=found.doubts,
        priors=prior_rows(problem),
        likelihoods=[likelihood_row(kind, result[kind]) for kind in kinds_of(result)],
        data=None if problem.measured is None or problem.is_cyclic else data_section(problem),
        cyclic=loops_section(problem) if problem.is_cyclic else None,
        ambient=None if problem.ambient is None else ambient_section(problem),
        modal=None if problem.modal is None else modal_section(problem),
        mode_columns=MODE_COLUMNS,
        mode_meaning=MEANING,
        changed=found.changed,
        left_out=found.left_out,
        columns=COLUMNS,
        posterior=[posterior_row(row) for row in found.table],
        shared=[figure for figure in figures if "_" not in figure["name"]],
        kinds=[
            kind_section(kind, result[kind], figures, found.modes.get(kind, [])) for kind in kinds_of(result)
        ],
        text=problem.text,
        versions=versions(),
    )


def measures_sentence(problem) -> str:
    """Which motion the measured responses are, and in which unit."""
    if problem.measured is None or problem.is_cyclic:
        return ""
    relative = {"relative": "relative to the base", "inter": "those of storeys"}
    how = relative.get(problem.first.quantity.split("_")[0], "absolute")
    kind = MEASURED[problem.first.quantity].capitalize().replace("Velocity", "Velocitie")
    return f"{kind}s are {how} and in {pretty(problem.measured.units)}."


def data_section(problem) -> dict:
    """The channels, and what was done to them."""
    measured = problem.measured
    return {
        "steps": processing_steps(problem),
        "rate": f"{measured.channels.sizes['time']} samples at {measured.step:.6g} s; base at "
        f"{measured.record.dt:.6g} s",
        "sensors": sensor_rows(problem),
        "gains": [] if measured.checked.gains is None else gain_rows(measured.checked.gains),
        "checked": measured.checked.sentence,
    }


def modal_section(problem) -> dict:
    """The identified modes: frequencies with standard deviations, damping, and the places of channels."""
    modal = problem.modal
    data, n = modal.data, len(modal.data)
    columns = [modal.names, [f"{f:.4g}" for f in data.frequencies]]
    for values, factor in ((data.frequency_sd, 1.0), (data.damping_ratios, 100.0)):
        numbers = np.full(n, np.nan) if values is None else factor * values
        columns.append(["" if np.isnan(value) else f"{value:.2g}" for value in numbers])
    at = ", ".join(f"{name} ({dof})" for name, dof in zip(data.channels, modal.dofs, strict=True))
    undrawn = modal.dofs and modal.points is None and problem.ambient is None
    return {
        "sentence": modal.sentence + (f": {at} (degree of freedom)" if at else ""),
        "rows": list(zip(*columns, strict=True)),
        "choice": f"Each is matched with one of the {modal.n_modes} lowest modes of the structure",
        "undrawn": "Name a file with its nodes as `modal.nodes` to see the shapes drawn." if undrawn else "",
    }


def prior_rows(problem) -> list[tuple]:
    """Name, unit, distribution and use of each prior."""
    uses = problem.config.uses()
    return [
        (name, pretty(problem.unit(name)), repr(prior), ", ".join(key for key, _ in uses[name]))
        for name, prior in problem.priors.items()
    ]


def likelihood_row(kind, part) -> tuple:
    """Name, meaning, sampler and time of a likelihood."""
    return kind, KINDS[kind].meaning, part.attrs["method"], f"{part.attrs['seconds']:.0f}"


def processing_steps(problem) -> list[str]:
    """Where the channels come from, and what was done to them."""
    asked = problem.config.processing
    steps = [f"source: {problem.measured.source}"]
    if asked.detrend is not None:
        window = asked.detrend.window
        over = f" of {window[0]:g} to {window[1]:g} s" if window else ""
        steps.append(f"less the {asked.detrend.kind} trend{over}")
    if asked.band_pass is not None:
        sides = ("above", asked.band_pass.low), ("below", asked.band_pass.high)
        corners = [f"{side} {corner:g} Hz" for side, corner in sides if corner is not None]
        steps.append(f"filtered to {' and '.join(corners)}")
    if asked.trim is not None:
        steps.append(f"window {asked.trim[0]:g} to {asked.trim[1]:g} s")
    return steps


def sensor_rows(problem) -> list[tuple]:
    """Name, degree of freedom, peak and root mean square of the base and of each sensor."""
    measured, channels = problem.measured, problem.measured.channels
    names = ["base", *channels["sensor"].values]
    histories = [measured.record.acceleration, *channels.values]
    return [
        (name, dof, f"{np.nanmax(np.abs(values)):.4g}", f"{np.sqrt(np.nanmean(values**2)):.4g}")
        for name, dof, values in zip(names, ["", *problem.dofs], histories, strict=True)
    ]


def gain_rows(gains) -> list[tuple]:
    """Name, gain, lag [ms] and coherence of each sensor against the base; dashes where it is unknown."""
    columns = gains["sensor"], gains["gain"], 1e3 * gains["lag"], gains["coherence"]
    cells = zip(*(column.values for column in columns), strict=True)
    return [
        (name, "-", "-", "-") if np.isnan(gain) else (name, f"{gain:.3f}", f"{lag:.2f}", f"{coherence:.3f}")
        for name, gain, lag, coherence in cells
    ]


def posterior_row(row) -> tuple:
    """One parameter under one likelihood; empty where there is no number."""
    numbers = [number_text(v) for v in (row.mean, row.sd, row.q05, row.q50, row.q95)]
    told = [
        "" if np.isnan(value) else form.format(value)
        for form, value in (("{:.2f}", row.taught), ("{:.3f}", row.r_hat), ("{:.0f}", row.ess))
    ]
    return row.kind, row.name, pretty(row.unit), *numbers, *told


def kind_section(kind, part, figures, modes) -> dict:
    """How one likelihood was sampled, how it fits the data, and its figures."""
    section = {
        "name": kind,
        "run": run_sentences(part),
        "modes": [row.cells for row in modes],
        "events": event_rows(part),
        "figures": [figure for figure in figures if figure["name"].startswith(f"{kind}_")],
    }
    return section | (fit_of(part["bands"].to_dataset()) if "bands" in part.children else {})


def fit_of(bands) -> dict:
    """How one likelihood fits the responses."""
    columns = {"sensor": bands["sensor"].values}
    columns["rms error / measured rms"] = [f"{value:.2f}" for value in bands["normalised_error"].values]
    if "coverage" in bands:
        shares = 100 * bands["coverage"].values
        columns["samples in the 90 % band"] = [f"{share:.0f} %" for share in shares]
    return {
        "fit_columns": list(columns),
        "fit": list(zip(*columns.values(), strict=True)),
        "peaks": [peak_table(bands[name]) for name in bands.data_vars if str(name).endswith("_peak")],
    }


def run_sentences(part) -> list[str]:
    """What the sampler says of itself."""
    sizes = part["posterior"].sizes
    told = [f"{part.attrs['method']}, {sizes['chain']} chains of {sizes['draw']} draws"]
    stats = part["sample_stats"].to_dataset() if "sample_stats" in part.children else {}
    if "evaluations" in stats:
        told.append(f"{int(stats['evaluations'].sum())} evaluations")
    if "epsilon" in part.attrs:
        told.append(f"tolerance {part.attrs['epsilon']:.4g} m²/s⁴")
    if base := KINDS[part.attrs["kind"]].calibrates:
        told.append(f"of the likelihood of {base} to the power {stats.attrs['power']:.3g}, stretched")
    if "sequence" in part.children:
        record = part["sequence"].to_dataset()
        total, error = (float(record[name].sum()) for name in ("log_score", "log_score_se"))
        told.append(
            f"log evidence of all events {total:.2f}, standard error at most {error:.2g}"
            if error < UNTOLD
            else f"log evidence of all events: {CANNOT_BE_TOLD}"
        )
    if "advice" in getattr(stats, "attrs", {}):
        return told + sentences_of_sample(stats.attrs, is_calibrated=bool(base))
    if "log_marginal_likelihood" in stats:
        values = stats["log_marginal_likelihood"].values
        told.append(f"log evidence {', '.join(f'{v:.2f}' for v in np.ravel(values))}")
    if "efficiency" in stats:
        told.append(f"efficiency of the approximation {100 * float(stats['efficiency'][0]):.0f} %")
    if "largest_error" in stats:
        off, name = float(stats["largest_error"][0]), stats.attrs["worst_parameter"]
        told.append(f"its quantiles are off by at most {100 * off:.0f} % of the 5-95 % width ({name})")
    return told


def sentences_of_sample(found, is_calibrated=False) -> list[str]:
    """What `sample` says of its run, from its attributes; nothing of modes or evidence if calibrated.

    After several events, modes were searched for in the first one alone.
    """
    told = [
        f"{found.get('search_evaluations')} evaluations and {found.get('search_gradients')} gradients in "
        "search of modes",
        f"modes found: {found['n_modes']}",
        f"log evidence {found['log_evidence']:.2f}, standard error {found['log_evidence_se']:.2g}",
        f"draws worth {found['ess']:.0f} independent ones for the quantiles of the worst parameter",
        f"Pareto k of the weights {found['pareto_k']:.2f} (below 0.7: they can be trusted)",
    ]
    if is_calibrated or "search_evaluations" not in found:
        del told[:3]
    elif found["no_gradient"]:
        told[:2] = [f"no climbs to modes, for the model has no gradient: {found['no_gradient']}"]
    if np.isfinite(found["max_r_hat"]):
        told.append(f"largest R-hat {found['max_r_hat']:.3f}")
    if found["undetermined"]:
        told.append(f"nearly as wide as the prior: {found['undetermined']}")
    if found["close_to_laplace"]:
        told.append(f"close to Laplace's approximation? {found['close_to_laplace']}")
    return told + [found["advice"] or "nothing was found wrong"]


def peak_table(peaks) -> tuple[str, list[tuple]]:
    """Unit, and the quantiles of the largest values of a quantity at each place."""
    label = str(peaks.name).removesuffix("_peak").replace("_", " ")
    values = np.reshape(peaks.transpose("quantile", ...).values, (peaks.sizes["quantile"], -1))
    dim = next((d for d in peaks.dims if d != "quantile"), None)
    names = [] if dim is None else [f"{label}, {dim.rpartition('_')[2]} {v}" for v in peaks[dim].values]
    rows = [
        (place, *map("{:.4g}".format, row)) for place, row in zip(names or [label], values.T, strict=True)
    ]
    return pretty(peaks.attrs.get("units", "")), rows


def pretty(unit) -> str:
    """A unit with raised exponents."""
    return unit.replace("^2", "²").replace("^3", "³")


def number_text(value) -> str:
    """Four digits, or three and an exponent where it is needed."""
    return f"{value:.4g}" if 1e-3 < abs(value) < 1e4 or value == 0.0 else f"{value:.2e}"


def versions() -> list[str]:
    """What it was computed with."""
    found = []
    for name in PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found.append(f"{name} {importlib.metadata.version(name)}")
    return found
