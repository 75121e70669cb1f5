"""A campaign of simulations: runs so far and their emulator, the next ones, the error that is left.

The first runs are all over the prior, further ones where the posterior is and where it is unknown. True runs
at draws from the emulator's posterior say how far that is from the simulator's.
"""

import logging
import warnings
from contextlib import ExitStack, contextmanager
from typing import NamedTuple

import numpy as np
from scipy import stats

from pymc_features.emulation.emulator import Coordinates, Emulator
from pymc_features.emulation.replacement import Part
from pymc_features.exceptions import SamplingWarning
from pymc_features.inference.parameters import Unconstrained, to_unconstrained
from pymc_features.inference.unit_cube import unit_cube
from pymc_features.smc import population_logp, prior_points, sample_smc

REFIT = 1.2  # growth of the number of runs after which the hyperparameters are fitted again
LEAST_USABLE = 5
WIDER, DEGREES = 1.5, 4.0  # of the Student-t around the posterior's draws, for what the emulator may miss
DOUBT = 2.0  # standard deviations by which a likelihood may be larger than expected
EDGE = 0.02  # share of the posterior's draws that are taken for its edge
TARGETS = 400
LEVELS = (0.05, 0.5, 0.95)


@contextmanager
def quietly():
    """Silence what samplers say of each run, of which there are many."""
    logger = logging.getLogger("pymc")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SamplingWarning)
            yield
    finally:
        logger.setLevel(level)


class Response:
    """Runs of one simulator so far, and their emulator.

    Parameters
    ----------
    part : Part
    prior : array (n, d)
        Draws from the prior, unconstrained, for the scales of the parameters.

    Attributes
    ----------
    x : array (run, parameter)
        What the simulator was called with.
    found : array (run, sensor, time) or (run, sensor)
    """

    def __init__(self, part: Part, prior):
        self.simulator, self.stand_in, self.parameters_of = part
        x = self.x_of(prior)
        self.coordinates, self.x = Coordinates.of(x), x[:0]
        shape = self.simulator.shape
        self.found = np.empty((0, *(shape[:1] if self.simulator.returns == "mean_square" else shape)))

    @property
    def emulator(self) -> Emulator:
        """The emulator of all runs."""
        return self.stand_in.emulator

    def x_of(self, theta):
        """Arguments of the simulator as rows of numbers (n, parameter)."""
        parameters = self.parameters_of(theta)
        return np.concatenate([p.reshape(len(theta), -1) for p in parameters], axis=1)

    def run(self, theta, refit):
        """Simulate at points (n, d), and emulate with what is known then."""
        parameters = self.parameters_of(theta)
        if self.simulator.returns == "mean_square":
            found = self.simulator.discrepancies(*parameters, observed=None)
        else:
            found = self.simulator.responses(*parameters)
        self.x = np.concatenate([self.x, self.x_of(theta)])
        self.found = np.concatenate([self.found, found])
        usable = np.isfinite(self.found).reshape(len(self.found), -1).all(axis=1).sum()
        if usable < LEAST_USABLE:
            failure = next(iter(self.simulator.failures), None)
            raise RuntimeError(
                f"{len(self.found) - usable} of {len(self.found)} simulations failed, too many to go on: "
                f"{failure.message if failure else 'results are not finite'}. See simulator.failures."
            )
        self.stand_in.emulator = Emulator(self.x, self.found, self.coordinates, self.emulator, refit)


class Campaign:
    """Simulations, one batch after the other.

    Parameters
    ----------
    model : pymc.Model
        With stand-ins.
    parts : list of Part
        Its responses.
    prior : array (n, d)
        Draws from the prior, unconstrained.

    Attributes
    ----------
    theta : array (run, d)
        Where the model was run, unconstrained.
    """

    def __init__(self, model, parts: list[Part], prior):
        self.model, self.space = model, Unconstrained(model)
        self.responses = [Response(part, prior) for part in parts]
        self.theta, self.fitted_to, self._logp = prior[:0], 0, None

    @property
    def n_runs(self) -> int:
        """Simulations of each response, those that failed included."""
        return len(self.theta)

    def run(self, theta):
        """Simulate at points (n, d), and emulate with what is known then."""
        self.theta = np.concatenate([self.theta, theta])
        refit = self.n_runs >= REFIT * self.fitted_to
        for response in self.responses:
            response.run(theta, refit)
        if refit:
            self.fitted_to = self.n_runs

    @property
    def logp(self):
        """Log prior and log-likelihood of points (n, d), compiled once."""
        if self._logp is None:
            self._logp = population_logp(self.model, self.space.point, {})
        return self._logp

    def log_likelihood(self, theta, shifts=None):
        """Log-likelihood of points (n, d) by the emulators; with components off by so many deviations."""
        with ExitStack() as stack:
            for response, shift in zip(self.responses, shifts or [], strict=shifts is not None):
                stack.enter_context(response.stand_in.shifted(shift))
            return self.logp(theta)[1]

    def true_log_likelihood(self, theta):
        """Log-likelihood of points (n, d) at which the simulators were run."""
        with ExitStack() as stack:
            for response in self.responses:
                stack.enter_context(response.stand_in.true_runs())
            return self.logp(theta)[1]

    def sample(self, n, random_seed):
        """Draws (n, d) from the posterior of the emulator."""
        with quietly():
            idata = sample_smc(
                n,
                chains=1,
                cores=1,
                model=self.model,
                random_seed=random_seed,
                progressbar=False,
                compute_convergence_checks=False,
            )
        return to_unconstrained(self.model, idata["posterior"].to_dataset())[0]


def first_points(model, space, n, rng):
    """Points (n, d) all over the prior: Sobol's in its unit cube, or draws where it has no cube."""
    d = len(space.join(space.point))
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings(
                "ignore", "RandomVariables .* were found in the derived graph", UserWarning
            )
            cube = unit_cube(model, space, {})
    except ValueError:
        return prior_points(model, n, rng)
    sobol = stats.qmc.Sobol(d, rng=rng)
    u = sobol.random_base2(max(1, int(np.ceil(np.log2(n)))))[:n]
    [theta] = cube.to_theta(np.clip(u, 1e-6, 1.0 - 1e-6))
    return theta


def uncertainty(campaign, theta, rng):
    """Contribution (n, process) of each process to the variance of the log-likelihood at points (n, d).

    By components one standard deviation up and down, with random signs where several share a process: slope
    and curvature of any likelihood.
    """
    none = [np.zeros(len(response.emulator.basis)) for response in campaign.responses]
    here, parts = campaign.log_likelihood(theta, none), []
    for i, response in enumerate(campaign.responses):
        for group in response.emulator.groups:
            sides = []
            signs = rng.choice([-1.0, 1.0], size=group.stop - group.start)
            for side in (1.0, -1.0):
                shifts = [shift.copy() for shift in none]
                shifts[i][group] = side * signs
                sides.append(campaign.log_likelihood(theta, shifts))
            with np.errstate(invalid="ignore"):
                parts.append((0.5 * (sides[0] - sides[1])) ** 2 + 0.5 * (sum(sides) - 2.0 * here) ** 2)
    parts = np.stack(parts, axis=1)
    return np.where(np.isfinite(parts), parts, 0.0)


def candidates(campaign, draws, rng):
    """Points to choose from (n, d): draws from the posterior, and what may belong to it for all one knows."""
    draws = draws[rng.permutation(len(draws))[:TARGETS]]
    spread = WIDER**2 * np.cov(draws, rowvar=False).reshape(draws.shape[1], -1)
    wide = stats.multivariate_t(draws.mean(axis=0), spread, DEGREES, allow_singular=True, seed=rng)
    wide = np.reshape(wide.rvs(TARGETS), (-1, draws.shape[1]))
    log_posterior = [np.sum(campaign.logp(points)[:2], axis=0) for points in (draws, wide)]
    edge = np.quantile(log_posterior[0], EDGE)
    some = np.flatnonzero(np.isfinite(log_posterior[1]))
    deviation = np.sqrt(uncertainty(campaign, wide[some], rng).sum(axis=1))
    possible = some[log_posterior[1][some] + DOUBT * deviation > edge]
    return np.concatenate([draws, wide[possible]])


def next_points(campaign, draws, n, rng):
    """Points (n, d) that teach most about the posterior, chosen one after the other.

    Each is the one that lowers the variance of the log-likelihood most, on average over what is or may be the
    posterior, given those chosen before: a Gaussian process's variance does not depend on what is found.
    """
    points = candidates(campaign, draws, rng)
    noises, covariances = [], []
    for response in campaign.responses:
        coordinates = response.coordinates(response.x_of(points))
        for process in response.emulator.processes:
            noises.append(process.noise)
            covariances.append(process.covariance(coordinates))
    variances = np.stack([np.diag(c) for c in covariances], axis=1)
    parts = uncertainty(campaign, points, rng)
    per_unit = parts / np.maximum(variances, 1e-12)
    per_unit /= (1.0 + parts.sum(axis=1))[:, None]  # much uncertainty is no better than all
    chosen = []
    for _ in range(n):
        gain = np.zeros(len(points))
        for g, (covariance, noise) in enumerate(zip(covariances, noises, strict=True)):
            reduced = covariance**2 / (np.diag(covariance) + noise)
            gain += per_unit[:, g] @ reduced
        gain[chosen] = -np.inf
        best = int(gain.argmax())
        chosen.append(best)
        for g, noise in enumerate(noises):
            column = covariances[g][:, best]
            covariances[g] = covariances[g] - np.outer(column, column) / (column[best] + noise)
    return points[chosen]


def normalised(log_weights):
    """Weights (n,) with mean one; none where a run failed."""
    log_weights = np.where(np.isfinite(log_weights), log_weights, -np.inf)
    weights = np.exp(log_weights - log_weights.max())
    return weights / weights.mean()


def largest_change(theta, log_weights) -> float:
    """Largest change of a quantile over the 5-95 % width, when draws (n, d) get weights."""
    if not np.isfinite(log_weights).any():
        return np.inf
    weights = normalised(log_weights)
    worst = 0.0
    for column in theta.T:
        before, after = weighted_quantiles(column, np.ones(len(column))), weighted_quantiles(column, weights)
        worst = max(worst, np.abs(after - before).max() / max(before[-1] - before[0], 1e-300))
    return float(worst)


def weighted_quantiles(x, weights):
    """Quantiles (level,) of weighted points (point,)."""
    order = np.argsort(x)
    at = (np.cumsum(weights[order]) - 0.5 * weights[order]) / weights.sum()
    return np.interp(LEVELS, at, x[order])


class Remaining(NamedTuple):
    """Error of an emulator that has learnt its true runs, for each parameter (d,).

    Attributes
    ----------
    shift, shift_se : array
        Of the mean, in standard deviations of the posterior, with its standard error.
    stretch, stretch_se : array
        Of the standard deviation, relative.
    efficiency : float
        Effective share of the true runs when they are weighed.
    """

    shift: np.ndarray
    shift_se: np.ndarray
    stretch: np.ndarray
    stretch_se: np.ndarray
    efficiency: float

    @property
    def largest(self) -> float:
        """Largest error of all, two standard errors included."""
        ends = [np.abs(self.shift) + 2.0 * self.shift_se, np.abs(self.stretch) + 2.0 * self.stretch_se]
        return float(np.max(ends))


def remaining(theta, at, log_ratios, log_updates) -> Remaining:
    """The error that is left.

    Parameters
    ----------
    theta : array (n, d)
        Draws from the posterior of an emulator.
    at : array of int (m,)
        Those of them, independent, where the simulator was run.
    log_ratios : array (m,)
        True log-likelihoods less the emulator's there.
    log_updates : array (n,)
        Log-likelihoods of the emulator that has learnt these runs, less those of the one before.

    Notes
    -----
    With weights w = exp(log_ratios) of mean one, E_true f - E_emulator f = Cov(w, f) is estimated by the mean
    of (w - 1)(f - E_emulator f), whose standard error shrinks with the error of the emulator: a control
    variate, since E_emulator f is known from all draws. What the update has moved f by is taken away.
    """
    weights, updates = normalised(log_ratios), normalised(log_updates)
    scaled = (theta - theta.mean(axis=0)) / theta.std(axis=0)
    results = []
    for f in (scaled, 0.5 * (scaled**2 - 1.0)):
        terms = (weights[:, None] - 1.0) * f[at]
        done = ((updates[:, None] - 1.0) * f).mean(axis=0)
        results += [terms.mean(axis=0) - done, terms.std(axis=0, ddof=1) / np.sqrt(len(at))]
    return Remaining(*results, float(len(weights) / (weights**2).sum() * weights.mean() ** 2))
