"""How right the draws of repeated runs are, for posteriors of any number of parameters.

Quantiles are compared over the exact width between 5 and 95 %. An effective number of draws says how many
independent ones would have the same mean square error of the share of draws below the exact quantiles, so
that bias counts as much as scatter; it is uncertain by about sqrt(2 / R) for strongly dependent parameters,
and less for independent ones.
"""

from dataclasses import dataclass

import numpy as np

from benchmarks.known import PROBABILITIES


@dataclass(frozen=True, eq=False)
class Accuracy:
    """Summary of R runs of one sampler on one problem.

    Attributes
    ----------
    runs : int
        R.
    seconds : float
        Median of a run after the first, which compiles; of the first if it is the only one.
    values, gradients : float
        Means of the runs.
    cost : float
        Mean number of log-densities, a gradient counted by its measured cost.
    error : array (3, d)
        Mean over the runs of the errors of the quantiles over the exact width.
    error_in_se : array (3, d)
        The same in its standard error, from the scatter of the runs and the answer's own; NaN if R = 1.
    typical : array (3,)
        Root mean square of the errors of single runs.
    effective, effective_least : float
        Effective draws of a run, mean of the parameters and least of them.
    evidence_bias, evidence_bias_se, evidence_sd : float
        Of the log evidence; NaN without one.
    evidence_se_ratio : float
        Reported standard error, root mean square, over the standard deviation of the runs.
    mode_weights, mode_weights_sd : array (k,) or None
        Mean and standard deviation over the runs.
    """

    runs: int
    seconds: float
    values: float
    gradients: float
    cost: float
    error: np.ndarray
    error_in_se: np.ndarray
    typical: np.ndarray
    effective: float
    effective_least: float
    evidence_bias: float
    evidence_bias_se: float
    evidence_sd: float
    evidence_se_ratio: float
    mode_weights: np.ndarray | None
    mode_weights_sd: np.ndarray | None

    @property
    def cost_per_effective(self):
        """Log-densities for one effective draw."""
        return self.cost / self.effective


def deviation(x, axis=0):
    """Standard deviation, NaN of one."""
    x = np.asarray(x)
    return x.std(axis=axis, ddof=1) if x.shape[axis] > 1 else np.full(np.delete(x.shape, axis), np.nan)


def effective_draws(shares):
    """Effective draws (d,) from shares (R, 3, d) below the exact quantiles; median and tails count alike."""
    relative = (shares - PROBABILITIES[:, None]) ** 2 / (PROBABILITIES * (1.0 - PROBABILITIES))[:, None]
    squares = relative.mean(axis=0)
    return 1.0 / (0.5 * squares[1] + 0.25 * (squares[0] + squares[2]))


def of_evidence(runs, answer):
    """Bias, its standard error, standard deviation, and the reported standard error over it."""
    off = np.array([run.log_evidence for run in runs]) - answer.log_evidence
    reported = np.sqrt(np.mean([run.log_evidence_se**2 for run in runs]))
    sd = float(deviation(off))
    return off.mean(), np.hypot(sd / np.sqrt(len(runs)), answer.log_evidence_se), sd, reported / sd


def accuracy(runs, seconds, problem, gradient_cost):
    """Judge a list of `Run` and their seconds; `gradient_cost`: values that a gradient counts for."""
    answer = problem.answer
    quantiles = np.array([np.quantile(run.draws, PROBABILITIES, axis=0) for run in runs])
    errors = (quantiles - answer.quantiles) / answer.width
    scatter = np.hypot(deviation(errors) / np.sqrt(len(runs)), answer.quantile_se / answer.width)
    shares = np.array([[(run.draws <= row).mean(axis=0) for row in answer.quantiles] for run in runs])
    each = effective_draws(shares)
    values, gradients = (np.mean([getattr(run, name) for run in runs]) for name in ("values", "gradients"))
    weights = None if problem.modes is None else np.array([problem.modes.found(run.draws) for run in runs])
    with np.errstate(divide="ignore", invalid="ignore"):
        in_se = errors.mean(axis=0) / scatter
        effective = 1.0 / np.mean(1.0 / each)
        evidence = of_evidence(runs, answer)
    return Accuracy(
        len(runs),
        float(np.median(seconds[1:] or seconds)),
        values,
        gradients,
        values + gradient_cost * gradients,
        errors.mean(axis=0),
        in_se,
        np.sqrt((errors**2).mean(axis=(0, 2))),
        effective,
        each.min(),
        *evidence,
        None if weights is None else weights.mean(axis=0),
        None if weights is None else deviation(weights),
    )
