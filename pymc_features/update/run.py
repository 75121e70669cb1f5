"""From a problem to its result: what is sampled, predicted and compared, with candidates and members.

Sections [compare] and [hierarchical] are problems of their own, sampled like that of the file.
"""

import json
import warnings
from collections.abc import Callable
from concurrent.futures import Executor
from functools import partial
from pathlib import Path

import numpy as np
import pymc as pm
import xarray as xr

from pymc_features.events import compare, hierarchical
from pymc_features.exceptions import ConfigError
from pymc_features.update.config.keys import named_key, shown
from pymc_features.update.kinds import KINDS
from pymc_features.update.kinds.base import QUANTILES, declare, geometry, mode_shapes, table
from pymc_features.update.predictions import predictions
from pymc_features.update.problem import Problem, problem_of, validated
from pymc_features.update.sampling import Running, run_parts, seed_of
from pymc_features.update.templates.numbers import interval_texts

GIVEN = "[structure]"  # what the structure of the file is called
LEFT_OUT = ("compare", "predict", "hierarchical")  # sections that are those of the file alone
COLUMNS = ("likelihood", "parameter", "of", "unit", "5 %", "50 %", "95 %")
MEANING = (
    "Mean and scatter of the population, the next member of it, and each member given all of them; of a "
    "log-normal population the mean is its median, the scatter the standard deviation of the logarithm."
)


def run_update(
    problem: Problem,
    *,
    out=None,
    cores: int | None = None,
    executor: int | str | Executor | None = None,
    progress: Callable[[str, int, int], None] | None = None,
    progressbar: bool = True,
) -> xr.DataTree:
    """Sample the posterior of every likelihood, and predict with it.

    Parameters
    ----------
    problem : Problem
        From `read_problem`.
    out : path, optional
        Folder in which each finished likelihood is kept at once; a second call with the same problem
        continues. Other likelihoods, another tolerance, report or `cores` are no other problem.
    cores : int, optional
        Processes; as the configuration says, or all processors.
    executor : int, str, dask Client or Executor, optional
        Where populations are evaluated, as of `sample_smc`; `cores` then says how many chains run at once.
    progress : callable (str, int, int), optional
        Called with the name of the likelihood in work, the number finished, and the number in all.
    progressbar : bool
        Whether each likelihood shows PyMC's own progress bar.

    Returns
    -------
    DataTree
        `/<kind>/` of each likelihood, CAL first: posterior, prior, sample_stats, observed_data, bands,
        histories (responses of draws by their principal components), modal and mode_shapes; calibration of
        CAL, what `effective_samples` returns; sequence of several events, all else is the state after the
        last; matched of identified modes, the mode that each is matched with; spectra of ambient vibration,
        see `ambient.fit.fitted_spectra`. Of all likelihoods `/data`, motion of the base, measured responses
        and their gain, or of a cyclic test displacement and force; `/identified` modes; `/geometry`, where
        degrees of freedom are; `/predict/<name>` of [[predict]], see `predictions`; `/compare/<likelihood>`,
        the evidence of candidates; `/hierarchical/<likelihood>`, the population. The attribute `failed` says
        in JSON which calibrated posterior could not be had, and why; if no other was asked for, that which
        it is made from is in its place. `units` are those of the parameters.

    Raises
    ------
    ConfigError
        If `out` holds another problem, or the tolerance of ABC is out of reach; everything else is kept.
    """
    candidates, members = candidates_of(problem), members_of(problem)  # whose errors come before any draw
    running = Running(out, cores, executor, progress, progressbar)
    parts, failed = run_parts(problem, running)
    reported = [kind for kind in problem.reported if kind in parts] or list(parts)
    title = problem.config.report.title.replace("/", "-")  # which would be a path in the tree
    result = xr.DataTree.from_dict({kind: parts[kind].copy() for kind in reported}, name=title)
    posteriors = {kind: parts[kind]["posterior"].to_dataset() for kind in reported}
    groups = compared(problem, candidates, parts, running)
    groups |= populations(problem, members, parts, running)
    for data in problem.shown:
        groups |= data.shared(problem)
    if problem.structure.has_modes:  # not kept in parts: other nodes are no other draws
        groups["geometry"] = geometry(problem)
        groups |= {f"{kind}/mode_shapes": mode_shapes(problem, one) for kind, one in posteriors.items()}
    motion = None if problem.measured is None else problem.measured.record
    settings = problem.config, problem.folder, problem.structure, posteriors[reported[0]], motion
    groups |= {f"predict/{name}": group for name, group in predictions(*settings).items()}
    for path, group in groups.items():
        result[path] = xr.DataTree(group)
    result.attrs["failed"] = json.dumps(failed)
    result.attrs["units"] = json.dumps(problem.units)
    return result


def variant(problem: Problem, changes: dict, at: str) -> Problem:
    """The problem of another file in the same folder, without priors that it does not use."""
    raw = {name: section for name, section in problem.raw.items() if name not in LEFT_OUT} | changes
    try:
        uses = validated(raw, prune=True).uses()
        raw["priors"] = {name: prior for name, prior in raw["priors"].items() if name in uses}
        return problem_of(problem.path, problem.text, validated(raw), raw)
    except ConfigError as error:
        raise ConfigError(f"[{at}]: {error}") from error


def candidates_of(problem: Problem) -> dict[str, Problem]:
    """The problem with the structure of each candidate, and with the priors that it uses."""
    raw, found = problem.raw, {}
    for name, asked in problem.config.compare.items():
        given = {} if "type" in asked.structure else raw["structure"]
        own = {"structure": given | asked.structure, "priors": raw["priors"] | asked.priors}
        if "likelihood" in raw:
            own["likelihood"] = raw["likelihood"] | {"kinds": with_evidence(problem.kinds)}
        found[name] = variant(problem, own, f"compare.{name}")
    return found


def members_of(problem: Problem) -> dict[str, Problem]:
    """Each member of [hierarchical] but the file itself, with its own sections in place of the file's."""
    asked, raw, found = problem.config.hierarchical, problem.raw, {}
    if asked is None:
        return found
    for name, sections in asked.members.items():
        merged = {section: raw.get(section, {}) | given for section, given in sections.items()}
        found[name] = variant(problem, merged, f"hierarchical.members.{name}")
    if strangers := [name for name in asked.population if name not in problem.structure.names]:
        raise ConfigError(
            f"`hierarchical.population` must name parameters of the structure "
            f"({', '.join(problem.structure.names)}), got {shown(strangers[0])}."
        )
    return found


def with_evidence(kinds) -> list[str]:
    return [kind for kind in kinds if not (KINDS[kind].calibrates or KINDS[kind].is_likelihood_free)]


def parts_of(problems, folder: str, settings: Running) -> dict[str, dict[str, xr.DataTree]]:
    """What is sampled of several problems, each kept in a folder of its own within that of the update."""
    found, tell = {}, settings.progress or (lambda part, done, total: None)
    for name, problem in problems.items():
        out = None if settings.out is None else Path(settings.out) / folder / name
        told = partial(lambda name, part, done, total: tell(f"{name}: {part}", done, total), name)
        found[name], _ = run_parts(problem, settings._replace(out=out, progress=told))
    return found


def compared(problem: Problem, candidates, parts, settings: Running) -> dict[str, xr.Dataset]:
    """Evidence and probability of candidates, and of `parts`, of the file: /compare/<likelihood> (model,)."""
    found = {GIVEN: parts} | parts_of(candidates, "compare", settings)
    prior = {GIVEN: 1.0} | {name: one.weight for name, one in problem.config.compare.items()}
    groups = {}
    for kind in with_evidence(parts) if candidates else ():
        of_kind = compare({name: of_model[kind] for name, of_model in found.items()}, prior=prior)
        groups[f"compare/{kind}"] = of_kind["comparison"].to_dataset()
    return groups


def populations(problem: Problem, members, parts, settings: Running) -> dict[str, xr.Dataset]:
    """The population of members and `parts`, those of the file: mean, scatter, the next one, and members."""
    found = {GIVEN: parts} | parts_of(members, "hierarchical", settings)
    everyone, groups = {GIVEN: problem} | members, {}
    for kind in [kind for kind in parts if not KINDS[kind].is_likelihood_free] if members else ():
        with named_key("hierarchical"), warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            result = hierarchical(
                [of_member[kind] for of_member in found.values()],
                hyper_model(problem),
                models=[declare(member, kind) for member in everyone.values()],
                random_seed=seed_of(problem, kind),
                **settings._replace(executor=None).of_sampler(problem.config.sampler),
            )
        ours = [str(w.message) for w in caught if w.category.__module__.startswith("pymc_features")]
        of_members, at = result["events"].to_dataset(), f"hierarchical/{kind}"
        groups[f"{at}/population"] = result["posterior"].to_dataset().assign_attrs(warnings=" ".join(ours))
        groups[f"{at}/next"] = result["predictive"].to_dataset()
        groups[f"{at}/members"] = of_members.assign_coords(event=list(everyone))
    return groups


def hyper_model(problem: Problem) -> pm.Model:
    """The population: of each parameter `NAME_mean` and `NAME_scatter`, on which it depends."""
    with pm.Model() as model:
        for name, asked in problem.config.hierarchical.population.items():
            mean, scatter = (getattr(asked, p).variable(f"{name}_{p}") for p in ("mean", "scatter"))
            middle = pm.math.log(mean) if asked.distribution == "LogNormal" else mean
            getattr(pm, asked.distribution)(name, middle, scatter)
    return model


def groups_in(result, name: str) -> dict:
    """Likelihoods with their group in /compare or /hierarchical."""
    return dict(getattr(result.children.get(name), "children", {}))


def comparison_sentences(result) -> list[str]:
    """Which candidate the data prefer, and what the draws of a population are worth where that is little."""
    told = []
    for kind, node in groups_in(result, "compare").items():
        pairs = zip(node["model"].values, node["probability"].values, strict=True)
        shares = ", ".join(f"{name} {float(p):.3f}" for name, p in pairs)
        told.append(f"Probabilities of the structures under {kind}: {shares}. {node.attrs['message']}")
    told += [node["population"].attrs["warnings"] for node in groups_in(result, "hierarchical").values()]
    return [text for text in told if text]


def population_table(problem: Problem, result) -> dict:
    """Mean and scatter of each parameter, the next one, and those of the members."""
    rows = []
    for kind, node in groups_in(result, "hierarchical").items():
        for name, asked in problem.config.hierarchical.population.items():
            unit, population, members = problem.units[name], node["population"], node["members"][name]
            of_scatter = "-" if asked.distribution == "LogNormal" else unit
            columns = [
                ("mean", unit, population[f"{name}_mean"]),
                ("scatter", of_scatter, population[f"{name}_scatter"]),
                ("the next one", unit, node["next"][name]),
                *((str(event), unit, members.sel(event=event)) for event in members["event"].values),
            ]
            for label, of_unit, draws in columns:
                shown_unit, texts = interval_texts(np.quantile(draws.values, QUANTILES), of_unit)
                rows.append((kind, name, label, shown_unit, *texts))
    return table("population", "population", "Mean, scatter and members", COLUMNS, rows, MEANING)
