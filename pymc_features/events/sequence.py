"""Updating in sequence: the posterior of one event is the prior of the next."""

import os
import warnings
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Unpack

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import xarray as xr
from scipy.special import expit, logit, softmax

from pymc_features._checks import (
    as_list,
    check_finite,
    check_group,
    check_integer,
    check_keywords,
    check_mapping,
    check_model,
    check_path,
    check_positive,
    check_seed,
    check_share,
    is_number,
    message,
    shown,
    single,
)
from pymc_features.events.compare import evidence_of
from pymc_features.events.hierarchical import OF_SAMPLERS
from pymc_features.exceptions import SamplingWarning, StudyMismatchError
from pymc_features.inference.parameters import (
    Unconstrained,
    check_continuous,
    posterior_for,
    to_unconstrained,
)
from pymc_features.inference.sample import sample, summarise
from pymc_features.smc import PersistentSMC, open_workers, population_logp, sample_smc
from pymc_features.smc.kernels.base import KernelOptions
from pymc_features.smc.kernels.checkpoint import model_fingerprint
from pymc_features.smc.proposals.pool import equal_draws
from pymc_features.smc.proposals.proposal import StudentMixture, StudentT, distinct, fit_mixture, moments
from pymc_features.smc.proposals.unbending import Unbent, fit_unbent, held_out_scores
from pymc_features.storage import PartStore

OWN_SHARE = 0.2  # of the model's own prior among the draws; it does not change the posterior
FOR_ERROR = 200  # draws whose likelihood is asked for again
ALARM = 0.5  # probability of a change from which there is an alarm
CLEARLY = 0.01  # nats for each draw by which more must be better than a Gaussian: what it adds is noise else
GAUSSIAN = 1e6  # degrees of freedom
OF_RUN = ("drift", "forgetting", "change")  # of `events.continue_with` alone


def continue_with(
    idata: xr.DataTree,
    *,
    model: pm.Model | None = None,
    drift: Mapping[str, float] | None = None,
    forgetting: float = 1.0,
    change: float = 0.005,
    draws: int | None = None,
    random_seed: int | None = None,
    **settings,
) -> xr.DataTree:
    """Posterior after one more event: that of the events before is the prior, with correlations and modes.

    A density q_e is fitted to the stored draws, and sequential Monte Carlo leads from there to the
    posterior with the new data d_e. What these were expected to be is the predictive score of the event,

        ln p(d_e | d_1 .. d_e-1) = ln integral p(d_e | theta) q_e(theta) dtheta;

    the scores of all events add up to the log evidence of all data together. Beside it stands the score under
    the model's own prior, as of a structure that nothing is known about. If the structure changes between two
    events with probability c, it has changed with the odds

        c / (1 - c) p(d_e) / p(d_e | d_1 .. d_e-1),

    and by these the draws are of the one posterior or the other: after a change the events before are
    forgotten.

    Parameters
    ----------
    idata : DataTree
        What `sample` returned for the first event, or this function for the event before.
    model : pymc.Model, optional
        Of the new event alone, with the parameters of `idata` and the prior that the first event had; the
        model of the context by default.
    drift : dict of str to float, optional
        Standard deviation by which a parameter may have moved since the event before, in its unit: a random
        walk.
    forgetting : float
        What of the precision of the events before is kept, 0 to 1: their covariance is divided by it.
    change : float
        c, the probability that the structure has changed since the event before, between 0 and 1. An event
        of a structure that has not raises an alarm with a probability of at most c / (1 - c).
    draws : int, optional
        Of each chain; as in `idata` by default.
    random_seed : int, optional
        For the same draws each time.
    **settings
        Of `sample_smc`.

    Returns
    -------
    DataTree
        As from `sample`. `sequence` (event), one entry longer than that of `idata`: `log_score`,
        `log_score_se`, `log_score_fresh` (under the model's own prior), `probability_changed`, `alarm`
        (whether that is above one half), and of each parameter `mean` and `standard_deviation` (event,
        parameter). The attribute `log_evidence` of `sample_stats` is that of this event, `log_score`.

    Raises
    ------
    TypeError, ValueError
        If `idata` is of other parameters, or a parameter is discrete.

    Warns
    -----
    SamplingWarning
        As `sample` does.

    Notes
    -----
    The cost of an event does not grow with the number of those before, whose data are not asked for again.
    Each fit adds an error of about one over the root of the number of draws, in standard deviations; the
    standard errors of the scores allow for it, and are to be added up, for one event's error is passed on to
    the next. Potentials of a model count once for each event.

    The bound on false alarms is Markov's inequality on p(d_e) / p(d_e | d_1 .. d_e-1), whose mean is one
    where the likelihood is right. Errors that persist make NORM claim too much, and then agreement is
    improbable; `drift`, or a likelihood that claims less, allows for it.

    References
    ----------
    Chopin, Biometrika 89, 539-551 (2002). West & Harrison, Bayesian Forecasting and Dynamic Models, 1997,
    Secs. 6.3 and 11.4, for forgetting by discount factors and the monitoring of forecasts.
    """
    model = check_model(model)
    check_continuous(model, "continue_with()")
    posterior = posterior_for(model, idata, "idata")
    drift = check_drift(drift, model)
    change = check_share(change, "change", "Use for example 0.005.")
    if not (is_number(single(forgetting)) and forgetting == 1):
        forgetting = check_share(forgetting, "forgetting", "1 forgets nothing.")
    draws = posterior.sizes["draw"] if draws is None else check_integer(draws, "draws", least=100)
    check_seed(random_seed, several=False)
    check_keywords(settings, (*OF_SAMPLERS, "checkpoint"), "continue_with")
    rng = np.random.default_rng(np.random.SeedSequence(random_seed).spawn(3)[2])
    points = moved(model, posterior, drift, rng)
    before = fit_density(points, rng, float(forgetting))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "PersistentSMC ended", SamplingWarning)  # `advice` says it
        result = sample_smc(
            draws,
            ContinuedSMC,
            chains=posterior.sizes["chain"],
            model=model,
            random_seed=random_seed,
            before=before,
            share=OWN_SHARE,
            compute_convergence_checks=False,
            **settings,
        )
    summary = summarise(model, Unconstrained(model), result, None)
    result["sample_stats"].attrs |= summary
    record = sequence_of(idata, model)
    scores = judged(model, result, before, len(points) / record.sizes["event"], change, rng)
    latest = entry(result, scores, model, int(record["event"].values[-1]) + 1)
    result["sequence"] = xr.DataTree(xr.concat([record, latest], "event", join="override"))
    if summary["advice"]:
        warnings.warn(summary["advice"], SamplingWarning, stacklevel=2)
    return result


def sample_in_sequence(
    events: Sequence[pm.Model | Mapping],
    *,
    model: pm.Model | None = None,
    out: str | os.PathLike | None = None,
    draws: int = 4000,
    chains: int = 2,
    random_seed: int = 0,
    **settings,
) -> xr.DataTree:
    """Sample the first event with its prior, and each that follows with the posterior of those before.

    Parameters
    ----------
    events : sequence of pymc.Model, or of dict
        A model for each event, or with `model` what `pymc.set_data` is to put into it: then nothing is
        compiled again from event to event.
    model : pymc.Model, optional
        With `pymc.Data`.
    out : path-like, optional
        Folder that keeps the posterior after each event. A run that was killed goes on from there, and so
        does one with more events at the end.
    draws, chains : int
        Of each posterior.
    random_seed : int
        For the same draws each time.
    **settings
        Of `events.continue_with`; those that `sample` has are for the first event, too.

    Returns
    -------
    DataTree
        As from `events.continue_with`, after the last event; of one event alone `sequence` has one entry.

    Raises
    ------
    StudyMismatchError
        If the folder holds other settings, or another event at some place.

    See Also
    --------
    plots.sequence : parameters and alarms, event by event.
    """
    with open_workers(settings.pop("executor", None)) as workers:
        if workers is not None:
            settings["executor"] = workers
        states = states_in_sequence(
            events, model=model, out=out, draws=draws, chains=chains, random_seed=random_seed, **settings
        )
        return deque(states, maxlen=1).pop()


def states_in_sequence(
    events, *, model=None, out=None, draws=4000, chains=2, random_seed=0, **settings
) -> Iterator[xr.DataTree]:
    """The posterior after each event, one by one; arguments as of `events.sample_in_sequence`."""
    listed = as_list(events)
    if not listed or not all(
        isinstance(event, Mapping if model is not None else pm.Model) for event in listed
    ):
        what = "a sequence of pymc.Model, or with `model` of dicts for pymc.set_data"
        raise TypeError(message("events", what, shown(events)))
    for name, value, least in (("draws", draws, 100), ("chains", chains, 1)):
        check_integer(value, name, least=least)
    check_seed(random_seed, several=False)
    if out is not None:
        check_path(out, "out")
    if model is not None:
        check_model(model)
    run = {"draws": int(draws), "chains": int(chains), "random_seed": random_seed}
    run |= {name: settings[name] for name in OF_RUN if name in settings}
    store, idata = PartStore(out, run, "sequence"), None
    for i, event in enumerate(listed):
        of_event = model if model is not None else event
        if model is not None:
            pm.set_data(event, model=model)
        name, print_ = f"{i:05d}", model_fingerprint(of_event)
        stored = store.load(name)
        if stored is not None and stored.attrs["model"] != print_:
            raise StudyMismatchError(
                f"`out` must hold the same events, got {out} with another one at place {i}. Choose another "
                "folder, or delete this one."
            )
        if stored is None:
            stored = one_event(idata, of_event, i, run, settings)
            stored.attrs["model"] = print_
            store.save(name, stored)
        idata = stored
        yield idata


def one_event(before, model, i: int, run: dict, settings: dict) -> xr.DataTree:
    """The posterior after event i."""
    seed = None if run["random_seed"] is None else run["random_seed"] + i
    if before is None:
        of_sample = {name: value for name, value in settings.items() if name not in OF_RUN}
        first = sample(run["draws"], chains=run["chains"], model=model, random_seed=seed, **of_sample)
        first["sequence"] = xr.DataTree(sequence_of(first, model))
        return first
    return continue_with(before, model=model, draws=run["draws"], random_seed=seed, **settings)


def fit_density(points: np.ndarray, rng: np.random.Generator, forgetting: float = 1.0):
    """Normalised density that draws (n, d), some of them many times, are from: a Gaussian, or more than that.

    A Student-t mixture, or one behind an unbending map, must be better at points that it has not seen, by
    more than what a fit to some thousand draws gains by chance. Covariances are divided by `forgetting`.

    Returns
    -------
    StudentMixture or Unbent
        With `log_density(x)` (n,) at points (n, d), and independent draws (n, d), `draw(n, rng)`.
    """
    x, weights = distinct(points)
    weights = np.asarray(weights, dtype=float)
    kinds = [fit_gaussian, fit_mixture, fit_unbent, partial(fit_unbent, rotated=False)]
    scores, total = held_out_scores(kinds, x, weights, rng.permutation(len(x)), rng)
    scores = scores / total - CLEARLY * np.array([0.0, 1.0, 1.0, 1.0])
    fitted = kinds[int(scores.argmax())](x, weights, rng)
    mixture = fitted.mixture if isinstance(fitted, Unbent) else fitted
    wider = [StudentT(c.location, c.factor / np.sqrt(forgetting), c.degrees) for c in mixture.components]
    mixture = StudentMixture(wider, mixture.weights)
    return fitted._replace(mixture=mixture) if isinstance(fitted, Unbent) else mixture


def fit_gaussian(x, weights, rng) -> StudentMixture:
    """Mean and covariance, as a mixture of one."""
    shares = weights / weights.sum()
    return StudentMixture([StudentT(*moments(x, shares, shares), GAUSSIAN)], np.ones(1))


class ContinuedSMC(PersistentSMC):
    """`PersistentSMC` whose prior is another one than the model's.

    With a share c of the model's own prior pi, lest a structure that has changed be looked for where it was,

        pi_e(theta) = (1 - c) q(theta) + c pi(theta).

    Parameters
    ----------
    before : StudentMixture or Unbent
        q, what is known from the events before.
    share : float
        c.
    """

    def __init__(self, draws: int = 2000, *, before, share: float, **kwargs: Unpack[KernelOptions]):
        super().__init__(draws, **kwargs)
        self.before, self.share = before, share

    def evaluate(self, particles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Log prior and log-likelihood, each (p,), of particles (p, d); counts evaluations and failures."""
        prior, likelihood = super().evaluate(particles)
        fitted = np.log1p(-self.share) + self.before.log_density(particles)
        mixed = np.logaddexp(fitted, np.log(self.share) + prior)
        return np.where(prior > -np.inf, mixed, -np.inf), likelihood

    def initial_particles(self, n: int) -> np.ndarray:
        """Draws (n, d) from this prior."""
        n_own = self.rng.binomial(n, self.share)
        fitted = self.before.draw(n - n_own, self.rng)
        particles = np.concatenate([fitted, super().initial_particles(n_own)]) if n_own else fitted
        return particles[self.rng.permutation(n)]


def check_drift(drift, model) -> dict[str, float]:
    """Standard deviations by name of a free parameter."""
    drift = check_mapping(drift, "drift", "a dict of parameters to standard deviations")
    names = [rv.name for rv in model.free_RVs]
    if unknown := sorted(set(drift) - set(names)):
        raise ValueError(message("drift", f"of the parameters {', '.join(names)}", ", ".join(unknown)))
    return {name: check_positive(value, "drift", f"That is of {name}.") for name, value in drift.items()}


def moved(model, posterior: xr.Dataset, drift: dict[str, float], rng) -> np.ndarray:
    """Draws (n, d) on the sampled scale after a step of a random walk, but for those outside of the prior."""
    steps = {name: value * rng.standard_normal(posterior[name].shape) for name, value in drift.items()}
    walked = posterior.assign({name: posterior[name] + step for name, step in steps.items()})
    with np.errstate(invalid="ignore", divide="ignore"):
        flat = to_unconstrained(model, walked)
    flat = flat.reshape(-1, flat.shape[-1])
    return flat[np.isfinite(flat).all(axis=1)]


def judged(model, result, before, n_before: float, change: float, rng) -> dict[str, float]:
    """Scores of the event; draws of `result` are exchanged for those of the posterior with this `change`."""
    flat = to_unconstrained(model, result["posterior"].to_dataset())
    chains, draws, d = flat.shape
    x = flat.reshape(-1, d)
    prior = population_logp(
        model, model.initial_point(), {}, name="prior", terms=lambda: (model.varlogp, pt.zeros(()))
    )
    model_prior = np.log(OWN_SHARE) + prior(x)[0]
    fitted_prior = np.log1p(-OWN_SHARE) + before.log_density(x)
    mixed_prior = np.logaddexp(model_prior, fitted_prior)
    log_own, log_known = model_prior - mixed_prior, fitted_prior - mixed_prior  # shares in each draw
    mixed = evidence_of(result)
    fresh = mixed.value + log_mean(log_own) - np.log(OWN_SHARE)
    score = mixed.value + log_mean(log_known) - np.log1p(-OWN_SHARE)
    error = float(np.hypot(mixed.error, error_of_fit(model, x, score, n_before, rng)))
    changed = expit(fresh - score + logit(change))
    log_weights = np.logaddexp(
        np.log(change / OWN_SHARE) + log_own, np.log((1.0 - change) / (1.0 - OWN_SHARE)) + log_known
    ).reshape(chains, draws)
    chosen = np.stack([equal_draws(softmax(row), draws, rng) for row in log_weights])
    posterior = result["posterior"].to_dataset()
    across = {"chain": xr.DataArray(np.arange(chains), dims="chain")}
    picked = posterior.isel(across | {"draw": xr.DataArray(chosen, dims=("chain", "draw"))})
    result["posterior"] = xr.DataTree(picked.assign_coords(draw=posterior["draw"], chain=posterior["chain"]))
    result["sample_stats"].attrs |= {"log_evidence": score, "log_evidence_se": error}
    return {
        "log_score": score,
        "log_score_se": error,
        "log_score_fresh": fresh,
        "probability_changed": float(changed),
        "alarm": int(changed > ALARM),
    }


def error_of_fit(model, x, score: float, n_before: float, rng) -> float:
    """Standard error of the score from the number of draws that stand for the events before.

    That of ln of the mean of L over n draws, the square root of (E[L^2] / E[L]^2 - 1) / n; E[L^2] over E[L]
    is the mean of L over the posterior (n, d) of which some are evaluated once more.
    """
    logp = population_logp(model, model.initial_point(), {})
    likelihood = logp(x[rng.choice(len(x), min(FOR_ERROR, len(x)), replace=False)])[1]
    ratio = np.exp(min(log_mean(likelihood) - score, 700.0))
    return float(np.sqrt(max(ratio - 1.0, 0.0) / n_before))


def log_mean(x) -> float:
    """ln of the mean of exp x."""
    return float(np.logaddexp.reduce(x) - np.log(len(x)))


def sequence_of(idata, model) -> xr.Dataset:
    """What is on record of the events before; of the first one its evidence."""
    if "sequence" in idata.children:
        return check_group(idata, "idata", "sequence", "Pass what events.continue_with() returned.", "event")
    evidence = evidence_of(idata)
    scores = {
        "log_score": evidence.value,
        "log_score_se": evidence.error,
        "log_score_fresh": evidence.value,
        "probability_changed": 0.0,
        "alarm": 0,
    }
    return entry(idata, scores, model, 0)


def entry(idata, scores: dict, model, number: int) -> xr.Dataset:
    """One event of the record."""
    import arviz as az  # slow to import

    names = [rv.name for rv in model.free_RVs]
    posterior = idata["posterior"].to_dataset()[names]
    for name in names:
        check_finite(posterior[name].values, "idata", f"Those are draws of {name}.")
    table = az.summary(posterior, kind="stats", round_to="none")
    columns = {"mean": table["mean"], "standard_deviation": table["sd"]}
    values = {name: ("event", [value]) for name, value in scores.items()}
    values |= {name: (("event", "parameter"), [np.asarray(x, dtype=float)]) for name, x in columns.items()}
    return xr.Dataset(values, {"event": [number], "parameter": list(table.index)})
