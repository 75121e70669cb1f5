"""Whole posteriors of one example by many methods, judged by its exact solution.

The methods take turns, one seed after another, until R = 20 or their share of the time is spent.
The first table tells what an effective sample costs, the second how right the result is.
"""

import contextlib
import io
import logging
import time

import numpy as np

from benchmarks.methods import METHODS, NotThereError
from benchmarks.problem import Problem
from benchmarks.scores import score
from benchmarks.tables import significant, table

# Seeds; seconds for each method after its first run, which compiles; seconds above which it has no second
FULL = (20, 45.0, np.inf)
QUICK = (3, 2.0, 10.0)


@contextlib.contextmanager
def silenced():
    """Without the progress reports of the samplers."""
    logging.disable(logging.CRITICAL)
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            yield
    finally:
        logging.disable(logging.NOTSET)


def attempt(method, problem, seed):
    """Run once; return (result, seconds), or None and why it failed as (status, reason)."""
    start = time.perf_counter()
    try:
        with silenced():
            result = method(problem, seed)
    except ImportError as error:
        return None, ("not installed", str(error))
    except NotThereError as error:
        return None, ("not there", str(error))
    except Exception as error:  # a competitor's failure is a result, and the others go on
        return None, ("failed", f"{type(error).__name__}: {error}, seed {seed}")
    return result, time.perf_counter() - start - result.counting


def spent(seconds, budget, patience, least):
    """Whether a method has had its share of the time, and its least number of runs."""
    return (len(seconds) >= least and sum(seconds[1:]) > budget) or sum(seconds[:1]) > patience


def collect(methods, problem, runs, budget, patience, least=1):
    """Run the methods in turns; return their results, seconds, and the reasons of those that cannot run."""
    results, seconds, reasons = {}, {}, {}
    for seed in range(1, runs + 1):
        for name, method in methods.items():
            if name in reasons or spent(seconds.get(name, []), budget, patience, least):
                continue
            result, told = attempt(method, problem, seed)
            if result is None:
                reasons[name] = told
                continue
            results.setdefault(name, []).append(result)
            seconds.setdefault(name, []).append(told)
        print(f"seed {seed} of {runs}: {sum(map(sum, seconds.values())):.0f} s so far", flush=True)
    return results, seconds, reasons


def cost_row(s):
    """Cells of the first table; `~` where R is too small for an effective size to mean much."""
    about = "" if s.runs >= 5 else "~"
    each = [*(s.evaluations / s.effective), *(1e3 * s.seconds / s.effective)]
    return [
        f"{s.runs} ({100.0 * np.sqrt(2.0 / s.runs):.0f} %)",
        *map(significant, (s.evaluations, s.first, s.seconds, s.set_up)),
        *["-" if np.isnan(value) else about + significant(value) for value in each],
    ]


def accuracy_row(s):
    """Cells of the second table."""
    evidence = "-"
    if np.isfinite(s.log_evidence).all():
        spread = f"{s.log_evidence.std(ddof=1):.2f}" if s.runs > 1 else "?"
        evidence = f"{s.log_evidence.mean():.2f} +- {spread}"
    quantiles = [" / ".join(f"{100.0 * error:.1f}" for error in row) for row in s.quantile_error]
    return [evidence, *quantiles, f"{s.distinct:.0f} of {s.draws:.0f}"]


def filled_rows(methods, headers, cells, scores, reasons):
    """Rows of a table, and dashes for the methods that could not run."""
    return [
        [name, *cells(scores[name])]
        if name in scores
        else [name, reasons[name][0], *["-"] * (len(headers) - 2)]
        for name in methods
    ]


def say_what_is_missing(scores, reasons):
    """Print why methods could not run, or not to the end."""
    for name, (status, reason) in reasons.items():
        before = ", its rows are of the runs before" if name in scores else ""
        print(f"{name}: {status} ({reason}){before}.")


COST = (
    *("method", "R (+-)", "evaluations", "first run s", "later run s", "of it set-up s"),
    *("evaluations per eff. theta", "sigma", "ms per eff. theta", "sigma"),
)
ACCURACY = ("method", "log evidence", "theta error 5/50/95 %", "sigma error 5/50/95 %", "distinct draws")

NOTES = """
Exact log evidence {:.3f}. First table: +- is the relative uncertainty of the effective sizes from R runs;
`later run` is the median after the first, which also compiles. Evaluations of NUTS are log-likelihoods with
gradients; BlackJAX evaluates each particle thirteen times a stage; peers without JAX call our scalar kernel.
Second table: quantile errors are root mean squares over the runs, in per cent of the exact 5-95 % width."""


def run(quick=False):
    """Print both tables."""
    print("\n## Posterior of the ten-storey example under TN (1000 samples, 10 sensors, 2 parameters)\n")
    problem = Problem()
    exact = problem.exact
    results, seconds, reasons = collect(METHODS, problem, *(QUICK if quick else FULL))
    scores = {name: score(found, seconds[name], exact) for name, found in results.items()}
    for headers, cells in ((COST, cost_row), (ACCURACY, accuracy_row)):
        print("\n" + table(headers, filled_rows(METHODS, headers, cells, scores, reasons)))
    print(NOTES.format(exact.log_evidence))
    say_what_is_missing(scores, reasons)
