"""Natural frequencies and damping read off shaken channels, without a model of the structure.

In a band around one mode the Fourier transform of a sensor that is shaken by its base is

    Y(f) = [c_0 + c_1 (f - f_k) + b D(f)] X(f) + t D(f),    D(f) = f_k^2 / (f_k^2 - f^2 + 2 i zeta f_k f)

for a record of any window: t D is what rings from before its first sample and past its last one (Pintelon
and Schoukens, System Identification, 2nd ed., sec. 2.6.3), c_0 and c_1 are the other modes. For given f_k and
zeta all coefficients follow by least squares, each sensor with its own; the poles are those with the largest
likelihood over all sensors. Inverted, swapped, late and mis-scaled sensors have the same poles.
"""

from typing import NamedTuple

import numpy as np

SPACING = 0.01  # of the logarithm of frequencies that are tried
RATIOS = np.array([0.003, 0.01, 0.03, 0.1])  # damping that is tried
FINE_RATIOS = 0.0005, 0.4
REACH = 0.4  # of a frequency: half the band in which it is fitted
BINS = 30  # frequencies of a band on either side, at most
FEWEST = 5  # on either side, so that a residual is left
LOWEST = 3.0  # periods in the record
DRIVEN = 0.998  # share of the power of the base up to the highest frequency that is looked at
BLOCK = 200  # candidates at once
CLEAR = 30.0  # log likelihood that a resonance gains over a smooth function, for each sensor's own fit
SHOWN = 0.3  # share of what a smooth function leaves that the resonance must explain at a sensor
APART = 0.12  # relative distance below which two peaks are one
MOST = 8  # peaks
DROP = 12.0  # log likelihood at the ends of a 90 % interval: of one parameter 1.35, and what neighbours add


class Resonance(NamedTuple):
    """A resonance of the channels."""

    frequency: float  # [Hz]
    # ratio [-]: 5 %, most likely, 95 %, with frequency and damping constant during the record
    damping: tuple[float, float, float]
    sensors: tuple[str, ...]  # those that show it, the clearest first
    gain: float  # log likelihood gained over a smooth function of frequency


class Spectra(NamedTuple):
    """Fourier transforms of a record: frequencies (k,), base (k,) and sensors (s, k), names (s,)."""

    frequency: np.ndarray
    base: np.ndarray
    sensors: np.ndarray
    names: tuple[str, ...]


def spectra_of(channels, step: float) -> Spectra:
    """Transforms of channels (sensor, time), the base first; gaps are bridged by zeros about the mean."""
    values = np.asarray(channels.values, dtype=np.float64)
    values = np.nan_to_num(values - np.nanmean(values, axis=1, keepdims=True))
    found = np.fft.rfft(values)
    frequency = np.fft.rfftfreq(values.shape[1], step)
    names = tuple(str(name) for name in channels["sensor"].values[1:])
    return Spectra(frequency, found[0], found[1:], names)


def resonances(spectra: Spectra) -> list[Resonance]:
    """Resonances that stand out of the channels, lowest first; none of a record too short for any."""
    power = np.cumsum(np.abs(spectra.base) ** 2)
    if not power[-1] > 0.0:
        return []
    top = spectra.frequency[np.searchsorted(power, DRIVEN * power[-1])]
    low = max(LOWEST, FEWEST / REACH) * spectra.frequency[1]
    tried = np.exp(np.arange(np.log(low), np.log(top), SPACING))
    gains, of_sensors = scan(spectra, tried)
    padded = np.pad(gains, 1, constant_values=-np.inf)
    is_peak = (gains >= padded[:-2]) & (gains > padded[2:]) & (gains > CLEAR) & (of_sensors > 0.0).any(axis=0)
    peaks, chosen = np.flatnonzero(is_peak), []
    for i in sorted(peaks, key=lambda i: -gains[i]):
        if all(abs(np.log(tried[i] / tried[j])) > APART for j in chosen) and len(chosen) < MOST:
            chosen.append(i)
    rough = tried[chosen]
    found = [refined(spectra, rough[n], np.delete(rough, n)) for n in range(len(rough))]
    return sorted(one for one in found if one is not None and one.gain > CLEAR and one.sensors)


def scan(spectra, tried) -> tuple[np.ndarray, np.ndarray]:
    """Gain in log likelihood (tried,) by the best damping, and what each sensor shows (sensor, tried)."""
    gains, shown = np.empty(tried.size), np.empty((len(spectra.names), tried.size))
    for first in range(0, tried.size, BLOCK):
        part = slice(first, first + BLOCK)
        bins = bands(spectra, tried[part])
        smooth = residuals(spectra, bins, smooth_terms(spectra, bins, tried[part]))
        best = np.full(tried[part].size, -np.inf)
        for ratio in RATIOS:
            fitted = residuals(spectra, bins, resonant_terms(spectra, bins, tried[part], ratio))
            each = gain_of(smooth, fitted, bins.shape[1])
            better = each.sum(axis=0) > best
            best = np.where(better, each.sum(axis=0), best)
            visible = np.where(1.0 - fitted / smooth > SHOWN, each, 0.0)
            shown[:, part] = np.where(better, visible, shown[:, part])
        gains[part] = best
    return gains, shown


def bands(spectra, centres) -> np.ndarray:
    """Indices (candidate, bin) of the frequencies in a band around each centre."""
    step, last = spectra.frequency[1], spectra.frequency.size - 1
    middle = np.rint(centres / step).astype(int)
    half = np.maximum(FEWEST, REACH * centres / step)
    stride = np.maximum(1.0, half / BINS)
    n = int(max(FEWEST, min(BINS, half.max())))
    # all candidates of a block have as many bins: those of the lowest reach a little further
    offsets = np.rint(np.arange(-n, n + 1) * stride[:, None]).astype(int)
    return np.clip(middle[:, None] + offsets, 1, last)


def smooth_terms(spectra, bins, centres) -> np.ndarray:
    """Terms (candidate, bin, term) without a resonance: as many as with it."""
    x, away = spectra.base[bins], spectra.frequency[bins] / centres[:, None] - 1.0
    return np.stack([x, x * away, x * away**2, x * away**3], axis=-1)


def resonant_terms(spectra, bins, centres, ratio, others=()) -> np.ndarray:
    """Terms (candidate, bin, term) of a resonance at each centre, and of other modes in the band."""
    f, x = spectra.frequency[bins], spectra.base[bins]
    centres = centres[:, None]
    d = oscillator(f, centres, np.reshape(ratio, (-1, 1)))
    terms = [x, x * (f / centres - 1.0), x * d, d]
    for other, of_other in others:
        d = oscillator(f, other, of_other)
        terms += [x * d, d]
    return np.stack(terms, axis=-1)


def oscillator(f, natural, ratio) -> np.ndarray:
    """D(f), one at f = 0."""
    q = f / natural
    return 1.0 / (1.0 - q**2 + 2.0j * ratio * q)


def residuals(spectra, bins, terms) -> np.ndarray:
    """Sums of squares (sensor, candidate) that are left of the sensors after least squares."""
    y = spectra.sensors[:, bins]  # (sensor, candidate, bin)
    scale = np.sqrt((np.abs(terms) ** 2).sum(axis=1, keepdims=True))
    q, _ = np.linalg.qr(terms / np.where(scale > 0.0, scale, 1.0))
    explained = np.abs(np.einsum("cbt,scb->sct", q.conj(), y)) ** 2
    total = (np.abs(y) ** 2).sum(axis=-1)
    return np.maximum(total - explained.sum(axis=-1), 1e-12 * total + np.finfo(float).tiny)


def gain_of(smooth, fitted, n_bins) -> np.ndarray:
    """Gain in log likelihood, of complex Gaussian errors with the scale that the residuals have."""
    return n_bins * np.log(smooth / fitted)


def refined(spectra, centre, others) -> Resonance | None:
    """The resonance near a frequency, with the others in its band; None where it is no maximum."""
    near = [(f, 0.02) for f in others if abs(f / centre - 1.0) < 1.5 * REACH]
    bins = bands(spectra, np.array([centre]))
    smooth = residuals(spectra, bins, smooth_terms(spectra, bins, np.array([centre])))
    used = max(0.2, 1.0 - (4 + 2 * len(near)) / bins.shape[1])  # of the bins; coefficients take the rest
    at, half, ratios = centre, 2.0 * SPACING, np.geomspace(*FINE_RATIOS, 14)
    for _ in range(3):
        grid = at * np.exp(np.linspace(-half, half, 11))
        f, z = (a.ravel() for a in np.meshgrid(grid, ratios, indexing="ij"))
        same = np.repeat(bins, f.size, axis=0)
        fitted = residuals(spectra, same, resonant_terms(spectra, same, f, z, near))
        each = gain_of(smooth, fitted, used * bins.shape[1])
        total = each.sum(axis=0).reshape(grid.size, ratios.size)
        i, j = np.unravel_index(total.argmax(), total.shape)
        inside = np.flatnonzero(total.max(axis=0) > total.max() - DROP)
        low, high = ratios[max(0, inside[0] - 1)], ratios[min(ratios.size - 1, inside[-1] + 1)]
        at, best, half, ratios = grid[i], ratios[j], 0.3 * half, np.geomspace(low, high, 14)
    if not 0 < i < grid.size - 1:
        return None
    gains, shares = each[:, i * 14 + j], 1.0 - (fitted / smooth)[:, i * 14 + j]
    shown = [s for s in np.argsort(-gains) if shares[s] > SHOWN and gains[s] > CLEAR / 3.0]
    names = tuple(spectra.names[s] for s in shown)
    return Resonance(float(at), (float(low), float(best), float(high)), names, float(total.max()))
