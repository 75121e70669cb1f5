"""A population model: the distribution of parameters among events, given its own parameters.

In the notation of Wu et al. (2019), psi are the parameters of the population, theta_e those of event e, d_e
its data. The stored posterior of an event was sampled under a prior of its own, pi_e(theta), with evidence
Z_e, and

    p(d_e | psi) = integral p(d_e | theta) p(theta | psi) dtheta
                 = Z_e E[ p(theta | psi) / pi_e(theta) ],    theta from the stored posterior,

so that the population can be inferred without a new simulation.
"""

from collections.abc import Callable

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from pymc.model.fgraph import clone_model
from pymc.pytensorf import compile as compile_function
from pytensor.gradient import disconnected_grad
from pytensor.graph.replace import graph_replace, vectorize_graph
from pytensor.graph.traversal import ancestors
from scipy.special import gammaln

from pymc_features.smc.density.compilation import with_mode

WIDER, DEGREES = (
    1.3,
    5.0,
)  # of the prior of an event that is sampled again, over what is known of the population


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


class Population:
    """A population model, and what follows from it for stored draws.

    Parameters
    ----------
    model : pymc.Model
    names : list of str
        Its variables that the events have.
    """

    def __init__(self, model: pm.Model, names: list[str]):
        self.model, self.names = model, names
        self.parameters = [rv for rv in model.free_RVs if rv.name not in names]
        self.follow = {  # deterministic variables that are of one event, not of the population
            v.name for v in model.deterministics if {model[name] for name in names} & set(ancestors([v]))
        }

    def inputs(self, graph):
        """A graph of the population's parameters as one of inputs, and these."""
        inputs = [rv.type(name=rv.name) for rv in self.parameters]
        return inputs, graph_replace(graph, dict(zip(self.parameters, inputs, strict=True)), strict=False)

    def marginal(self, draws: list, log_weights) -> pm.Model:
        """Model of psi alone, with ln p(d_e | psi) of all events as a potential.

        Parameters
        ----------
        draws : list of shared variables (event, draw, ...)
            One for each name.
        log_weights : shared variable (event, draw)
            ln Z_e - ln pi_e(theta) - ln S, with S draws.
        """
        model = clone_model(self.model)
        values, density = log_density(model, self.names)
        densities = vectorize_graph(density, dict(zip(values, draws, strict=True)))
        with model:
            pm.Potential("log_likelihood_of_events", log_sum_exp(densities + log_weights).sum())
        anywhere = {name: np.zeros(self.shape(name)) for name in self.names}  # no term asks for it any more
        return pm.do(model, anywhere)

    def shape(self, name: str) -> tuple[int, ...]:
        """Shape of a variable of one event."""
        return tuple(self.model[name].shape.eval(mode="FAST_COMPILE"))

    def density_function(self, draws: list) -> Callable:
        """Function of psi that gives ln p(theta | psi) (event, draw) of shared draws."""
        values, density = log_density(self.model, self.names)
        densities = vectorize_graph(density, dict(zip(values, draws, strict=True)))
        inputs, densities = self.inputs(densities)
        return compile_function(inputs, densities, **with_mode({"on_unused_input": "ignore"}, [densities]))

    def next_event(self, rows: list[dict], rng: np.random.Generator) -> dict[str, np.ndarray]:
        """Draws (row, ...) of theta for an event that has not been seen, one for each row of psi."""
        inputs, outputs = self.inputs([self.model[name] for name in self.names])
        seed = int(rng.integers(2**30))
        function = compile_function(
            inputs, outputs, mode="FAST_COMPILE", on_unused_input="ignore", random_seed=seed
        )
        columns = zip(*(function(**row) for row in rows), strict=True)
        return {name: np.stack(column) for name, column in zip(self.names, columns, strict=True)}

    def as_prior(self, model: pm.Model, theta: dict[str, np.ndarray], share: float):
        """The model of an event with another prior of theta: what is known of the next event, and its own.

        Parameters
        ----------
        model : pymc.Model
        theta : dict of arrays (draw, ...)
            Draws from the population, of which the new prior has the mean and, somewhat wider, the
            covariance.
        share : float
            Of the model's own prior, so that nothing that was possible becomes impossible.

        Returns
        -------
        model : pymc.Model
        relative : function of draws (draw, ...) by name
            ln of the new prior over the old one, (draw,).
        """
        model = clone_model(model)
        values, old = log_density(model, self.names)
        flat = pt.concatenate([pt.flatten(value) for value in values])
        new = log_student(flat, np.hstack([theta[name].reshape(len(theta[name]), -1) for name in self.names]))
        relative = pt.logaddexp(np.log1p(-share) + new - old, np.log(share))
        relative = graph_replace(relative, {value: model[value.name] for value in values}, strict=False)
        with model:
            pm.Potential("log_prior_of_population", relative)
        return model, over_draws(relative, model)


def log_student(x, points: np.ndarray):
    """ln of a Student-t density at a vector, a graph, with the mean of points (n, d) and more scatter."""
    d = points.shape[1]
    covariance = WIDER**2 * np.cov(points, rowvar=False).reshape(d, d)
    factor = np.linalg.inv(np.linalg.cholesky(covariance))
    squares = pt.sqr(pt.dot(factor, x - points.mean(axis=0))).sum()
    constant = gammaln(0.5 * (DEGREES + d)) - gammaln(0.5 * DEGREES) - 0.5 * d * np.log(DEGREES * np.pi)
    return constant + np.log(np.diag(factor)).sum() - 0.5 * (DEGREES + d) * pt.log1p(squares / DEGREES)
