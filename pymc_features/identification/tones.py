"""Machines at constant speed: sines in a record, found in its spectrum and taken off."""

import numpy as np
from scipy.fft import next_fast_len

FINER = 4  # frequencies of the padded spectrum for one of the record
BESIDE = np.arange(3, 9)  # frequencies of the record away, on both sides, with which a peak is compared
HIGHER = 60.0  # than the mean there: noise is so once in 1e8 frequencies, a mode 2.4 of them wide once in 40
MOST = 50
LOWEST = 10  # frequencies of the record below which a peak may be a drift


def without_tones(values: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Channels (s, n) without means and sines, and the frequencies of these [Hz], ascending.

    A sine looks as a record of its length makes it: it falls to 1/470 of its height, in the mean, between
    three and eight frequencies away. A mode does so only if it is narrower than a frequency. Each channel
    loses one of an amplitude and a phase of its own.
    """
    values, found = values - values.mean(axis=1, keepdims=True), []
    while len(found) < MOST and (f := highest_tone(values, dt)) is not None:
        columns = waves(f, values.shape[1], dt)
        values = values - np.linalg.lstsq(columns, values.T)[0].T @ columns.T
        found.append(f)
    return values, np.array(sorted(found))


def highest_tone(values, dt) -> float | None:
    """Frequency [Hz] of the sine that stands highest above what is beside it; None if there is none."""
    n = values.shape[1]
    size = next_fast_len(FINER * n)
    power = (np.abs(np.fft.rfft(values, size)) ** 2).sum(axis=0)
    step = size / n  # of the padded spectrum in a frequency of the record
    apart = np.round(step * BESIDE).astype(int)
    inside = np.arange(int(LOWEST * step), power.size - apart[-1])
    beside = [power[inside[:, None] + sign * apart].mean(axis=1) for sign in (-1, 1)]
    ratio = power[inside] / np.maximum(np.maximum(*beside), np.finfo(float).tiny)
    best = int(ratio.argmax())
    if ratio[best] < HIGHER:
        return None
    from scipy import optimize  # a second to import

    def minus_energy(f):
        return -np.sum((waves(f, n, dt).T @ values.T) ** 2)

    middle, half = inside[best] / (size * dt), 0.5 / (n * dt)
    found = optimize.minimize_scalar(
        minus_energy, bounds=(middle - half, middle + half), method="bounded", options={"xatol": 1e-3 * half}
    )
    return float(found.x)


def waves(f, n, dt) -> np.ndarray:
    """Cosine and sine (n, 2)."""
    phase = 2.0 * np.pi * f * dt * np.arange(n)
    return np.column_stack([np.cos(phase), np.sin(phase)])
