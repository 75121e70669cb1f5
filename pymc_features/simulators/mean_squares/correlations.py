"""What a table keeps of the record and the data: their correlations.

Multiplied by any row b[k], the state x[k] = E x[k-1] + a[k] is a polynomial in E = exp(lambda h),

    sum_k b[k] x[k] = sum_l E^l R[l],   R[l] = sum_k b[k] a[k - l],

and with that

    sum_k b[k] v[k] = (phi1^2 / E) sum_l E^l R[l] - (rho / E) R[0] - phi2 a[0] sum_l E^l b[l].

The rows are zero but at the outputs, every c-th step: the data g_j there, the phases a_i[c n + p] of the
inputs, a one at the last output, which gives v[N-1], and the inputs' own values, where they are others than
phase zero. The last term is that of an input of one at the first sample.

The increments v[n] - v[n-1] from one output to the next obey the recursion themselves, with the increments of
the phases, whose first is a[p], in place of a[c n + p], and the same, but for an output zero that is zero and
a[c] as output one, in place of a[c n + c]. The input of one at the first sample becomes one of 1 and -1 at
the first two outputs. So a table of them gives sums of squared increments of the misfit.
"""

from typing import NamedTuple

import numpy as np
from scipy import fft


class Sums(NamedTuple):
    """Of data (s, N), d inputs at every step, and their own values (d, N), or of the increments.

    Attributes
    ----------
    squares : array (s,)
        g'g.
    products : array (s, d)
        g'a with the own values, which the feed-through passes on.
    inputs : array (d, d)
        a'a of these.
    early : array (d c, d c)
        Of the phases without the last output.
    late : array (d, d)
        Of a[c n + c].
    first, last : array (d c,)
        Phases at the first output, of what there is to take increments of, and at the last one.
    second : array (d,)
        a[c], likewise.
    kick : array (d,)
        Of increments a[0], otherwise zero: with a[c n + c] in place of a[c n], a'v changes by `kick` v[1].
    own_first, own_last : array (d,)
        Own values at the first and the last output, or their increments there.
    own_at : int
        Where the functions of own values begin behind those of data, see `Correlations`.
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
    own_first: np.ndarray
    own_last: np.ndarray
    own_at: int


class Correlations(NamedTuple):
    """Of data (s, N) and d inputs.

    Attributes
    ----------
    step : float
        h [s].
    lags : array (d or d + 1, functions, c (N - 1) + 1)
        R of each input, and where an input does not begin with zero, of a one at the first sample. Functions
        are those of s data, d c phases, the last output, and d own values that are others than phase zero.
    sums : Sums
    """

    step: float
    lags: np.ndarray
    sums: Sums


def correlations(data: np.ndarray, inputs: np.ndarray, own: np.ndarray, step: float, of_increments=False):
    """Correlate data (s, N) and inputs, or their increments from output to output.

    Parameters
    ----------
    data : array (s, N)
    inputs : array (d, c (N - 1) + 1)
        At the steps of the recursion.
    own : array (d, N)
        What the feed-through passes on; none, (0, N), where that is the inputs.
    step : float
        h [s].
    of_increments : bool
    """
    (n_inputs, n_steps), n_times = inputs.shape, data.shape[1]
    stride = (n_steps - 1) // (n_times - 1)
    first, second = phases(inputs, stride, n_times)[:, 0].copy(), inputs[:, stride].copy()
    values = own if len(own) else inputs[:, ::stride]
    own_first, own_last = values[:, 0].copy(), values[:, -1].copy()
    if of_increments:
        data, own = np.diff(data, prepend=data[:, :1]), np.diff(own, prepend=own[:, :1])
        values = np.diff(values, prepend=values[:, :1])
        inputs = inputs - np.pad(inputs, ((0, 0), (stride, 0)))[:, :n_steps]
    by_phase, impulse = phases(inputs, stride, n_times), np.zeros((1, n_times))
    impulse[0, -1] = 1.0
    given = np.concatenate([data, by_phase, impulse, own])
    rows, size = np.zeros((len(given), n_steps)), fft.next_fast_len(2 * n_steps, real=True)
    rows[:, ::stride] = given
    starts = bool(first[::stride].any())
    lags = np.empty((n_inputs + starts, *rows.shape))
    spectra = [np.conj(fft.rfft(a, size)) for a in inputs]
    for f, row in enumerate(rows):
        spectrum = fft.rfft(row, size)
        for i, other in enumerate(spectra):
            lags[i, f] = fft.irfft(spectrum * other, size)[:n_steps]
        if starts:
            lags[-1, f] = row
            if of_increments:
                lags[-1, f, :-stride] -= row[stride:]
    lags[:n_inputs, :, 0] = np.einsum("dt,ft->df", inputs, rows)
    after = inputs[:, stride::stride].copy()
    if of_increments:
        after[:, 0] = second
    sums = Sums(
        squares=np.einsum("st,st->s", data, data),
        products=np.einsum("st,dt->sd", data, values),
        inputs=square(values),
        early=square(by_phase[:, :-1]),
        late=square(after),
        first=first,
        last=by_phase[:, -1].copy(),
        second=second,
        kick=first[::stride].copy() if of_increments else np.zeros(n_inputs),
        own_first=own_first,
        own_last=own_last,
        own_at=len(by_phase) + 1 if len(own) else 0,
    )
    return Correlations(step, lags, sums)


def phases(inputs, stride, n_times):
    """The inputs at the outputs and the steps behind each, (d c, N), zero behind the last output."""
    padded = np.pad(inputs, ((0, 0), (0, stride - 1)))
    return padded.reshape(len(inputs), n_times, stride).swapaxes(1, 2).reshape(-1, n_times).copy()


def square(inputs):
    """a'a (d, d)."""
    return np.einsum("dt,et->de", inputs, inputs)
