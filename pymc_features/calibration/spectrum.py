"""Long-run covariance of a score: how much the sum of sensitivities times errors varies.

For errors e (sensor, time) and sensitivities S (sensor, time, parameter) the score is u = sum S e, and

    B = Cov(u) = sum_f S(f)^H Phi(f) S(f),

with Phi the cross-spectral matrix of the errors, which the residuals estimate. Nothing in it depends on the
sampling step: what lies above the band of the sensitivities is left out before anything is estimated. A
smoothed periodogram alone blurs narrow peaks, so the residuals are taken to white noise first, and the
spectrum is coloured again afterwards (Andrews & Monahan, Econometrica 60, 1992): their amplitude may follow
that of the response, sensors may share errors (principal components), and each component is an
autoregressive process.
"""

import itertools
from typing import NamedTuple

import numpy as np
from scipy.fft import dct, idct, irfft, rfft
from scipy.ndimage import uniform_filter1d
from scipy.optimize import nnls

LOST = 1e-3  # share of the score's power above the band
FEWEST = 256  # samples that a longer record keeps,
STATIC = 32  # all, if the score has hardly any frequency besides zero: fewer terms of its cosine series
MARGIN = 1.25  # kept over needed frequencies
LARGEST_ORDER = 40  # of the autoregressions, and at most a twentieth of the samples
SMOOTHING = 12  # the spectrum of what is left is averaged over this part of the band to each side
SURE = 3.0  # gain of log-likelihood that an amplitude that follows the response must bring
QUIETEST = 1e-3  # least share of the mean variance
MOST_TAKEN = 0.9  # of a direction that one line of the spectrum may decide: more is not put back
TINY = np.finfo(float).tiny


class ErrorModel(NamedTuple):
    """What the residuals say of the errors, in the band of the sensitivities."""

    scores: np.ndarray  # parts of the score by frequency (band, p), from the same residuals as B
    variabilities: np.ndarray  # their covariances (band, p, p)
    informations: np.ndarray  # how they change with the parameters (band, p, p)
    memory: float  # longest time constant of the autoregressions, in samples of the record
    follows_response: np.ndarray  # whether the errors of a sensor grow with its response (sensor,)

    @property
    def variability(self) -> np.ndarray:
        """B (p, p)."""
        return self.variabilities.sum(axis=0)


def error_model(residuals, sensitivities, response=None, whole=None, edges=(), whiten=None) -> ErrorModel:
    """Estimate B from residuals (sensor, time) and sensitivities (sensor, time, p).

    `response` (sensor, time) is what the amplitude of the errors may follow; None if there is none. Where the
    sensitivities are zero in gaps, `whole` is what they are without: gaps must not hide that a score is
    static. `edges` are frequencies between bands, in cycles per sample. `whiten` W (p, k) with
    W' (sum S'S) W = 1 over all events lets what the fit took out of the residuals be put back.
    """
    n_all = residuals.shape[1]
    both = [sensitivities] if whole is None or whole is sensitivities else [sensitivities, whole]
    n = max(samples_of_the_band(residuals, s) for s in both)
    r, s = resampled(residuals, n), resampled(sensitivities, n)
    amplitude, follows = amplitudes(r, None if response is None else resampled(response, n))
    back = 0.0 if whiten is None else taken(r, s @ whiten * np.sqrt(n_all / n))
    level = np.sqrt(np.mean(amplitude**2, axis=1, keepdims=True))
    r = r / amplitude + back / np.maximum(amplitude, level)
    changes, s = s / amplitude[..., None], s * amplitude[..., None]
    rotation = np.linalg.eigh(r @ r.T)[1]
    r, s, changes = (np.tensordot(rotation, x, (0, 0)) for x in (r, s, changes))
    filters = autoregressions(r, max(1, min(LARGEST_ORDER, n // 20)))
    white = np.stack([np.convolve(x, a, mode="valid") for a, x in zip(filters, r, strict=True)])
    whitens = rfft(filters, 2 * n, axis=1)[..., None]
    spectrum = rfft(s, 2 * n, axis=1) / whitens.conj()
    changes = rfft(changes, 2 * n, axis=1) * whitens
    starts = np.unique(np.r_[0, np.ceil(2 * n_all * np.asarray(edges)).astype(int).clip(max=n)])
    ratio = n_all / n
    scores, variabilities, informations = by_band(white, spectrum, changes, starts)
    return ErrorModel(
        scores * ratio, variabilities * ratio**2, informations * ratio, memory(filters) * ratio, follows
    )


def taken(residuals, whitened):
    """What the fit took out of residuals (sensor, time).

    A few lines of a spectrum decide a parameter near a resonance, and there the fit makes residuals small.
    For each line f, e_f becomes (1 - H_ff)^-1 e_f with H = S (sum S'S)^-1 S', the residual that a fit without
    the line would leave (CR3; Bell & McCaffrey, Surv. Methodol. 28, 2002).

    `whitened` (sensor, time, k) are the sensitivities times W, with W' (sum S'S) W = 1 over all events.
    """
    n = residuals.shape[1]
    e, s = (rfft(x, axis=1)[:, 1:].swapaxes(0, 1) for x in (residuals, whitened))
    e, s = (np.concatenate([x.real, x.imag], axis=1) for x in (e, s))  # (line, part of sensor, ...)
    values, vectors = np.linalg.eigh(2.0 / n * (s.swapaxes(1, 2) @ s))
    rest = (1.0 - np.minimum(values, MOST_TAKEN))[..., None]
    along = vectors @ (vectors.swapaxes(1, 2) @ (s.swapaxes(1, 2) @ e[..., None]) / rest)
    back = 2.0 / n * (s @ along)[..., 0].T
    real, imaginary = np.split(back, 2)
    return irfft(np.pad(real + 1j * imaginary, ((0, 0), (1, 0))), n, axis=1)


def samples_of_the_band(residuals, sensitivities):
    """How many samples hold all but a thousandth of the score's power, and of the sensitivities'."""
    n = residuals.shape[1]
    if n <= FEWEST:
        return n
    power = dct(sensitivities, axis=1, norm="ortho") ** 2
    power = (power / power.sum(axis=(0, 1), keepdims=True).clip(min=TINY)).sum(axis=2)
    errors = uniform_filter1d(dct(residuals, axis=1, norm="ortho") ** 2, n // SMOOTHING, axis=1)
    highest = 0
    for share in (power.sum(axis=0), (power * errors).sum(axis=0)):
        below = np.cumsum(share)
        highest = max(highest, int(np.searchsorted(below, (1.0 - LOST) * below[-1])) + 1)
    return n if highest < STATIC else min(n, max(FEWEST, int(np.ceil(MARGIN * highest))))


def resampled(x, n):
    """Signals (sensor, time, ...) at n samples: their cosine series without terms of higher frequency."""
    if x.shape[1] == n:
        return x
    return idct(dct(x, axis=1, norm="ortho")[:, :n], axis=1, norm="ortho") * np.sqrt(n / x.shape[1])


def amplitudes(residuals, response):
    """Standard deviation of the errors (sensor, time), and whose grow with the response (sensor,).

    Their variance is constant or a + b g^2 + c times the mean of g^2 over a period, with g the response, if
    that raises the log-likelihood by `SURE`.
    """
    n = residuals.shape[1]
    level = np.repeat(np.mean(residuals**2, axis=1, keepdims=True), n, axis=1)
    follows = np.zeros(len(residuals), dtype=bool)
    if response is not None:
        power = dct(response, axis=1, norm="ortho") ** 2
        cycles = 0.5 * (power @ np.arange(n)) / power.sum(axis=1).clip(min=TINY)
        for j, (r, g) in enumerate(zip(residuals, response, strict=True)):
            if cycles[j] > 0 and r.any():
                square, mean, variance = r**2, level[j, 0], level[j]
                local = uniform_filter1d(g**2, int(np.clip(n / cycles[j], 3, n)))
                columns = np.stack([np.full(n, np.mean(g**2)), g**2, local], axis=1) / np.mean(g**2)
                for _ in range(4):
                    coefficients, _ = nnls(columns / variance[:, None], square / variance)
                    variance = np.maximum(columns @ coefficients, QUIETEST * mean)
                gain = 0.5 * np.sum(np.log(mean / variance) - square / variance + square / mean)
                if gain > SURE:
                    follows[j], level[j] = True, variance
    return np.sqrt(level), follows


def autoregressions(x, largest):
    """Filters (component, order + 1) that whiten signals (component, time), by Burg's method.

    Orders by Akaike's criterion, corrected for short records; one filter for all, scaled, if that is better.
    """
    n, k = x.shape[1], np.arange(largest + 1)
    scale = np.sqrt(np.mean(x**2, axis=1, keepdims=True)).clip(min=TINY)
    (alone, shared), (gain, shared_gain) = burg(np.stack([x, x / scale]), largest, [[False], [True]])
    score = n * np.log(gain) + (2.0 * (k + 1) * n / (n - k - 2))
    together = n * len(x) * np.log(shared_gain[0]) + 2.0 * (k + len(x))
    if together.min() < score.min(axis=1).sum():
        filters = shared[:, together.argmin()]
    else:
        filters = alone[np.arange(len(x)), score.argmin(axis=1)]
    return filters[:, : 1 + np.flatnonzero(filters.any(axis=0)).max()]


def burg(signals, largest, shared=False):
    """Filters (..., order, order + 1) of signals (..., time), or one of all in a row where they are `shared`.

    With them the residual variance (..., order) over that of the signals.
    """
    forward, backward = signals[..., 1:], signals[..., :-1]
    filters = np.zeros((*signals.shape[:-1], largest + 1, largest + 1))
    variance = np.ones(filters.shape[:-1])
    filters[..., 0, 0] = 1.0
    for k in range(1, largest + 1):
        sums = np.vecdot(forward, backward), np.vecdot(forward, forward) + np.vecdot(backward, backward)
        cross, power = (np.where(shared, x.sum(axis=-1, keepdims=True), x) for x in sums)
        by = (-2.0 * cross / np.where(power > 0, power, 1.0))[..., None]
        filters[..., k, :] = filters[..., k - 1, :]
        filters[..., k, 1 : k + 1] += by * filters[..., k - 1, k - 1 :: -1]
        variance[..., k] = variance[..., k - 1] * (1.0 - by[..., 0] ** 2)
        forward, backward = (forward + by * backward)[..., 1:], (backward + by * forward)[..., :-1]
    return filters, variance


def memory(filters):
    """Longest time constant of autoregressive filters (component, order + 1), in samples."""
    radius = max((np.abs(np.roots(np.trim_zeros(a, "b"))).max(initial=0.0) for a in filters), default=0.0)
    return np.inf if radius >= 1.0 else (-1.0 / np.log(radius) if radius > 0 else 0.0)


def by_band(white, spectrum, changes, starts):
    """Parts of the score S(f)^H e(f), of B = S(f)^H Phi(f) S(f), and of S(f)^H G(f), by band.

    Phi is the smoothed cross-periodogram of white (component, time); `spectrum` and `changes` (component,
    frequency, p) are S and G, minus the derivative of e, of signals with as many zeros behind. Bands begin at
    the frequencies `starts`.
    """
    n_frequencies = spectrum.shape[1]
    length = 2 * (n_frequencies - 1)
    bands = [slice(*ends) for ends in itertools.pairwise([*starts, n_frequencies])]
    twice = np.full(n_frequencies, 2.0)
    twice[[0, -1]] = 1.0
    lost = np.pad(white, ((0, 0), (length // 2 - white.shape[1], 0)))  # by the filters, at the start
    back = spectrum.conj() * (twice / length)[:, None]
    e = rfft(lost, length, axis=1)
    scores = np.add.reduceat(np.einsum("cfp,cf->fp", back, e).real, starts, axis=0)
    informations = [np.tensordot(back[:, f], changes[:, f], ([0, 1], [0, 1])).real for f in bands]
    half = max(1, min(n_frequencies - 2, n_frequencies // SMOOTHING))
    kernel = np.hanning(2 * half + 3)[1:-1]
    window = irfft(length * kernel[half:] / kernel.sum(), length)  # of lags: smooths what they make
    r = rfft(white, length, axis=1)
    total = np.zeros((len(bands), spectrum.shape[2], spectrum.shape[2]))
    for i, s in enumerate(spectrum):  # rows: no array (component, component, ...)
        cross = rfft(irfft(r[i] * r[i:].conj(), length, axis=1) * window, axis=1) * twice
        cross[1:] *= 2.0
        weighed = np.einsum("cf,cfp->fp", cross, spectrum[i:])
        total += [(s[f].conj().T @ weighed[f]).real for f in bands]
    total /= white.shape[1] * length
    return scores, 0.5 * (total + total.transpose(0, 2, 1)), np.array(informations)
