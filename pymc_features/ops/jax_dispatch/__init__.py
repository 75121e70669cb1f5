"""How JAX runs the Ops, batched and differentiable, on any of its devices. Only this folder imports JAX.

The same mathematics as the compiled kernels, once more; the exact gradients are custom derivatives, so that
repeated frequencies do no harm here either. JAX can differentiate these once more; such second derivatives
are right only where no two frequencies are close.
"""

import jax
import pytensor.tensor as pt
from pytensor.link.jax.dispatch.basic import jax_funcify

from pymc_features.ops.comparison import (
    DiscrepancyTangent,
    MisfitGradient,
    StructuralDiscrepancy,
    StructuralMisfit,
)
from pymc_features.ops.gradient import ResponseGradient, ResponseTangent
from pymc_features.ops.jax_dispatch.gradient import (
    differentiable_discrepancy,
    differentiable_misfit,
    differentiable_response,
    discrepancy_tangent,
    misfit_gradient,
    response_gradient,
    response_tangent,
)
from pymc_features.ops.population import PopulationDiscrepancy, PopulationGradient, PopulationMisfit
from pymc_features.ops.response import StructuralResponse


def static_settings(node) -> tuple[int, int, int]:
    """Substeps, stride and number of modes, which fix the shape of the computation."""
    op = node.op
    if op.family != "chain":
        raise NotImplementedError(
            f"JAX runs spring-mass chains, got the family {op.family!r}. Sample with the default backend: "
            "leave out `nuts_sampler` and `mode`."
        )
    values = []
    for name in ("substeps", "stride", "n_modes"):
        value = node.inputs[op.at(name)]
        try:
            values.append(int(pt.get_underlying_scalar_constant_value(value)))
        except pt.exceptions.NotScalarConstantError:
            raise NotImplementedError(
                "JAX needs an output step and a number of modes that are fixed when it compiles, got "
                f"{value}. Pass `dt` to response() as a number."
            ) from None
    return tuple(values)


def split(op, inputs):
    """Parameters; record, its step and sensors; and what follows the family's inputs."""
    acceleration, direct, dt, sensors = (
        inputs[op.at(name)] for name in ("acceleration", "direct", "dt", "sensors")
    )
    return tuple(inputs[: op.n_parameters]), ((acceleration, direct), dt, sensors), inputs[op.n_common :]


def on_one_particle(kernel):
    """Return the dispatch of an Op whose kernel takes (op, static, parameters, record, dt, sensors, more)."""

    def funcify(op, node, **kwargs):
        static = static_settings(node)

        def chain_op(*inputs):
            parameters, settings, more = split(op, inputs)
            return kernel(op, static, parameters, *settings, *more)

        return chain_op

    return funcify


def on_population(kernel):
    """The same for a batch; parameters of one row belong to all, and get the sum of the gradients."""

    def funcify(op, node, **kwargs):
        static = static_settings(node)

        def chain_op(*inputs):
            parameters, settings, (observed, *more) = split(op, inputs)
            axes = tuple(0 if x.shape[0] > 1 else None for x in parameters)
            if all(axis is None for axis in axes):
                axes = (0,) * len(axes)
            rows = tuple(x if axis == 0 else x[0] for x, axis in zip(parameters, axes, strict=True))

            def one(row, *more):
                return kernel(op, static, row, *settings, observed, *more)

            results = jax.vmap(one, in_axes=(axes, *(0 for _ in more)))(rows, *more)
            if not more:
                return results
            return tuple(
                g if axis == 0 else g.sum(axis=0, keepdims=True)
                for g, axis in zip(results, axes, strict=True)
            )

        return chain_op

    return funcify


jax_funcify.register(StructuralResponse)(on_one_particle(differentiable_response))
jax_funcify.register(StructuralDiscrepancy)(on_one_particle(differentiable_discrepancy))
jax_funcify.register(ResponseGradient)(on_one_particle(response_gradient))
jax_funcify.register(MisfitGradient)(on_one_particle(misfit_gradient))
jax_funcify.register(ResponseTangent)(on_one_particle(response_tangent))
jax_funcify.register(DiscrepancyTangent)(on_one_particle(discrepancy_tangent))
jax_funcify.register(PopulationDiscrepancy)(on_population(differentiable_discrepancy))
jax_funcify.register(StructuralMisfit)(on_one_particle(differentiable_misfit))
jax_funcify.register(PopulationMisfit)(on_population(differentiable_misfit))
jax_funcify.register(PopulationGradient)(on_population(misfit_gradient))
