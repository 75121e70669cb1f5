"""Bands of frequency: which Fourier coefficients of a record lie in them, and their transforms."""

from typing import NamedTuple

import numpy as np
import pytensor.tensor as pt
from numpy.typing import ArrayLike
from pytensor.gradient import disconnected_type
from pytensor.graph.basic import Apply

from pymc_features._checks import as_numbers, check_finite, message, require
from pymc_features.ops.arrays import ArrayOp
from pymc_features.ops.batches import take_batches
from pymc_features.ops.numba_dispatch import run_in_python
from pymc_features.simulators.spectra import MULTIPLE

FEWEST = 8  # frequencies of a band


class Bands(NamedTuple):
    """Coefficients of the Fourier transform of a record, one band after the other.

    Attributes
    ----------
    limits : array (b, 2)
        Of each band [Hz], ascending.
    bins : array of int (k,)
        Numbers of the coefficients; those of a band are filled up to a multiple of eight.
    weights : array (k,)
        1, or 0 for those that only fill up.
    gains : array (k,)
        |2 pi i f_k|^(-q), where q times the integral of the acceleration was measured.
    starts : array of int (b + 1,)
        Where each band begins, and the last one ends.
    n_samples : int
    dt : float
        Sampling interval [s].
    """

    limits: np.ndarray
    bins: np.ndarray
    weights: np.ndarray
    gains: np.ndarray
    starts: np.ndarray
    n_samples: int
    dt: float

    @property
    def frequencies(self) -> np.ndarray:
        """Return the frequencies of the coefficients [Hz], (k,)."""
        return self.bins / (self.n_samples * self.dt)


def checked_bands(bands: ArrayLike, n_samples: int, dt: float, integrals: int) -> Bands:
    """The coefficients of a record in bands (b, 2) [Hz]; `integrals` is q of `Bands`."""
    limits = as_numbers(bands, "bands", "Pass pairs of frequencies in Hz.")
    if limits.ndim == 1:
        limits = limits[None]
    are_pairs = limits.ndim == 2 and limits.shape[1] == 2 and len(limits)
    require(are_pairs, message("bands", "pairs of frequencies (band, 2)", limits.shape))
    check_finite(limits, "bands")
    limits = limits[np.argsort(limits[:, 0])].astype(np.float64)
    nyquist, duration = 0.5 / dt, n_samples * dt
    low, high = limits.T
    expected = f"ascending pairs between 0 and {nyquist:.4g} Hz, half the sampling rate"
    are_inside = np.all((low > 0.0) & (high < nyquist) & (low < high))
    require(are_inside, message("bands", expected, limits.tolist()))
    advice = "A frequency counts once: join bands that overlap."
    require(np.all(low[1:] > high[:-1]), message("bands", "apart", limits.tolist(), advice))
    bins, weights, starts = [], [], [0]
    for first, last in limits:
        own = np.arange(int(np.ceil(first * duration)), int(np.floor(last * duration)) + 1)
        apart = f"The frequencies of a record of {duration:.4g} s are {1.0 / duration:.3g} Hz apart:"
        advice = f"{apart} take a longer record, or a wider band."
        what, got = f"bands with {FEWEST} frequencies", f"{own.size} between {first:g} and {last:g} Hz"
        require(own.size >= FEWEST, message("bands", f"{what} of the record", got, advice))
        fill = -own.size % MULTIPLE
        bins += [own, np.full(fill, own[-1])]
        weights += [np.ones(own.size), np.zeros(fill)]
        starts.append(starts[-1] + own.size + fill)
    bins, weights = np.concatenate(bins), np.concatenate(weights)
    gains = (2.0 * np.pi * bins / duration) ** -integrals
    return Bands(limits, bins, weights, gains, np.array(starts), int(n_samples), float(dt))


def transfer_functions(natural, ratios, frequencies) -> np.ndarray:
    """h (k, m) from unit modal forces to accelerations, for k frequencies [Hz] of the forces, all above zero.

    h_kr = 1 / (1 - beta^2 - 2 i zeta_r beta) with beta = f_r / f_k: that of `AmbientResponse` with q = 0.
    """
    beta = natural / np.asarray(frequencies)[:, None]
    return 1.0 / (1.0 - beta**2 - 2j * ratios * beta)


class BandTransform(ArrayOp):
    """Scaled Fourier transforms (..., s, 2, k) of histories (..., s, t) at the frequencies of all bands.

    F_k = sqrt(2 dt / t) sum_j y_j exp(-2 pi i j k / t), so that E|F_k|^2 is the one-sided spectral density.
    With `back` the transpose: histories with these transforms, times dt.
    """

    __props__ = ("back",)
    n_connected = 1

    def __init__(self, back: bool = False):
        self.back = back

    def make_node(self, values, bins, weights, dt, n_samples):
        values, weights, dt = (pt.as_tensor_variable(x).astype("float64") for x in (values, weights, dt))
        bins, n_samples = (pt.as_tensor_variable(x).astype("int64") for x in (bins, n_samples))
        shape = (
            (*values.type.shape[:-2], None) if self.back else (*values.type.shape[:-1], 2, *bins.type.shape)
        )
        inputs = [values, bins, weights, dt, n_samples]
        return Apply(self, inputs, [pt.tensor(dtype="float64", shape=shape)])

    def run(self, inputs) -> tuple[np.ndarray]:
        """Results for arrays."""
        return (band_histories(*inputs) if self.back else band_transform(*inputs[:-1]),)

    def infer_shape(self, node, shapes):
        rows = shapes[0][: -2 if self.back else -1]
        return [(*rows, node.inputs[-1]) if self.back else (*rows, 2, shapes[1][0])]

    def pullback(self, inputs, outputs, cotangents):
        """By the transpose."""
        slope = BandTransform(not self.back)(cotangents[0], *inputs[1:])
        return [slope, *(disconnected_type() for _ in inputs[1:])]


take_batches(BandTransform, first=1)
run_in_python(BandTransform)


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
