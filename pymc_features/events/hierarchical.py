"""`hierarchical`: what several events or specimens have in common, from the posterior of each.

In the notation of Wu et al. (2019), psi are the parameters of the population, theta_e those of event e, d_e
its data. The stored posterior of an event was sampled under a prior of its own, pi_e(theta), with evidence
Z_e, and

    p(d_e | psi) = integral p(d_e | theta) p(theta | psi) dtheta
                 = Z_e E[ p(theta | psi) / pi_e(theta) ],    theta from the stored posterior,

so that the population can be inferred without a new simulation.
"""

import json
import warnings
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import xarray as xr
from pymc.model.fgraph import clone_model
from pymc.pytensorf import compile as compile_function
from pytensor.gradient import disconnected_grad
from pytensor.graph.replace import graph_replace, vectorize_graph
from pytensor.graph.traversal import ancestors
from scipy.special import gammaln, softmax

from pymc_features._checks import (
    as_list,
    check_finite,
    check_group,
    check_integer,
    check_keywords,
    check_seed,
    message,
    shown,
)
from pymc_features.events.compare import Evidence, evidence_of, product
from pymc_features.exceptions import SamplingWarning
from pymc_features.inference.parameters import posterior_for
from pymc_features.inference.sample import sample
from pymc_features.smc.density.rows import with_mode
from pymc_features.smc.proposals.pool import LARGEST_K, pareto_k

ROUNDS = 3  # of sampling events again
OF_SAMPLERS = ("cores", "executor", "progressbar", "compile_kwargs", "stage_draws", "threshold")
OWN_SHARE = 0.1  # of an event's own prior, in that under which it is sampled again
WIDER, DEGREES = 1.3, 5.0  # of the rest of that prior, over what is known of the population
CHECKED, OFTEN = 200, 0.9  # values of psi at which weights are looked at, and how many of them must be good
SAMPLE_THEM = "Pass what `sample` returned for each event."


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
    events = check_events(events)
    models = check_models(hyper, models, len(events))
    event_draws = check_integer(event_draws, "event_draws", least=100)
    check_seed(random_seed, several=False)
    names = shared_names(hyper, events)
    stored = [stored_draws(event, models and models[i], hyper, names, i) for i, event in enumerate(events)]
    rng = np.random.default_rng(np.random.SeedSequence(random_seed).spawn(2)[1])
    check_keywords(settings, ("draws", "chains", *OF_SAMPLERS), "hierarchical")
    settings["random_seed"] = random_seed
    counts, marginal = np.zeros(len(events), dtype=int), Marginal(hyper, names, stored, event_draws)
    for round_ in range(ROUNDS + 1):
        marginal.set(stored)
        idata = sample(model=marginal.model, **settings)
        rows = marginal.rows(idata["posterior"].to_dataset())
        shapes = marginal.pareto_k(rows, rng)
        poor = np.flatnonzero(~(shapes <= LARGEST_K))
        again = [e for e in poor if models is not None and "calibration" not in events[e].children]
        if not again or round_ == ROUNDS:
            break
        theta = marginal.next_event(rows, rng)
        for e in again:
            counts[e] += 1
            stored[e] = sampled_again(models[e], names, theta, event_draws, settings)
    if poor.size:
        warn_of(poor, shapes, models)
    of_events = {"pareto_k": shapes, "sampled_again": counts}
    return described(idata, marginal, rows, of_events, events, rng)


def check_events(events) -> list[xr.DataTree]:
    """Two or more posteriors, as a list."""
    listed = None if isinstance(events, xr.DataTree) else as_list(events)
    if listed is None or len(listed) < 2:
        got = shown(events) if listed is None else len(listed)
        raise TypeError(message("events", "a sequence of two or more posteriors", got, SAMPLE_THEM))
    for event in listed:
        check_group(event, "events", "posterior", SAMPLE_THEM, "chain", "draw")
    return listed


def check_models(hyper, models, n: int) -> list[pm.Model] | None:
    """Refuse what is no population model; the models of n events, if there are any."""
    if not isinstance(hyper, pm.Model):
        raise TypeError(message("hyper", "a pymc.Model of the population", shown(hyper)))
    if not hyper.free_RVs:
        raise ValueError(message("hyper", "a model with free variables", "none"))
    if models is None:
        return None
    listed = as_list(models)
    if listed is None or not all(isinstance(model, pm.Model) for model in listed):
        advice = "Pass one of each event."
        raise TypeError(message("models", "a sequence of pymc.Model", shown(models), advice))
    if len(listed) != n:
        raise ValueError(message("models", f"as many as `events`, {n}", len(listed)))
    return listed


def shared_names(hyper: pm.Model, events) -> list[str]:
    """Variables of the population model that each event has."""
    free = [rv.name for rv in hyper.free_RVs]
    names = [name for name in free if all(name in event["posterior"].data_vars for event in events)]
    if not names or len(names) == len(free):
        what = "one with free variables that the events have, and others that these depend on"
        got = f"{', '.join(free)}, of which the events have {', '.join(names) or 'none'}"
        raise ValueError(message("hyper", what, got, "Call them by the names of the events' parameters."))
    return names


class Stored(NamedTuple):
    """Draws (draw, ...) of what varies in the population, ln pi_e (draw,) of them, and ln Z_e of an event."""

    draws: dict[str, np.ndarray]
    log_prior: np.ndarray
    evidence: Evidence


def flat_draws(x: xr.DataArray) -> np.ndarray:
    """Draws (draw, ...) of all chains."""
    values = x.transpose("chain", "draw", ...).values
    return values.reshape(-1, *values.shape[2:])


def log_density(model: pm.Model, names: list[str]):
    """ln p of some free variables given those that they depend on, as a graph.

    Returns
    -------
    values : list of TensorVariable
        One stands for each of the variables.
    density : scalar TensorVariable
    """
    rvs = [model[name] for name in names]
    values = [rv.type(name=rv.name) for rv in rvs]
    terms = [pm.logp(rv, value).sum() for rv, value in zip(rvs, values, strict=True)]
    return values, graph_replace(sum(terms), dict(zip(rvs, values, strict=True)), strict=False)


def over_draws(graph, model: pm.Model) -> Callable:
    """Function of draws (draw, ...) of free variables by name that gives a scalar graph at each, (draw,)."""
    of_graph = set(ancestors([graph]))
    rvs = [rv for rv in model.free_RVs if rv in of_graph]
    many = [pt.tensor(rv.name, dtype=rv.dtype, shape=(None, *rv.type.shape)) for rv in rvs]
    one = [rv.type(name=rv.name) for rv in rvs]
    graph = graph_replace(graph, dict(zip(rvs, one, strict=True)), strict=False)
    batch = vectorize_graph(graph, dict(zip(one, many, strict=True)))
    function = compile_function(many, batch, mode="FAST_COMPILE", on_unused_input="ignore")

    def at(draws):
        columns = [np.asarray(draws[rv.name], dtype=rv.dtype) for rv in rvs]
        return np.broadcast_to(function(*columns), len(columns[0])).astype(np.float64)

    return at


def log_prior(model: pm.Model, names: list[str]) -> Callable:
    """Function of draws (draw, ...) by name that gives ln p (draw,) of some free variables."""
    values, density = log_density(model, names)
    rvs = {value: model[value.name] for value in values}
    return over_draws(graph_replace(density, rvs, strict=False), model)


def log_sum_exp(terms):
    """ln sum_s exp(terms) (event,) of terms (event, draw).

    In parts, not by `pt.logsumexp`, which in a population is a loop over its particles, and must be compiled.
    """
    largest = disconnected_grad(pt.max(terms, axis=1))
    shift = pt.switch(pt.isinf(largest), 0.0, largest)
    return pt.log(pt.exp(terms - shift[:, None]).sum(axis=1)) + shift


def log_student(x, points: np.ndarray):
    """ln of a Student-t density at a vector, a graph, with the mean of points (n, d) and more scatter."""
    d = points.shape[1]
    covariance = WIDER**2 * np.cov(points, rowvar=False).reshape(d, d)
    factor = np.linalg.inv(np.linalg.cholesky(covariance))
    squares = pt.sqr(pt.dot(factor, x - points.mean(axis=0))).sum()
    constant = gammaln(0.5 * (DEGREES + d)) - gammaln(0.5 * DEGREES) - 0.5 * d * np.log(DEGREES * np.pi)
    return constant + np.log(np.diag(factor)).sum() - 0.5 * (DEGREES + d) * pt.log1p(squares / DEGREES)


class Marginal:
    """A population model, and ln p(d_e | psi) / Z_e of all events from stored draws that may be exchanged.

    Parameters
    ----------
    hyper : pymc.Model
        The population.
    names : list of str
        Its variables that the events have.
    stored : list of Stored
    n : int
        Draws of each event, at most.

    Attributes
    ----------
    model : pymc.Model
        Of psi alone, with ln p(d_e | psi) of all events as a potential.
    density : function of psi by name
        ln p(theta | psi) (event, draw) of the stored draws.
    """

    def __init__(self, hyper: pm.Model, names: list[str], stored: list[Stored], n: int):
        hyper = clone_model(hyper)
        self.hyper, self.names = hyper, names
        self.parameters = [rv for rv in hyper.free_RVs if rv.name not in names]
        self.n = min(n, *(len(one.log_prior) for one in stored))
        self.columns = [pytensor.shared(self.thinned([one.draws[name] for one in stored])) for name in names]
        self.log_weights = pytensor.shared(np.zeros((len(stored), self.n)))  # ln Z_e - ln pi_e(theta) - ln S
        values, density = log_density(hyper, names)
        densities = vectorize_graph(density, dict(zip(values, self.columns, strict=True)))
        self.density = self.function_of_psi(densities, **with_mode({}, [densities]))
        with hyper:
            pm.Potential("log_likelihood_of_events", log_sum_exp(densities + self.log_weights).sum())
        anywhere = {name: np.zeros(shape_of(hyper, name)) for name in names}  # no term asks for it any more
        self.model = pm.do(hyper, anywhere)

    def function_of_psi(self, graphs, **settings) -> Callable:
        """Compile graphs of the population's parameters as a function of their values by name."""
        inputs = [rv.type(name=rv.name) for rv in self.parameters]
        graphs = graph_replace(graphs, dict(zip(self.parameters, inputs, strict=True)), strict=False)
        return compile_function(inputs, graphs, on_unused_input="ignore", **settings)

    def thinned(self, columns) -> np.ndarray:
        """Take as many draws of each event (event, draw, ...), evenly spaced."""
        return np.stack([x[np.linspace(0, len(x) - 1, self.n).round().astype(int)] for x in columns])

    def set(self, stored: list[Stored]) -> None:
        """Exchange the draws."""
        self.stored = stored
        for name, column in zip(self.names, self.columns, strict=True):
            column.set_value(self.thinned([one.draws[name] for one in stored]))
        self.log_weights.set_value(-self.thinned([one.log_prior for one in stored]) - np.log(self.n))

    def rows(self, posterior) -> list[dict]:
        """Draws of psi, one dictionary each."""
        columns = {rv.name: flat_draws(posterior[rv.name]).astype(rv.dtype) for rv in self.parameters}
        return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]

    def log_ratios(self, row: dict) -> np.ndarray:
        """ln of p(theta | psi) / pi_e(theta) / S at the stored draws (event, draw)."""
        return self.density(**row) + self.log_weights.get_value(borrow=True)

    def pareto_k(self, rows: list[dict], rng: np.random.Generator) -> np.ndarray:
        """Shape of each event's largest weights (event,), which nine tenths of psi do not exceed."""
        some = rng.choice(len(rows), min(CHECKED, len(rows)), replace=False)
        shapes = [[pareto_k(of_event) for of_event in self.log_ratios(rows[i])] for i in some]
        return np.quantile(shapes, OFTEN, axis=0, method="higher")

    def of_events(self, rows: list[dict], rng: np.random.Generator):
        """Draws of theta (row, event, ...) given psi, and the variance of ln Z that the stored draws add.

        By the delta method: ln Z moves with the mean over psi of the relative error of each p(d_e | psi).
        """
        n_events, n = self.log_weights.get_value(borrow=True).shape
        chosen, total = np.empty((len(rows), n_events), dtype=int), np.zeros((n_events, n))
        for i, row in enumerate(rows):
            weights = softmax(self.log_ratios(row), axis=-1)
            below = np.cumsum(weights, axis=-1) < rng.random(n_events)[:, None]
            chosen[i] = below.sum(axis=-1).clip(max=n - 1)
            total += weights
        relative = n * total / len(rows)
        columns = zip(self.names, self.columns, strict=True)
        theta = {name: x.get_value(borrow=True)[np.arange(n_events), chosen] for name, x in columns}
        return theta, float(relative.var(axis=1).sum() / n)

    def next_event(self, rows: list[dict], rng: np.random.Generator) -> dict[str, np.ndarray]:
        """Draws (row, ...) of theta for an event that has not been seen, one for each row of psi."""
        theta, seed = [self.hyper[name] for name in self.names], int(rng.integers(2**30))
        function = self.function_of_psi(theta, mode="FAST_COMPILE", random_seed=seed)
        columns = zip(*(function(**row) for row in rows), strict=True)
        return {name: np.stack(column) for name, column in zip(self.names, columns, strict=True)}


def as_prior(model: pm.Model, names: list[str], theta: dict[str, np.ndarray], share: float):
    """The model of an event with another prior of theta: what is known of the next event, and its own.

    Parameters
    ----------
    model : pymc.Model
    names : list of str
        What varies in the population.
    theta : dict of arrays (draw, ...)
        Draws from the population, of which the new prior has the mean and, somewhat wider, the covariance.
    share : float
        Of the model's own prior, so that nothing that was possible becomes impossible.

    Returns
    -------
    model : pymc.Model
    relative : function of draws (draw, ...) by name
        ln of the new prior over the old one, (draw,).
    """
    model = clone_model(model)
    values, old = log_density(model, names)
    flat = pt.concatenate([pt.flatten(value) for value in values])
    new = log_student(flat, np.hstack([theta[name].reshape(len(theta[name]), -1) for name in names]))
    relative = pt.logaddexp(np.log1p(-share) + new - old, np.log(share))
    relative = graph_replace(relative, {value: model[value.name] for value in values}, strict=False)
    with model:
        pm.Potential("log_prior_of_population", relative)
    return model, over_draws(relative, model)


def shape_of(hyper: pm.Model, name: str) -> tuple[int, ...]:
    """Shape of a variable of one event."""
    return tuple(hyper[name].shape.eval(mode="FAST_COMPILE"))


def stored_draws(event, model, hyper: pm.Model, names: list[str], i: int) -> Stored:
    """What the posterior of event i tells."""
    if model is not None:
        posterior_for(model, event, "events")
    posterior = event["posterior"].to_dataset()
    draws = {
        name: flat_draws(x)
        for name, x in posterior.data_vars.items()
        if {"chain", "draw"} <= set(x.dims) and x.dtype.kind in "biuf"
    }
    for name in names:
        if name not in draws:
            raise ValueError(message("events", f"posteriors with numbers for {name}", f"none in event {i}"))
        check_finite(draws[name], "events", f"Those are draws of {name} in event {i}.")
        if draws[name].shape[1:] != shape_of(hyper, name):
            what = f"posteriors with {name} of shape {shape_of(hyper, name)}, as in `hyper`"
            raise ValueError(message("events", what, f"{draws[name].shape[1:]} in event {i}"))
    if model is not None:
        if missing := [name for name in names if name not in model.named_vars]:
            raise ValueError(message("models", f"ones with {', '.join(missing)}", f"none in model {i}"))
        prior = log_prior(model, names)(draws)
    elif "log_prior" in event.children and set(names) <= set(event["log_prior"].data_vars):
        terms = [flat_draws(event["log_prior"][name]) for name in names]
        prior = sum(term.reshape(len(term), -1).sum(axis=1) for term in terms)
        check_finite(prior, "events", f"That is `log_prior` of event {i}.")
    else:
        raise ValueError(
            f"`events` must have a group `log_prior` of {', '.join(names)} where `models` are "
            f"left out, got none in event {i}. Pass `models`, or call pymc.compute_log_prior()."
        )
    return Stored({name: draws[name] for name in names}, prior, evidence_of(event))


def sampled_again(model, names: list[str], theta, draws: int, settings: dict) -> Stored:
    """An event's posterior under what draws of the population tell of the next event."""
    model, relative = as_prior(model, names, theta, OWN_SHARE)
    chains = settings.get("chains") or 2
    idata = sample(model=model, **settings | {"draws": -(-draws // chains), "chains": chains})
    posterior = idata["posterior"].to_dataset()
    every = {rv.name: flat_draws(posterior[rv.name]) for rv in model.free_RVs}
    prior = log_prior(model, names)(every) + relative(every)
    return Stored({name: every[name] for name in names}, prior, evidence_of(idata))


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
    posterior, hyper = idata["posterior"].to_dataset(), marginal.hyper
    sizes = posterior.sizes["chain"], posterior.sizes["draw"]
    theta = {hyper[name] for name in marginal.names}  # what follows from it is of one event
    follow = [v.name for v in hyper.deterministics if theta & set(ancestors([v]))]
    idata["posterior"] = xr.DataTree(posterior.drop_vars(follow, errors="ignore"))
    evidence = product(one.evidence for one in marginal.stored)
    error = idata["sample_stats"].attrs["log_evidence_se"]
    theta, noise = marginal.of_events(rows, rng)
    idata["sample_stats"].attrs["log_evidence"] += evidence.value
    idata["sample_stats"]["log_marginal_likelihood"] += evidence.value
    idata["sample_stats"].attrs["log_evidence_se"] = float(np.sqrt(error**2 + evidence.error**2 + noise))
    dims = {name: [f"{name}_dim_{i}" for i in range(len(shape_of(hyper, name)))] for name in theta}
    dims |= {name: list(labels) for name, labels in hyper.named_vars_to_dims.items()}

    def shaped(values, *more):
        return {
            name: (("chain", "draw", *more, *dims[name]), x.reshape(*sizes, *x.shape[1:]))
            for name, x in values.items()
        }

    used = {dim for name in theta for dim in dims[name]}
    coords = {"chain": posterior["chain"], "draw": posterior["draw"]}
    coords |= {dim: list(x) for dim, x in hyper.coords.items() if x is not None and dim in used}
    events = shaped(theta, "event") | {name: ("event", x) for name, x in of_events.items()}
    idata["events"] = xr.DataTree(xr.Dataset(events, coords))
    idata["predictive"] = xr.DataTree(xr.Dataset(shaped(marginal.next_event(rows, rng)), coords))
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
        text = event["sample_stats"].attrs.get("likelihoods") if "sample_stats" in event.children else None
        kinds |= {f"{name}_{e}": kind for name, kind in json.loads(text or "{}").items()}
    idata["observed_data"] = xr.DataTree(xr.Dataset(data))
    idata["sample_stats"].attrs["likelihoods"] = json.dumps(kinds)
    if set(kinds) != set(data):  # of one that some sampler has not told
        del idata["sample_stats"].attrs["likelihoods"]
