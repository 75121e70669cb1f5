"""Likelihood-free updating at a hard tolerance by many methods, judged by the exact region.

The problem is in `benchmarks.abc_problem`; its prior puts 2.6e-4 within the tolerance. All methods call our
compiled simulator, those that take batches the batched kernel and the others the scalar one, so that the
comparison is about the algorithm. Users of the others would pay for a simulator of their own.

The effective size of a run is 2 over the mean of d' C^-1 d, where d is the error of the posterior mean of
(theta_1, theta_2) and C the exact covariance: bias counts as much as scatter. R runs of two parameters tell
it to about 1 / sqrt(R).
"""

from dataclasses import dataclass

import numpy as np

from benchmarks.abc_problem import ACCEPTANCE, ToleranceProblem
from benchmarks.methods import ABC_METHODS
from benchmarks.posteriors import collect, filled_rows, say_what_is_missing
from benchmarks.tables import significant, table

OURS = "SubsetSimulation (ours)"
# Draws; seeds; seconds for each method after its first run, above which it has no second, and least runs
FULL = (1000, 40, 8.0, np.inf, 8)
QUICK = (800, 4, 1.0, 8.0, 2)


@dataclass(frozen=True, eq=False)
class Score:
    """Means over the R runs of a method, if not said otherwise.

    Attributes
    ----------
    runs : int
        R.
    simulations, draws : float
    within, distinct : float
        Shares of the draws.
    effective : float
        Effective size of a run.
    bias, width : array (2,)
        Mean over the runs minus the exact one, over the exact standard deviation; standard deviation of the
        draws over the exact one.
    log_probability_error : array (R,)
        NaN where the method gives none.
    first, seconds : float
        Seconds of the first run; median of a later one.
    """

    runs: int
    simulations: float
    draws: float
    within: float
    distinct: float
    effective: float
    bias: np.ndarray
    width: np.ndarray
    log_probability_error: np.ndarray
    first: float
    seconds: float

    @property
    def accepted(self):
        """Draws within the tolerance."""
        return self.within * self.draws


def score(results, seconds, problem):
    """Return the score of a list of results and their seconds."""
    exact = problem.exact
    scale = np.sqrt(np.diag(exact.covariance))
    errors = np.array([r.points.mean(axis=0) - exact.mean for r in results])
    distances = np.einsum("ri,ij,rj->r", errors, np.linalg.inv(exact.covariance), errors)
    return Score(
        runs=len(results),
        simulations=float(np.mean([r.simulations for r in results])),
        draws=float(np.mean([len(r.points) for r in results])),
        within=float(np.mean([(problem.rho(r.points) <= exact.epsilon).mean() for r in results])),
        distinct=float(np.mean([len(np.unique(r.points, axis=0)) / len(r.points) for r in results])),
        effective=2.0 / float(distances.mean()),
        bias=errors.mean(axis=0) / scale,
        width=np.mean([r.points.std(axis=0) for r in results], axis=0) / scale,
        log_probability_error=np.array([r.log_probability for r in results]) - np.log(ACCEPTANCE),
        first=seconds[0],
        seconds=float(np.median(seconds[1:] or seconds)),
    )


def seconds_each(s):
    """Seconds of a run, of an accepted and of an effective draw."""
    return s.seconds, s.seconds / s.accepted, s.seconds / s.effective


def cost_row(s, ours):
    """Cells of the first table; `~` where R is too small for an effective size to mean much."""
    about = "" if s.runs >= 5 else "~"
    seconds = seconds_each(s)
    ratios = np.divide(seconds, ours)
    return [
        f"{s.runs} ({100.0 / np.sqrt(s.runs):.0f} %)",
        *map(significant, (s.simulations, s.simulations / s.accepted)),
        about + significant(s.simulations / s.effective),
        *map(significant, (s.first, *seconds[:1], 1e3 * seconds[1])),
        about + significant(1e3 * seconds[2]),
        *map(significant, ratios[:2]),
        about + significant(ratios[2]),
    ]


def accuracy_row(s):
    """Cells of the second table."""
    error = s.log_probability_error
    spread = f"{error.std(ddof=1):.2f}" if s.runs > 1 else "?"
    probability = f"{error.mean():+.2f} +- {spread}" if np.isfinite(error).all() else "-"
    return [
        *(significant(s.draws), f"{100.0 * s.within:.0f} %", f"{100.0 * s.distinct:.0f} %"),
        *(" / ".join(f"{value:+.2f}" for value in s.bias), " / ".join(f"{value:.2f}" for value in s.width)),
        probability,
    ]


COST = (
    *("method", "R (+-)", "simulations", "per accepted draw", "per eff. draw"),
    *("first run s", "later run s", "ms per accepted", "ms per eff.", "s x ours", "per accepted", "per eff."),
)
ACCURACY = ("method", "draws", "rho <= epsilon", "distinct", "bias", "width", "log P error")

NOTES = """
Exact, by a grid: epsilon = {:.4f} (m/s^2)^2, P = {:.2g}, means {}, standard deviations {}.
First table: +- is the relative uncertainty of the effective sizes from R runs, `accepted` are draws with
rho <= epsilon; the last three columns compare the seconds of a run, of an accepted and of an effective draw.
Rejection is asked for a twentieth of the draws. Second table: bias of the means over the exact standard
deviations, and standard deviations over the exact ones, of theta_1 / theta_2; log P: mean +- scatter."""


def run(quick=False):
    """Print both tables."""
    draws, *turns = QUICK if quick else FULL
    problem = ToleranceProblem(draws)
    exact = problem.exact
    print(f"\n## ABC at a hard tolerance: 10 DOF, 10 sensors, 1000 samples, 2 parameters, {draws} draws\n")
    results, seconds, reasons = collect(ABC_METHODS, problem, *turns)
    scores = {name: score(found, seconds[name], problem) for name, found in results.items()}
    reference = seconds_each(scores[OURS]) if OURS in scores else (np.nan,) * 3
    for headers, cells in ((COST, lambda s: cost_row(s, reference)), (ACCURACY, accuracy_row)):
        print("\n" + table(headers, filled_rows(ABC_METHODS, headers, cells, scores, reasons)))
    deviations = np.sqrt(np.diag(exact.covariance))
    print(NOTES.format(exact.epsilon, ACCEPTANCE, exact.mean.round(5), deviations.round(5)))
    say_what_is_missing(scores, reasons)
