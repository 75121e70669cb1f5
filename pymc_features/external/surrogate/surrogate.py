"""`Surrogate`: predicts most of the simulations of an `ExternalSimulator`."""

from collections.abc import Callable, Hashable
from importlib.util import find_spec

import numpy as np

from pymc_features._checks import check_integer, check_seed, is_number, shown, single, to_float
from pymc_features.external.surrogate.learner import Learner


class Surrogate:
    """Predictions in place of simulations, where they are certain enough; learnt while sampling goes on.

    A Gaussian process (scikit-learn's, Matern 5/2, one length scale for each parameter) through log e_j of
    Eq. (3) at the parameters already run. Of a population those are run that it cannot predict within the
    tolerance, the most uncertain first, a few at a time, so that each teaches about the others. A share of
    the rest is run as well, by chance, to measure the error.

    Parameters
    ----------
    degrees_of_freedom : float
        m of e_j / sigma^2 in the likelihood, which says how much an error of e_j matters: 1 for
        `TruncNormalFeature`, 2 for `ExpFeature`, the number of times for `pm.Normal`.
    tolerance : float
        Permitted standard deviation of a prediction near the best fit, in nats of the log-likelihood.
    n_initial : int, optional
        Runs before the first prediction; ten for each parameter by default.
    max_points : int
        Runs that a prediction is made from: those nearest to the population.
    check_fraction : float
        Share of the predictions held to be good enough that are run nevertheless.
    random_seed : int, optional
        Of that choice; for the same runs each time.

    Attributes
    ----------
    learners : dict
        What is known, for each data set.

    Raises
    ------
    ValueError, ImportError
        If a setting is out of range, or scikit-learn is not installed.

    Notes
    -----
    With sigma inferred, what counts is the log-likelihood -(M/2) ln S, with S = sum_j e_j and M =
    `degrees_of_freedom` times sensors. Deeper below the best run a larger standard deviation is permitted,

        min(tolerance / sqrt(P), tolerance + depth / 2).

    P is the share of the posterior beyond that depth, if S is quadratic near its minimum: an error there
    moves a probability by P times the error at most. The second bound serves the tempered posteriors: at
    inverse temperature beta their points lie about d / (2 beta) deep, for d parameters, so that beta times
    the error stays below d / 4. The depth is that of a point two standard deviations better than predicted.
    So the surrogate is good where the posterior is, and nowhere else. A sigma fixed far below the
    discrepancies makes errors larger than they are taken for, and needs a smaller tolerance.

    Predicted standard deviations are multiplied by the root mean square of the latest standardised errors,
    if that exceeds one: all runs are predicted first. Points whose nearest run failed are run, and all if
    no process can be fitted. Results depend on the populations and their order, not on where they run. A
    surrogate starts with nothing in every process, also after a restart from a checkpoint; chains run one
    after the other share it. It takes about half a millisecond of a processor for each particle: a
    simulation should take far longer.

    Examples
    --------
    >>> def run(rows):
    ...     return 1.0 + np.sum((x[rows] - 0.5) ** 2, axis=1, keepdims=True) * np.ones(10)
    >>> surrogate = Surrogate(degrees_of_freedom=1, random_seed=1)
    >>> for seed in range(3):
    ...     x = np.random.default_rng(seed).random((200, 2))
    ...     e = surrogate.evaluate(x, run)
    >>> report = surrogate.report()
    >>> report["runs"] < 200, report["runs"] + report["predicted"], report["error"] < 0.1
    (True, 600, True)
    """

    def __init__(
        self,
        degrees_of_freedom: float,
        *,
        tolerance: float = 0.1,
        n_initial: int | None = None,
        max_points: int = 500,
        check_fraction: float = 0.02,
        random_seed: int | None = None,
    ):
        if find_spec("sklearn") is None:
            raise ImportError(
                "`Surrogate` needs scikit-learn, which is not installed. Install it with: "
                "pip install pymc-features[surrogate]"
            )
        advice = "0.1 changes quantiles by a percent or so of the interval."
        self.tolerance = _positive("tolerance", tolerance, advice)
        self.degrees_of_freedom = _positive("degrees_of_freedom", degrees_of_freedom, "TN has 1, EXP 2.")
        fraction = single(check_fraction)
        if not (is_number(fraction) and 0.0 <= fraction <= 1.0):
            raise ValueError(
                f"`check_fraction` must lie between 0 and 1, got {shown(check_fraction)}. The default is "
                "0.02."
            )
        self.n_initial = None if n_initial is None else check_integer(n_initial, "n_initial", least=5)
        self.max_points = check_integer(max_points, "max_points", least=20)
        self.check_fraction = float(fraction)
        self.random_seed = check_seed(random_seed)
        self.learners: dict = {}

    def __repr__(self):
        names = (
            "degrees_of_freedom",
            "tolerance",
            "n_initial",
            "max_points",
            "check_fraction",
            "random_seed",
        )
        return f"Surrogate({', '.join(f'{name}={getattr(self, name)}' for name in names)})"

    def first_runs(self, n_parameters: int) -> int:
        """Runs before the first prediction."""
        return max(5, 10 * n_parameters) if self.n_initial is None else self.n_initial

    def evaluate(
        self, x: np.ndarray, run: Callable[[np.ndarray], np.ndarray], data: Hashable = ""
    ) -> np.ndarray:
        """e_j of a population: run, or predicted.

        Parameters
        ----------
        x : array (particle, parameter)
        run : callable
            Numbers of particles (row,) -> their e_j (row, sensor), NaN where a simulation fails.
        data : hashable
            Which data are meant: what is learnt about some says nothing about others.

        Returns
        -------
        array (particle, sensor)
        """
        x = np.ascontiguousarray(x, dtype=np.float64)
        if data not in self.learners:
            self.learners[data] = Learner(self, x.shape[1])
        return self.learners[data].evaluate(x, run)

    def report(self) -> dict[str, int | float]:
        """What was saved, and the errors measured.

        Returns
        -------
        dict
            runs, failed, predicted : int
                Simulations, those of them that failed, and predictions in their place.
            checked : int
                Predictions held to be good enough that were run nevertheless. The errors below are theirs.
            error, largest : float
                Root mean square and largest error of the log-likelihood where the posterior is, in nats;
                compare with the tolerance. NaN without such checks.
            excess : float
                Root mean square of error over what was permitted, everywhere; should stay below one.
            calibration : float
                Root mean square of the errors of all runs over their predicted standard deviations; should be
                about one or less.
        """
        learners = list(self.learners.values())
        checks = [c for learner in learners for c in learner.checks]
        by_chance = [c for c in checks if c.certain]
        near = [c.error for of in learners for c in of.checks if c.certain and of.is_near(c)]
        return {
            "runs": sum(len(learner.x) for learner in learners),
            "failed": sum(int((~learner.usable).sum()) for learner in learners),
            "predicted": sum(learner.n_predicted for learner in learners),
            "checked": len(by_chance),
            "error": root_mean_square(near),
            "largest": float(np.max(np.abs(near))) if near else np.nan,
            "excess": root_mean_square([c.error / max(c.permitted, 1e-12) for c in by_chance]),
            "calibration": root_mean_square([c.error / max(c.sd, 1e-12) for c in checks]),
        }


def root_mean_square(values) -> float:
    """Of numbers; NaN of none."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else np.nan


def _positive(name, value, advice):
    number = single(value)
    if is_number(number) and 0.0 < to_float(number) < np.inf:
        return to_float(number)
    raise ValueError(f"`{name}` must be positive and finite, got {shown(value)}. {advice}")
