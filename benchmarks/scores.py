"""How good repeated runs of a sampler are against the exact posterior.

The effective size of one run is the posterior's variance over the mean squared error of the posterior
means of R runs, so that bias counts as much as scatter. It is uncertain by a factor of about
1 +- sqrt(2 / R), which the tables state.
"""

from dataclasses import dataclass

import numpy as np

from benchmarks.problem import NAMES, PROBABILITIES, moments


@dataclass(frozen=True, eq=False)
class Score:
    """Summary of the runs of one method.

    Attributes
    ----------
    runs : int
        R.
    first, seconds, set_up : float
        Seconds of the first run; medians of a later run and of its set-up, NaN if R = 1.
    evaluations : float
        Mean of the runs.
    effective : array (2,)
        Effective size of a run for theta and sigma.
    log_evidence : array (R,)
        Estimates.
    quantile_error : array (2, 3)
        Root mean square error of the 5, 50 and 95 % quantiles of theta and sigma over the exact 5-95 % width.
    draws, distinct : float
        Medians of the number of draws and of the distinct ones among them.
    """

    runs: int
    first: float
    seconds: float
    set_up: float
    evaluations: float
    effective: np.ndarray
    log_evidence: np.ndarray
    quantile_error: np.ndarray
    draws: float
    distinct: float


def score(results, seconds, exact):
    """Return the score of a list of results and their seconds against an `ExactPosterior`."""
    effective, errors = [], []
    for name in NAMES:
        marginal = exact.marginals[name]
        mean, variance = moments(marginal)
        draws = [getattr(result, name) for result in results]
        effective.append(variance / np.mean([(np.mean(values) - mean) ** 2 for values in draws]))
        quantiles = marginal.quantile(PROBABILITIES)
        found = np.array([np.quantile(values, PROBABILITIES) for values in draws])
        width = quantiles[-1] - quantiles[0]
        errors.append(np.sqrt(np.mean((found - quantiles) ** 2, axis=0)) / width)
    only = len(results) == 1
    pairs = [np.column_stack([result.theta, result.sigma]) for result in results]
    return Score(
        runs=len(results),
        first=seconds[0],
        seconds=np.nan if only else float(np.median(seconds[1:])),
        set_up=np.nan if only else float(np.median([result.set_up for result in results[1:]])),
        evaluations=float(np.mean([result.n_evaluations for result in results])),
        effective=np.array(effective),
        log_evidence=np.array([result.log_evidence for result in results]),
        quantile_error=np.array(errors),
        draws=float(np.median([len(pair) for pair in pairs])),
        distinct=float(np.median([len(np.unique(pair, axis=0)) for pair in pairs])),
    )
