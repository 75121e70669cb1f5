"""What a table keeps of the record and the data: their correlations.

Multiplied by any row b[k], the state x[k] = E x[k-1] + a[k] is a polynomial in E = exp(lambda h),

    sum_k b[k] x[k] = sum_l E^l R[l],   R[l] = sum_k b[k] a[k - l],

and with that

    sum_k b[k] v[k] = (phi1^2 / E) sum_l E^l R[l] - (rho / E) R[0] - phi2 a[0] sum_l E^l b[l].

The rows are the data g_j, the inputs a_i, and a one at the last sample, which gives v[N-1]. The last term is
that of an input of one at the first sample.
"""

from typing import NamedTuple

import numpy as np
from scipy import fft


class Sums(NamedTuple):
    """Of data (s, N) and inputs (d, N).

    Attributes
    ----------
    squares : array (s,)
        g'g.
    products : array (s, d)
        g'a.
    inputs : array (d, d)
        a'a.
    first, last : array (d,)
        a[0] and a[N-1].
    """

    squares: np.ndarray
    products: np.ndarray
    inputs: np.ndarray
    first: np.ndarray
    last: np.ndarray


class Correlations(NamedTuple):
    """Of data (s, N) and inputs (d, N).

    Attributes
    ----------
    step : float
        h [s].
    lags : array (d or d + 1, s + d + 1, N)
        R of each input, and where an input does not begin with zero, of a one at the first sample.
    sums : Sums
    """

    step: float
    lags: np.ndarray
    sums: Sums


def correlations(data: np.ndarray, inputs: np.ndarray, step: float) -> Correlations:
    """Correlate data (s, N) and inputs (d, N), both at the steps of the recursion."""
    n_times = data.shape[1]
    impulse = np.zeros((1, n_times))
    impulse[0, -1] = 1.0
    rows, size = np.concatenate([data, inputs, impulse]), fft.next_fast_len(2 * n_times, real=True)
    starts = bool(inputs[:, 0].any())
    lags = np.empty((len(inputs) + starts, len(rows), n_times))
    spectra = [np.conj(fft.rfft(a, size)) for a in inputs]
    for f, row in enumerate(rows):
        spectrum = fft.rfft(row, size)
        for i, other in enumerate(spectra):
            lags[i, f] = fft.irfft(spectrum * other, size)[:n_times]
        if starts:
            lags[-1, f] = row
    lags[: len(inputs), :, 0] = np.einsum("dt,ft->df", inputs, rows)
    sums = Sums(
        squares=np.einsum("st,st->s", data, data),
        products=np.ascontiguousarray(lags[: len(inputs), : len(data), 0].T),
        inputs=np.ascontiguousarray(lags[: len(inputs), len(data) : -1, 0]),
        first=inputs[:, 0].copy(),
        last=inputs[:, -1].copy(),
    )
    return Correlations(step, lags, sums)
