"""A value that samplers must not differentiate."""

from pytensor.graph.basic import Apply
from pytensor.graph.op import Op
from pytensor.graph.replace import _vectorize_node
from pytensor.graph.rewriting.basic import node_rewriter
from pytensor.tensor.rewriting.basic import register_specialize

from pymc_features.exceptions import NotDifferentiableError


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
