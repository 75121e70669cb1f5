"""Averaged spectra of channels against each other."""

from typing import NamedTuple

import numpy as np

SEGMENTS = 20  # of the record, half over each other


class Spectra(NamedTuple):
    """Spectra that are averaged over twenty parts of a record, half over each other (Welch, Hann windows).

    Attributes
    ----------
    frequencies : array (k,)
        [Hz]
    matrices : array (k, s, s)
        Of all channels against each other, one-sided [unit^2/Hz].
    length : int
        Samples of a part.
    """

    frequencies: np.ndarray
    matrices: np.ndarray
    length: int

    @property
    def singular_values(self) -> np.ndarray:
        """Singular values of the matrices, largest first (k, s) [unit^2/Hz]."""
        return np.linalg.eigvalsh(self.matrices)[:, ::-1].clip(min=0.0)


def averaged_spectra(values: np.ndarray, dt: float) -> Spectra:
    """Spectra of channels (s, t) without gaps."""
    from scipy import signal  # a second to import

    length = min(values.shape[1], 2 * values.shape[1] // (SEGMENTS + 1))
    f, _ = signal.welch(values[0], 1.0 / dt, nperseg=length)
    rows = [[signal.csd(a, b, 1.0 / dt, nperseg=length)[1] for b in values] for a in values]
    return Spectra(f, np.array(rows).transpose(2, 0, 1), length)
