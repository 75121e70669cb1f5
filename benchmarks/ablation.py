"""What each part of `pmf.sample` buys: runs without it, beside runs with all, on known targets."""

import sys
import time
from contextlib import ExitStack
from unittest.mock import patch

import numpy as np

import pymc_features as pmf
from benchmarks.comparison import gradient_cost
from benchmarks.known import flat_draws, problem
from benchmarks.known.answer import PROBABILITIES
from benchmarks.samplers.run import evidence, of_search, total
from benchmarks.tables import significant, table
from pymc_features.smc.kernels import persistent
from pymc_features.smc.proposals import pool, reference, unbending

TARGETS = (
    *("TN-4-wide", "funnel-10", "banana-10", "corner-10", "student-10", "schools_centred-10"),
    *("modes_19-10", "TN-11-wide", "EXP-11-wide", "TN-22-wide"),
)
QUICK_TARGETS = ("TN-4-wide", "funnel-10")
SEEDS = (1, 2, 3)
DRAWS = 500
SETTINGS = {"chains": 2, "cores": 1, "check": None, "progressbar": False}


def without_map(*args, **kwargs):
    """Fail as a fit does that cannot be made."""
    raise ValueError("no map")


def only_along_parameters(x, weights, rng, rotated=True, *args, **kwargs):
    """Fit a map along the parameters; none along the principal axes."""
    return without_map() if rotated else fit_unbent(x, weights, rng, False, *args, **kwargs)


def only_along_principal_axes(x, weights, rng, rotated=True, *args, **kwargs):
    """Fit a map along the principal axes; none along the parameters."""
    return fit_unbent(x, weights, rng, True, *args, **kwargs) if rotated else without_map()


fit_unbent = unbending.fit_unbent
entry = sys.modules[pmf.sample.__module__]

# part -> (object, attribute, what stands there instead), any number of them
PARTS = {
    "nothing": (),
    "trials": ((persistent.PersistentSMC, "pays_to_fit_again", lambda self, trials: False),),
    "draws anew": ((persistent, "HEAVY_K", np.inf),),
    "second map": ((persistent, "fit_to", lambda *args, twice: unbending.fit_to(*args)),),
    "maps": ((unbending, "fit_unbent", without_map),),
    "maps along principal axes": ((unbending, "fit_unbent", only_along_parameters),),
    "maps along parameters": ((unbending, "fit_unbent", only_along_principal_axes),),
    "bends of modes": ((reference.Reference, "bent", lambda self, *rest: self),),
    "trajectories": ((persistent.FittedMoves, "wants_trial", False), (persistent, "OF_TRAJECTORIES", 0.0)),
    "fits in place of chains": ((persistent.PersistentSMC, "fit_is_good", lambda self: False),),
    "chains until a fit is usable": ((persistent, "MOST_ROUNDS", 0),),
    "paths from a reference": ((persistent, "USABLE_REFERENCE", 2.0),),
    "climbs": ((entry, "find_reference", lambda *args: None),),
    "smoothing": ((pool, "pareto_smoothed", lambda log_weights: log_weights),),
}


def judged(there, ratio, part, seed):
    """CPU seconds, evaluations, error of the worst quantile, bias of ln Z and its error, of one run."""
    start = time.process_time()
    with ExitStack() as stack:
        for thing, name, instead in PARTS[part]:
            stack.enter_context(patch.object(thing, name, instead))
        idata = pmf.sample(DRAWS, model=there.model, random_seed=seed, **SETTINGS)
    seconds = time.process_time() - start
    values, gradients = np.array([total(idata, "evaluations"), total(idata, "gradients")]) + of_search(idata)
    draws = np.quantile(flat_draws(there.model, idata), PROBABILITIES, axis=0)
    error = (np.abs(draws - there.answer.quantiles) / there.answer.width).max()
    log_z, se = evidence(idata)
    return seconds, values + ratio * gradients, error, log_z - there.answer.log_evidence, se


def rows_of(name, parts, seeds):
    """A row for each part that a target is sampled without, and its logarithms of CPU and evaluations."""
    there = problem(name)
    ratio = gradient_cost(there.model, rounds=1)
    judged(there, ratio, "nothing", 0)  # compiles
    rows, found = [], {}
    for part in parts:
        try:
            runs = np.array([judged(there, ratio, part, seed) for seed in seeds])
        except Exception as error:  # a part that is needed is a result, and the others go on
            rows.append([name, part, type(error).__name__, *["-"] * 5])
            print(" | ".join(rows[-1]), flush=True)
            continue
        found[part] = runs
        full = found["nothing"]
        cpu, evaluations = np.exp(np.log(runs[:, :2]).mean(axis=0) - np.log(full[:, :2]).mean(axis=0))
        bias, se = runs[:, 3].mean(), np.sqrt((runs[:, 4] ** 2).mean())
        least = 100.0 * np.sqrt((runs[:, 2] ** 2).mean())
        cells = (runs[:, 0].mean(), cpu, runs[:, 1].mean(), evaluations, least)
        rows.append([name, part, *map(significant, cells), f"{bias:+.2f} +- {se:.2f}"])
        print(" | ".join(rows[-1]), flush=True)
    return rows


HEADERS = (
    "target",
    "without",
    "CPU s",
    "ratio",
    "evaluations",
    "ratio",
    "worst quantile: % of width",
    "ln Z bias +- SE",
)


def run(quick=False, names=None):
    """Print a row for each target and part that it is sampled without."""
    print("\n## Parts of `pmf.sample`\n")
    rows, seeds = [], SEEDS[:1] if quick else SEEDS
    try:
        for name in names or (QUICK_TARGETS if quick else TARGETS):
            rows += rows_of(name, PARTS, seeds)
    finally:
        print("\n" + table(HEADERS, rows))
        print(f"\nMeans of {len(seeds)} seeds, 2 chains of {DRAWS} draws, no cross-check.")
