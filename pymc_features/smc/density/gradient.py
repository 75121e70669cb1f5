"""Gradients of log prior and log-likelihood, of one particle and of a population, and why there are none."""

import pytensor.tensor as pt
from pytensor.gradient import NullTypeGradError

from pymc_features.exceptions import NotDifferentiableError
from pymc_features.smc.density.graph import DensityGraph, Outputs


def gradient_graph(graph: DensityGraph) -> DensityGraph:
    """Add the gradients of log prior and log-likelihood, (d,) or (p, d), behind the outputs of a graph.

    Raises
    ------
    NotDifferentiableError
        If a part of the model has no gradient; the message is one sentence without its stop.
    """
    if graph.discrete:
        raise NotDifferentiableError(f"{', '.join(graph.discrete)} is discrete")
    try:
        one = with_gradients(graph.one)
    except Exception as error:  # any Op of any library may refuse in its own way
        raise NotDifferentiableError(reason_of(error)) from error
    if graph.population is None:
        return graph._replace(one=one)
    try:
        return graph._replace(one=one, population=with_gradients(graph.population))
    except Exception as error:
        reason = f"a part of the model has no gradient of a population ({reason_of(error)})"
        return graph._replace(one=one, population=None, why_not_batched=reason)


def with_gradients(graph: Outputs) -> Outputs:
    """Add the gradients: those of sums over particles, for no row depends on another."""
    prior, likelihood, *_ = graph.outputs
    slopes = [
        pt.grad(density.astype("float64").sum(), graph.joined, disconnected_inputs="ignore")
        for density in (prior, likelihood)
    ]
    return graph._replace(outputs=[*graph.outputs, *slopes])


def reason_of(error: Exception) -> str:
    """First sentence of what an error says; of PyTensor's on a missing gradient, that which names the Op."""
    said = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, NullTypeGradError):
        said = said.rpartition(" because ")[2]
    return said.partition(". ")[0].removesuffix(".")
