"""Ops of the Fourier transforms of channels at the frequencies of bands, and their transposes."""

import numpy as np
import pytensor.tensor as pt
from pytensor.gradient import disconnected_type
from pytensor.graph.basic import Apply
from pytensor.graph.op import Op
from pytensor.graph.replace import _vectorize_node

from pymc_features.ops.population import without_unit_batch


class BandTransform(Op):
    """Scaled Fourier transforms (..., s, 2, k) of histories (..., s, t) at the frequencies of all bands.

    F_k = sqrt(2 dt / t) sum_j y_j exp(-2 pi i j k / t), so that E|F_k|^2 is the one-sided spectral density.
    """

    __props__ = ()

    def make_node(self, histories, bins, weights, dt):
        histories, weights, dt = (
            pt.as_tensor_variable(x).astype("float64") for x in (histories, weights, dt)
        )
        bins = pt.as_tensor_variable(bins).astype("int64")
        shape = (*histories.type.shape[:-1], 2, bins.type.shape[0])
        return Apply(self, [histories, bins, weights, dt], [pt.tensor(dtype="float64", shape=shape)])

    def perform(self, node, inputs, output_storage):
        [output_storage[0][0]] = self.run(inputs)

    def run(self, inputs) -> tuple[np.ndarray]:
        """Transforms of arrays."""
        return (band_transform(*inputs),)

    def infer_shape(self, node, shapes):
        return [(*shapes[0][:-1], 2, shapes[1][0])]

    def connection_pattern(self, node):
        """Histories count."""
        return [[True], [False], [False], [False]]

    def pullback(self, inputs, outputs, cotangents):
        """By `BandHistories`, its transpose."""
        histories, *lines = inputs
        slope = BandHistories()(cotangents[0], *lines, histories.shape[-1])
        return [slope, *(disconnected_type() for _ in lines)]


class BandHistories(Op):
    """Transpose of `BandTransform`: histories (..., s, t) with these transforms, times dt."""

    __props__ = ()

    def make_node(self, spectra, bins, weights, dt, n_samples):
        spectra, weights, dt = (pt.as_tensor_variable(x).astype("float64") for x in (spectra, weights, dt))
        bins, n_samples = (pt.as_tensor_variable(x).astype("int64") for x in (bins, n_samples))
        shape = (*spectra.type.shape[:-2], None)
        inputs = [spectra, bins, weights, dt, n_samples]
        return Apply(self, inputs, [pt.tensor(dtype="float64", shape=shape)])

    def perform(self, node, inputs, output_storage):
        [output_storage[0][0]] = self.run(inputs)

    def run(self, inputs) -> tuple[np.ndarray]:
        """Histories from arrays."""
        return (band_histories(*inputs),)

    def infer_shape(self, node, shapes):
        return [(*shapes[0][:-2], node.inputs[-1])]

    def connection_pattern(self, node):
        """Transforms count."""
        return [[True], [False], [False], [False], [False]]

    def pullback(self, inputs, outputs, cotangents):
        """By `BandTransform`."""
        slope = BandTransform()(cotangents[0], *inputs[1:4])
        return [slope, *(disconnected_type() for _ in inputs[1:])]


@_vectorize_node.register(BandTransform)
@_vectorize_node.register(BandHistories)
def vectorize_transform(op, node, first, *others):
    """The leading dimensions are a batch as they are."""
    others = [without_unit_batch(x, old.ndim) for x, old in zip(others, node.inputs[1:], strict=True)]
    if any(x.ndim != old.ndim for x, old in zip(others, node.inputs[1:], strict=True)):
        raise NotImplementedError("the bands are the same for all particles")
    return [op(first, *others)]


def band_transform(histories, bins, weights, dt) -> np.ndarray:
    """`BandTransform` of arrays."""
    found = np.fft.rfft(histories, axis=-1)[..., bins] * (weights * np.sqrt(2.0 * dt / histories.shape[-1]))
    return np.stack([found.real, found.imag], axis=-2)


def band_histories(spectra, bins, weights, dt, n_samples) -> np.ndarray:
    """`BandHistories` of arrays."""
    n = int(n_samples)
    size = np.sqrt(2.0 * dt / n) * n / 2.0
    whole = np.zeros((*spectra.shape[:-2], n // 2 + 1), dtype=np.complex128)
    used = weights > 0.0  # each frequency once
    whole[..., bins[used]] = size * (spectra[..., 0, used] + 1j * spectra[..., 1, used])
    return np.fft.irfft(whole, n, axis=-1)
