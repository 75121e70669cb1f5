"""Ops of the gradients: reverse mode and, as its transpose, forward mode.

The reverse Op of each response Op is linear in its cotangent; its derivative by that is the forward Op, and
the other way round. So forward mode, Gauss-Newton and Fisher products work. Second derivatives by the
parameters do not exist: PyTensor says so if they are asked for.
"""

import numpy as np
import pytensor.tensor as pt
from pytensor.gradient import DisconnectedType, disconnected_type, grad_undefined
from pytensor.graph.basic import Apply
from pytensor.tensor.blockwise import Blockwise

from pymc_features.ops.base import INPUT_SIGNATURE, INPUTS, N_PARAMETERS, ChainOp
from pymc_features.simulators import (
    discrepancy_gradient,
    discrepancy_tangent,
    population_gradient,
    response_gradient,
    response_tangent,
)

N_COMMON = len(INPUTS)
DIRECTIONS = (1, 1, 1, 1)  # dimensions of what belongs to mass, stiffness, rayleigh, ratios
DIRECTIONS_SIGNATURE = "(n),(n),(2),(n)"


def undefined(op, inputs, i):
    """What stands for a second derivative; PyTensor raises if it is used."""
    return grad_undefined(
        op, i, inputs[i], "The structural response has first derivatives only; see fisher_information()."
    )


def filled(cotangents, like):
    """Cotangents, with zeros where an output is not used."""
    return [
        pt.zeros_like(x) if isinstance(c.type, DisconnectedType) else c
        for c, x in zip(cotangents, like, strict=True)
    ]


class Derivative(ChainOp):
    """Base: the inputs of a response Op, then more; linear in the last `n_linear` of these.

    Attributes
    ----------
    kernel : callable
        Arrays in, one array or a tuple of arrays out.
    extra : tuple of int
        Numbers of dimensions of the inputs behind those of the response Op.
    """

    kernel = None
    extra: tuple[int, ...] = ()
    n_linear = 1

    def make_node(self, *inputs):
        common = self.prepare_inputs(inputs[:N_COMMON])
        extra = [pt.as_tensor_variable(x).astype("float64") for x in inputs[N_COMMON:]]
        if tuple(x.ndim for x in extra) != self.extra:
            raise ValueError(
                f"{type(self).__name__} takes {len(self.extra)} more inputs of {self.extra} dimensions."
            )
        return Apply(self, [*common, *extra], self.output_variables(common))

    def perform(self, node, inputs, output_storage):
        inputs = [np.ascontiguousarray(x) if np.ndim(x) else x.item() for x in inputs]
        results = type(self).kernel(*inputs[:N_COMMON], self.quantity_code, *inputs[N_COMMON:])
        for storage, result in zip(
            output_storage, results if isinstance(results, tuple) else (results,), strict=True
        ):
            storage[0] = result

    def pullback(self, inputs, outputs, cotangents):
        """With respect to the linear inputs."""
        first = len(inputs) - self.n_linear
        return [
            *(undefined(self, inputs, i) for i in range(N_PARAMETERS)),
            *(disconnected_type() for _ in range(N_PARAMETERS, N_COMMON)),
            *(undefined(self, inputs, i) for i in range(N_COMMON, first)),
            *self.transpose(inputs[:first], filled(cotangents, outputs)),
        ]


class Gradient(Derivative):
    """Reverse mode: outputs of the shapes of mass, stiffness, rayleigh and ratios."""

    def output_variables(self, common):
        return [x.type() for x in common[:N_PARAMETERS]]

    def infer_shape(self, node, shapes):
        return shapes[:N_PARAMETERS]


class Tangent(Derivative):
    """Forward mode: directions of mass, stiffness, rayleigh and ratios come last."""

    n_linear = N_PARAMETERS


class ChainResponseGradient(Gradient):
    """Gradient of sum_jk W_jk y_jk; the last input is W (sensor, time)."""

    gufunc_signature = f"{INPUT_SIGNATURE},(s,u)->{DIRECTIONS_SIGNATURE}"
    kernel = staticmethod(response_gradient)
    extra = (2,)

    def transpose(self, inputs, cotangents):
        return [ChainResponseTangent(self.quantity)(*inputs, *cotangents)]


class ChainResponseTangent(Tangent):
    """Derivative (sensor, time) of the response along a direction."""

    gufunc_signature = f"{INPUT_SIGNATURE},{DIRECTIONS_SIGNATURE}->(s,u)"
    kernel = staticmethod(response_tangent)
    extra = DIRECTIONS

    def output_variables(self, common):
        return [pt.tensor(dtype="float64", shape=(common[8].type.shape[0], self.static_n_outputs(common)))]

    def infer_shape(self, node, shapes):
        return [(shapes[8][0], self.symbolic_n_outputs(node, shapes))]

    def transpose(self, inputs, cotangents):
        return ChainResponseGradient(self.quantity)(*inputs, *cotangents)


class ChainDiscrepancyGradient(Gradient):
    """Gradient of sum_j c_j e_j; the last inputs are the data (sensor, time) and c (sensor,)."""

    gufunc_signature = f"{INPUT_SIGNATURE},(s,u),(s)->{DIRECTIONS_SIGNATURE}"
    kernel = staticmethod(discrepancy_gradient)
    extra = (2, 1)

    def transpose(self, inputs, cotangents):
        return [ChainDiscrepancyTangent(self.quantity)(*inputs, *cotangents)]


class ChainDiscrepancyTangent(Tangent):
    """Derivative (sensor,) of the discrepancy along a direction; the data come before that."""

    gufunc_signature = f"{INPUT_SIGNATURE},(s,u),{DIRECTIONS_SIGNATURE}->(s)"
    kernel = staticmethod(discrepancy_tangent)
    extra = (2, *DIRECTIONS)

    def output_variables(self, common):
        return [pt.tensor(dtype="float64", shape=(common[8].type.shape[0],))]

    def infer_shape(self, node, shapes):
        return [(shapes[8][0],)]

    def transpose(self, inputs, cotangents):
        return ChainDiscrepancyGradient(self.quantity)(*inputs, *cotangents)


class PopulationGradient(Gradient):
    """Gradient of sum_pj c_pj e_pj; as `PopulationDiscrepancy`, and c (particle, sensor)."""

    kernel = staticmethod(population_gradient)
    extra = (2, 2)

    def prepare_inputs(self, inputs):
        """Parameters have one row for each particle, or one for all."""
        parameters = [pt.as_tensor_variable(x).astype("float64") for x in inputs[:N_PARAMETERS]]
        return [*parameters, *super().prepare_inputs(inputs[N_PARAMETERS:], start=N_PARAMETERS)]

    def transpose(self, inputs, cotangents):
        rows = inputs[0].shape[0]
        for x in inputs[1:N_PARAMETERS]:
            rows = pt.maximum(rows, x.shape[0])
        spread = [pt.broadcast_to(x, (rows, x.shape[1])) for x in (*inputs[:N_PARAMETERS], *cotangents)]
        settings = inputs[N_PARAMETERS:]
        tangent = Blockwise(ChainDiscrepancyTangent(self.quantity))
        return [tangent(*spread[:N_PARAMETERS], *settings, *spread[N_PARAMETERS:])]
