"""Which simulations of a batch are run, and which are predicted from those that were."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError
from scipy.spatial import cKDTree
from scipy.special import betaincc

from pymc_features.external.surrogate.gaussian_process import GaussianProcess, Prediction, fit_lengths

GROWTH = 0.5  # nats of error permitted for each nat below the posterior
CAUTION = 2.0  # standard deviations by which a point may be better than predicted
REFIT = 1.3  # growth of the number of runs after which the length scales are fitted again
SUB_BATCH = 8  # least number of runs at once, where so many are wanted
WINDOW = 60  # latest runs by which the predicted errors are scaled
LARGEST = 5.0  # standardised error that counts


@dataclass(frozen=True, eq=False)
class Judgement:
    """Predictions at some points, and how good they must be.

    Attributes
    ----------
    e : array (point, sensor)
    log_likelihood, sd, permitted : array (point,)
        In nats; `sd` is the predicted standard deviation, not yet scaled by the errors seen.
    per_unit : array (point,)
        The same where the process has variance one.
    process : Prediction
        Tells what a further run would teach.
    """

    e: np.ndarray
    log_likelihood: np.ndarray
    sd: np.ndarray
    permitted: np.ndarray
    per_unit: np.ndarray
    process: Prediction


@dataclass(frozen=True)
class Check:
    """A run that was predicted before: log-likelihoods, predicted standard deviation, what was permitted."""

    predicted: float
    true: float
    sd: float
    permitted: float
    certain: bool  # held to be good enough, and run by chance

    @property
    def error(self) -> float:
        """Of the prediction [nats]."""
        return self.predicted - self.true


def posterior_beyond(depth, m: float, n_parameters: int):
    """Probability that a draw from the posterior lies deeper than this below the top [nats], as an estimate.

    With sigma integrated out the posterior is S^(-(m - 1)/2). Where S = S_min (1 + r^2) it is a Student-t,
    for which r^2 / (1 + r^2) has the distribution Beta(d/2, (m - 1 - d)/2); m is taken large enough for it.
    """
    share = -np.expm1(-2.0 * np.maximum(depth, 0.0) / m)
    return betaincc(0.5 * n_parameters, 0.5 * max(m - 1.0 - n_parameters, 1.0), share)


class Learner:
    """What is known of the discrepancies of one data set.

    Parameters
    ----------
    settings : Surrogate
    n_parameters : int

    Attributes
    ----------
    x, e : array (run, parameter), (run, sensor)
        All runs; e has NaN where they failed.
    """

    def __init__(self, settings, n_parameters: int):
        self.settings, self.rng = settings, np.random.default_rng(settings.random_seed)
        self.x, self.e = np.empty((0, n_parameters)), None
        self.usable = np.empty(0, dtype=bool)
        self.lengths, self.noise, self.fitted_to = None, 0.0, 0
        self.process, self.n_predicted, self.inflation = None, 0, 1.0
        self.checks: list[Check] = []

    def evaluate(self, x: np.ndarray, run) -> np.ndarray:
        """e_j (particle, sensor) at x (particle, parameter); `run(rows)` runs some of them: (row, sensor)."""
        if not len(x):
            return run(np.arange(0))
        left, e = np.arange(len(x)), None
        lottery = self.rng.random(len(x)) < self.settings.check_fraction
        while len(left):
            judged = self.judge(x[left])
            chosen = self.first(len(left)) if judged is None else self.choose(judged, lottery[left])
            if not len(chosen):
                e = np.empty((len(x), judged.e.shape[1])) if e is None else e
                e[left] = judged.e
                self.n_predicted += len(left)
                break
            found = np.asarray(run(left[chosen]), dtype=np.float64)
            e = np.empty((len(x), found.shape[1])) if e is None else e
            e[left[chosen]] = found
            self.add(x[left[chosen]], found)
            if judged is not None:
                self.compare(judged, chosen, found)
            left = np.delete(left, chosen)
        return e

    def first(self, n: int) -> np.ndarray:
        """Where nothing can be predicted: enough of `n` points to begin with, or all of them."""
        missing = self.settings.first_runs(self.x.shape[1]) - int(self.usable.sum())
        return np.arange(min(n, missing) if missing > 0 else n)

    def add(self, x, e):
        """Keep what was run."""
        finite = np.isfinite(x).all(axis=1)
        self.x = np.concatenate([self.x, x[finite]])
        self.e = e[finite] if self.e is None else np.concatenate([self.e, e[finite]])
        self.usable = (np.isfinite(self.e) & (self.e > 0)).all(axis=1)
        self.process = None

    def log_likelihood(self, e) -> np.ndarray:
        """-m/2 ln S (point,): what is left of TN or EXP when sigma is integrated out."""
        return -0.5 * self.settings.degrees_of_freedom * e.shape[-1] * np.log(np.sum(e, axis=-1))

    def judge(self, x) -> Judgement | None:
        """Predict at x (point, parameter); None if that cannot be done."""
        if self.usable.sum() < self.settings.first_runs(x.shape[1]) or not np.isfinite(x).all():
            return None
        try:
            predicted = self.local_process(x).predict(x)
        except (LinAlgError, ValueError):
            return None
        e = np.exp(predicted.mean)
        log_likelihood, per_unit = self.log_likelihood(e), self.effect(e)
        sd = per_unit * np.sqrt(predicted.variance)
        if not (np.isfinite(sd) & np.isfinite(log_likelihood)).all():
            return None
        depth = self.best - log_likelihood
        permitted = self.permitted(depth - CAUTION * self.inflation * sd)
        if not self.usable.all():  # failures have neighbours
            _, nearest = cKDTree(self.x / self.lengths).query(x / self.lengths)
            permitted[~self.usable[nearest]] = 0.0
        return Judgement(e, log_likelihood, sd, permitted, per_unit, predicted)

    def beyond(self, depth):
        """Share of the posterior beyond this depth (point,)."""
        m = self.settings.degrees_of_freedom * self.e.shape[1]
        return posterior_beyond(depth, m, self.x.shape[1])

    def is_near(self, check: Check) -> bool:
        """Whether a run was predicted or found where 99 % of the posterior are, by what is known now."""
        return self.beyond(self.best - max(check.predicted, check.true)) > 0.01

    def permitted(self, depth):
        """Permitted standard deviation (point,) of a prediction at this depth [nats]; see `Surrogate`."""
        tolerance = self.settings.tolerance
        rare = np.sqrt(np.maximum(self.beyond(depth), 1e-12))
        return np.minimum(tolerance / rare, tolerance + GROWTH * np.maximum(depth, 0.0))

    @property
    def best(self) -> float:
        """Largest log-likelihood of all runs [nats]."""
        return self.log_likelihood(self.e[self.usable]).max()

    def effect(self, e) -> np.ndarray:
        """Standard deviation (point,) of the log-likelihood [nats] for a process of variance one.

        For one sigma, where the relative error of S counts, or one for each sensor, where all errors of log
        e_j count alike: the larger.
        """
        covariance = self.process.output_covariance
        shares = e / e.sum(axis=1, keepdims=True)
        together = np.einsum("pi,ij,pj->p", shares, covariance, shares)
        variance = np.maximum(together, covariance.mean())
        return 0.5 * self.settings.degrees_of_freedom * e.shape[1] * np.sqrt(np.maximum(variance, 0.0))

    def local_process(self, x) -> GaussianProcess:
        """The process through the runs nearest to x (point, parameter)."""
        known, log_e = self.x[self.usable], np.log(self.e[self.usable])
        if self.process is not None and len(known) <= self.settings.max_points:
            return self.process
        lengths = self.lengths
        if lengths is None:
            lengths = np.where(np.ptp(known, axis=0) > 0, np.std(known, axis=0), 1.0)
        distance, _ = cKDTree(x / lengths).query(known / lengths)
        near = np.argsort(distance, kind="stable")[: self.settings.max_points]
        if self.lengths is None or len(known) >= REFIT * self.fitted_to:
            self.lengths, self.noise = fit_lengths(known[near], log_e[near], self.lengths)
            self.fitted_to = len(known)
        self.process = GaussianProcess(known[near], log_e[near], self.lengths, self.noise)
        return self.process

    def choose(self, judged: Judgement, lottery) -> np.ndarray:
        """Points to run now: one after the other the most uncertain, given those before it.

        At most a quarter of those that are not certain enough, for what they teach may settle the others.
        """
        doubt = self.inflation * judged.sd > judged.permitted
        chosen = np.flatnonzero(lottery & ~doubt).tolist()
        variance = judged.process.variance
        for point in chosen:
            variance = judged.process.learn(point)
        for _ in range(max(SUB_BATCH, -(-int(doubt.sum()) // 4))):
            sd = self.inflation * judged.per_unit * np.sqrt(variance)
            excess = np.where(sd > judged.permitted, sd / np.maximum(judged.permitted, 1e-12), 0.0)
            excess[chosen] = 0.0
            worst = int(excess.argmax())
            if excess[worst] == 0.0:
                break
            chosen.append(worst)
            variance = judged.process.learn(worst)
        return np.array(chosen, dtype=int)

    def compare(self, judged: Judgement, chosen, found):
        """Note the errors of predictions, and scale further predictions by them."""
        good = (np.isfinite(found) & (found > 0)).all(axis=1)
        for i, true in zip(chosen[good], self.log_likelihood(found[good]), strict=True):
            certain = self.inflation * judged.sd[i] <= judged.permitted[i]
            numbers = judged.log_likelihood[i], true, judged.sd[i], judged.permitted[i]
            self.checks.append(Check(*map(float, numbers), bool(certain)))
        latest = [np.clip(c.error / max(c.sd, 1e-12), -LARGEST, LARGEST) for c in self.checks[-WINDOW:]]
        if len(latest) > SUB_BATCH:
            self.inflation = max(1.0, float(np.sqrt(np.mean(np.square(latest)))))
