"""Samples of a band-limited history at other times."""

import numpy as np

from pymc_features.signals.gaps import filled, widened, without

HALF_LENGTH = 48  # of the kernel, in samples of the slower rate
_KAISER = 10.0  # 100 dB in the stop band
_CORNER = 0.9  # middle of the transition, of half the slower rate
_BLOCK = 16_384  # samples at a time


def at_times(values: np.ndarray, step: float, times: np.ndarray) -> np.ndarray:
    """A history (time,) with the step `step` [s], from 0, at even times (k,) [s] within it.

    A symmetric low-pass (sinc with a Kaiser window) without phase, within 1e-3 of 1 up to 0.82 of half the
    slower of the two rates, below 1e-3 from half of it on. The straight line through both ends bypasses it;
    expect errors within 48 samples of the ends. Gaps, NaN, are wider by as many.
    """
    new_step = (times[-1] - times[0]) / (times.size - 1)
    slower = max(step, new_step)
    whole, gaps = filled(np.asarray(values, dtype=np.float64))
    at = np.arange(whole.size) * step
    line = whole[0] + (whole[-1] - whole[0]) * at / at[-1]
    reach = int(np.ceil(HALF_LENGTH * slower / step))
    padded = np.pad(whole - line, reach + 1)
    found = whole[0] + (whole[-1] - whole[0]) * times / at[-1]
    corner, offsets = _CORNER * step / slower, np.arange(-reach, reach + 1)
    for first in range(0, times.size, _BLOCK):
        block = times[first : first + _BLOCK] / step
        nearest = np.rint(block).astype(np.int64)
        away = block[:, None] - nearest[:, None] - offsets
        inside = np.sqrt(np.clip(1.0 - (away / (reach + 0.5)) ** 2, 0.0, None))
        kernel = corner * np.sinc(corner * away) * np.i0(_KAISER * inside)
        kernel /= kernel.sum(axis=1, keepdims=True)
        found[first : first + _BLOCK] += (kernel * padded[nearest[:, None] + offsets + reach + 1]).sum(axis=1)
    missing = widened(gaps, reach)[np.rint(times / step).astype(np.int64).clip(0, whole.size - 1)]
    return without(found, missing)
