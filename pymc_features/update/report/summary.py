"""The posterior in a table, and what to doubt about it in sentences."""

import json
from typing import NamedTuple

import numpy as np
import xarray as xr

from pymc_features.calibration.events import SHORT, interval
from pymc_features.update.kinds import KINDS
from pymc_features.update.presentation.numbers import Row
from pymc_features.update.problem import Problem

R_HAT = 1.05  # of chains of SMC that agree; they are few and short
R_HAT_NUTS = 1.01
FEWEST = 100  # effective draws of each chain
TAUGHT = 0.1  # share of the prior's variance that the data must take away to have said something,
MOVED = 0.8  # or the overlap with the prior that they must leave
BINS = 20  # of equal prior probability, for the overlap
ESTIMATED_CHAINS = 2  # R-hat compares chains


def kinds_of(result) -> list[str]:
    """Likelihoods in a result."""
    return [name for name, part in result.children.items() if "posterior" in part.children]


def rows(problem: Problem, result: xr.DataTree) -> list[Row]:
    """All parameters, and natural frequencies in the band of the data, under all likelihoods."""
    import arviz as az  # slow to import

    found = []
    low, high = problem.first.band
    for kind in kinds_of(result):
        part = result[kind]
        posterior, prior = part["posterior"].to_dataset(), part["prior"].to_dataset()
        at = bounds_of(part)
        several = posterior.sizes["chain"] >= ESTIMATED_CHAINS
        for name in prior.data_vars:
            draws = posterior[str(name)]
            taught = max(0.0, 1.0 - float(draws.var() / prior[name].var()))
            overlap = overlap_of(prior[name].values, draws.values)
            r_hat = float(az.rhat(draws)) if several else np.nan
            unit = problem.unit(str(name))
            found.append(
                Row(
                    kind,
                    str(name),
                    unit,
                    *moments(draws, at.get(name)),
                    taught,
                    r_hat,
                    float(az.ess(draws)),
                    overlap,
                )
            )
        if "modal" not in part.children:
            continue
        modal = part["modal"]["natural_frequency"]
        for mode in modal["mode"].values:
            one = modal.sel(mode=mode)
            if mode > 1 and not low <= float(one.median()) <= high:
                continue  # the data say nothing about it
            found.append(Row(kind, f"f{mode}", "Hz", *moments(one), *[np.nan] * 4))
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


def bounds_of(part) -> dict[str, float]:
    """Parameters whose interval is the shortest, and the bound of their prior that it lies next to."""
    if "calibration" not in part.children:
        return {}
    found = json.loads(part.attrs["calibration"])["parameters"]
    return {
        name: row["bound"]
        for name, row in found.items()
        if (row["room"] or 0.0) < SHORT and row["near_bound"]
    }


def supported(problem: Problem, result: xr.DataTree, explains: bool = True) -> str:
    """How many observations the residuals support, beside what likelihoods claim; empty without CAL.

    And what made its intervals what they are: frequency bands that disagree, bounds of priors. Where the
    model does not explain the data, or the likelihood has several maxima, no interval comes first.
    """
    for kind in kinds_of(result):
        base = KINDS[kind].calibrates
        if not base:
            continue
        part = result[kind]
        n_eff = float(part["calibration"].attrs["n_eff"])
        samples, m = problem.measured.samples, problem.config.likelihood.m
        claims = {name: KINDS[name].claimed(samples, m) for name in dict.fromkeys([base, *kinds_of(result)])}
        claimed = [f"{name} {n:,.0f}" for name, n in claims.items() if n is not None]
        claimed[0] = claimed[0].replace(" ", " claims ", 1)
        sentences = [f"The residuals support {n_eff:,.0f} independent observations; {', '.join(claimed)}."]
        n_modes = part["calibration"].sizes.get("mode", 1)
        if not explains:
            sentences.append(
                "No interval can be relied on where the model does not explain the measurements."
            )
        elif n_modes > 1:
            sentences.append(
                f"The likelihood has {n_modes} maxima, of which residuals do not tell the right one: no "
                "interval can be relied on."
            )
        else:
            sentences.append(f"{kind} comes first, for its intervals are as wide as the residuals support.")
        sentences.append(json.loads(part.attrs["calibration"])["sentence"])
        if at := bounds_of(part):
            named = ", ".join(f"{name} ({bound:.4g})" for name, bound in at.items())
            sentences.append(f"Next to a bound of its prior the 90 % interval is the shortest one: {named}.")
        return " ".join(filter(None, sentences))
    return ""


class Doubt(NamedTuple):
    """What to doubt about a result.

    Attributes
    ----------
    kind : str
        The likelihood.
    code : str
        By which scripts know it: `data`, `run`, `failed`, or a key of `DOUBTS`.
    text : str
        A sentence.
    """

    kind: str
    code: str
    text: str

    def __str__(self):
        return f"{self.kind}: {self.text[:1].upper()}{self.text[1:]}"


#: Codes to what is said of some names, and what to do.
DOUBTS = {
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
        "Fewer than 80 % of the samples lie in the 90 % predictive band of",
        "The likelihood takes the errors for smaller than they are.",
    ),
}


def doubts_of(result: xr.DataTree, table: list[Row]) -> list[Doubt]:
    """What to doubt, from the run and from its numbers."""
    failed = json.loads(result.attrs.get("failed", "{}"))
    found = [Doubt(kind, "failed", text) for kind, text in failed.items()]
    for kind in kinds_of(result):
        part = result[kind]
        found += [Doubt(kind, "run", text) for text in json.loads(part.attrs["warnings"])]
        for code, names in names_in_doubt(part, [row for row in table if row.kind == kind]).items():
            sentence, advice = DOUBTS[code]
            if names:
                found.append(Doubt(kind, code, f"{sentence} {', '.join(names)}. {advice}"))
        stats = part["sample_stats"].to_dataset() if "sample_stats" in part.children else {}
        if "failed" in stats and (n := int(stats["failed"].sum())):
            text = f"{n} of {int(stats['evaluations'].sum())} evaluations gave no response and count as "
            found.append(Doubt(kind, "impossible", f"{text}impossible."))
    return found


def names_in_doubt(part, table: list[Row]) -> dict[str, list[str]]:
    """Codes of `DOUBTS` to the parameters, or sensors, that they are about."""
    limit = R_HAT_NUTS if part.attrs["method"] == "NUTS" else R_HAT
    rows = [row for row in table if np.isfinite(row.taught)]
    wide = [row for row in rows if row.taught < TAUGHT]
    little = [row.name for row in wide if row.overlap > MOVED]
    moved = [row.name for row in wide if row.overlap <= MOVED]
    covered = part["bands"].get("coverage") if "bands" in part.children else None
    return {
        "chains": [row.name for row in rows if row.r_hat > limit],
        "draws": [row.name for row in rows if row.ess < FEWEST * part["posterior"].sizes["chain"]],
        "prior": little,
        "moved": moved,
        "apart": [name for name in undetermined_in(part) if name not in (*little, *moved)],
        "edge": [row.name for row in rows if leans(part, row)],
        "band": [] if covered is None else [str(s) for s in covered["sensor"].values[covered.values < 0.8]],
    }


def undetermined_in(part) -> list[str]:
    """Parameters, and combinations of them, that the data do not determine, as `sample` names them."""
    stats = part["sample_stats"].attrs if "sample_stats" in part.children else {}
    return [direction for direction in stats.get("undetermined", "").split(", ") if direction]


def changed(table: list[Row]) -> str:
    """Which parameters the data changed, under the first likelihood, by how much of the prior is left."""
    of_first = [row for row in table if row.kind == table[0].kind and np.isfinite(row.overlap)]
    ordered = sorted(of_first, key=lambda row: row.overlap)
    moved = [f"{r.name} ({r.overlap:.2f})" for r in ordered if r.overlap <= MOVED or r.taught >= TAUGHT]
    same = [f"{r.name} ({r.overlap:.2f})" for r in ordered if r.overlap > MOVED and r.taught < TAUGHT]
    parts = [f"The data changed {', '.join(moved)}" if moved else "The data changed no parameter"]
    parts += [f"they left as they were {', '.join(same)}"] if same else []
    return f"{'; '.join(parts)}. In brackets the overlap of prior and posterior: 1 if they are the same."


def leans(part, row) -> bool:
    """Whether a posterior lies where the prior has one per cent of its mass."""
    low, high = np.quantile(part["prior"][row.name].values, [0.01, 0.99])
    return not low < row.q50 < high
