"""Assignment as a PyTensor Op: which model mode each measured mode takes."""

import numpy as np
import pytensor.tensor as pt
from pytensor.graph.basic import Apply
from pytensor.graph.op import Op
from pytensor.graph.replace import _vectorize_node

from pymc_features.simulators.modal.assignment import assignments


class Assignment(Op):
    """Ones where a row takes a column, each its own, at the largest total score; zeros elsewhere.

    Scores (..., row, column), with any number of leading batch dimensions and rows <= columns; -inf and NaN
    are taken last. Constant between the points where the best assignment changes: its derivative is zero.
    """

    __props__ = ()

    def make_node(self, score):
        score = pt.as_tensor_variable(score).astype("float64")
        if score.ndim < 2:
            raise ValueError(f"`score` must be (..., row, column), got {score.ndim} dimensions.")
        return Apply(self, [score], [score.type()])

    def perform(self, node, inputs, output_storage):
        [output_storage[0][0]] = self.run(inputs)

    def run(self, inputs) -> tuple[np.ndarray]:
        """The assignments of arrays."""
        [score] = inputs
        rows, columns = score.shape[-2:]
        if rows > columns:
            raise ValueError(f"an assignment must have as many columns as rows, got {columns} for {rows}.")
        cost = np.ascontiguousarray(-score).reshape(-1, rows, columns)
        return (assignments(cost).reshape(score.shape),)

    def infer_shape(self, node, shapes):
        return shapes

    def pullback(self, inputs, outputs, cotangents):
        """Zero."""
        return [pt.zeros_like(inputs[0])]


@_vectorize_node.register(Assignment)
def vectorize_assignment(op, node, score):
    """Assign a batch."""
    return [op(score)]
