"""What the kernels of the spectral likelihood take."""

from typing import NamedTuple

import numpy as np

MULTIPLE = 8  # frequencies of a band are filled up to a multiple of this, with the weight zero


class Lines(NamedTuple):
    """Frequencies of all bands, one band after the other.

    Attributes
    ----------
    frequencies : array (k,)
        f_k [Hz]; the number in each band is a multiple of `MULTIPLE`.
    weights : array (k,)
        1, or 0 for those that only fill up.
    gains : array (k,)
        |2 pi i f_k|^(-q), the size of what was measured of a unit acceleration.
    starts : array of int (b + 1,)
        Where each band begins, and the last one ends.
    """

    frequencies: np.ndarray
    weights: np.ndarray
    gains: np.ndarray
    starts: np.ndarray


class SpectralParameters(NamedTuple):
    """Parameters of one structure under unmeasured forces; of a population, with an axis in front.

    Attributes
    ----------
    natural : array (m,)
        Natural frequencies f_r [Hz].
    ratios : array (m,)
        Damping ratios zeta_r [-].
    shapes : array (m, s)
        Rows are the mode shapes at the sensors.
    factor : array (b, m, r, 2)
        L in each band, real and imaginary parts: L L^* is the spectral density S of the modal forces.
    error : array (b, s)
        S_e of each channel in each band [unit^2/Hz].
    spectra : array (s, 2, k)
        Real and imaginary parts of the transforms, zero where the weight is zero.
    """

    natural: np.ndarray
    ratios: np.ndarray
    shapes: np.ndarray
    factor: np.ndarray
    error: np.ndarray
    spectra: np.ndarray


class Scratch(NamedTuple):
    """Memory of one block of frequencies, a row for each number; complex ones take two.

    Attributes
    ----------
    g : array (m, m)
        G of the band.
    h : array (2 m, LANES)
    b, gb : array (2 m r, LANES)
        B and G B.
    u : array (2 m, LANES)
    k : array (2 r r, LANES)
        K, then its Cholesky factor, then (of gradients) N = K^-1 + w w^*.
    v : array (2 r, LANES)
        v, then its solution with the factor, then (of gradients) w = K^-1 v.
    """

    g: np.ndarray
    h: np.ndarray
    b: np.ndarray
    gb: np.ndarray
    u: np.ndarray
    k: np.ndarray
    v: np.ndarray
