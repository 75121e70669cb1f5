"""Several structures for the same data, compared by their evidence: [compare]."""

from functools import partial
from pathlib import Path

import xarray as xr

from pymc_features.events import compare
from pymc_features.exceptions import ConfigError
from pymc_features.update.document import validated
from pymc_features.update.kinds import KINDS
from pymc_features.update.parts import RunSettings, run_parts
from pymc_features.update.problem import Problem, problem_of

GIVEN = "[structure]"  # what the structure of the file is called
LEFT_OUT = ("compare", "predict", "hierarchical")  # sections that are those of the file alone


def problem_with(problem: Problem, name: str) -> Problem:
    """The problem with the structure of one candidate, and with the priors that it uses.

    Raises
    ------
    ConfigError
        If it is no structure, or a prior is missing; the message names the candidate.
    """
    asked, raw = problem.config.compare[name], problem.raw
    own = {k: v for k, v in raw.items() if k not in LEFT_OUT}
    own["structure"] = asked.structure if "type" in asked.structure else raw["structure"] | asked.structure
    own["priors"] = raw["priors"] | asked.priors
    if "likelihood" in raw:
        own["likelihood"] = raw["likelihood"] | {"kinds": with_evidence(problem.kinds)}
    return variant(problem, own, f"compare.{name}")


def variant(problem: Problem, raw: dict, at: str) -> Problem:
    """The problem of another file in the same folder, without priors that it does not use.

    Raises
    ------
    ConfigError
        If it cannot be read; the message begins with the section `at`.
    """
    try:
        uses = validated(raw, prune=True).uses()
        raw = raw | {"priors": {k: v for k, v in raw["priors"].items() if k in uses}}
        return problem_of(problem.path, problem.text, validated(raw), raw)
    except ConfigError as error:
        raise ConfigError(f"[{at}]: {error}") from error


def with_evidence(kinds) -> list[str]:
    """Choose the likelihoods whose posterior has an evidence."""
    return [kind for kind in kinds if not (KINDS[kind].calibrates or KINDS[kind].is_likelihood_free)]


def candidates_of(problem: Problem) -> dict[str, Problem]:
    """The problem with the structure of each candidate."""
    return {name: problem_with(problem, name) for name in problem.config.compare}


def compared(problem: Problem, candidates, parts, settings: RunSettings) -> dict[str, xr.Dataset]:
    """Evidence and probability of every candidate under each likelihood that has an evidence.

    Parameters
    ----------
    problem : Problem
        Perhaps with [compare].
    candidates : dict
        From `candidates_of`.
    parts : dict
        Likelihoods to what was sampled with the structure of the file.
    settings : RunSettings
        Candidates are kept in `compare/<name>` of its folder.

    Returns
    -------
    dict
        `compare/<likelihood>` to the group `comparison` of `compare`, (model,).
    """
    asked = problem.config.compare
    if not asked:
        return {}
    found = {GIVEN: parts} | parts_of(candidates, "compare", settings)
    prior = {GIVEN: 1.0} | {name: candidate.weight for name, candidate in asked.items()}
    return {
        f"compare/{kind}": compare({name: of_kind[kind] for name, of_kind in found.items()}, prior=prior)[
            "comparison"
        ].to_dataset()
        for kind in with_evidence(parts)
    }


def parts_of(problems, folder: str, settings: RunSettings) -> dict[str, dict[str, xr.DataTree]]:
    """What is sampled of several problems, each kept in a folder of its own within that of the update."""
    found = {}
    for name, problem in problems.items():
        own = settings._replace(
            out=None if settings.out is None else Path(settings.out) / folder / name,
            progress=settings.progress and partial(told, settings.progress, name),
        )
        found[name] = run_parts(problem, own).found
    return found


def told(progress, name: str, part: str, done: int, total: int) -> None:
    """Progress of one candidate."""
    progress(f"{name}: {part}", done, total)


def comparison_sentences(comparison: xr.Dataset, kind: str) -> list[str]:
    """Which candidate the data prefer under a likelihood, and by how much."""
    shares = ", ".join(
        f"{name} {float(p):.3f}"
        for name, p in zip(comparison["model"].values, comparison["probability"].values, strict=True)
    )
    return [f"Probabilities of the structures under {kind}: {shares}. {comparison.attrs['message']}"]
