"""Several specimens or laboratories, and the population they come from: [hierarchical]."""

import warnings

import numpy as np
import pymc as pm
import xarray as xr

from pymc_features.events import hierarchical
from pymc_features.exceptions import ConfigError
from pymc_features.update.candidates import GIVEN, LEFT_OUT, parts_of, variant
from pymc_features.update.config.messages import named_key, shown
from pymc_features.update.config.priors import Prior
from pymc_features.update.kinds import KINDS
from pymc_features.update.kinds.model import declare
from pymc_features.update.parts import RunSettings
from pymc_features.update.presentation.numbers import interval_texts
from pymc_features.update.problem import Problem
from pymc_features.update.sampling import seed_of

COLUMNS = ("likelihood", "parameter", "of", "unit", "5 %", "50 %", "95 %")
QUANTILES = (0.05, 0.5, 0.95)


def members_of(problem: Problem) -> dict[str, Problem]:
    """The file itself, and each member with its own sections in place of those of the file; none without.

    Raises
    ------
    ConfigError
        If a section of a member cannot be read; the message names the member.
    """
    if problem.config.hierarchical is None:
        return {}
    raw = {k: v for k, v in problem.raw.items() if k not in LEFT_OUT}
    found = {GIVEN: problem}
    for name, sections in problem.config.hierarchical.members.items():
        own = {
            section: raw[section] | given if isinstance(given, dict) and section in raw else given
            for section, given in sections.items()
        }
        found[name] = variant(problem, raw | own, f"hierarchical.members.{name}")
    for name in problem.config.hierarchical.population:
        if name not in problem.structure.names:
            raise ConfigError(
                f"`hierarchical.population` must name parameters of the structure "
                f"({', '.join(problem.structure.names)}), got {shown(name)}."
            )
    return found


def hyper_model(problem: Problem) -> pm.Model:
    """The population: of each parameter `NAME_mean` and `NAME_scatter`, on which it depends."""
    with pm.Model() as model:
        for name, asked in problem.config.hierarchical.population.items():
            at = f"hierarchical.population.{name}"
            mean, scatter = (
                Prior(f"{at}.{part}", given.distribution, given.arguments).declare(f"{name}_{part}")
                for part, given in (("mean", asked.mean), ("scatter", asked.scatter))
            )
            if asked.distribution == "LogNormal":
                pm.LogNormal(name, pm.math.log(mean), scatter)
            else:
                pm.Normal(name, mean, scatter)
    return model


def populations(problem: Problem, members, parts, settings: RunSettings) -> dict[str, xr.Dataset]:
    """The population under each likelihood that has a density, by `hierarchical`.

    Parameters
    ----------
    problem : Problem
        Perhaps with [hierarchical].
    members : dict
        From `members_of`.
    parts : dict
        Likelihoods to what was sampled with the data of the file.
    settings : RunSettings
        Members are kept in `hierarchical/<name>` of its folder.

    Returns
    -------
    dict
        `hierarchical/<likelihood>/` to the groups `population` (mean and scatter), `next`, and `members`.
    """
    if not members:
        return {}
    others = {name: member for name, member in members.items() if name != GIVEN}
    found = {GIVEN: parts} | parts_of(others, "hierarchical", settings)
    groups, sampler = {}, problem.config.sampler
    for kind in [kind for kind in parts if not KINDS[kind].is_likelihood_free]:
        with named_key("hierarchical"), warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            result = hierarchical(
                [of_member[kind] for of_member in found.values()],
                hyper_model(problem),
                models=[declare(member, kind) for member in members.values()],
                draws=sampler.draws,
                chains=sampler.chains,
                cores=settings.cores or sampler.cores,
                random_seed=seed_of(problem, kind),
                progressbar=settings.progressbar,
            )
        ours = [str(w.message) for w in caught if w.category.__module__.startswith("pymc_features")]
        of_members = result["events"].to_dataset().assign_coords(event=list(members))
        at = f"hierarchical/{kind}"
        groups[f"{at}/population"] = result["posterior"].to_dataset().assign_attrs(warnings=" ".join(ours))
        groups[f"{at}/next"] = result["predictive"].to_dataset()
        groups[f"{at}/members"] = of_members
    return groups


def population_rows(problem: Problem, result) -> list[tuple[str, ...]]:
    """Cells of `COLUMNS`: mean and scatter of each parameter, the next one, and those of the members."""
    rows = []
    for kind, node in kinds_with_population(result):
        for name, asked in problem.config.hierarchical.population.items():
            unit = problem.unit(name)
            of_scatter = "-" if asked.distribution == "LogNormal" else unit
            population, members = node["population"], node["members"][name]
            columns = [
                ("mean", unit, population[f"{name}_mean"]),
                ("scatter", of_scatter, population[f"{name}_scatter"]),
                ("the next one", unit, node["next"][name]),
                *((str(event), unit, members.sel(event=event)) for event in members["event"].values),
            ]
            for label, of_unit, draws in columns:
                of_row, texts = interval_texts(np.quantile(draws.values, QUANTILES), of_unit)
                rows.append((kind, name, label, of_row, *texts))
    return rows


def population_sentences(result) -> list[str]:
    """What the weights of the members' draws are worth, where they are not worth much."""
    told = (node["population"].attrs["warnings"] for _, node in kinds_with_population(result))
    return [text for text in told if text]


def kinds_with_population(result):
    """Likelihoods with their group in /hierarchical."""
    return getattr(result.children.get("hierarchical"), "children", {}).items()
