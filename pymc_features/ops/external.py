"""Responses computed outside PyTensor, and their discrepancies, one by one or for a whole population.

The Ops call an object with `responses`, `discrepancies` and `gradients` (pymc_features/external/): parameters
of all particles in, arrays (particle, ...) out, NaN for those that failed.
"""

from functools import reduce

import numpy as np
import pytensor.tensor as pt
from pytensor.graph.basic import Apply
from pytensor.graph.op import Op
from pytensor.graph.replace import _vectorize_node

from pymc_features.exceptions import NotDifferentiableError
from pymc_features.ops.batches import in_one_call
from pymc_features.ops.structural import check_shape


class ExternalOp(Op):
    """Base: parameters of a simulator, and what else the Op needs, to arrays.

    Parameters
    ----------
    simulator : object
        What computes. Two Ops are equal if they share it.
    ndims : tuple of int
        Numbers of dimensions of its parameters.
    batched : bool
        Parameters have rows, one for each particle, or one that all share; so has the result.
    """

    __props__ = ("simulator", "ndims", "batched")
    simulates = True  # a value that is not finite is a failed simulation
    expensive = True  # not to be evaluated on a whim, and parallel by itself
    more_ndims: tuple[int, ...] = ()

    def __init__(self, simulator, ndims: tuple[int, ...], batched: bool = False):
        self.simulator, self.ndims, self.batched = simulator, tuple(ndims), batched

    @property
    def identity(self) -> str:
        """Fingerprint of what is computed, for checkpoints."""
        return self.simulator.identity

    @property
    def n_parameters(self) -> int:
        """Number of parameters, the first inputs."""
        return len(self.ndims)

    @property
    def parameter_ndims(self) -> tuple[int, ...]:
        """Numbers of dimensions of the parameters of one particle."""
        return self.ndims

    @property
    def gufunc_signature(self):
        """Shapes for one particle; a population Op is never wrapped."""
        if self.batched:
            return None
        inputs = [
            "(" + ",".join(f"{letter}{i}{k}" for k in range(n)) + ")"
            for letter, ndims in (("p", self.ndims), ("m", self.more_ndims))
            for i, n in enumerate(ndims)
        ]
        return f"{','.join(inputs)}->{self.output_signature}"

    def make_node(self, *inputs):
        inputs = [pt.as_tensor_variable(x).astype("float64") for x in inputs]
        expected = (*(n + self.batched for n in self.ndims), *self.more_ndims)
        if tuple(x.ndim for x in inputs) != expected:
            raise ValueError(
                f"the simulator's parameters must have {self.ndims} dimensions, got "
                f"{tuple(x.ndim for x in inputs[: self.n_parameters])}."
            )
        rows = (None,) if self.batched else ()
        outputs = [pt.tensor(dtype="float64", shape=(*rows, *shape)) for shape in self.output_shapes(inputs)]
        return Apply(self, inputs, outputs)

    def perform(self, node, inputs, output_storage):
        parameters, more = inputs[: self.n_parameters], inputs[self.n_parameters :]
        rows = [np.asarray(p) if self.batched else np.asarray(p)[None] for p in parameters]
        results = self.compute(rows, *more)
        for storage, result in zip(output_storage, results, strict=True):
            storage[0] = np.asarray(result if self.batched else result[0], order="C")

    def run(self, inputs):
        """What `perform` computes, for one particle."""
        return [result[0] for result in self.compute([np.asarray(p)[None] for p in inputs])]

    def connection_pattern(self, node):
        """Everything counts."""
        return [[True] * len(node.outputs) for _ in node.inputs]


class ExternalResponse(ExternalOp):
    """Response history (sensor, time) of an external simulator."""

    output_signature = "(s,u)"

    def output_shapes(self, inputs):
        """Take the shape that the simulator says."""
        return [self.simulator.shape]

    def infer_shape(self, node, shapes):
        rows = [(most_rows(shapes),)] if self.batched else [()]
        return [(*rows[0], *(pt.constant(n) for n in self.simulator.shape))]

    def compute(self, rows):
        """Histories of all rows."""
        return [self.simulator.responses(*rows)]

    def pullback(self, inputs, outputs, cotangents):
        """By the user's gradient; for a population where the simulator has one for all rows at once."""
        batched = self.batched and hasattr(self.simulator, "discrepancy_gradients")
        return ExternalGradient(self.simulator, self.ndims, batched).of(inputs, cotangents[0])

    def compare(self, parameters, observed):
        """e_j of Eq. (3), without a history here."""
        return ExternalDiscrepancy(self.simulator, self.ndims)(*parameters, observed)


class ExternalDiscrepancy(ExternalOp):
    """e_j of Eq. (3), computed where the simulator runs: no history comes back."""

    output_signature = "(s)"
    more_ndims = (2,)

    def output_shapes(self, inputs):
        """One value for each sensor."""
        check_shape(self.simulator.shape, inputs[-1].type.shape)
        return [self.simulator.shape[:1]]

    def infer_shape(self, node, shapes):
        rows = (most_rows(shapes[: self.n_parameters]),) if self.batched else ()
        return [(*rows, pt.constant(self.simulator.shape[0]))]

    def compute(self, rows, observed):
        """Mean squares of all rows."""
        return [self.simulator.discrepancies(*rows, observed=observed)]

    def pullback(self, inputs, outputs, cotangents):
        """By the user's gradient, for one particle; of a history, from one more run unless it is at hand."""
        *parameters, observed = inputs
        [weights] = cotangents
        if hasattr(self.simulator, "discrepancy_gradients"):
            slopes = ExternalDiscrepancyGradient(self.simulator, self.ndims, self.batched)
            by_parameters = slopes(*parameters, observed, weights, return_list=True)
            return [*by_parameters, pt.full_like(observed, np.nan)]  # data are not inferred
        gradient = ExternalGradient(self.simulator, self.ndims)
        by_data = pt.full_like(observed, np.nan)  # data are not inferred
        if self.simulator.returns == "mean_square":
            return [*gradient.of(parameters, weights), by_data]
        misfit = ExternalResponse(self.simulator, self.ndims)(*parameters) - observed
        misfit = pt.switch(pt.isnan(observed), 0.0, misfit)
        return [
            *gradient.of(parameters, weights[:, None] * (2.0 / observed.shape[1]) * misfit),
            -weights[:, None] * (2.0 / observed.shape[1]) * misfit,
        ]


class GradientOp(ExternalOp):
    """Base: gradients by each parameter, of the shapes of the parameters."""

    simulates = False

    @property
    def output_signature(self):
        """Shapes of the outputs are those of the parameters."""
        return ",".join("(" + ",".join(f"p{i}{k}" for k in range(n)) + ")" for i, n in enumerate(self.ndims))

    def output_shapes(self, inputs):
        """Take the shapes of the parameters."""
        return [x.type.shape[self.batched :] for x in inputs[: self.n_parameters]]

    def infer_shape(self, node, shapes):
        parameters = shapes[: self.n_parameters]
        if not self.batched:
            return parameters
        rows = pt.maximum(most_rows(parameters), shapes[-1][0])
        return [(rows, *shape[1:]) for shape in parameters]


class ExternalGradient(GradientOp):
    """Gradient of sum(cotangent * result) by each parameter, by the user's function."""

    def __init__(self, simulator, ndims, batched=False):
        super().__init__(simulator, ndims, batched)
        self.more_ndims = ((1 if simulator.returns == "mean_square" else 2) + batched,)

    def of(self, parameters, cotangent):
        """Gradients as a list; refused where the user gave no function."""
        if self.simulator.gradient is None:
            raise NotDifferentiableError(
                "an external simulator without `gradient` has none. Sample with pmf.sample_smc(), give "
                "ExternalSimulator a gradient, or let pmf.emulate() make a model that has one."
            )
        return self(*parameters, cotangent, return_list=True)

    def compute(self, rows, cotangent):
        """Gradients of one row, or of all with a cotangent for each."""
        return self.simulator.gradients(*rows, cotangent=cotangent)


class ExternalDiscrepancyGradient(GradientOp):
    """Gradient of sum_j weights_j e_j by each parameter, of a simulator that has it without a history."""

    def __init__(self, simulator, ndims, batched=False):
        super().__init__(simulator, ndims, batched)
        self.more_ndims = (2, 1 + batched)

    def compute(self, rows, observed, weights):
        """Gradients of all rows."""
        weights = np.asarray(weights).reshape(-1, np.shape(weights)[-1])
        return self.simulator.discrepancy_gradients(*rows, observed=observed, weights=weights)


def most_rows(shapes):
    """Number of particles: rows of a parameter, where they do not share it."""
    return reduce(pt.maximum, (shape[0] for shape in shapes))


@_vectorize_node.register(ExternalResponse)
@_vectorize_node.register(ExternalDiscrepancy)
def vectorize_external(op, node, *inputs):
    """Batches of parameters become the Op of a population; others are looped over."""
    population = type(op)(op.simulator, op.ndims, batched=True)
    return in_one_call(op, population, inputs, [*op.ndims, *op.more_ndims])
