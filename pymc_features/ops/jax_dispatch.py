"""How JAX runs the Ops of every family: one call of the kernels each, with their exact gradients.

Only this file imports JAX. A call leaves XLA for the processor and comes back; `jax.vmap` takes structures
one by one. First derivatives exist, by `jax.grad`.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytensor.tensor as pt
from pytensor.graph.basic import Constant
from pytensor.link.jax.dispatch.basic import jax_funcify

from pymc_features.ops.comparison import (
    MisfitGradient,
    StructuralComparison,
)
from pymc_features.ops.gradient import ResponseGradient, ResponseTangent, gradient_op
from pymc_features.ops.numba_dispatch import OPS
from pymc_features.ops.population import (
    PopulationComparison,
    PopulationGradient,
)
from pymc_features.ops.response import StructuralResponse
from pymc_features.simulators import n_outputs

RESPONSES = (StructuralResponse, ResponseTangent)


def of_kernel(op, known, n_samples=None):
    """A function of JAX arrays that calls the kernel of an Op; `n_samples(record)` of a response.

    Inputs that are `known`, by their number, stay where they are; only the others are carried to and fro.
    """

    def on_processor(*carried):
        carried = iter(carried)
        inputs = [known[i] if i in known else np.asarray(next(carried)) for i in range(n_inputs)]
        return tuple(np.asarray(x, dtype=np.float64) for x in op.run(inputs))

    n_inputs = op.n_common + len(op.more_ndims)

    def call(*inputs):
        shapes = [jax.ShapeDtypeStruct(s, jnp.float64) for s in output_shapes(op, inputs, n_samples)]
        carried = [x for i, x in enumerate(inputs) if i not in known]
        results = jax.pure_callback(on_processor, tuple(shapes), *carried, vmap_method="sequential")
        return results if len(results) > 1 else results[0]

    return call


def output_shapes(op, inputs, n_samples) -> list[tuple[int, ...]]:
    """Shapes of what an Op returns."""
    n_sensors = inputs[op.at("sensors")].shape[0]
    if isinstance(op, RESPONSES):
        return [(n_sensors, n_samples(inputs[op.at("acceleration")].shape[-1]))]
    parameters = [x.shape for x in inputs[: op.n_parameters]]
    if isinstance(op, ResponseGradient | MisfitGradient):
        return parameters
    if isinstance(op, PopulationComparison):
        return [(max(shape[0] for shape in parameters), n_sensors, *op.values)]
    return [(n_sensors, *getattr(op, "values", ()))]


def samples_of(op, node):
    """Number of samples of a response from that of its record; JAX must know the step when it compiles."""
    if not isinstance(op, RESPONSES):
        return None
    try:
        given = (node.inputs[op.at(name)] for name in ("substeps", "stride"))
        substeps, stride = (int(pt.get_underlying_scalar_constant_value(value)) for value in given)
    except pt.exceptions.NotScalarConstantError:
        raise NotImplementedError(
            "JAX needs an output step that is fixed when it compiles. Pass `dt` to response() as a number."
        ) from None
    return lambda n_times: n_outputs(n_times, substeps, stride)


def funcify(op, node, **kwargs):
    """The kernel of an Op, with the derivative that it has."""
    known = {i: x.data for i, x in enumerate(node.inputs) if isinstance(x, Constant)}
    function = of_kernel(op, known, samples_of(op, node))
    if not isinstance(op, StructuralResponse | StructuralComparison | PopulationComparison):
        return function
    free = [i for i in range(len(node.inputs)) if i not in known]

    def every(values):
        given = dict(zip(free, values, strict=True))
        return [known[i] if i in known else given[i] for i in range(len(node.inputs))]

    @jax.custom_vjp
    def differentiable(*values):
        return function(*every(values))

    gradient = backward_of(op, node, known)
    differentiable.defvjp(
        lambda *values: (function(*every(values)), values),
        lambda values, weights: tuple(gradient(every(values), weights)[i] for i in free),
    )
    return lambda *inputs: differentiable(*(inputs[i] for i in free))


def backward_of(op, node, known):
    """The cotangents of all inputs, from those of the outputs."""
    if isinstance(op, StructuralResponse):
        gradient = of_kernel(gradient_op(op, ResponseGradient, node.inputs), known)
        return lambda inputs, weights: as_cotangents(gradient(*inputs, weights), inputs)
    is_population = isinstance(op, PopulationComparison)
    kind = PopulationGradient if is_population else MisfitGradient
    gradient = of_kernel(gradient_op(op, kind, node.inputs, n_statistics=4 if op.values else 1), known)

    def backward(inputs, weights):
        *common, observed = inputs
        weights = weights if op.values else weights[..., None]
        found = as_cotangents(gradient(*inputs, weights), inputs)
        if is_population or len(common) in known:  # data that are not differentiated
            return found
        response = of_kernel(op.like(StructuralResponse), known, lambda _: observed.shape[1])
        misfit = observed - response(*common)
        return *found[:-1], by_data(jnp.where(jnp.isnan(observed), 0.0, misfit), weights)

    return backward


def as_cotangents(gradients, inputs):
    """Gradients by the parameters, and nothing by the other inputs."""
    gradients = gradients if isinstance(gradients, tuple) else (gradients,)

    def nothing(x):
        if jnp.issubdtype(jnp.result_type(x), jnp.floating):
            return jnp.zeros_like(x)
        return np.zeros(np.shape(x), jax.dtypes.float0)

    return *gradients, *(nothing(x) for x in inputs[len(gradients) :])


def by_data(misfit, weights):
    """`ops.comparison.misfit_cotangent` in JAX."""
    _, transpose = jax.vjp(statistics, misfit)
    [found] = transpose(jnp.pad(weights, ((0, 0), (0, 4 - weights.shape[1]))))
    return found


def statistics(misfit):
    """`ops.comparison.misfit_values` in JAX."""
    squares = ((x**2).sum(axis=1) / misfit.shape[1] for x in (misfit, jnp.diff(misfit, axis=1)))
    return jnp.stack([*squares, misfit[:, 0], misfit[:, -1]], axis=-1)


for _op in OPS:
    jax_funcify.register(_op)(funcify)
