"""Spectral densities of forces that nobody measured, brought to the modes."""

import numpy as np
import pytensor.tensor as pt
from pytensor.graph.basic import Apply
from pytensor.graph.op import Op
from pytensor.graph.replace import _vectorize_node
from pytensor.tensor.variable import TensorVariable

from pymc_features._checks import message
from pymc_features.ops.gradient import undefined


def in_bands(value: TensorVariable, name: str, n_bands: int, columns: int | None, what: str):
    """A tensor (b, columns) from one number, one for each band, or one for each band and column."""
    expected = f"one value, one for each of the {n_bands} bands, or (band, {what})"
    shape = value.type.shape
    if value.ndim > 2 or (value.ndim and shape[0] not in (None, 1, n_bands)):
        raise ValueError(message(name, expected, shape))
    if value.ndim == 2 and columns is not None and shape[1] not in (None, 1, columns):
        raise ValueError(message(name, expected, shape, f"There are {columns} columns."))
    if value.ndim < 2:
        value = value[..., None]
    return pt.broadcast_to(value, (n_bands, columns))


def modal_factor(patterns: TensorVariable, density: TensorVariable) -> TensorVariable:
    """L (b, m, r, 2) with L L' = P diag(S) P', for patterns P (m, r) and spectral densities S (b, r).

    Of more forces than modes, L is the Cholesky factor (b, m, m).
    """
    m, r = patterns.type.shape
    if m is None or r is None or r <= m:
        factor = patterns[None] * pt.sqrt(density)[:, None, :]
    else:
        factor = ModalFactor()(patterns, density)
    return pt.stack([factor, pt.zeros_like(factor)], axis=-1)


class ModalFactor(Op):
    """Cholesky factors L (..., b, m, m) of P diag(S) P' for P (..., m, r) and S (..., b, r).

    NaN where there is none. PyTensor's own `cholesky` raises there, and its gradient is a dozen Ops.
    """

    __props__ = ()

    def make_node(self, patterns, density):
        patterns, density = (pt.as_tensor_variable(x).astype("float64") for x in (patterns, density))
        m = patterns.type.shape[-2]
        rows = (None,) * (max(patterns.ndim, density.ndim) - 2)
        shape = (*rows, density.type.shape[-2], m, m)
        return Apply(self, [patterns, density], [pt.tensor(dtype="float64", shape=shape)])

    def perform(self, node, inputs, output_storage):
        [output_storage[0][0]] = self.run(inputs)

    def run(self, inputs) -> tuple[np.ndarray]:
        """The factors for arrays."""
        patterns, density = inputs
        return (lower_factors((patterns[..., None, :, :] * density[..., None, :]) @ turned(patterns)),)

    def infer_shape(self, node, shapes):
        patterns, density = shapes
        rows = pt.broadcast_shape(patterns[:-2], density[:-2], arrays_are_shapes=True)
        return [(*rows, density[-2], patterns[-2], patterns[-2])]

    def pullback(self, inputs, outputs, cotangents):
        """By `ModalFactorGradient`."""
        return ModalFactorGradient()(*inputs, *outputs, *cotangents, return_list=True)


class ModalFactorGradient(Op):
    """Gradients by P and S, from these, L and the cotangent of L; each of the shape of its row of inputs."""

    __props__ = ()

    def make_node(self, patterns, density, factor, cotangent):
        rows = (None,) * (factor.ndim - 3)
        outputs = [pt.tensor(dtype="float64", shape=(*rows, *x.type.shape[-2:])) for x in (patterns, density)]
        return Apply(self, [patterns, density, factor, cotangent], outputs)

    def perform(self, node, inputs, output_storage):
        for storage, result in zip(output_storage, self.run(inputs), strict=True):
            storage[0] = result

    def run(self, inputs) -> tuple[np.ndarray, np.ndarray]:
        """Murray, arXiv:1602.07527, Eq. (10), for A = P diag(S) P'."""
        patterns, density, factor, cotangent = inputs
        inner = np.tril(factor.swapaxes(-1, -2) @ cotangent)
        inner *= 1.0 - 0.5 * np.eye(factor.shape[-1])
        inverse = inverted(factor)
        of_a = inverse.swapaxes(-1, -2) @ inner @ inverse
        of_a = 0.5 * (of_a + of_a.swapaxes(-1, -2))
        moved = of_a @ patterns[..., None, :, :]
        of_patterns = 2.0 * (moved * density[..., None, :]).sum(axis=-3)
        return of_patterns, (moved * patterns[..., None, :, :]).sum(axis=-2)

    def infer_shape(self, node, shapes):
        rows = tuple(shapes[2][:-3])
        return [(*rows, *shapes[0][-2:]), (*rows, *shapes[1][-2:])]

    def pullback(self, inputs, outputs, cotangents):
        """No second derivatives."""
        return [undefined(self, inputs, i) for i in range(4)]


@_vectorize_node.register(ModalFactor)
@_vectorize_node.register(ModalFactorGradient)
def vectorize_factor(op, node, *inputs):
    """The leading dimensions are a batch as they are."""
    return op.make_node(*inputs).outputs


def turned(patterns):
    """P', with an axis for bands."""
    return patterns.swapaxes(-1, -2)[..., None, :, :]


def lower_factors(matrices) -> np.ndarray:
    """Cholesky factors; NaN of a matrix that is not positive."""
    try:
        return np.linalg.cholesky(matrices)
    except np.linalg.LinAlgError:
        factors = np.full(matrices.shape, np.nan)
        for i in np.ndindex(matrices.shape[:-2]):
            try:
                factors[i] = np.linalg.cholesky(matrices[i])
            except np.linalg.LinAlgError:
                continue
        return factors


def inverted(factors) -> np.ndarray:
    """Inverses; NaN where the factors are."""
    found = np.full(factors.shape, np.nan)
    good = np.isfinite(factors).all(axis=(-1, -2))
    found[good] = np.linalg.inv(factors[good])
    return found
