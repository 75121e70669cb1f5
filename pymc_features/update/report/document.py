"""What a report says in words and tables: a plain structure that is saved with the result.

    {"title": str, "subtitle": str,
     "verdict": {"explains": bool, "sentences": [str]},  # on the fit of the first likelihood
     "sentences": [{"text": str, "is_good": bool}],      # what else comes first
     "warnings": [str],
     "posterior": [{...}],                               # fields of `Row`, None where there is no number
     "tables": [{"name": str, "section": str, "title": str, "columns": [str], "rows": [[str]], "note": str}],
     "configuration": str, "versions": [str]}

A table stands under the heading of its section, one of `SECTIONS`; without columns it is its note alone.
"""

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
from pymc_features.update.predictions import predicted_rows
from pymc_features.update.problem import Problem
from pymc_features.update.report.findings import Findings
from pymc_features.update.report.numbers import PREDICTED, interval_texts, predicted_cells, pretty
from pymc_features.update.report.summary import kinds_of

PREDICTION = "prediction"
PACKAGES = ("pymc-features", "pymc", "pytensor", "numba", "numpy", "arviz")
SENSORS = ("sensor", "degree of freedom", "peak [m/s²]", "rms [m/s²]")


def document_of(problem: Problem, result, found: Findings, warnings) -> dict:
    """The words and tables of a report, see the head of this file.

    Parameters
    ----------
    problem, result
        As of `write_outputs`.
    found : Findings
        From `findings`.
    warnings : list of str
        All of them.
    """
    kinds = kinds_of(result)
    first = [(found.events, found.is_unchanged), (found.supported, True), (found.left_out, True)]
    first += [(text, True) for text in found.besides]
    tables = [
        *tables_of_fit(result, kinds),
        *tables_of_modes(found),
        *tables_of_events(result, kinds),
        table_of_predictions(result),
        *tables_of_model(problem, result, kinds),
        *tables_of_data(problem),
        *(table(f"{kind}_run", "sampling", note=" ".join(run_sentences(result[kind]))) for kind in kinds),
    ]
    return {
        "title": problem.config.report.title,
        "subtitle": subtitle_of(problem, kinds),
        "verdict": found.verdict._asdict(),
        "sentences": [{"text": text, "is_good": is_good} for text, is_good in first if text],
        "warnings": list(warnings),
        "posterior": [
            {key: None if value != value else value for key, value in row._asdict().items()}
            for row in found.table
        ],
        "changed": found.changed,
        "tables": [one for one in tables if one["rows"] or one["note"]],
        "configuration": problem.text,
        "versions": versions(),
    }


def table(name, section, title="", columns=(), rows=(), note="") -> dict:
    """A table of the document; its cells become texts."""
    rows = [[str(cell) for cell in row] for row in rows]
    named = {"name": name, "section": section, "title": title}
    return named | {"columns": list(columns), "rows": rows, "note": note}


def subtitle_of(problem, kinds) -> str:
    """What was updated with what, under which likelihoods, and which motion was measured."""
    n = len(problem.priors)
    of_parameters = f"{n} uncertain parameter{'s' if n > 1 else ''}"
    used = " and ".join(data.used for data in problem.data)
    sentence = f"{problem.config.structure.type} updated with {used}, {of_parameters}"
    return f"{sentence}, under {', '.join(kinds)}. {measures_sentence(problem)}".strip()


def measures_sentence(problem) -> str:
    """Which motion the measured responses are, and in which unit."""
    if problem.measured is None or problem.is_cyclic:
        return ""
    relative = {"relative": "relative to the base", "inter": "those of storeys"}
    how = relative.get(problem.first.quantity.split("_")[0], "absolute")
    kind = MEASURED[problem.first.quantity].capitalize().replace("Velocity", "Velocitie")
    return f"{kind}s are {how} and in {pretty(problem.measured.units)}."


def tables_of_fit(result, kinds) -> list[dict]:
    """How each likelihood meets the responses, and the largest values of other responses."""
    fit, peaks = [], []
    for kind in kinds:
        if "bands" not in result[kind].children:
            continue
        bands = result[kind]["bands"].to_dataset()
        errors = [f"{value:.2f}" for value in bands["normalised_error"].values]
        shares = [f"{100 * v:.0f} %" for v in bands["coverage"].values] if "coverage" in bands else None
        shares = shares or ["" for _ in errors]
        fit += [(kind, *row) for row in zip(bands["sensor"].values, errors, shares, strict=True)]
        names = [name for name in bands.data_vars if str(name).endswith("_peak")]
        peaks += [(kind, *row) for name in names for row in peak_rows(bands[name])]
    columns = ("likelihood", "sensor", "rms error / measured rms", "samples in the 90 % band")
    quantiles = ("likelihood", "largest response", "unit", "5 %", "50 %", "95 %")
    return [
        table("fit", "response", "Error of the median response", columns, fit),
        table("peaks", "response", "Largest values of other responses", quantiles, peaks),
    ]


def peak_rows(peaks) -> list[tuple]:
    """Place, unit and quantiles of the largest values of a quantity."""
    label = str(peaks.name).removesuffix("_peak").replace("_", " ")
    values = np.reshape(peaks.transpose("quantile", ...).values, (peaks.sizes["quantile"], -1)).T
    dim = next((d for d in peaks.dims if d != "quantile"), None)
    names = [f"{label}, {dim.rpartition('_')[2]} {v}" for v in peaks[dim].values] if dim else [label]
    texts = [interval_texts(row, peaks.attrs.get("units", "-")) for row in values]
    return [(name, unit, *row) for name, (unit, row) in zip(names, texts, strict=True)]


def tables_of_modes(found) -> list[dict]:
    """Identified modes beside those of the model."""
    rows = [(kind, *row.cells) for kind, of_kind in found.modes.items() for row in of_kind]
    return [
        table("modes", "modes", "Identified modes", ("likelihood", *MODE_COLUMNS), rows, rows and MEANING)
    ]


def tables_of_events(result, kinds) -> list[dict]:
    """The events one after another."""
    rows = [(kind, *row) for kind in kinds for row in event_rows(result[kind])]
    columns = ("likelihood", *EVENT_COLUMNS)
    return [table("events", "events", "From event to event", columns, rows, rows and EVENT_MEANING)]


def table_of_predictions(result) -> dict:
    """Peaks under other motions, and the probabilities that they exceed limits."""
    rows = predicted_cells(predicted_rows(result))
    note = rows and (
        "The largest value at any place, from the uncertainty of the parameters alone; a probability is that "
        "of exceeding the limit anywhere."
    )
    return table(PREDICTION, PREDICTION, "Largest responses to other motions", PREDICTED, rows, note)


def with_predictions(document: dict, result) -> dict:
    """A document with the predictions that a result has now."""
    others = [one for one in document["tables"] if one["name"] != PREDICTION]
    own = table_of_predictions(result)
    return document | {"tables": [*others, *([own] if own["rows"] else [])]}


def tables_of_model(problem, result, kinds) -> list[dict]:
    """Priors and likelihoods."""
    uses = problem.config.uses()
    priors = [
        (name, pretty(problem.unit(name)), repr(prior), ", ".join(key for key, _ in uses[name]))
        for name, prior in problem.priors.items()
    ]
    parts = [result[kind].attrs for kind in kinds]
    likelihoods = [
        (kind, KINDS[kind].meaning, attrs["method"], f"{attrs['seconds']:.0f}")
        for kind, attrs in zip(kinds, parts, strict=True)
    ]
    columns = ("likelihood", "what it takes for the error", "sampler", "seconds")
    return [
        table("priors", "fitted", "Priors", ("prior", "unit", "distribution", "used as"), priors),
        table("likelihoods", "fitted", "Likelihoods", columns, likelihoods),
    ]


def tables_of_data(problem) -> list[dict]:
    """The data, and what was done to them."""
    found = []
    if problem.is_cyclic:
        section = loops_section(problem)
        note = f"The {section['source'].replace(';', ' has')}. The loops dissipate {section['energy']} J."
        found.append(
            table("cyclic", "data", "Cyclic test", ("", "smallest", "largest"), section["rows"], note)
        )
    elif problem.measured is not None:
        found += tables_of_channels(problem)
    if problem.ambient is not None:
        section = ambient_section(problem)
        note = (
            f"The {', '.join(section['steps']).replace(':', ' is', 1)}: {section['rate']}. Nobody measured "
            f"the forces. Compared are the frequencies {section['bands']}"
            f"{', proposed from the peaks of the spectra' if section['proposed'] else ''}."
        )
        found.append(table("channels", "data", "Channels", SENSORS, section["sensors"], note))
    if problem.modal is not None:
        found.append(table_of_identified(problem))
    return found


def tables_of_channels(problem) -> list[dict]:
    """The channels, and how they compare with the base."""
    measured, channels = problem.measured, problem.measured.channels
    left_out = (
        "Peaks, root mean squares and errors are those of the samples that are left."
        if measured.left_out
        else ""
    )
    note = (
        f"The {', '.join(processing_steps(problem)).replace(':', ' is', 1)}. There are "
        f"{channels.sizes['time']} samples at {measured.step:.6g} s, of the base at "
        f"{measured.record.dt:.6g} s. The channels were {measured.checked.sentence.rstrip('.')}. {left_out}"
    )
    names = ["base", *channels["sensor"].values]
    histories = [measured.record.acceleration, *channels.values]
    rows = [
        (name, dof, f"{np.nanmax(np.abs(values)):.4g}", f"{np.sqrt(np.nanmean(values**2)):.4g}")
        for name, dof, values in zip(names, ["", *problem.dofs], histories, strict=True)
    ]
    gains = [] if measured.checked.gains is None else gain_rows(measured.checked.gains)
    columns = ("sensor", "gain [-]", "lag [ms]", "coherence [-]")
    return [
        table("channels", "data", "Channels", SENSORS, rows, note.strip()),
        table("gains", "data", "Sensors against the base", columns, gains),
    ]


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


def gain_rows(gains) -> list[tuple]:
    """Name, gain, lag [ms] and coherence of each sensor against the base; dashes where it is unknown."""
    lag = np.round(1e3 * gains["lag"], 2) + 0.0  # no -0.00
    columns = gains["sensor"], gains["gain"], lag, gains["coherence"]
    cells = zip(*(column.values for column in columns), strict=True)
    return [
        (name, "-", "-", "-") if np.isnan(gain) else (name, f"{gain:.3f}", f"{lag:.2f}", f"{coherence:.3f}")
        for name, gain, lag, coherence in cells
    ]


def table_of_identified(problem) -> dict:
    """The identified modes: frequencies with standard deviations, damping, and the places of channels."""
    modal = problem.modal
    data, n = modal.data, len(modal.data)
    columns = [modal.names, [f"{f:.4g}" for f in data.frequencies]]
    for values, factor in ((data.frequency_sd, 1.0), (data.damping_ratios, 100.0)):
        numbers = np.full(n, np.nan) if values is None else factor * values
        columns.append(["" if np.isnan(value) else f"{value:.2g}" for value in numbers])
    at = ", ".join(f"{name} ({dof})" for name, dof in zip(data.channels, modal.dofs, strict=True))
    sentences = [
        f"There are {modal.sentence}.",
        f"The channels and their degrees of freedom are {at}." if at else "",
        f"Each is matched with one of the {modal.n_modes} lowest modes of the structure.",
    ]
    if modal.dofs and modal.points is None and problem.ambient is None:
        sentences.append("Name a file with its nodes as `modal.nodes` to see the shapes drawn.")
    header = ("identified mode", "frequency [Hz]", "standard deviation [Hz]", "damping [%]")
    rows, note = list(zip(*columns, strict=True)), " ".join(filter(None, sentences))
    return table("identified", "data", "Identified modes", header, rows, note)


def run_sentences(part) -> list[str]:
    """What the sampler of one likelihood says of itself."""
    sizes, kind = part["posterior"].sizes, part.attrs["kind"]
    chains = f"{sizes['chain']} chain{'s' if sizes['chain'] > 1 else ''} of {sizes['draw']} draws"
    told = [f"{kind} was sampled by {part.attrs['method']}: {chains}."]
    stats = part["sample_stats"].to_dataset() if "sample_stats" in part.children else {}
    if "evaluations" in stats:
        told.append(f"It took {int(stats['evaluations'].sum())} evaluations.")
    if "epsilon" in part.attrs:
        told.append(f"The tolerance is {part.attrs['epsilon']:.4g} m²/s⁴.")
    if base := KINDS[kind].calibrates:
        told.append(f"Its likelihood is that of {base} to the power {stats.attrs['power']:.3g}, stretched.")
    if "sequence" in part.children:
        record = part["sequence"].to_dataset()
        total, error = (float(record[name].sum()) for name in ("log_score", "log_score_se"))
        told.append(
            f"The log evidence of all events is {total:.2f} with a standard error of at most {error:.2g}."
            if error < UNTOLD
            else f"The log evidence of all events {CANNOT_BE_TOLD}."
        )
    if "advice" in getattr(stats, "attrs", {}):
        return told + sentences_of_sample(stats.attrs, is_calibrated=bool(base))
    if "log_marginal_likelihood" in stats:
        values = stats["log_marginal_likelihood"].values
        told.append(f"The log evidence of each chain is {', '.join(f'{v:.2f}' for v in np.ravel(values))}.")
    if "efficiency" in stats:
        told.append(f"The efficiency of the approximation is {100 * float(stats['efficiency'][0]):.0f} %.")
    if "largest_error" in stats:
        off, name = float(stats["largest_error"][0]), stats.attrs["worst_parameter"]
        told.append(f"Its quantiles are off by at most {100 * off:.0f} % of the 5-95 % width ({name}).")
    return told


def sentences_of_sample(found, is_calibrated=False) -> list[str]:
    """What `sample` says of its run, from its attributes; nothing of modes or evidence if calibrated.

    After several events, modes were searched for in the first one alone.
    """
    n = found["n_modes"]
    told = [
        f"The search for modes took {found.get('search_evaluations')} evaluations and "
        f"{found.get('search_gradients')} gradients.",
        f"It found {n} mode{'s' if n != 1 else ''}.",
        f"The log evidence is {found['log_evidence']:.2f} with a standard error of "
        f"{found['log_evidence_se']:.2g}.",
        f"The draws are worth {found['ess']:.0f} independent ones for the quantiles of the worst parameter.",
        f"Pareto k of the weights is {found['pareto_k']:.2f}; below 0.7 they can be trusted.",
    ]
    if is_calibrated or "search_evaluations" not in found:
        del told[:3]
    elif found["no_gradient"]:
        told[:2] = [f"There were no climbs to modes, for the model has no gradient: {found['no_gradient']}."]
    if np.isfinite(found["max_r_hat"]):
        told.append(f"The largest R-hat is {found['max_r_hat']:.3f}.")
    if found["undetermined"]:
        told.append(f"Nearly as wide as the prior are {found['undetermined']}.")
    if found["close_to_laplace"]:
        told.append(f"Is the posterior close to Laplace's approximation? {ended(found['close_to_laplace'])}")
    return told + [found["advice"] or "Nothing was found wrong."]


def ended(text: str) -> str:
    """A text as a sentence."""
    return f"{text[:1].upper()}{text[1:].rstrip('.')}."


def versions() -> list[str]:
    """What it was computed with."""
    found = []
    for name in PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found.append(f"{name} {importlib.metadata.version(name)}")
    return found
