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

from pymc_features.update.config.messages import with_keys
from pymc_features.update.kinds import KINDS
from pymc_features.update.kinds.events import CANNOT_BE_TOLD, UNTOLD, event_rows
from pymc_features.update.kinds.events import COLUMNS as EVENT_COLUMNS
from pymc_features.update.kinds.events import MEANING as EVENT_MEANING
from pymc_features.update.population import COLUMNS as POPULATION
from pymc_features.update.predictions import predicted_rows
from pymc_features.update.presentation.mode_rows import COLUMNS as MODE_COLUMNS
from pymc_features.update.presentation.mode_rows import MEANING
from pymc_features.update.presentation.numbers import PREDICTED, interval_texts, predicted_cells, pretty
from pymc_features.update.presentation.shown import table
from pymc_features.update.problem import Problem
from pymc_features.update.report.findings import Findings
from pymc_features.update.report.summary import kinds_of

PREDICTION = "prediction"
PACKAGES = ("pymc-features", "pymc", "pytensor", "numba", "numpy", "arviz")


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
        table_of_predictions(found.predicted),
        table_of_population(found.population),
        *tables_of_model(problem, result, kinds),
        *(one for data in problem.data for one in data.tables(problem)),
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


def subtitle_of(problem, kinds) -> str:
    """What was updated with what, under which likelihoods, and which motion was measured."""
    n = len(problem.priors)
    of_parameters = f"{n} uncertain parameter{'s' if n > 1 else ''}"
    used = " and ".join(data.used for data in problem.data)
    sentence = f"{problem.structure.title} updated with {used}, {of_parameters}"
    return f"{sentence}, under {', '.join(kinds)}. {problem.first.measures}".strip()


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


def table_of_predictions(predicted) -> dict:
    """Peaks under other motions, and the probabilities that they exceed limits."""
    rows = predicted_cells(predicted)
    note = rows and (
        "The largest value at any place, from the uncertainty of the parameters alone; a probability is that "
        "of exceeding the limit anywhere."
    )
    return table(PREDICTION, PREDICTION, "Largest responses to other motions", PREDICTED, rows, note)


def table_of_population(rows) -> dict:
    """Mean and scatter of the members of [hierarchical]."""
    note = rows and (
        "Mean and scatter of the population, the next member of it, and each member given all of them; of a "
        "log-normal population the mean is its median, the scatter the standard deviation of the logarithm."
    )
    return table("population", "population", "Mean, scatter and members", POPULATION, rows, note)


def with_predictions(document: dict, result) -> dict:
    """A document with the predictions that a result has now."""
    others = [one for one in document["tables"] if one["name"] != PREDICTION]
    own = table_of_predictions(predicted_rows(result))
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
    return told + [ended(with_keys(found["advice"] or "Nothing was found wrong"))]


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
