"""A value that samplers must not differentiate."""

from pytensor.compile.ops import ViewOp
from pytensor.graph.replace import _vectorize_node


class NotDifferentiableError(RuntimeError):
    """A gradient was asked of what has none.

    Not a `NotImplementedError`: PyMC answers that one by a silent change to Metropolis or Slice.
    """


class NoGradient(ViewOp):
    """Its input, unchanged; a gradient raises `NotDifferentiableError`."""

    __props__ = ("reason",)

    def __init__(self, reason: str):
        super().__init__()
        self.reason = reason

    def pullback(self, inputs, outputs, cotangents):
        raise NotDifferentiableError(self.reason)


@_vectorize_node.register(NoGradient)
def vectorize_no_gradient(op, node, batched):
    """The same for a batch."""
    return [op(batched)]
