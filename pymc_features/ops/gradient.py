"""Ops of the gradients: reverse mode and, as its transpose, forward mode, by differences of responses.

The reverse Op of each response Op is linear in its cotangent; its derivative by that is the forward Op, and
the other way round. So forward mode, Gauss-Newton and Fisher products work. Second derivatives by the
parameters do not exist: PyTensor says so if they are asked for.
"""

import functools

import pytensor.tensor as pt
from pytensor.gradient import DisconnectedType, disconnected_type, grad_undefined
from pytensor.graph.basic import Apply, Constant
from pytensor.graph.op import Op
from pytensor.graph.replace import _vectorize_node
from pytensor.graph.rewriting.basic import node_rewriter
from pytensor.tensor.basic import Join
from pytensor.tensor.rewriting.basic import register_specialize

from pymc_features.exceptions import NotDifferentiableError
from pymc_features.ops.structural import StructuralOp


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


class Derivative(StructuralOp):
    """Base: the inputs of a response Op, then more; linear in the last `n_linear` of these."""

    @property
    def n_linear(self):
        """Number of inputs it is linear in."""
        return 1

    def make_node(self, *inputs):
        common = self.prepare_inputs(inputs[: self.n_common])
        more = [pt.as_tensor_variable(x).astype("float64") for x in inputs[self.n_common :]]
        if tuple(x.ndim for x in more) != self.more_ndims:
            raise ValueError(
                f"{type(self).__name__} takes {len(self.more_ndims)} more inputs of {self.more_ndims} "
                "dimensions."
            )
        return Apply(self, [*common, *more], self.output_variables(common))

    def pullback(self, inputs, outputs, cotangents):
        """With respect to the linear inputs."""
        first = len(inputs) - self.n_linear
        return [
            *(undefined(self, inputs, i) for i in range(self.n_parameters)),
            *(disconnected_type() for _ in range(self.n_parameters, self.n_common)),
            *(undefined(self, inputs, i) for i in range(self.n_common, first)),
            *self.transpose(inputs[:first], filled(cotangents, outputs)),
        ]


class Gradient(Derivative):
    """Reverse mode: outputs of the shapes of the parameters.

    Parameters
    ----------
    quantity, family
        As of `StructuralOp`.
    sought : tuple of str, optional
        Parameters that the gradient is wanted by, of families whose kernels ask for them.
    """

    __props__ = ("quantity", "family", "sought")
    output_signature = "parameters"

    def __init__(self, quantity="absolute_acceleration", family="chain", sought=None):
        super().__init__(quantity, family)
        self.sought = sought

    @property
    def kernel(self):
        kernel = super().kernel
        return kernel if self.sought is None else functools.partial(kernel, sought=self.sought)

    def output_variables(self, common):
        return [x.type() for x in common[: self.n_parameters]]

    def infer_shape(self, node, shapes):
        return shapes[: self.n_parameters]


def gradient_op(op, op_type, inputs, **changes):
    """The Op of the gradient of an Op, by all that the inputs of its node make depend on a variable."""
    if op.spec.asks_what_is_sought:
        changes["sought"] = sought_parameters(op, inputs)
    return op.like(op_type, **changes)


def sought_parameters(op, inputs) -> tuple[str, ...]:
    """Names of the parameters that are no constants, and numbers of rows in them, as in "law[2]"."""
    found = []
    for (name, dims), variable in zip(op.spec.parameters.items(), inputs, strict=False):
        rows = rows_of(variable) if "," in dims else None
        if rows is not None:
            found += [f"{name}[{i}]" for i, row in enumerate(rows) if not is_constant(row)]
        elif not is_constant(variable):
            found.append(name)
    return tuple(found)


def rows_of(table):
    """What the rows of a table, of one structure or of each, were joined from; None where that is unknown."""
    node = table.owner
    if node is None or not isinstance(getattr(node.op, "core_op", node.op), Join):
        return None
    parts = [x for x in node.inputs if x.type.ndim > 1]
    numbers = [x.type.shape[-2] for x in parts]
    if None in numbers or sum(numbers) != table.type.shape[-2]:
        return None
    return [part for part, n in zip(parts, numbers, strict=True) for _ in range(n)]


def is_constant(variable) -> bool:
    """Whether nothing but constants decides a variable, its shape apart."""
    waiting, seen = [variable], set()
    while waiting:
        one = waiting.pop()
        if one in seen:
            continue
        seen.add(one)
        if one.owner is None:
            if not isinstance(one, Constant):
                return False
            continue
        pattern = getattr(one.owner.op, "connection_pattern", None)
        counts = pattern(one.owner) if pattern else [[True] * len(one.owner.outputs)] * len(one.owner.inputs)
        waiting += [x for x, row in zip(one.owner.inputs, counts, strict=True) if row[one.index]]
    return True


class Tangent(Derivative):
    """Forward mode: directions of the parameters come last."""

    takes_directions = True

    @property
    def n_linear(self):
        return self.n_parameters


class ResponseGradient(Gradient):
    """Gradient of sum_jk W_jk y_jk; the last input is W (sensor, time)."""

    kernel_name = "response_gradient"
    more_signature = "(s,u)"

    def transpose(self, inputs, cotangents):
        return [self.like(ResponseTangent)(*inputs, *cotangents)]


class ResponseTangent(Tangent):
    """Derivative (sensor, time) of the response along a direction."""

    kernel_name = "response_tangent"
    more_signature = "parameters"
    output_signature = "(s,u)"

    def output_variables(self, common):
        shape = self.static_n_sensors(common), self.static_n_outputs(common)
        return [pt.tensor(dtype="float64", shape=shape)]

    def infer_shape(self, node, shapes):
        return [(shapes[self.at("sensors")][0], self.symbolic_n_outputs(node, shapes))]

    def transpose(self, inputs, cotangents):
        return gradient_op(self, ResponseGradient, inputs)(*inputs, *cotangents, return_list=True)


class NoGradient(Op):
    """Its input, unchanged; a gradient raises `NotDifferentiableError`.

    No `ViewOp`, which PyTensor removes before a gradient is taken; this one goes when a graph is compiled.
    """

    __props__ = ("reason",)
    view_map = {0: [0]}

    def __init__(self, reason: str):
        self.reason = reason

    def make_node(self, x):
        return Apply(self, [x], [x.type()])

    def perform(self, node, inputs, output_storage):
        output_storage[0][0] = inputs[0]

    def infer_shape(self, node, shapes):
        return shapes

    def pullback(self, inputs, outputs, cotangents):
        raise NotDifferentiableError(self.reason)


@_vectorize_node.register(NoGradient)
def vectorize_no_gradient(op, node, batched):
    """Do without a gradient of a batch."""
    return [op(batched)]


@register_specialize
@node_rewriter([NoGradient])
def local_remove_no_gradient(fgraph, node):
    """Samplers have been told; the compiled function need not know."""
    return [node.inputs[0]]
