"""The figures of an update, with what they show in words."""

from pymc_features import plots
from pymc_features.update.presentation.shown import Figure
from pymc_features.update.problem import Problem
from pymc_features.update.report.summary import kinds_of


def figures(problem: Problem, result) -> list[Figure]:
    """Every figure of the report; nothing is drawn yet."""
    found = [figure for data in problem.data for figure in data.figures(problem, result)]
    for kind in kinds_of(result):
        part = result[kind]
        found.append(of_posterior(problem, part, kind))
        found += [figure for data in problem.data for figure in data.figures_of(problem, part, kind)]
        found += of_run(part, kind)
    return found


def of_posterior(problem, part, kind) -> Figure:
    """Prior against posterior."""
    units = {name: problem.unit(name) for name in problem.priors}
    return Figure(
        f"{kind}_prior_posterior",
        f"{kind}: prior (grey) against posterior, each to its own height.",
        lambda: plots.plot_prior_posterior(part, units=units),
    )


def of_run(part, kind) -> list[Figure]:
    """How the sampler fared."""
    found = []
    if has_stages(part):
        found.append(
            Figure(
                f"{kind}_stages",
                f"{kind}: the way from the prior, or from the first guess at the modes, to the posterior, "
                "and the acceptance of its moves.",
                lambda: plots.plot_tempering(part),
            )
        )
    if part["posterior"].sizes["chain"] > 1:
        found.append(
            Figure(
                f"{kind}_ranks",
                f"{kind}: density of each chain, and ranks of its draws; the curves "
                "of chains that agree stay near the middle (p: of a test that they do).",
                lambda: plots.plot_chains(part, "rank"),
            )
        )
    if part.attrs["method"] == "NUTS":
        found.append(Figure(f"{kind}_traces", f"{kind}: traces.", lambda: plots.plot_chains(part, "trace")))
    return found


def has_stages(part) -> bool:
    """Whether the sampler went to the posterior in stages."""
    return "sample_stats" in part.children and part["sample_stats"].sizes.get("stage", 0) > 1
