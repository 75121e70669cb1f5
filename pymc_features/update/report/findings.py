"""What is found in a result, in numbers and sentences: once, for the terminal and for the report."""

from typing import NamedTuple

from pymc_features.update.problem.read import Problem
from pymc_features.update.report.summary import Row, rows, supported, warnings_of
from pymc_features.update.report.verdict import Verdict, verdict


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
    doubts : list of str
        Warnings, each with its likelihood in front.
    """

    verdict: Verdict
    left_out: str
    supported: str
    table: list[Row]
    doubts: list[str]


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
    return Findings(
        verdict(problem, result),
        gaps_of(problem),
        supported(problem, result),
        table,
        warnings_of(result, table),
    )


def gaps_of(problem: Problem) -> str:
    """A sentence on what was not compared; empty without gaps."""
    left_out = problem.measured.left_out
    return f"Left out as gaps: {left_out}." if left_out else ""
