"""`emulate`: the posterior of an external simulator from a hundred runs.

The first runs are all over the prior, further ones where the posterior is and where it is unknown. True runs
at draws from the emulator's posterior say how far that is from the simulator's.
"""

import logging
import sys
import warnings
from contextlib import ExitStack, contextmanager
from functools import cached_property
from itertools import repeat
from typing import NamedTuple

import numpy as np
import pymc as pm
import xarray as xr
from rich.console import Console
from scipy import stats

from pymc_features._checks import check_integer, check_model, check_seed, check_share
from pymc_features.exceptions import SamplingWarning
from pymc_features.external.emulator import Coordinates, Emulator
from pymc_features.external.replacement import Part, replaced
from pymc_features.external.workers.calls import one_thread_each
from pymc_features.inference.compiled import unit_cube
from pymc_features.inference.parameters import (
    Unconstrained,
    check_continuous,
    coordinate_names,
    to_unconstrained,
)
from pymc_features.inference.sample import sample
from pymc_features.progress import PartProgress
from pymc_features.smc import check_run, population_logp, prior_points, sample_smc

FIRST, LEAST_FIRST = 6, 8  # runs for each parameter of the simulator before the first choice
BATCHES, LEAST_BATCH = 12, 4  # parts of all runs
CHECKS, LEAST_CHECKS, MOST_CHECKS = 6, 8, 32  # part of all runs that judges the result
DESIGN_DRAWS = 1000
PRIOR_DRAWS = 500
NATS = 10.0  # permitted error of the log-likelihood, in tolerances
AMONG = 0.01  # share of the posterior's draws below which a run is not in the posterior
REFIT = 1.2  # growth of the number of runs after which the hyperparameters are fitted again
LEAST_USABLE = 5
WIDER, DEGREES = 1.5, 4.0  # of the Student-t around the posterior's draws, for what the emulator may miss
DOUBT = 2.0  # standard deviations by which a likelihood may be larger than expected
EDGE = 0.02  # share of the posterior's draws that are taken for its edge
TARGETS = 400
LEVELS = (0.05, 0.5, 0.95)


class Emulation(NamedTuple):
    """Posterior and model that `emulate` has found.

    Attributes
    ----------
    idata : DataTree
        As from `sample`, of the emulated model. The group `emulation` says how it came about: for each batch
        `runs` so far, `change` of the posterior and `error` of predictions before they were learnt [nats];
        for each parameter `shift` and `stretch`, the error that is left in its mean, in standard deviations,
        and in its standard deviation, relative, with their standard errors `shift_se` and `stretch_se`. Its
        attributes are `runs`, `failed`, `converged`, `largest_error` (of all these, two standard errors
        included), `efficiency` (of the weights of the last runs) and `advice`.
    model : pymc.Model
        The model with the emulator in place of the simulator. It has gradients.
    """

    idata: xr.DataTree
    model: pm.Model


class Batch(NamedTuple):
    """Runs so far, change of the posterior, error of predictions [nats]."""

    runs: int
    change: float
    error: float


class Remaining(NamedTuple):
    """Error of an emulator that has learnt its true runs, for each parameter (d,).

    Of the mean in standard deviations of the posterior, and of the standard deviation, relative, each with
    its standard error; `efficiency` is the effective share of the true runs when they are weighed.
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


def emulate(
    runs: int = 100,
    *,
    model: pm.Model | None = None,
    draws: int = 1000,
    chains: int | None = None,
    batch: int | None = None,
    tolerance: float = 0.02,
    random_seed: int | None = None,
    progressbar: bool = True,
) -> Emulation:
    """Posterior of a model with an `ExternalSimulator`, from some hundred runs of it.

    An emulator of the whole response takes the place of the simulator: Gaussian processes of its principal
    components, in the parameters. It begins with runs all over the prior. Then batches are run where the
    posterior of the emulator is, or may be, and where a run lowers the variance of its log-likelihood most,
    until batches move the posterior no more and are predicted before they are run. The last runs are made at
    draws from the posterior: weighing them by their true likelihood says how far the posterior still is from
    that of the simulator.

    Parameters
    ----------
    runs : int
        Simulations of each response at most, those that fail or are found in the cache included.
    model : pymc.Model, optional
        With responses of `ExternalSimulator`, one or several, compared with data by any likelihood. The model
        of the context by default.
    draws, chains : int, optional
        Of the posterior, as for `sample`.
    batch : int, optional
        Simulations at once; a twelfth of all by default. A multiple of the processes they run on is best.
    tolerance : float
        Change of the 5, 50 and 95 % quantiles of any parameter from batch to batch, over the 5-95 % width, at
        which no more is run. Predictions must then be within ten times as many nats of the log-likelihood.
    random_seed : int, optional
        For the same runs and draws each time. With a cache a second call finds its runs there.
    progressbar : bool
        Whether to show progress.

    Returns
    -------
    Emulation
        `idata` and `model`: the posterior, and the model with the emulator, which `pm.sample`, `sample_nuts`
        and `calibrate` take.

    Raises
    ------
    ValueError
        If the model has no response of an external simulator, or discrete parameters; or `runs` are too few.
    RuntimeError
        If almost all simulations fail.

    Warns
    -----
    SamplingWarning
        If the runs were too few: the error that is left is then larger than the tolerance.

    Notes
    -----
    The expected e_j of Eq. (3) under the emulator's uncertainty, and with it TN, EXP, `GammaFeature` and
    NORM, are in closed form; other likelihoods take the mean response. A parameter is taken by its logarithm
    where draws from its prior are less skewed so. Parameters whose nearest run failed have probability zero.
    What is emulated must depend smoothly on ten parameters or so at most; where it does not, the predictions
    before each batch stay bad, and that is said. Between two runs lie some seconds of computation.

    References
    ----------
    Higdon, Gattiker, Williams & Rightley, J. Am. Stat. Assoc. 103, 2008 (principal components); Sinsbeck &
    Nowak, SIAM/ASA J. Uncertain. Quantif. 5, 2017 (design for a likelihood).

    Examples
    --------
    >>> from pymc_features import ExternalSimulator
    >>> def beam(stiffness):
    ...     return np.outer([1.0, 2.0], np.cos(np.arange(20.0))) / stiffness
    >>> with ExternalSimulator(beam, shape=(2, 20), executor=1) as simulator, pm.Model():
    ...     k = pm.Uniform("k", 0.5, 2.0)
    ...     y = pm.Normal("y", simulator(k), 0.1, observed=beam(1.0))
    ...     found = emulate(20, draws=200, chains=2, random_seed=1, progressbar=False)
    >>> bool(abs(found.idata.posterior["k"].mean() - 1.0) < 0.02)
    True
    """
    settings, seed = checked(runs, batch, tolerance), check_seed(random_seed)
    check_run(draws, chains, None, None, progressbar)
    model = check_model(model)
    check_continuous(model, "emulate()")
    rng = np.random.default_rng(np.random.SeedSequence(seed).spawn(1)[0])
    emulated, parts = replaced(model)
    campaign = Campaign(emulated, parts, prior_points(emulated, PRIOR_DRAWS, rng))
    console = Console(file=sys.stderr, quiet=not progressbar)
    with PartProgress(console, "Emulating") as shown_progress, one_thread_each():
        history, left = explored(campaign, settings, rng, shown_progress)
        shown_progress("sampling the posterior", campaign.n_runs, settings.runs)
        idata = sample(
            draws,
            chains=chains,
            model=campaign.model,
            random_seed=int(rng.integers(2**31)),
            progressbar=False,
        )
    idata["emulation"] = xr.DataTree(described(campaign, settings, history, left))
    if advice := idata["emulation"].attrs["advice"]:
        warnings.warn(advice, SamplingWarning, stacklevel=2)
    return Emulation(idata, campaign.model)


class Settings(NamedTuple):
    """Numbers of runs, and when they are enough."""

    runs: int
    batch: int
    checks: int
    tolerance: float


def checked(runs, batch, tolerance) -> Settings:
    """Refuse what cannot be used."""
    runs = check_integer(runs, "runs", least=LEAST_FIRST + LEAST_CHECKS)
    batch = max(LEAST_BATCH, runs // BATCHES) if batch is None else check_integer(batch, "batch")
    tolerance = check_share(tolerance, "tolerance", "0.02 is a good choice.")
    return Settings(runs, batch, min(max(LEAST_CHECKS, runs // CHECKS), MOST_CHECKS), tolerance)


def explored(campaign, settings, rng, progress) -> tuple[list[Batch], Remaining]:
    """Run until the posterior stays where it is, and then at its draws."""
    n_parameters = max(response.coordinates.varying.size for response in campaign.responses)
    first = min(max(LEAST_FIRST, FIRST * n_parameters), settings.runs - settings.checks)
    progress("runs all over the prior", 0, settings.runs)
    campaign.run(first_points(campaign.model, campaign.space, first, rng))
    history = []
    while True:
        progress(told(history), campaign.n_runs, settings.runs)
        draws = campaign.sample(DESIGN_DRAWS, int(rng.integers(2**31)))
        left = settings.runs - settings.checks - campaign.n_runs
        if left <= 0 or is_settled(history, settings):
            progress("runs at draws from the posterior", campaign.n_runs, settings.runs)
            found, error = judged(campaign, draws, settings, rng)
            history.append(found)
            if settings.runs - settings.checks - campaign.n_runs <= 0 or is_settled(history, settings):
                return history, error
            continue
        points = next_points(campaign, draws, min(settings.batch, left), rng)
        history.append(learnt(campaign, draws, points))


def told(history) -> str:
    """Say how the last batch went."""
    if not history:
        return "first posterior"
    return f"posterior moved by {100 * history[-1].change:.2g} %, error {history[-1].error:.2g}"


def is_settled(history, settings) -> bool:
    """Whether the last batch has not moved the posterior, and was predicted."""
    if not history:
        return False
    last = history[-1]
    return last.change < settings.tolerance and last.error < NATS * settings.tolerance


def learnt(campaign, draws, points) -> Batch:
    """Run a batch, and say what it has changed."""
    before, predicted = campaign.log_likelihood(draws), campaign.log_likelihood(points)
    edge = np.quantile(campaign.logp(draws)[0] + before, AMONG)
    campaign.run(points)
    true = campaign.log_likelihood(points, truly=True)
    with np.errstate(invalid="ignore"):
        error = predicted - true
        near = np.maximum(predicted, true) + campaign.logp(points)[0] > edge
        change = largest_change(draws, campaign.log_likelihood(draws) - before)
    return Batch(campaign.n_runs, change, spread(error[near]))


def spread(errors) -> float:
    """Root mean square of errors of a log-likelihood, up to what is common to all; NaN is an infinite one."""
    if not len(errors):
        return 0.0
    if not np.isfinite(errors).all():
        return np.inf
    return float(np.sqrt(np.mean((errors - np.median(errors)) ** 2)))


def judged(campaign, draws, settings, rng) -> tuple[Batch, Remaining]:
    """Run at draws from the posterior, learn that, and say how far the posterior is from the true one."""
    at = rng.choice(len(draws), size=settings.checks, replace=False)
    before = campaign.log_likelihood(draws)
    campaign.run(draws[at])
    ratios = campaign.log_likelihood(draws[at], truly=True) - before[at]
    updates = campaign.log_likelihood(draws) - before
    change = largest_change(draws, updates)
    return Batch(campaign.n_runs, change, spread(ratios)), remaining(draws, at, ratios, updates)


def described(campaign, settings, history, left: Remaining) -> xr.Dataset:
    """The group `emulation` of the result."""
    usable = np.concatenate([response.emulator.usable for response in campaign.responses])
    names = coordinate_names(campaign.model, campaign.space)
    runs, change, error = (np.array(column) for column in zip(*history, strict=True))
    data = {"runs": ("batch", runs), "change": ("batch", change), "error": ("batch", error)}
    data |= {name: ("parameter", getattr(left, name)) for name in left._fields[:4]}
    converged = is_settled(history, settings)
    attrs = {
        "runs": campaign.n_runs,
        "failed": int((~usable).sum()),
        "converged": int(converged),
        "largest_error": left.largest,
        "efficiency": left.efficiency,
        "advice": "" if converged else advice(history[-1], left, settings),
    }
    return xr.Dataset(data, coords={"parameter": names}, attrs=attrs)


def advice(last: Batch, left: Remaining, settings) -> str:
    """Say what is wrong, and what to do."""
    return (
        f"the emulator was still learning after {last.runs} runs: the last ones moved a quantile by "
        f"{100 * last.change:.2g} % of the 5-95 % width, and were predicted to {last.error:.2g} nats. The "
        f"error that is left is up to {left.largest:.2g} standard deviations. Increase `runs`; if that does "
        "not help, the response is not smooth in the parameters, or the priors are too wide: sample with "
        "sample_smc()."
    )


# ---- the campaign of runs ----


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
    """Runs of one simulator so far, and their emulator; `prior` (n, d) gives the scales of the parameters.

    `x` (run, parameter) is what the simulator was called with, `found` (run, sensor, time) or (run, sensor)
    what it returned.
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
    """Simulations of all responses of a model with stand-ins, in batches; `theta` (run, d), unconstrained."""

    def __init__(self, model, parts: list[Part], prior):
        self.model, self.space = model, Unconstrained(model)
        self.responses = [Response(part, prior) for part in parts]
        self.theta, self.fitted_to = prior[:0], 0

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

    @cached_property
    def logp(self):
        """Log prior and log-likelihood of points (n, d), compiled once."""
        return population_logp(self.model, self.space.point, {})

    def log_likelihood(self, theta, shifts=None, truly=False):
        """Log-likelihood of points (n, d) by the emulators; with components off by so many deviations.

        Or, at points where the simulators were run, `truly`.
        """
        with ExitStack() as stack:
            for response, shift in zip(self.responses, shifts or repeat(None), strict=False):
                stack.enter_context(response.stand_in.taken(shift=shift, truly=truly))
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
            to_theta, _ = unit_cube(model, space, {})
    except ValueError:
        return prior_points(model, n, rng)
    sobol = stats.qmc.Sobol(d, rng=rng)
    u = sobol.random_base2(max(1, int(np.ceil(np.log2(n)))))[:n]
    [theta] = to_theta(np.clip(u, 1e-6, 1.0 - 1e-6))
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


def remaining(theta, at, log_ratios, log_updates) -> Remaining:
    """The error that is left in draws theta (n, d) from the posterior of an emulator.

    `log_ratios` (m,) are true log-likelihoods less the emulator's at the draws `at`, where the simulator was
    run; `log_updates` (n,) those of the emulator that has learnt these runs, less those of the one before.

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
