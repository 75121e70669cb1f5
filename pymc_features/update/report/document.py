"""What a result says, in words and tables: one plain structure, made once and saved with the result.

    {"title": str, "subtitle": str,
     "verdict": {"explains": bool, "sentences": [str]},  # on the fit of the first likelihood
     "sentences": [{"text": str, "is_good": bool}],      # what else comes first
     "findings": [{"kind": str, "code": str, "text": str}],  # what to doubt
     "warnings": [str],                                  # on the data, and the findings
     "posterior": [{...}],                               # fields of `Row`, None where there is no number
     "changed": str,                                     # which parameters the data changed
     "predicted": [{...}],                               # of `predicted_rows`
     "tables": [{"name": str, "section": str, "title": str, "columns": [str], "rows": [[str]], "note": str}],
     "configuration": str, "versions": [str]}

Terminal, page, `--json`, `table.csv` and `table.tex` are made from it. A table stands under the heading of
its section; without columns it is its note alone.
"""

import importlib.metadata
import json

import numpy as np
import xarray as xr
from rich import box
from rich.markup import escape
from rich.table import Table

from pymc_features.calibration.events import interval
from pymc_features.update.config.keys import with_keys
from pymc_features.update.kinds import KINDS
from pymc_features.update.kinds.base import kinds_of, table
from pymc_features.update.kinds.events import CANNOT_BE_TOLD, UNTOLD
from pymc_features.update.kinds.histories import bounds_of
from pymc_features.update.predictions import PREDICTION, predicted_rows, predicted_table
from pymc_features.update.problem import Problem
from pymc_features.update.run import comparison_sentences, population_table
from pymc_features.update.templates import numbers

PACKAGES = ("pymc-features", "pymc", "pytensor", "numba", "numpy", "arviz")
R_HAT = 1.05  # of chains of SMC that agree; they are few and short
R_HAT_NUTS = 1.01
# of the posterior, as many as 80 characters hold
SHOWN = ("parameter", "unit", "5 %", "50 %", "95 %", "sd", "learned", "R-hat", "ESS")
TABLES = ("population", "prediction", "modes")  # besides
FEWEST = 100  # effective draws of each chain
TAUGHT = 0.1  # share of the prior's variance that the data must take away to have said something,
MOVED = 0.8  # or the overlap with the prior that they must leave
BINS = 20  # of equal prior probability, for the overlap
COVERED = 0.8  # share of the samples in the 90 % band
PRIORS = ("prior", "unit", "distribution", "used as")
SAMPLED = ("likelihood", "what it takes for the error", "sampler", "seconds")
#: Codes of findings to what is said of some names, and what to do; others are `run` and `failed`.
FINDINGS = {
    "chains": ("Chains disagree on", "Increase `sampler.draws`, and look at the ranks."),
    "draws": (f"Fewer than {FEWEST} effective draws of each chain for", "Increase `sampler.draws`."),
    "prior": ("The data say little about", "Their posterior is the prior: fix them, or add sensors."),
    "moved": (
        "The data move, but do not narrow",
        "The prior expects something else: ask which of the two is wrong.",
    ),
    "apart": (
        "The data leave nearly as wide as the prior",
        "What is named together they cannot tell apart: give narrower priors, or add sensors.",
    ),
    "edge": ("The posterior leans on the edge of the prior for", "Widen the prior, or ask why."),
    "band": (
        f"Fewer than {100 * COVERED:.0f} % of the samples lie in the 90 % predictive band of",
        "The likelihood takes the errors for smaller than they are.",
    ),
}


def document_of(problem: Problem, result: xr.DataTree, channel_warnings=()) -> dict:
    """The words and tables of a report, see the head of this file; arguments are those of `write_outputs`."""
    kinds, rows = kinds_of(result), rows_of_result(problem, result)
    verdict, findings = problem.verdict(result, kinds[0]), findings_of(result, rows)
    sentences = [one for data in problem.data for one in data.sentences(problem, result, verdict.explains)]
    sentences += [(text, True) for text in comparison_sentences(result)]
    n, predicted = len(problem.priors), predicted_rows(result)
    used = " and ".join(data.used for data in problem.data)
    tables = [
        *(one for data in problem.shown for one in data.tables(problem, result)),
        predicted_table(predicted),
        population_table(problem, result),
        *tables_of_model(problem, result, kinds),
        *(table(f"{kind}_run", "sampling", note=" ".join(run_sentences(result[kind]))) for kind in kinds),
    ]
    return {
        "title": problem.config.report.title,
        "subtitle": (
            f"{problem.structure.title} updated with {used}, {n} uncertain parameter{'s' if n > 1 else ''}, "
            f"under {', '.join(kinds)}. {problem.first.measures}"
        ).strip(),
        "verdict": verdict._asdict(),
        "sentences": [{"text": text, "is_good": is_good} for text, is_good in sentences],
        "findings": findings,
        "warnings": [*(f"data: {text}" for text in channel_warnings), *map(numbers.warning_of, findings)],
        "posterior": [
            {key: None if value != value else value for key, value in row._asdict().items()} for row in rows
        ],
        "changed": changed([row for row in rows if row.kind == kinds[0] and np.isfinite(row.overlap)]),
        "predicted": predicted,
        "tables": [one for one in tables if one["rows"] or not one["columns"]],
        "configuration": problem.text,
        "versions": [f"{name} {importlib.metadata.version(name)}" for name in PACKAGES],
    }


def put_predictions(result) -> None:
    """Give the document of a result the predictions which the result has now."""
    document, rows = json.loads(result.attrs["document"]), predicted_rows(result)
    tables = [one for one in document["tables"] if one["name"] != PREDICTION]
    document |= {"predicted": rows, "tables": [*tables, predicted_table(rows)]}
    result.attrs["document"] = json.dumps(document)


def as_json(document: dict) -> str:
    """What scripts read: verdict, table in SI units, and findings with their codes; no number is null."""
    return json.dumps(
        {
            "explains": document["verdict"]["explains"],
            "verdict": document["verdict"]["sentences"],
            "is_unchanged": all(one["is_good"] for one in document["sentences"]),
            "sentences": [one["text"] for one in document["sentences"]],
            "table": document["posterior"],
            "predicted": document["predicted"],
            "findings": document["findings"],
        }
    )


def stats_of(part) -> xr.Dataset:
    """What the sampler of one likelihood noted, perhaps nothing."""
    return part["sample_stats"].to_dataset() if "sample_stats" in part.children else xr.Dataset()


def rows_of_result(problem: Problem, result: xr.DataTree) -> list[numbers.Row]:
    """All parameters, and natural frequencies in the band of the data, under all likelihoods."""
    import arviz as az  # slow to import

    found, units = [], problem.units
    low, high = problem.first.band
    for kind in kinds_of(result):
        part = result[kind]
        posterior, prior, at = part["posterior"].to_dataset(), part["prior"].to_dataset(), bounds_of(part)
        for name in map(str, prior.data_vars):
            draws = posterior[name]
            taught = max(0.0, 1.0 - float(draws.var() / prior[name].var()))
            r_hat = float(az.rhat(draws)) if posterior.sizes["chain"] > 1 else np.nan
            overlap = overlap_of(prior[name].values, draws.values)
            of_run = taught, r_hat, float(az.ess(draws)), overlap
            found.append(numbers.Row(kind, name, units[name], *moments(draws, at.get(name)), *of_run))
        modes = part["modal"]["natural_frequency"].transpose("mode", ...) if "modal" in part.children else ()
        for k, one in enumerate(modes, start=1):
            if k == 1 or low <= float(one.median()) <= high:  # else the data say nothing about it
                found.append(numbers.Row(kind, f"f{k}", "Hz", *moments(one), *[np.nan] * 4))
    return found


def overlap_of(prior, posterior) -> float:
    """Mass that two densities share [-], by a histogram with bins of equal prior probability."""
    edges = np.quantile(prior, np.linspace(0.0, 1.0, BINS + 1)[1:-1])
    shares = np.bincount(np.searchsorted(edges, np.ravel(posterior)), minlength=BINS) / np.size(posterior)
    return float(np.minimum(shares, 1.0 / BINS).sum())


def moments(draws, bound=None) -> tuple[float, ...]:
    """Median between the ends of the 90 % interval, see `interval`, mean and standard deviation."""
    values = draws.values[np.isfinite(draws.values)]
    low, high = interval(values, bound=bound)
    return low, float(np.median(values)), high, float(values.mean()), float(values.std())


def findings_of(result: xr.DataTree, rows: list[numbers.Row]) -> list[dict]:
    """What to doubt, from the run and from its numbers: likelihood, code and sentence."""
    found = [(kind, "failed", text) for kind, text in json.loads(result.attrs.get("failed", "{}")).items()]
    for kind in kinds_of(result):
        part = result[kind]
        found += [(kind, "run", text) for text in json.loads(part.attrs["warnings"])]
        for code, names in names_in_doubt(part, [row for row in rows if row.kind == kind]).items():
            sentence, advice = FINDINGS[code]
            if names:
                found.append((kind, code, f"{sentence} {', '.join(names)}. {advice}"))
        stats = stats_of(part)
        if "failed" in stats and (n := int(stats["failed"].sum())):
            of_all = f"{n} of {int(stats['evaluations'].sum())} evaluations"
            found.append((kind, "impossible", f"{of_all} gave no response and count as impossible."))
    return [dict(zip(("kind", "code", "text"), one, strict=True)) for one in found]


def names_in_doubt(part, rows: list[numbers.Row]) -> dict[str, list[str]]:
    """Codes of `FINDINGS` to the parameters, or sensors, that they are about."""
    limit = R_HAT_NUTS if part.attrs["method"] == "NUTS" else R_HAT
    rows = [row for row in rows if np.isfinite(row.taught)]
    wide = [row for row in rows if row.taught < TAUGHT]
    apart = [direction for direction in stats_of(part).attrs.get("undetermined", "").split(", ") if direction]
    covered = part["bands"].get("coverage") if "bands" in part.children else None
    return {
        "chains": [row.name for row in rows if row.r_hat > limit],
        "draws": [row.name for row in rows if row.ess < FEWEST * part["posterior"].sizes["chain"]],
        "prior": [row.name for row in wide if row.overlap > MOVED],
        "moved": [row.name for row in wide if row.overlap <= MOVED],
        "apart": [name for name in apart if name not in [row.name for row in wide]],
        "edge": [row.name for row in rows if leans(part["prior"][row.name].values, row.q50, row.sd)],
        "band": [] if covered is None else covered["sensor"].values[covered.values < COVERED].tolist(),
    }


def leans(prior, middle, deviation) -> bool:
    """Whether a posterior lies in a tail of its prior, or within three deviations of the end of a prior.

    Looked for beyond 1 % of the draws of the prior; a tail is less than half as dense as where it is densest.
    A scale near zero under a half-normal prior lies in no tail.
    """
    for draws, place in ((prior, middle), (-prior, -middle)):
        end, low = np.quantile(draws, [0.0, 0.01])
        if place < low:
            narrowest = np.diff(np.quantile(draws, np.linspace(0.0, 1.0, BINS + 1))).min()
            is_tail = 0.01 * narrowest < 0.5 * (low - end) / BINS
            return is_tail or place - end < 3.0 * deviation
    return False


def changed(rows: list[numbers.Row]) -> str:
    """Which parameters the data changed, by how much of the prior is left."""
    moved, same = [], []
    for row in sorted(rows, key=lambda row: row.overlap):
        is_same = row.overlap > MOVED and row.taught < TAUGHT
        overlap = f"{row.overlap:.2f}" if row.overlap > 1.0 / BINS else f"at most {1.0 / BINS:.2f}"
        (same if is_same else moved).append(f"{row.name} ({overlap})")
    told = f"The data changed {', '.join(moved) or 'no parameter'}"
    told += f"; they left as they were {', '.join(same)}" if same else ""
    return f"{told}. In brackets the overlap of prior and posterior: 1 if they are the same."


def tables_of_model(problem, result, kinds) -> list[dict]:
    """Priors and likelihoods."""
    uses, units = problem.config.uses(), problem.units
    priors = [
        (name, numbers.pretty(units[name]), repr(prior), ", ".join(key for key, _ in uses[name]))
        for name, prior in problem.priors.items()
    ]
    runs = [(kind, KINDS[kind].meaning, result[kind].attrs) for kind in kinds]
    likelihoods = [(*names, attrs["method"], f"{attrs['seconds']:.0f}") for *names, attrs in runs]
    return [
        table("priors", "fitted", "Priors", PRIORS, priors),
        table("likelihoods", "fitted", "Likelihoods", SAMPLED, likelihoods),
    ]


def run_sentences(part) -> list[str]:
    """What the sampler of one likelihood says of itself."""
    sizes, kind = part["posterior"].sizes, part.attrs["kind"]
    chains = f"{sizes['chain']} chain{'s' if sizes['chain'] > 1 else ''} of {sizes['draw']} draws"
    told = [f"{kind} was sampled by {part.attrs['method']}: {chains}."]
    stats = stats_of(part)
    if "evaluations" in stats:
        told.append(f"It took {int(stats['evaluations'].sum())} evaluations.")
    if "epsilon" in part.attrs:
        told.append(f"The tolerance is {part.attrs['epsilon']:.4g} m²/s⁴.")
    if base := KINDS[kind].calibrates:
        told.append(f"Its likelihood is that of {base} to the power {stats.attrs['power']:.3g}, stretched.")
    if "sequence" in part.children:
        record = part["sequence"].to_dataset()
        total, error = (float(record[name].sum()) for name in ("log_score", "log_score_se"))
        number = f"is {total:.2f} with a standard error of at most {error:.2g}"
        told.append(f"The log evidence of all events {number if error < UNTOLD else CANNOT_BE_TOLD}.")
    if "advice" in stats.attrs:
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
    """What `sample` says of its run, from its attributes; nothing of modes or evidence if calibrated."""
    n, told = found["n_modes"], []
    if not is_calibrated and "search_evaluations" in found:
        told = [
            f"The search for modes took {found['search_evaluations']} evaluations and "
            f"{found.get('search_gradients')} gradients.",
            f"It found {n} mode{'s' if n != 1 else ''}.",
        ]
        if found["no_gradient"]:
            told = [f"There were no climbs to modes, for the model has no gradient: {found['no_gradient']}."]
        error = f"a standard error of {found['log_evidence_se']:.2g}"
        told.append(f"The log evidence is {found['log_evidence']:.2f} with {error}.")
    told += [
        f"The draws are worth {found['ess']:.0f} independent ones for the quantiles of the worst parameter.",
        f"Pareto k of the weights is {found['pareto_k']:.2f}; below 0.7 they can be trusted.",
    ]
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


# ---- the terminal ----


def summary(document: dict):
    """What to print of a document: sentences, and tables of the first likelihood, each with its style."""
    verdict, rows = document["verdict"], numbers.rows_of(document)
    for sentence in verdict["sentences"]:
        yield sentence, "bold" if verdict["explains"] else "bold red"
    for sentence in document["sentences"]:
        yield sentence["text"], None if sentence["is_good"] else "bold red"
    first, places = rows[0].kind, [numbers.COLUMNS.index(name) for name in SHOWN]
    texts = numbers.cells([row for row in rows if row.kind == first])
    posterior = [[row[k] for k in places] for row in texts]
    title = f"Posterior under {first}"
    yield drawn_table({"title": title, "columns": SHOWN, "rows": posterior}, no_wrap=True), None
    tables = {one["name"]: one for one in document["tables"]}
    for one in (tables[name] for name in TABLES if name in tables):
        if one["columns"][0] == "likelihood":
            rows = [row[1:] for row in one["rows"] if row[0] == first]
            one |= {"columns": one["columns"][1:], "rows": rows, "title": f"{one['title']} under {first}"}
        yield drawn_table(one), None
    yield document["changed"], None
    for one in document["findings"]:
        yield f"warning: {numbers.warning_of(one)}", "yellow"


def drawn_table(asked: dict, no_wrap=False) -> Table:
    """A table of the report for the terminal: columns of words to the left, of numbers to the right."""
    compact = {"collapse_padding": True, "pad_edge": False}
    drawn = Table(title=asked["title"], title_justify="left", box=box.SIMPLE_HEAD, **compact)
    for name, is_text in zip(asked["columns"], numbers.columns_of_words(asked), strict=True):
        drawn.add_column(escape(name), justify="left" if is_text else "right", no_wrap=no_wrap)
    for row in asked["rows"]:
        drawn.add_row(*map(escape, row))
    return drawn
