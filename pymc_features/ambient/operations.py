"""Ops of the spectral likelihood: its value and gradient, and the factor of the spectra of forces."""

import numpy as np
import pytensor.tensor as pt
from pytensor.gradient import disconnected_type
from pytensor.graph.basic import Apply
from pytensor.graph.op import Op
from pytensor.graph.replace import _vectorize_node
from pytensor.graph.rewriting.basic import node_rewriter
from pytensor.tensor.blockwise import Blockwise
from pytensor.tensor.rewriting.basic import register_specialize

from pymc_features.ops.gradient import undefined
from pymc_features.ops.population import as_rows, take_batches, without_unit_batch
from pymc_features.simulators.spectra import (
    Lines,
    SpectralParameters,
    spectral_gradient,
    spectral_logp,
)

NDIMS = 1, 1, 2, 4, 2, 3  # of `SpectralParameters`
CORE = "(m),(m),(m,s),(b,m,r,c),(b,s),(s,c,k),(k),(k),(k),(e)"
N, N_LINES = len(NDIMS), len(Lines._fields)
LAST = N + N_LINES - 1


class SpectralOp(Op):
    """Base: `SpectralParameters`, then the arrays of `Lines`.

    Parameters
    ----------
    of_spectra : bool
        Whether the transforms depend on parameters.
    batched : bool
        Whether each parameter has a row for each particle, or one for all.
    """

    __props__ = ("of_spectra", "batched")

    def __init__(self, of_spectra: bool = False, batched: bool = False):
        self.of_spectra, self.batched = of_spectra, batched

    def prepare(self, inputs):
        """Cast inputs, and check their numbers of dimensions."""
        inputs = [pt.as_tensor_variable(x) for x in inputs]
        ndims = [ndim + self.batched for ndim in NDIMS] + [1] * N_LINES
        if [x.ndim for x in inputs] != ndims:
            raise ValueError(f"inputs must have {ndims} dimensions, got {[x.ndim for x in inputs]}.")
        return [x.astype("int64" if i == LAST else "float64") for i, x in enumerate(inputs)]

    def arguments(self, arrays) -> tuple[SpectralParameters, Lines, int]:
        """Arguments of the kernels, and the number of particles."""
        arrays = [np.require(x, requirements=["C", "W"]) for x in arrays]
        parameters = arrays[:N] if self.batched else [x[None] for x in arrays[:N]]
        rows = max(len(x) for x in parameters)
        return SpectralParameters(*parameters), Lines(*arrays[N:]), rows

    def rows(self, shapes):
        """Number of particles, from shapes of inputs, as a tuple; empty for one particle."""
        if not self.batched:
            return ()
        most = shapes[0][0]
        for shape in shapes[1:N]:
            most = pt.maximum(most, shape[0])
        return (most,)

    def perform(self, node, inputs, output_storage):
        for storage, result in zip(output_storage, self.run(inputs), strict=True):
            storage[0] = result

    def connection_pattern(self, node):
        """Parameters count, lines do not."""
        return [[i < N] * len(node.outputs) for i in range(len(node.inputs))]


class SpectralLogp(SpectralOp):
    """Log-likelihood of the transforms in all bands."""

    simulates = True

    @property
    def gufunc_signature(self):
        """Return the shapes of one particle; a population Op is never wrapped."""
        return None if self.batched else f"{CORE}->()"

    def make_node(self, *inputs):
        return Apply(self, self.prepare(inputs), [pt.tensor(dtype="float64", shape=(None,) * self.batched)])

    def infer_shape(self, node, shapes):
        return [self.rows(shapes)]

    def run(self, inputs) -> tuple[np.ndarray]:
        """The log-likelihoods for arrays."""
        parameters, lines, rows = self.arguments(inputs)
        logp = np.empty(rows)
        spectral_logp(parameters, lines, logp)
        return (logp if self.batched else logp[0],)

    def pullback(self, inputs, outputs, cotangents):
        """By `SpectralGradient`, which is evaluated once for all."""
        [weight] = cotangents
        _, *slopes = SpectralGradient(self.of_spectra, self.batched)(*inputs, return_list=True)
        gradients = []
        for x, slope in zip(inputs, slopes, strict=False):
            spread = weight.dimshuffle(*range(weight.ndim), *["x"] * (slope.ndim - weight.ndim)) * slope
            shared = self.batched and x.type.broadcastable[0]
            gradients.append(spread.sum(axis=0, keepdims=True) if shared else spread)
        if not self.of_spectra:
            gradients.append(undefined(self, inputs, N - 1))
        return [*gradients, *(disconnected_type() for _ in inputs[N:])]


class SpectralGradient(SpectralOp):
    """The log-likelihood, and its gradient by each of the parameters; by the transforms if `of_spectra`."""

    @property
    def n_slopes(self) -> int:
        """Number of parameters by which the gradient is wanted."""
        return N if self.of_spectra else N - 1

    @property
    def gufunc_signature(self):
        """Return the shapes of one particle; a population Op is never wrapped."""
        slopes = ",".join(("(m)", "(m)", "(m,s)", "(b,m,r,c)", "(b,s)", "(s,c,k)")[: self.n_slopes])
        return None if self.batched else f"{CORE}->(),{slopes}"

    def make_node(self, *inputs):
        inputs = self.prepare(inputs)
        shapes = [x.type.shape[self.batched :] for x in inputs[: self.n_slopes]]
        rows = (None,) * self.batched
        return Apply(self, inputs, [pt.tensor(dtype="float64", shape=(*rows, *s)) for s in ((), *shapes)])

    def infer_shape(self, node, shapes):
        rows = self.rows(shapes)
        return [rows, *((*rows, *shape[self.batched :]) for shape in shapes[: self.n_slopes])]

    def run(self, inputs) -> tuple[np.ndarray, ...]:
        """Log-likelihoods and gradients for arrays."""
        parameters, lines, rows = self.arguments(inputs)
        logp = np.empty(rows)
        slopes = [np.zeros((rows, *x.shape[1:])) for x in parameters[: self.n_slopes]]
        none = [] if self.of_spectra else [np.zeros((0, *parameters.spectra.shape[1:]))]
        spectral_gradient(parameters, lines, logp, SpectralParameters(*slopes, *none))
        return tuple(x if self.batched else x[0] for x in (logp, *slopes))

    def pullback(self, inputs, outputs, cotangents):
        """No second derivatives."""
        return [
            *(undefined(self, inputs, i) for i in range(N)),
            *(disconnected_type() for _ in inputs[N:]),
        ]


@_vectorize_node.register(SpectralLogp)
@_vectorize_node.register(SpectralGradient)
def vectorize_spectral(op, node, *inputs):
    """Batches of parameters become one Op of the population; others are left to `Blockwise`."""
    ndims = [*NDIMS, *[1] * N_LINES]
    inputs = [without_unit_batch(x, ndim) for x, ndim in zip(inputs, ndims, strict=True)]
    if op.batched or any(x.ndim != 1 for x in inputs[N:]):
        return Blockwise(op).make_node(*inputs).outputs
    if all(x.ndim == ndim for x, ndim in zip(inputs, ndims, strict=True)):
        return op.make_node(*inputs).outputs
    rows, batch = as_rows(inputs[:N], NDIMS)
    props = {name: getattr(op, name) for name in op.__props__} | {"batched": True}
    results = type(op)(**props).make_node(*rows, *inputs[N:]).outputs
    if batch is None:
        return results
    return [x.reshape((*batch, *tuple(x.shape)[1:]), ndim=len(batch) + x.ndim - 1) for x in results]


@register_specialize
@node_rewriter([SpectralLogp])
def local_value_with_gradient(fgraph, node):
    """Return the log-likelihood that comes with the gradient, where that is evaluated."""
    for client, _ in fgraph.clients[node.inputs[0]]:
        if isinstance(client.op, SpectralGradient) and client.inputs == node.inputs:
            return [client.outputs[0]]
    return None


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


take_batches(ModalFactor, ModalFactorGradient)


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
