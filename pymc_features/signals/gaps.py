"""Gaps in channels: NaN, each sensor its own."""

import numpy as np


def filled(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values (..., time) with straight lines across the gaps, and where these are, bool (..., time).

    A gap at an end takes the value nearest to it. Without gaps the values are those given.
    """
    gaps = np.isnan(values)
    if not gaps.any():
        return values, gaps
    whole = np.array(values, dtype=np.float64).reshape(-1, values.shape[-1])
    at = np.arange(whole.shape[1])
    for row, missing in zip(whole, gaps.reshape(whole.shape), strict=True):
        row[missing] = np.interp(at[missing], at[~missing], row[~missing])
    return whole.reshape(values.shape), gaps


def widened(gaps: np.ndarray, samples: int) -> np.ndarray:
    """Gaps (..., time) that begin as many samples earlier and end as many later."""
    if samples == 0 or not gaps.any():
        return gaps
    near = np.pad(gaps, [(0, 0)] * (gaps.ndim - 1) + [(samples + 1, samples)])
    count = np.cumsum(near, axis=-1)
    return count[..., 2 * samples + 1 :] > count[..., : -2 * samples - 1]


def without(values: np.ndarray, gaps: np.ndarray) -> np.ndarray:
    """Values (..., time) with NaN in the gaps."""
    return np.where(gaps, np.nan, values) if gaps.any() else values
