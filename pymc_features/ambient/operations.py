"""Ops of the spectral likelihood: its value and gradient, and the factor of the spectra of forces."""

import numpy as np
import pytensor.tensor as pt
from pytensor.gradient import disconnected_type
from pytensor.graph.basic import Apply
from pytensor.graph.rewriting.basic import node_rewriter
from pytensor.tensor.rewriting.basic import register_specialize

from pymc_features.ops.arrays import ArrayOp, RowOp
from pymc_features.ops.batches import take_batches
from pymc_features.ops.gradient import undefined
from pymc_features.ops.numba_dispatch import run_in_python
from pymc_features.simulators.spectra import Lines, SpectralParameters, spectral_gradient, spectral_logp

NDIMS = 1, 1, 2, 4, 2, 3  # of `SpectralParameters`
N = len(NDIMS)


class SpectralOp(RowOp):
    """Base: `SpectralParameters`, then the arrays of `Lines`.

    Parameters
    ----------
    of_spectra : bool
        Whether the transforms depend on parameters.
    """

    __props__ = ("of_spectra",)
    ndims, n_connected = NDIMS, N

    def __init__(self, of_spectra: bool = False):
        self.of_spectra = of_spectra

    def make_node(self, *inputs):
        inputs = [pt.as_tensor_variable(x) for x in inputs]
        inputs = [*(x.astype("float64") for x in inputs[:-1]), inputs[-1].astype("int64")]
        return Apply(self, inputs, self.outputs(inputs))

    def of_rows(self, rows, lines, n) -> list[np.ndarray]:
        """The log-likelihoods (n,) and slopes of parameters with a row for each particle, or one for all."""
        rows, lines = ([np.require(x, requirements=["C", "W"]) for x in arrays] for arrays in (rows, lines))
        results = [np.empty(n), *(np.zeros((n, *x.shape[1:])) for x in rows[: self.n_slopes])]
        self.write(SpectralParameters(*rows), Lines(*lines), *results)
        return results


class SpectralLogp(SpectralOp):
    """Log-likelihood of the transforms in all bands."""

    simulates = True
    write = staticmethod(spectral_logp)

    def pullback(self, inputs, outputs, cotangents):
        """By `SpectralGradient`, which is evaluated once for all."""
        _, *slopes = SpectralGradient(self.of_spectra)(*inputs, return_list=True)
        gradients = self.pulled_back(cotangents[0], inputs, slopes)
        if not self.of_spectra:
            gradients.insert(N - 1, undefined(self, inputs, N - 1))
        return gradients


class SpectralGradient(SpectralOp):
    """The log-likelihood, and its gradient by each of the parameters; by the transforms if `of_spectra`."""

    @property
    def n_slopes(self) -> int:
        """Number of parameters by which the gradient is wanted."""
        return N if self.of_spectra else N - 1

    def write(self, parameters, lines, logp, *slopes):
        """Write the results."""
        none = [] if self.of_spectra else [np.zeros((0, *parameters.spectra.shape[1:]))]
        spectral_gradient(parameters, lines, logp, SpectralParameters(*slopes, *none))

    def pullback(self, inputs, outputs, cotangents):
        """No second derivatives."""
        return [*(undefined(self, inputs, i) for i in range(N)), *(disconnected_type() for _ in inputs[N:])]


take_batches(SpectralLogp, SpectralGradient, first=N)
run_in_python(SpectralLogp, SpectralGradient)


@register_specialize
@node_rewriter([SpectralLogp])
def local_value_with_gradient(fgraph, node):
    """Return the log-likelihood that comes with the gradient, where that is evaluated."""
    for client, _ in fgraph.clients[node.inputs[0]]:
        if isinstance(client.op, SpectralGradient) and client.inputs == node.inputs:
            return [client.outputs[0]]
    return None


class ModalFactor(ArrayOp):
    """Cholesky factors L (..., b, m, m) of P diag(S) P' for P (..., m, r) and S (..., b, r).

    NaN where there is none. The gradient of PyTensor's own `cholesky` takes Numba a minute to compile.
    """

    def make_node(self, patterns, density):
        patterns, density = (pt.as_tensor_variable(x).astype("float64") for x in (patterns, density))
        m = patterns.type.shape[-2]
        rows = (None,) * (max(patterns.ndim, density.ndim) - 2)
        shape = (*rows, density.type.shape[-2], m, m)
        return Apply(self, [patterns, density], [pt.tensor(dtype="float64", shape=shape)])

    def run(self, inputs) -> tuple[np.ndarray]:
        """The factors for arrays."""
        patterns, density = inputs
        patterns = patterns[..., None, :, :]
        return (lower_factors((patterns * density[..., None, :]) @ patterns.swapaxes(-1, -2)),)

    def infer_shape(self, node, shapes):
        patterns, density = shapes
        rows = pt.broadcast_shape(patterns[:-2], density[:-2], arrays_are_shapes=True)
        return [(*rows, density[-2], patterns[-2], patterns[-2])]

    def pullback(self, inputs, outputs, cotangents):
        """By `ModalFactorGradient`."""
        return ModalFactorGradient()(*inputs, *outputs, *cotangents, return_list=True)


class ModalFactorGradient(ArrayOp):
    """Gradients by P and S, from these, L and the cotangent of L; each of the shape of its row of inputs."""

    def make_node(self, patterns, density, factor, cotangent):
        rows = (None,) * (factor.ndim - 3)
        outputs = [pt.tensor(dtype="float64", shape=(*rows, *x.type.shape[-2:])) for x in (patterns, density)]
        return Apply(self, [patterns, density, factor, cotangent], outputs)

    def run(self, inputs) -> tuple[np.ndarray, np.ndarray]:
        """Murray, arXiv:1602.07527, Eq. (10), for A = P diag(S) P'."""
        patterns, density, factor, cotangent = inputs
        inner = np.tril(factor.swapaxes(-1, -2) @ cotangent)
        inner *= 1.0 - 0.5 * np.eye(factor.shape[-1])
        inverse = np.full(factor.shape, np.nan)
        good = np.isfinite(factor).all(axis=(-1, -2))
        inverse[good] = np.linalg.inv(factor[good])
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


take_batches(ModalFactor, ModalFactorGradient)
run_in_python(ModalFactor, ModalFactorGradient)


def lower_factors(matrices) -> np.ndarray:
    """Cholesky factors; NaN of a matrix that is not positive."""
    try:
        return np.linalg.cholesky(matrices)
    except np.linalg.LinAlgError:
        if matrices.ndim == 2:
            return np.full(matrices.shape, np.nan)
        return np.array([lower_factors(some) for some in matrices])
