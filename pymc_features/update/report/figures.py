"""The figures of an update, with what they show in words."""

from typing import NamedTuple

import numpy as np

from pymc_features import plots
from pymc_features.update.kinds.ambient import draw_spectra
from pymc_features.update.kinds.events import draw_events
from pymc_features.update.kinds.modal import draw_mac, draw_shapes
from pymc_features.update.problem import Problem
from pymc_features.update.report.summary import kinds_of

ZOOM = 4.0  # [s] around the strongest motion
LONG = (
    "A record of more samples than the figure has pixels is drawn by its smallest and largest values: as a "
    "grey area what was measured, by two lines a response that oscillates too fast for one."
)


class Figure(NamedTuple):
    """A figure: its file name without suffix, its caption, and a function that draws it."""

    name: str
    caption: str
    draw: object


def figures(problem: Problem, result, modes) -> list[Figure]:
    """Every figure of the report; nothing is drawn yet. `modes` are the rows of each likelihood."""
    found = of_data(result) if problem.measured is not None and not problem.is_cyclic else []
    for kind in kinds_of(result):
        first, *rest = of_one(problem, result[kind], kind)
        found.append(first)
        if kind in modes:
            found += of_modes(problem, result[f"{kind}/shapes"].to_dataset(), modes[kind], kind)
        found += rest
    return found


def of_data(result) -> list[Figure]:
    """Figures of responses that all likelihoods share."""
    return [
        Figure(
            "record",
            "Motion of the base that the model is shaken with, after processing.",
            lambda: plots.plot_record(result),
        ),
        Figure(
            "frequencies",
            "Gain of the sensors against the base (root of the ratio of power spectra), and below it the "
            "5-95 % intervals of the natural frequencies with their medians under each likelihood. Dotted: "
            "peaks of the gain; dashed: frequencies given in the configuration, or identified.",
            lambda: plots.plot_natural_frequencies(result),
        ),
    ]


def of_modes(problem, shapes, rows, kind) -> list[Figure]:
    """Figures of identified modes under one likelihood."""
    found = []
    if "at_channels" in shapes:
        found.append(
            Figure(
                f"{kind}_mac",
                f"{kind}: modal assurance criterion of the identified shapes and those of the model, median "
                "and 5-95 % interval of the draws. Framed: the modes that are matched.",
                lambda: draw_mac(problem.modal, shapes, rows),
            )
        )
    if "at_points" in shapes:
        found.append(
            Figure(
                f"{kind}_shapes",
                f"{kind}: identified shapes (dots) on those of the model they are matched with, each draw "
                "scaled by the factor that brings it closest.",
                lambda: draw_shapes(problem.modal, shapes, rows),
            )
        )
    return found


def of_one(problem, part, kind) -> list[Figure]:
    """Figures of one likelihood."""
    units = {name: problem.unit(name) for name in problem.priors}
    found = [
        Figure(
            f"{kind}_prior_posterior",
            f"{kind}: prior (grey) against posterior, each to its own height.",
            lambda: plots.plot_prior_posterior(part, units=units),
        ),
    ]
    if "sequence" in part.children:
        found.append(
            Figure(
                f"{kind}_events",
                f"{kind}: mean and 90 % interval of each parameter after each event, with the alarms.",
                lambda: draw_events(part, units),
            )
        )
    if problem.is_cyclic:
        found.append(of_loops(part, kind))
    elif "bands" in part.children:
        found += of_responses(part, kind)
    if "spectra" in part.children:
        found.append(
            Figure(
                f"{kind}_spectra",
                f"{kind}: singular values of the spectra of the channels (black the first, grey the others), "
                "averaged over twenty parts of the record; shaded the bands that are compared, and in red "
                "what the model makes of them there, median and 5-95 % interval. Dotted: identified modes.",
                lambda: draw_spectra(problem.ambient, part["spectra"].to_dataset()),
            )
        )
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


def of_responses(part, kind) -> list[Figure]:
    """Figures of responses under one likelihood."""
    shades = "Dark: 5-95 % of the response, from the uncertainty of the parameters. "
    if "predictive" in part["bands"]:
        shades += "Light: 5-95 % of data drawn from the likelihood, where measured samples should lie."
    return [
        Figure(
            f"{kind}_response",
            f"{kind}: measured response and posterior predictive bands. {shades} {LONG}",
            lambda: plots.plot_predictive(part),
        ),
        Figure(
            f"{kind}_response_zoom",
            f"{kind}: the same, {ZOOM:g} s around the strongest motion.",
            lambda: plots.plot_predictive(part, window=strongest(part)),
        ),
    ]


def of_loops(part, kind) -> Figure:
    """Figure of a cyclic test under one likelihood."""
    bands, force = part["bands"].to_dataset(), part["observed_data"]["y"]
    found = bands[["response"]].rename(response="restoring_force")
    return Figure(
        f"{kind}_loops",
        f"{kind}: force against displacement in three parts of the test. Dashed what was measured; blue the "
        "5-95 % interval and the median of the specimen, from the uncertainty of the parameters.",
        lambda: plots.plot_loops(found, measured=force),
    )


def has_stages(part) -> bool:
    """Whether the sampler went to the posterior in stages."""
    return "sample_stats" in part.children and part["sample_stats"].sizes.get("stage", 0) > 1


def strongest(part) -> tuple[float, float]:
    """A window [s] around the largest measured acceleration."""
    observed = part["observed_data"]["y"]
    peak = float(observed["time"][int(np.abs(np.nan_to_num(observed.values)).max(axis=0).argmax())])
    last = float(observed["time"][-1])
    first = max(0.0, min(peak - 0.4 * ZOOM, last - ZOOM))
    return first, min(last, first + ZOOM)
