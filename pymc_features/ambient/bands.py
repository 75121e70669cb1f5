"""Bands of frequency: which Fourier coefficients of a record lie in them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pymc_features._checks import as_numbers, check_finite, message
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
    if limits.ndim != 2 or limits.shape[1] != 2 or not len(limits):
        raise ValueError(message("bands", "pairs of frequencies (band, 2)", limits.shape))
    check_finite(limits, "bands")
    limits = limits[np.argsort(limits[:, 0])].astype(np.float64)
    nyquist, duration = 0.5 / dt, n_samples * dt
    low, high = limits.T
    if np.any(low <= 0.0) or np.any(high >= nyquist) or np.any(low >= high):
        expected = f"ascending pairs between 0 and {nyquist:.4g} Hz, half the sampling rate"
        raise ValueError(message("bands", expected, limits.tolist()))
    if np.any(low[1:] <= high[:-1]):
        raise ValueError(
            message("bands", "apart", limits.tolist(), "A frequency counts once: join bands that overlap.")
        )
    bins, weights, starts = [], [], [0]
    for first, last in limits:
        own = np.arange(int(np.ceil(first * duration)), int(np.floor(last * duration)) + 1)
        if own.size < FEWEST:
            advice = (
                f"The frequencies of a record of {duration:.4g} s are {1.0 / duration:.3g} Hz apart: "
                "take a longer record, or a wider band."
            )
            got = f"{own.size} between {first:g} and {last:g} Hz"
            raise ValueError(message("bands", f"bands with {FEWEST} frequencies of the record", got, advice))
        fill = -own.size % MULTIPLE
        bins += [own, np.full(fill, own[-1])]
        weights += [np.ones(own.size), np.zeros(fill)]
        starts.append(starts[-1] + own.size + fill)
    bins, weights = np.concatenate(bins), np.concatenate(weights)
    gains = (2.0 * np.pi * bins / duration) ** -integrals
    return Bands(limits, bins, weights, gains, np.array(starts), int(n_samples), float(dt))
