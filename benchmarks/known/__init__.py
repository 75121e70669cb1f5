"""Posteriors whose answers are known, by name: `problem("EXP-11-wide")`, `problem("funnel-10")`.

`problem(name)` has the PyMC model, exact 5, 50 and 95 % quantiles of each scalar parameter with their
errors, and the log evidence. The structural ones are answered by quadrature or by long chains
(`benchmarks.known.exact`, saved in `answers.json`), most targets in closed form or by one integral.
"""

from benchmarks.known import structural
from benchmarks.known.answer import PROBABILITIES, Answer, Modes, Problem, flat_draws
from benchmarks.known.saved import saved_answer
from benchmarks.known.targets import NAMES as TARGET_NAMES
from benchmarks.known.targets import TARGETS

STRUCTURAL_NAMES = structural.NAMES
NAMES = (*STRUCTURAL_NAMES, *TARGET_NAMES)


def problem(name):
    """The problem of a name: LIKELIHOOD-d-PRIOR for a structure, TARGET-d for a target, in any d it has."""
    kind, d, *_ = name.split("-")
    if kind in structural.LIKELIHOODS:
        return Problem(structural.declare(name), saved_answer(name))
    return TARGETS[kind](int(d))


__all__ = [
    "NAMES",
    "PROBABILITIES",
    "STRUCTURAL_NAMES",
    "TARGETS",
    "TARGET_NAMES",
    "Answer",
    "Modes",
    "Problem",
    "flat_draws",
    "problem",
]
