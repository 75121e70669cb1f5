"""What a table keeps of the record and the data: their correlations.

Multiplied by any row b[k], the state x[k] = E x[k-1] + a[k] is a polynomial in E = exp(lambda h),

    sum_k b[k] x[k] = sum_l E^l R[l],   R[l] = sum_k b[k] a[k - l],

and with that

    sum_k b[k] v[k] = (phi1^2 / E) sum_l E^l R[l] - (rho / E) R[0] - phi2 a[0] sum_l E^l b[l].

The rows are the data g_j, the inputs a_i, and a one at the last sample, which gives v[N-1]. The last term is
that of an input of one at the first sample.

The increments v[k] - v[k-1], from sample one on, obey the recursion themselves, with the increments of the
inputs, whose first is a[0], in place of a[k], and the same, but for a sample zero that is zero and a[1] as
sample one, in place of a[k+1]. The input of one at the first sample becomes one of 1 and -1 at the first two.
So a table of them gives sums of squared increments of the misfit.
"""

from typing import NamedTuple

import numpy as np
from scipy import fft


class Sums(NamedTuple):
    """Of data (s, N) and inputs (d, N), or of their increments.

    Attributes
    ----------
    squares : array (s,)
        g'g.
    products : array (s, d)
        g'a.
    inputs, early, late : array (d, d)
        a'a of what the feed-through passes on, of a[k] without the last sample, and of a[k+1].
    first, last : array (d,)
        a[0], of what there is to take increments of, and the last sample.
    second : array (d,)
        a[1], likewise.
    kick : array (d,)
        Of increments a[0], otherwise zero: with a[k+1] in place of a[k], a'v changes by `kick` v[1].
    """

    squares: np.ndarray
    products: np.ndarray
    inputs: np.ndarray
    early: np.ndarray
    late: np.ndarray
    first: np.ndarray
    last: np.ndarray
    second: np.ndarray
    kick: np.ndarray


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


def correlations(data: np.ndarray, inputs: np.ndarray, step: float, of_increments: bool = False):
    """Correlate data (s, N) and inputs (d, N), both at the steps of the recursion, or their increments."""
    first, second = inputs[:, 0].copy(), inputs[:, 1].copy()
    if of_increments:
        data = np.diff(data, prepend=data[:, :1])
        inputs = np.diff(inputs, prepend=0.0)
    n_times = data.shape[1]
    impulse = np.zeros((1, n_times))
    impulse[0, -1] = 1.0
    rows, size = np.concatenate([data, inputs, impulse]), fft.next_fast_len(2 * n_times, real=True)
    starts = bool(first.any())
    lags = np.empty((len(inputs) + starts, len(rows), n_times))
    spectra = [np.conj(fft.rfft(a, size)) for a in inputs]
    for f, row in enumerate(rows):
        spectrum = fft.rfft(row, size)
        for i, other in enumerate(spectra):
            lags[i, f] = fft.irfft(spectrum * other, size)[:n_times]
        if starts:
            lags[-1, f] = row
            if of_increments:
                lags[-1, f, :-1] -= row[1:]
    lags[: len(inputs), :, 0] = np.einsum("dt,ft->df", inputs, rows)
    last, after = inputs[:, -1].copy(), inputs[:, 1:].copy()
    if of_increments:
        after[:, 0] = second
    sums = Sums(
        squares=np.einsum("st,st->s", data, data),
        products=np.ascontiguousarray(lags[: len(inputs), : len(data), 0].T),
        inputs=square(inputs[:, 1:] if of_increments else inputs),
        early=square(inputs[:, :-1]),
        late=square(after),
        first=first,
        last=last,
        second=second,
        kick=first if of_increments else np.zeros_like(first),
    )
    return Correlations(step, lags, sums)


def square(inputs):
    """a'a (d, d)."""
    return np.einsum("dt,et->de", inputs, inputs)
