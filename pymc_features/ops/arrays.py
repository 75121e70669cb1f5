"""Bases of Ops that are functions of arrays, of one particle or of many."""

import numpy as np
import pytensor.tensor as pt
from pytensor.gradient import disconnected_type
from pytensor.graph.op import Op


class ArrayOp(Op):
    """Base: `run` takes arrays and returns a tuple of them; the first `n_connected` inputs count, or all."""

    __props__ = ()
    n_connected: int | None = None

    def perform(self, node, inputs, output_storage):
        for storage, result in zip(output_storage, self.run(inputs), strict=True):
            storage[0] = result

    def connection_pattern(self, node):
        """Others are numbers of lines, samples and the like."""
        n = len(node.inputs) if self.n_connected is None else self.n_connected
        return [[i < n] * len(node.outputs) for i in range(len(node.inputs))]


class RowOp(ArrayOp):
    """Base of log-densities of particles, which lie along any leading dimensions of the first inputs.

    One of these without such dimensions is the same for all. `ndims` are their numbers of dimensions for one
    particle; outputs are the log-density, and gradients by the first `n_slopes` of them.
    """

    ndims: tuple[int, ...] = ()
    n_slopes = 0

    def core(self, shapes) -> list:
        """Shapes of the outputs for one particle, from those of the inputs."""
        pairs = zip(shapes, self.ndims[: self.n_slopes], strict=False)
        return [(), *(tuple(shape)[len(shape) - ndim :] for shape, ndim in pairs)]

    def outputs(self, inputs) -> list:
        """Output variables."""
        pairs = zip(inputs, self.ndims, strict=False)
        rows = (None,) * max(x.ndim - ndim for x, ndim in pairs)
        shapes = self.core([x.type.shape for x in inputs])
        return [pt.tensor(dtype="float64", shape=(*rows, *shape)) for shape in shapes]

    def infer_shape(self, node, shapes):
        pairs = zip(shapes, self.ndims, strict=False)
        rows = [tuple(shape)[: len(shape) - ndim] for shape, ndim in pairs]
        batch = pt.broadcast_shape(*rows, arrays_are_shapes=True) if any(rows) else ()
        return [(*batch, *shape) for shape in self.core(shapes)]

    def run(self, inputs) -> tuple[np.ndarray, ...]:
        """Results for arrays."""
        leading = [x.shape[: x.ndim - ndim] for x, ndim in zip(inputs, self.ndims, strict=False)]
        batch, rows = np.broadcast_shapes(*leading), []
        for x, own in zip(inputs, leading, strict=False):
            core = x.shape[len(own) :]
            rows.append(np.broadcast_to(x, (batch if own else ()) + core).reshape(-1, *core))
        results = self.of_rows(rows, inputs[len(rows) :], int(np.prod(batch, dtype=int)))
        return tuple(x.reshape((*batch, *x.shape[1:])) for x in results)

    def pulled_back(self, weight, inputs, slopes) -> list:
        """Gradients from the slopes of the log-density: sums for what all particles share."""
        gradients = []
        for x, slope in zip(inputs, slopes, strict=False):
            whole = weight.dimshuffle(*range(weight.ndim), *["x"] * (slope.ndim - weight.ndim)) * slope
            rows = tuple(range(slope.ndim - x.ndim))
            gradients.append(whole.sum(axis=rows) if rows else whole)
        return [*gradients, *(disconnected_type() for _ in inputs[self.n_connected :])]
