"""What is found in a result, in numbers and sentences: once, for the terminal and for the report."""

import json
import math
from typing import NamedTuple

from pymc_features.update.candidates import comparison_sentences
from pymc_features.update.kinds.events import events_verdict
from pymc_features.update.population import population_rows, population_sentences
from pymc_features.update.predictions import PredictedRow, predicted_rows
from pymc_features.update.presentation.mode_rows import ModeRow
from pymc_features.update.presentation.shown import Verdict
from pymc_features.update.problem import Problem
from pymc_features.update.report.summary import Doubt, Row, changed, doubts_of, kinds_of, rows, supported


class Findings(NamedTuple):
    """What terminal and report say of a result.

    Attributes
    ----------
    verdict : Verdict
        On the fit of the first likelihood.
    left_out : str
        Which part of each sensor is left out as a gap; empty without gaps.
    supported : str
        How many observations the residuals support; empty without CAL.
    table : list of Row
        The posterior under all likelihoods.
    doubts : list of Doubt
        What to doubt about it.
    changed : str
        Which parameters the data changed, under the first likelihood.
    modes : dict
        Likelihoods to their rows of identified modes; empty without any.
    events : str
        Whether the structure changed from event to event; empty without several.
    is_unchanged : bool
        Whether no event raised an alarm.
    besides : list of str
        Which candidate the data prefer.
    predicted : list of PredictedRow
        Peaks and limits under other motions.
    population : list of tuple
        Cells of the population of several members.
    """

    verdict: Verdict
    left_out: str
    supported: str
    table: list[Row]
    doubts: list[Doubt]
    changed: str
    modes: dict[str, list[ModeRow]]
    events: str
    is_unchanged: bool
    besides: list[str]
    predicted: list[PredictedRow]
    population: list[tuple[str, ...]]


def findings(problem: Problem, result) -> Findings:
    """Judge a result.

    Parameters
    ----------
    problem : Problem
        What was updated.
    result : DataTree
        From `run_update`.
    """
    table = rows(problem, result)
    modes = {}
    if problem.modal is not None:
        modes = {kind: problem.modal.rows(result[f"{kind}/matched"]) for kind in kinds_of(result)}
    first, left_out = kinds_of(result)[0], problem.first.left_out
    of_first = problem.verdict(result, first)
    return Findings(
        of_first,
        f"Left out as gaps: {left_out}." if left_out else "",
        supported(problem, result, of_first.explains),
        table,
        doubts_of(result, table),
        changed(table),
        modes,
        *events_verdict(first, result[first]),
        besides(result),
        predicted_rows(result),
        population_rows(problem, result),
    )


def besides(result) -> list[str]:
    """Sentences on the comparisons in a result."""
    told = []
    for kind, node in getattr(result.children.get("compare"), "children", {}).items():
        told += comparison_sentences(node.to_dataset(), kind)
    return told + population_sentences(result)


def as_json(found: Findings) -> str:
    """Findings for scripts: verdict, table in SI units, and doubts with their codes; no number is null."""
    rows = [
        {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in row._asdict().items()}
        for row in found.table
    ]
    return json.dumps(
        {
            "explains": found.verdict.explains,
            "verdict": found.verdict.sentences,
            "is_unchanged": found.is_unchanged,
            "sentences": list(filter(None, [found.events, found.left_out, found.supported, *found.besides])),
            "table": rows,
            "predicted": [row._asdict() for row in found.predicted],
            "findings": [doubt._asdict() for doubt in found.doubts],
        }
    )
