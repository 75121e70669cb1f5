"""Residuals of data with gaps: what stands in their place where it is estimated how errors persist.

A score is a sum over the samples that were measured: there residuals and sensitivities are zero in the gaps,
and nothing else is needed. The spectrum of the errors is that of whole series. In a gap of any sensor the
residuals of all, and their responses, are taken in reverse order from beside it, half from before and half
from behind: errors seen backwards have the same spectrum, amplitude and share in common.
"""

import numpy as np
from pytensor.compile.mode import Mode

from pymc_features.distributions.feature import FeatureRV

MOST = 0.4  # share of the record in gaps of one sensor or another; of more the intervals become too narrow


def check_gaps(model) -> None:
    """Refuse gaps in what is no feature likelihood, and more of them than leave a spectrum to be seen."""
    for rv in model.observed_RVs:
        data = model.rvs_to_values[rv].eval(mode=Mode(linker="py", optimizer=None))
        gaps = np.isnan(data)
        if not gaps.any():
            continue
        if not isinstance(rv.owner.op, FeatureRV):
            raise ValueError(
                f"`model` must have data without gaps, got NaN in {rv.name}. Leave them out by a feature "
                "likelihood, or compare a part of the record without gaps."
            )
        share = gaps.reshape(-1, gaps.shape[-1]).any(axis=0).mean()
        if share > MOST:
            raise ValueError(
                f"`model` must have all sensors for {100 * (1 - MOST):.0f} % of the record or more, so that "
                f"residuals tell how errors persist, got {100 * (1 - share):.0f} % in {rv.name}. Compare a "
                "part with fewer gaps, or leave out the sensor that has most of them."
            )


def mirrored(gaps) -> np.ndarray:
    """For each sample (time,) itself or, in a gap, the one that stands in for it: beyond the nearer end."""
    n, at = gaps.size, np.arange(gaps.size)
    known = np.flatnonzero(~gaps)
    for first, last in np.flatnonzero(np.diff(np.r_[False, gaps, False].astype(np.int8))).reshape(-1, 2):
        for k in range(first, last):
            ends = (2 * first - 1 - k, 2 * last - 1 - k)
            if 2 * k >= first + last - 1:
                ends = ends[::-1]
            inside = [end for end in ends if 0 <= end < n and not gaps[end]]
            at[k] = inside[0] if inside else known[np.abs(known - k).argmin()]
    return at
