"""A band-limited signal between its samples, and samples whose straight lines stand for it.

A signal sampled at the rate f_s without content above f_s / 2 is known everywhere: its spectrum, continued by
zeros, is that of finer samples. Joined by straight lines, samples at the rate F lose the factor
sinc^2(f / F) of each component; divided by it beforehand, the straight lines have the components of the
signal, and images around F, 2 F, ... besides, which an oscillator far below F does not follow.

Records do not begin and end at zero. Both ends are continued by linear prediction, which fades out.

Burg, J. P. (1975), Maximum Entropy Spectral Analysis, Stanford University.
"""

from functools import lru_cache

import numpy as np

MARGIN = 400  # samples by which both ends are continued
ORDER = 100  # of the prediction: first second 6e-4 of the peak, 3e-3 by reflection through the last sample
LEARNT = 20 * ORDER  # samples next to an end from which it is predicted
TRUNCATION = 1e-24  # of the power of the samples: what is left to predict is rounding
N_ORDERS = 5  # the signal and four derivatives
FINER = 16  # samples through which a cubic spline is laid


def refined(samples: np.ndarray, factor: int) -> np.ndarray:
    """Samples that, joined by straight lines, have the components of a band-limited signal.

    Parameters
    ----------
    samples : array (d, t)
    factor : int
        How many times finer the result is.

    Returns
    -------
    array (d, factor (t - 1) + 1)
    """
    return _kept(_refined, samples, factor)


def evaluated(samples: np.ndarray, dt: float, substeps: int, stride: int) -> np.ndarray:
    """A band-limited signal and its four derivatives at every `stride`-th of `substeps` points per sample.

    Returns
    -------
    array (5, d, u)
        In the unit of the samples (d, t), and per s, ... s^4. At the samples the signal is theirs to the bit.
    """
    return _kept(_evaluated, samples, dt, substeps, stride)


def _kept(function, samples, *settings):
    return function(np.ascontiguousarray(samples, dtype=float).tobytes(), len(samples), *settings).copy()


@lru_cache(maxsize=32)
def _spectrum(content: bytes, n_inputs: int):
    """Spectra (d, f) of the continued samples and their number; before them come `MARGIN` samples."""
    from scipy.fft import next_fast_len, rfft  # slow to import, and not needed to read a record

    samples = np.frombuffer(content).reshape(n_inputs, -1)
    total = next_fast_len(samples.shape[1] + 2 * MARGIN, real=True)
    after = total - samples.shape[1] - MARGIN
    whole = np.stack(
        [np.concatenate([_onward(x[::-1], MARGIN)[::-1], x, _onward(x, after)]) for x in samples]
    )
    return rfft(whole), total


def _onward(samples, count):
    """Continue samples (t,) by `count` more, by linear prediction, to zero."""
    samples = samples[-LEARNT:]
    coefficients = _prediction(samples, min(ORDER, (len(samples) - 1) // 3))
    width = len(coefficients)
    onward = np.concatenate([samples[-width:], np.empty(count)])
    for k in range(width, width + count):
        onward[k] = coefficients @ onward[k - width : k]
    faded = np.cos(np.linspace(0.0, 0.5 * np.pi, count)) ** 2
    return onward[width:] * faded


def _prediction(samples, order):
    """Coefficients (order,) by which the samples before one predict it: Burg's, which never grow.

    Those of least squares may: then they reached five times the peak, and the signal inside was off by 5 %.
    """
    if order < 1:
        return np.ones(1)
    forward, backward, coefficients = samples[1:], samples[:-1], np.ones(1)
    for _ in range(order):
        power = forward @ forward + backward @ backward
        if power <= TRUNCATION * (samples @ samples):
            break
        reflected = -2.0 * (forward @ backward) / power
        coefficients = np.append(coefficients, 0.0)
        coefficients = coefficients + reflected * coefficients[::-1]
        forward, backward = (
            (forward + reflected * backward)[1:],
            (backward + reflected * forward)[:-1],
        )
    return -coefficients[:0:-1] if len(coefficients) > 1 else np.zeros(1)


def _finer(spectrum, total, n_times, factor):
    """The signal (d, factor (n_times - 1) + 1) of a spectrum of `total` samples."""
    from scipy.fft import irfft

    if total % 2 == 0 and factor > 1:
        spectrum = spectrum.copy()
        spectrum[:, -1] *= 0.5
    whole = factor * irfft(spectrum, factor * total)
    return whole[:, factor * MARGIN : factor * (MARGIN + n_times - 1) + 1]


@lru_cache(maxsize=32)
def _refined(content, n_inputs, factor):
    spectrum, total = _spectrum(content, n_inputs)
    lowered = np.sinc(np.fft.rfftfreq(total, factor)) ** 2
    return _finer(spectrum / lowered, total, len(content) // 8 // n_inputs, factor)


@lru_cache(maxsize=32)
def _evaluated(content, n_inputs, dt, substeps, stride):
    samples = np.frombuffer(content).reshape(n_inputs, -1)
    spectrum, total = _spectrum(content, n_inputs)
    rate = 2j * np.pi * np.fft.rfftfreq(total, dt)
    found = [_finer(spectrum * rate**k, total, samples.shape[1], substeps) for k in range(N_ORDERS)]
    found[0][:, ::substeps] = samples
    return np.stack(found)[:, :, ::stride]


def at_times(samples: np.ndarray, dt: float, times: np.ndarray, step: float) -> np.ndarray:
    """A band-limited signal at any times (u,) within its own, without what a rate of 1 / `step` cannot carry.

    Parameters
    ----------
    samples : array (d, t)
        At 0, dt, 2 dt ... [s].
    times : array (u,)
        [s]

    Returns
    -------
    array (d, u)
        To 1e-4 of the peak (tests/test_resampled_records.py): a cubic spline through samples 16 times finer.
    """
    from scipy.interpolate import CubicSpline  # slow to import, and seldom needed

    spectrum, total = _spectrum(np.ascontiguousarray(samples, dtype=float).tobytes(), len(samples))
    spectrum = np.where(np.fft.rfftfreq(total, dt) <= 0.5 / step, spectrum, 0.0)
    fine = _finer(spectrum, total, samples.shape[1], FINER)
    return CubicSpline(np.arange(fine.shape[1]) * (dt / FINER), fine, axis=1)(times)
