"""`emulate`: the posterior of an external simulator from a hundred runs."""

import sys
import warnings
from typing import NamedTuple

import numpy as np
import pymc as pm
import xarray as xr
from rich.console import Console

from pymc_features._checks import check_integer, check_model, check_seed, check_share
from pymc_features.emulation.campaign import (
    Campaign,
    Remaining,
    first_points,
    largest_change,
    next_points,
    remaining,
)
from pymc_features.emulation.replacement import replaced
from pymc_features.exceptions import SamplingWarning
from pymc_features.inference.parameters import check_continuous, coordinate_names
from pymc_features.inference.sample import sample
from pymc_features.processes.calls import one_thread_each
from pymc_features.progress import PartProgress
from pymc_features.smc import check_run, prior_points

FIRST, LEAST_FIRST = 6, 8  # runs for each parameter of the simulator before the first choice
BATCHES, LEAST_BATCH = 12, 4  # parts of all runs
CHECKS, LEAST_CHECKS, MOST_CHECKS = 6, 8, 32  # part of all runs that judges the result
DESIGN_DRAWS = 1000
PRIOR_DRAWS = 500
NATS = 10.0  # permitted error of the log-likelihood, in tolerances
EDGE = 0.01  # share of the posterior's draws below which a run is not in the posterior


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
    edge = np.quantile(campaign.logp(draws)[0] + before, EDGE)
    campaign.run(points)
    true = campaign.true_log_likelihood(points)
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
    ratios = campaign.true_log_likelihood(draws[at]) - before[at]
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
