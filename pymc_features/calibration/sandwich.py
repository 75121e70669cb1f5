"""Sensitivity A of a score, its variability B, and what follows from them.

For errors e (sensor, time) and sensitivities S (sensor, time, parameter) the score is u = sum S e, and

    B = Cov(u) = sum_f S(f)^H Phi(f) S(f),

with Phi the cross-spectral matrix of the errors, which the residuals estimate. Nothing in it depends on the
sampling step: what lies above the band of the sensitivities is left out before anything is estimated. A
smoothed periodogram alone blurs narrow peaks, so the residuals are taken to white noise first, and the
spectrum is coloured again afterwards (Andrews & Monahan, Econometrica 60, 1992): their amplitude may follow
that of the response, sensors may share errors (principal components), and each component is an
autoregressive process.

B grows where the frequency bands of a record disagree about the parameters. With u_b the part of the score in
a band b, and B_b its covariance by the residuals,

    growth = sqrt(max(1, chi2 / (k - p))),
    chi2 = min_d sum_b (u_b - A_b d)' B_b^-1 (u_b - A_b d),

of k components of the score over all bands and p parameters, is by how much intervals must grow for the bands
to agree (Birge, Phys. Rev. 40, 1932). A_b d is how a change d of the parameters changes u_b: the fit weighs
samples, and not bands by their errors. It is about one for errors that spectra describe, and more where the
model is not the structure. Bands lie between the natural frequencies of the model.
"""

import itertools
from typing import NamedTuple

import numpy as np
from scipy.fft import dct, idct, irfft, rfft
from scipy.ndimage import uniform_filter1d
from scipy.optimize import nnls

from pymc_features.calibration.residuals import Fit

FLAT = 1e-10  # of the largest relative eigenvalue: directions that a likelihood cannot tell
MOST_BANDS = 5  # the last one holds all frequencies above
HIGHEST = 0.45  # of the sampling rate: frequencies above divide no bands
FAINT, SINGULAR = 1e-9, 1e-3  # of a parameter's variance, of the largest eigenvalue: not counted
LARGEST = 2.0  # factor that intervals grow by
NOTABLE = 1.5  # factor that is worth a word
LOST = 1e-3  # share of the score's power above the band
FEWEST = 256  # samples that a longer record keeps,
STATIC = 32  # all, if the score has hardly any frequency besides zero: fewer terms of its cosine series
MARGIN = 1.25  # kept over needed frequencies
LARGEST_ORDER = 40  # of the autoregressions, and at most a twentieth of the samples
SMOOTHING = 12  # the spectrum of what is left is averaged over this part of the band to each side
SURE = 3.0  # gain of log-likelihood that an amplitude that follows the response must bring
QUIETEST = 1e-3  # least share of the mean variance
MOST_TAKEN = 0.9  # of a direction that one line of the spectrum may decide: more is not put back
BOUNDED = 6.0  # standard deviations from a bound that count
REALISATIONS = 200  # of noise on a base: good to 5 % of a standard deviation
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


class Peak(NamedTuple):
    """A maximum of the likelihood, how much it claims to know there, and how much its score varies."""

    fit: Fit
    information: np.ndarray  # A (d, d), minus the Hessian of the log-likelihood
    errors: np.ndarray  # B (d, d) before it grows; A if the likelihood's assumptions hold
    models: list[ErrorModel]  # of each likelihood
    growth: float = np.nan  # by how much the frequency bands disagree; NaN where there are none

    @classmethod
    def at(cls, fit, model_error="bands", leverage=True) -> "Peak":
        """What residuals say; `model_error` as of `calibrate`, `leverage` puts back what the fit took."""
        events, whiten = fit.events, whitening(sum(e.of_response for e in fit.events))
        back = whiten if leverage else whiten[:, :0]
        models = [error_model(e.residuals, e.sensitivities, e.mu, e.gaps, edges_of(e), back) for e in events]
        growth = growth_of(models, whiten.shape[1]) if model_error else np.nan
        errors = sum(model.variability for model in models) + sum(map(of_scale, events))
        return cls(fit, fit.information, errors, models, growth)

    @property
    def factor(self) -> float:
        """By which the disagreement of bands makes intervals wider."""
        return 1.0 if np.isnan(self.growth) else min(LARGEST, self.growth)

    @property
    def variability(self) -> np.ndarray:
        """B (d, d), covariance of the score."""
        return self.factor**2 * self.errors

    @property
    def claims(self) -> np.ndarray:
        """A^-1 (d, d), the covariance that the likelihood claims; zero along what it cannot tell."""
        whiten = whitening(self.information)
        return whiten @ whiten.T

    @property
    def covariance(self) -> np.ndarray:
        """A^-1 B A^-1 (d, d), that of the likelihood's maximum."""
        return self.claims @ self.variability @ self.claims

    @property
    def precision(self) -> np.ndarray:
        """A B^-1 A (d, d)."""
        return of_values(self.information, self.variability, np.reciprocal)

    @property
    def free(self) -> np.ndarray:
        """Coordinates (d,) where the maximum would be without bounds, by one step beyond."""
        return self.fit.w + self.claims @ self.fit.pushing

    @property
    def deviations(self) -> np.ndarray:
        """Standard deviations (d,) of coordinates, NaN of what the likelihood does not know."""
        sd = np.sqrt(np.diag(self.covariance))
        return np.where(sd > 0, sd, np.nan)

    @property
    def rooms(self) -> np.ndarray:
        """Standard deviations (2, d) from the bounds of the prior to the maximum without bounds."""
        beyond = self.free - self.fit.w
        return (self.fit.coordinates.rooms(self.fit.z) + [beyond, -beyond]) / self.deviations

    def distance(self, z) -> np.ndarray:
        """Standard deviations (...,) between the maximum and unconstrained points (..., d)."""
        apart = self.fit.coordinates.of(z) - self.fit.w
        return np.sqrt(np.einsum("...i,ij,...j->...", apart, self.precision, apart))

    def near_bounds(self) -> np.ndarray:
        """Parameters (d,) whose prior ends so near to the maximum that this may shape the interval.

        Those that no response depends on only where their score pushes them against it.
        """
        of_response = np.any([np.any(e.sensitivities, axis=(0, 1)) for e in self.fit.events], axis=0)
        near = (self.fit.pushing != 0) | (of_response & (self.rooms.min(axis=0) < BOUNDED))
        return (self.fit.coordinates.sides > 0) & near

    def with_base_noise(self, predictions, sd: float) -> "Peak":
        """Make the peak at least as wide, in every direction, as white noise on the base does [m/s^2]."""
        rng, scores = np.random.default_rng(0), []
        for _ in range(REALISATIONS):
            pairs = zip(predictions.with_noisy_base(self.fit.z, sd, rng), self.fit.events, strict=True)
            off = [np.einsum("stp,st->p", e.sensitivities, v.residuals - e.residuals) for v, e in pairs]
            scores.append(sum(off))
        noise = np.einsum("np,nq->pq", scores, scores) / REALISATIONS
        wider = of_values(self.errors, noise, lambda ratios: np.maximum(ratios - 1.0, 0.0))
        return self._replace(errors=self.errors + wider)


def of_scale(event) -> np.ndarray:
    """Covariance (d, d) of what the scales add to the score, sum_jk (r_jk^2 - m_j / N) d ln s_j / dw."""
    used = np.flatnonzero(event.of_scale.any(axis=0))
    result, square = np.zeros((event.of_scale.shape[1],) * 2), event.residuals**2
    if used.size:
        gaps = event.gaps
        series = square - (square.sum(axis=1) / (~gaps).sum(axis=1))[:, None]
        sensitivities = ~gaps[..., None] * event.of_scale[:, None, used]
        result[np.ix_(used, used)] = error_model(series, sensitivities, gaps=gaps).variability
    return result


def known(matrix) -> np.ndarray:
    """Whether a likelihood depends on parameters (d,)."""
    diagonal = np.diag(matrix)
    return diagonal > FLAT**2 * diagonal.max(initial=0.0)


def whitening(information, flat=FLAT) -> np.ndarray:
    """W (d, k) with W' A W = 1, for the k directions that A tells."""
    used = known(information)
    scale = np.sqrt(np.diag(information)[used])
    values, vectors = np.linalg.eigh(information[np.ix_(used, used)] / np.outer(scale, scale))
    keep = values > flat * values.max(initial=0.0)
    result = np.zeros((len(information), keep.sum()))
    result[used] = vectors[:, keep] / np.sqrt(values[keep]) / scale[:, None]
    return result


def directions(information, other) -> tuple[np.ndarray, np.ndarray]:
    """Values v (k,), ascending, and V (d, k) with V' A V = 1 and V' X V = diag(v), of what A tells."""
    whiten = whitening(information)
    relative = whiten.T @ other @ whiten
    values, vectors = np.linalg.eigh(0.5 * (relative + relative.T))
    return values, whiten @ vectors


def of_values(first, second, function) -> np.ndarray:
    """Matrix (d, d) whose values (k,) relative to the first are a function of those of the second."""
    values, vectors = directions(first, second)
    along = first @ vectors
    return (along * function(values)) @ along.T


def stretching(information: np.ndarray, precision: np.ndarray) -> tuple[float, np.ndarray]:
    """Power k and matrix C (d, d), of determinant one, with C' (k A) C = a precision where A tells of any."""
    values, vectors = directions(information, precision)
    power = float(np.exp(np.mean(np.log(values)))) if values.size else 1.0
    along = (vectors * (np.sqrt(values / power) - 1.0)) @ vectors.T
    return power, np.eye(len(information)) + along @ information


def edges_of(event) -> np.ndarray:
    """Frequencies between bands, in cycles per sample."""
    f = np.sort(np.multiply([] if event.frequencies is None else event.frequencies, event.step))
    f = f[f < HIGHEST]
    return 0.5 * (f[:-1] + f[1:])[: MOST_BANDS - 1]


def growth_of(models, p: int) -> float:
    """The factor, not limited, by the error models of all events and p parameters; NaN without bands."""
    bands = [band for m in models for band in zip(m.scores, m.variabilities, m.informations, strict=True)]
    left, slopes = [], []
    largest = np.diag(sum(b for _, b, _ in bands))
    scale = np.sqrt(np.where(largest > 0.0, largest, 1.0))
    for u, b, a in bands:
        seen = np.diag(b) > FAINT * largest
        whiten = whitening(b * np.outer(seen, seen), SINGULAR)
        left.append(whiten.T @ u)
        slopes.append(whiten.T @ a * (largest > 0.0) / scale)
    left, slopes = np.concatenate(left), np.concatenate(slopes)
    if len(bands) == len(models) or len(left) <= p:
        return np.nan
    left = left - slopes @ np.linalg.lstsq(slopes, left, rcond=SINGULAR)[0]
    return float(np.sqrt(max(1.0, left @ left / (len(left) - p))))


def sentence(growth: float) -> str:
    """What the disagreement of bands means; empty where it is no more than spectra explain."""
    if not growth > NOTABLE:
        return ""
    return (
        f"The frequency bands of this record disagree about the parameters by a factor of {growth:.2g} more "
        "than its residuals allow: the model is not the structure, or the errors are narrow-band. "
        f"Intervals are {min(LARGEST, growth):.2g} times wider, for the values that fit best on average over "
        "such events."
    )


def error_model(residuals, sensitivities, response=None, gaps=None, edges=(), whiten=None) -> ErrorModel:
    """Estimate B from residuals (sensor, time) and sensitivities (sensor, time, p), which are zero in gaps.

    `response` (sensor, time) is what the amplitude of the errors may follow. `edges` are frequencies between
    bands, in cycles per sample. `whiten` as of `taken`; None puts nothing back.
    """
    n_all, both = residuals.shape[1], [sensitivities]
    response = np.zeros_like(residuals) if response is None else response
    if gaps is not None and gaps.any():
        at = mirrored(gaps.any(axis=0))
        residuals, response = residuals[:, at], response[:, at]
        both.append(sensitivities[:, at])  # gaps must not hide that a score is static
    n = max(samples_of_the_band(residuals, s) for s in both)
    r, s = resampled(residuals, n), resampled(sensitivities, n)
    amplitude, follows = amplitudes(r, resampled(response, n))
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
    (u, b, a), ratio = by_band(white, spectrum, changes, starts), n_all / n
    return ErrorModel(u * ratio, b * ratio**2, a * ratio, memory(filters) * ratio, follows)


def mirrored(gaps) -> np.ndarray:
    """For each sample (time,) itself or, in a gap, one beyond the nearer end: errors are alike backwards."""
    at, known = np.arange(gaps.size), np.flatnonzero(~gaps)
    for k in np.flatnonzero(gaps):
        before, behind = 2 * known[known < k][-1:] + 1 - k, 2 * known[known > k][:1] - 1 - k
        ends = sorted([*behind, *before], key=lambda end: abs(end - k))
        inside = [end for end in ends if 0 <= end < gaps.size and not gaps[end]]
        at[k] = inside[0] if inside else known[np.abs(known - k).argmin()]
    return at


def taken(residuals, whitened):
    """What the fit took out of residuals (sensor, time).

    A few lines of a spectrum decide a parameter near a resonance, and there the fit makes residuals small.
    For each line f, e_f becomes (1 - H_ff)^-1 e_f with H = S (sum S'S)^-1 S', the residual that a fit without
    the line would leave (CR3; Bell & McCaffrey, Surv. Methodol. 28, 2002). `whitened` (sensor, time, k) are
    the sensitivities times W, with W' (sum S'S) W = 1 over all events.
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
    below = np.cumsum([power.sum(axis=0), (power * errors).sum(axis=0)], axis=1)
    highest = 1 + max(np.searchsorted(x, (1.0 - LOST) * x[-1]) for x in below)
    return n if highest < STATIC else min(n, max(FEWEST, int(np.ceil(MARGIN * highest))))


def resampled(x, n):
    """Signals (sensor, time, ...) at n samples: their cosine series without terms of higher frequency."""
    if x.shape[1] == n:
        return x
    return idct(dct(x, axis=1, norm="ortho")[:, :n], axis=1, norm="ortho") * np.sqrt(n / x.shape[1])


def amplitudes(residuals, response):
    """Standard deviation of the errors (sensor, time), and whose grow with the response g (sensor,).

    Their variance is constant, or a + b g^2 + c times the mean of g^2 over a period if that is likelier.
    """
    n = residuals.shape[1]
    level = np.repeat(np.mean(residuals**2, axis=1, keepdims=True), n, axis=1)
    follows = np.zeros(len(residuals), dtype=bool)
    power = dct(response, axis=1, norm="ortho") ** 2
    cycles = 0.5 * (power @ np.arange(n)) / power.sum(axis=1).clip(min=TINY)
    for j in np.flatnonzero((cycles > 0) & residuals.any(axis=1)):
        square, mean, variance, g2 = residuals[j] ** 2, level[j, 0], level[j], response[j] ** 2
        local = uniform_filter1d(g2, int(np.clip(n / cycles[j], 3, n)))
        columns = np.stack([np.full(n, np.mean(g2)), g2, local], axis=1) / np.mean(g2)
        for _ in range(4):
            coefficients, _ = nnls(columns / variance[:, None], square / variance)
            variance = np.maximum(columns @ coefficients, QUIETEST * mean)
        if 0.5 * np.sum(np.log(mean / variance) - square / variance + square / mean) > SURE:
            follows[j], level[j] = True, variance
    return np.sqrt(level), follows


def autoregressions(x, largest):
    """Filters (component, order + 1) that whiten signals (component, time), alike if their AICc is better."""
    n, k = x.shape[1], np.arange(largest + 1)
    scale = np.sqrt(np.mean(x**2, axis=1, keepdims=True)).clip(min=TINY)
    (alone, shared), (gain, shared_gain) = burg(np.stack([x, x / scale]), largest, [[False], [True]])
    score = n * np.log(gain) + (2.0 * (k + 1) * n / (n - k - 2))
    together = n * len(x) * np.log(shared_gain[0]) + 2.0 * (k + len(x))
    filters = alone[np.arange(len(x)), score.argmin(axis=1)]
    if together.min() < score.min(axis=1).sum():
        filters = shared[:, together.argmin()]
    return filters[:, : 1 + np.flatnonzero(filters.any(axis=0)).max()]


def burg(signals, largest, shared=False):
    """Filters (..., order, order + 1) of signals (..., time), rows `shared` or not; variances left over."""
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
    """Parts of the score S(f)^H e(f), of B = S(f)^H Phi(f) S(f), and of S(f)^H G(f), by band from `starts`.

    Phi is the smoothed cross-periodogram of white (component, time); `spectrum` and `changes` (component,
    frequency, p) are S and G, minus the derivative of e, of signals with as many zeros behind.
    """
    n, n_frequencies = white.shape[1], spectrum.shape[1]
    length = 2 * (n_frequencies - 1)
    bands = [slice(*ends) for ends in itertools.pairwise([*starts, n_frequencies])]
    twice = np.full(n_frequencies, 2.0)
    twice[[0, -1]] = 1.0
    e = rfft(np.pad(white, ((0, 0), (length // 2 - n, 0))), length, axis=1)  # filters lose the start
    back = spectrum.conj() * (twice / length)[:, None]
    scores = np.add.reduceat(np.einsum("cfp,cf->fp", back, e).real, starts, axis=0)
    informations = [np.tensordot(back[:, f], changes[:, f], ([0, 1], [0, 1])).real for f in bands]
    half = max(1, min(n_frequencies - 2, n_frequencies // SMOOTHING))
    kernel = np.hanning(2 * half + 3)[1:-1]
    window = irfft(length * kernel[half:] / kernel.sum(), length)  # of lags: smooths what they make
    total = np.zeros((len(bands), spectrum.shape[2], spectrum.shape[2]))
    for i, s in enumerate(spectrum):  # rows: no array (component, component, ...)
        cross = rfft(irfft(e[i] * e[i:].conj(), length, axis=1) * window, axis=1) * twice
        cross[1:] *= 2.0
        weighed = np.einsum("cf,cfp->fp", cross, spectrum[i:])
        total += [(s[f].conj().T @ weighed[f]).real for f in bands]
    total /= n * length
    return scores, 0.5 * (total + total.transpose(0, 2, 1)), np.array(informations)
