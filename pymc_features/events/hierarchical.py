"""`hierarchical`: what several events or specimens have in common, from the posterior of each."""

import json
import warnings
from collections.abc import Sequence

import numpy as np
import pymc as pm
import xarray as xr

from pymc_features._checks import check_finite, check_integer, check_seed, message
from pymc_features.events.checks import (
    check_events,
    check_hyper,
    check_models,
    flat_draws,
    number_draws,
    shared_names,
)
from pymc_features.events.evidence import evidence_of
from pymc_features.events.marginal import Marginal, Stored
from pymc_features.events.population import Population, log_prior
from pymc_features.events.weights import LARGEST_K
from pymc_features.exceptions import SamplingWarning
from pymc_features.inference.parameters import posterior_for
from pymc_features.inference.sample import sample
from pymc_features.keywords import check_keywords

ROUNDS = 3  # of sampling events again
OF_SAMPLE = (
    "draws",
    "chains",
    "cores",
    "executor",
    "progressbar",
    "compile_kwargs",
    "stage_draws",
    "threshold",
)
OWN_SHARE = 0.1  # of an event's own prior, in that under which it is sampled again


def hierarchical(
    events: Sequence[xr.DataTree],
    hyper: pm.Model,
    *,
    models: Sequence[pm.Model] | None = None,
    event_draws: int = 2000,
    random_seed: int | None = None,
    **settings,
) -> xr.DataTree:
    """Population of which several events or specimens are members, from the posterior of each of them.

    Parameters theta_e of event e are taken to be drawn from a population p(theta | psi): one stiffness for
    each earthquake or specimen, with a common mean and scatter. With draws of the stored posteriors, which
    were sampled under priors pi_e with evidences Z_e,

        p(psi | d) ~ p(psi) prod_e p(d_e | psi),
        p(d_e | psi) = Z_e mean_s[ p(theta_es | psi) / pi_e(theta_es) ],

    so that no structure is simulated again. Where the population is narrow beside an event's posterior, few
    of its draws count. An event whose weights cannot be trusted (Pareto k above 0.7) is sampled again, with
    the population that has been found as its prior.

    Parameters
    ----------
    events : sequence of DataTree
        What `sample` returned for each of two or more events. Those of other samplers do, without an
        evidence.
    hyper : pymc.Model
        The population: its free variables with the name of a parameter of the events are what varies from
        event to event; the others, on which their distributions depend, are psi. Other parameters of the
        events, such as the scale of their errors, keep their priors, each its own.
    models : sequence of pymc.Model, optional
        Of the events, in the same order; their priors are read from there, and events are sampled again
        with them. Without, each of `events` must have a group `log_prior`, see `pymc.compute_log_prior`,
        and nothing is sampled again.
    event_draws : int
        Draws of each event to use, at most.
    random_seed : int, optional
        For the same draws each time.
    **settings
        Of `sample`, for psi and for events that are sampled again.

    Returns
    -------
    DataTree
        As from `sample`: `posterior` of psi, `sample_stats` with `log_evidence` of all events together and
        its standard error, which includes that of the stored draws; NaN if an event has no evidence.
        `events`: theta of each event given all of them, (chain, draw, event, ...); `pareto_k` (event), that
        of nine tenths of the posterior of psi; `sampled_again` (event), how often. `predictive`: theta
        (chain, draw, ...) of the next event or specimen. `observed_data`: those of all events, so that
        `compare` can set it beside a model with one value for all of them.

    Raises
    ------
    TypeError, ValueError
        If no variable of `hyper` is a parameter of the events or no other one is left, or priors are unknown.

    Warns
    -----
    SamplingWarning
        If weights of an event cannot be trusted, and what to do. As from `sample`.

    Notes
    -----
    What an event's own prior excludes stays excluded: give single events priors that are wider than the
    population. Centred: write theta ~ Normal(mu, tau), never mu + tau z. A draw of psi costs events times
    `event_draws` densities, and no simulation.

    References
    ----------
    Wu, Angelikopoulos, Beck & Koumoutsakos, Hierarchical stochastic model in Bayesian inference for
    engineering applications, ASCE-ASME J. Risk Uncertainty B 5, 011006 (2019), whose estimate by importance
    sampling Korali calls Psi. Behmanesh, Moaveni, Lombaert & Papadimitriou, Mech. Syst. Signal Process.
    64-65, 360-376 (2015). Vehtari, Simpson, Gelman, Yao & Gabry, JMLR 25 (2024), for Pareto k.
    """
    events, hyper = check_events(events), check_hyper(hyper)
    models = check_models(models, events)
    event_draws = check_integer(event_draws, "event_draws", least=100)
    check_seed(random_seed, several=False)
    population = Population(hyper, shared_names(hyper, events))
    stored = [stored_draws(event, models and models[i], population, i) for i, event in enumerate(events)]
    rng = np.random.default_rng(np.random.SeedSequence(random_seed).spawn(2)[1])
    check_keywords(settings, OF_SAMPLE, "hierarchical")
    settings["random_seed"] = random_seed
    counts, marginal = np.zeros(len(events), dtype=int), Marginal(population, stored, event_draws)
    for round_ in range(ROUNDS + 1):
        marginal.set(stored)
        idata = sample(model=marginal.model, **settings)
        rows = marginal.rows(idata["posterior"].to_dataset())
        shapes = marginal.pareto_k(rows, rng)
        poor = np.flatnonzero(~(shapes <= LARGEST_K))
        again = [e for e in poor if models is not None and "calibration" not in events[e].children]
        if not again or round_ == ROUNDS:
            break
        theta = population.next_event(rows, rng)
        for e in again:
            counts[e] += 1
            stored[e] = sampled_again(models[e], population, theta, event_draws, settings)
    if poor.size:
        warn_of(poor, shapes, models)
    of_events = {"pareto_k": shapes, "sampled_again": counts}
    return described(idata, marginal, rows, of_events, events, rng)


def stored_draws(event, model, population: Population, i: int) -> Stored:
    """What the posterior of event i tells."""
    if model is not None:
        posterior_for(model, event, "events")
    draws = number_draws(event["posterior"].to_dataset())
    for name in population.names:
        if name not in draws:
            raise ValueError(message("events", f"posteriors with numbers for {name}", f"none in event {i}"))
        check_finite(draws[name], "events", f"Those are draws of {name} in event {i}.")
        if draws[name].shape[1:] != population.shape(name):
            wanted = f"posteriors with {name} of shape {population.shape(name)}, as in `hyper`"
            raise ValueError(message("events", wanted, f"{draws[name].shape[1:]} in event {i}"))
    if model is not None:
        if missing := [name for name in population.names if name not in model.named_vars]:
            raise ValueError(message("models", f"ones with {', '.join(missing)}", f"none in model {i}"))
        prior = log_prior(model, population.names)(draws)
    elif "log_prior" in event.children and set(population.names) <= set(event["log_prior"].data_vars):
        terms = [flat_draws(event["log_prior"][name]) for name in population.names]
        prior = sum(term.reshape(len(term), -1).sum(axis=1) for term in terms)
        check_finite(prior, "events", f"That is `log_prior` of event {i}.")
    else:
        raise ValueError(
            f"`events` must have a group `log_prior` of {', '.join(population.names)} where `models` are "
            f"left out, got none in event {i}. Pass `models`, or call pymc.compute_log_prior()."
        )
    draws = {name: draws[name] for name in population.names}
    return Stored(draws, prior, *evidence_of(event))


def sampled_again(model, population: Population, theta, draws: int, settings: dict) -> Stored:
    """An event's posterior under what draws of the population tell of the next event."""
    model, relative = population.as_prior(model, theta, OWN_SHARE)
    chains = settings.get("chains") or 2
    idata = sample(model=model, **settings | {"draws": -(-draws // chains), "chains": chains})
    posterior = idata["posterior"].to_dataset()
    every = {rv.name: flat_draws(posterior[rv.name]) for rv in model.free_RVs}
    prior = log_prior(model, population.names)(every) + relative(every)
    return Stored({name: every[name] for name in population.names}, prior, *evidence_of(idata))


def warn_of(poor, shapes, models) -> None:
    """Say which events' weights cannot be trusted."""
    worst = ", ".join(f"{e} (k = {shapes[e]:.2f})" for e in poor)
    todo = "Pass their `models`, to sample them again" if models is None else "Use more `event_draws`"
    warnings.warn(
        f"stored draws of events {worst} hardly overlap with the population: mean and scatter are less "
        f"certain than they seem. {todo}, or a joint model of all events.",
        SamplingWarning,
        stacklevel=3,
    )


def described(idata, marginal: Marginal, rows, of_events: dict, sources, rng) -> xr.DataTree:
    """The result: the population's posterior, and what it says of each event and of the next."""
    posterior, population = idata["posterior"].to_dataset(), marginal.population
    sizes = posterior.sizes["chain"], posterior.sizes["draw"]
    idata["posterior"] = xr.DataTree(posterior.drop_vars(population.follow, errors="ignore"))
    evidence, error = marginal.evidence(), idata["sample_stats"].attrs["log_evidence_se"]
    theta, noise = marginal.of_events(rows, rng)
    idata["sample_stats"].attrs["log_evidence"] += evidence.value
    idata["sample_stats"]["log_marginal_likelihood"] += evidence.value
    idata["sample_stats"].attrs["log_evidence_se"] = float(np.sqrt(error**2 + evidence.error**2 + noise))
    dims = {name: [f"{name}_dim_{i}" for i in range(len(population.shape(name)))] for name in theta}
    dims |= {name: list(found) for name, found in population.model.named_vars_to_dims.items()}

    def shaped(values, *more):
        return {
            name: (("chain", "draw", *more, *dims[name]), x.reshape(*sizes, *x.shape[1:]))
            for name, x in values.items()
        }

    coords = {dim: x for dim, x in population.model.coords.items() if x is not None}
    used = {dim for name in theta for dim in dims[name]}
    coords = {"chain": posterior["chain"], "draw": posterior["draw"]} | {
        dim: list(x) for dim, x in coords.items() if dim in used
    }
    events = shaped(theta, "event") | {name: ("event", x) for name, x in of_events.items()}
    idata["events"] = xr.DataTree(xr.Dataset(events, coords))
    idata["predictive"] = xr.DataTree(xr.Dataset(shaped(population.next_event(rows, rng)), coords))
    if "constant_data" in idata.children:
        del idata["constant_data"]
    with_data_of(idata, sources)
    return idata


def with_data_of(idata, events) -> None:
    """Write into the result whose data it is of, that `compare` may know."""
    kinds, data = {}, {}
    for e, event in enumerate(events):
        if "observed_data" in event.children:
            for name, x in event["observed_data"].to_dataset().data_vars.items():
                data[f"{name}_{e}"] = ([f"{dim}_{e}" for dim in x.dims], x.values)
        told = event["sample_stats"].attrs.get("likelihoods") if "sample_stats" in event.children else None
        kinds |= {f"{name}_{e}": kind for name, kind in json.loads(told or "{}").items()}
    idata["observed_data"] = xr.DataTree(xr.Dataset(data))
    idata["sample_stats"].attrs["likelihoods"] = json.dumps(kinds)
    if set(kinds) != set(data):  # of one that some sampler has not told
        del idata["sample_stats"].attrs["likelihoods"]
