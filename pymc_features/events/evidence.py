"""The evidence that a sampler has left in its result."""

from typing import NamedTuple

import numpy as np
import xarray as xr

from pymc_features.smc import savable


class Evidence(NamedTuple):
    """ln Z and its standard error; NaN where the sampler has left none."""

    value: float
    error: float


UNKNOWN = Evidence(np.nan, np.nan)


def evidence_of(idata: xr.DataTree) -> Evidence:
    """What `sample`, `sample_smc`, `laplace` or `pm.sample_smc` has left.

    Of several chains the mean of the evidences; where a sampler gives no standard error, that of the mean
    from how far the chains are apart. The evidence of a stretched likelihood, of `calibrate`, is none.
    """
    if "sample_stats" not in idata.children or "calibration" in idata.children:
        return UNKNOWN
    summary = idata["sample_stats"].attrs
    if "log_evidence" in summary:
        return Evidence(float(summary["log_evidence"]), float(summary["log_evidence_se"]))
    stats = savable(idata)["sample_stats"].to_dataset()
    name = "log_marginal_likelihood"
    name = f"{name}_is" if f"{name}_is" in stats else name  # of `laplace`
    if name not in stats:
        return UNKNOWN
    values = np.asarray(stats[name].values, dtype=np.float64)
    weights = np.exp(values - values.max())
    value, n = float(values.max() + np.log(weights.mean())), len(values)
    if f"{name}_se" in stats:
        errors = np.asarray(stats[f"{name}_se"].values, dtype=np.float64)
        return Evidence(value, float(np.sqrt(((weights * errors) ** 2).sum()) / weights.sum()))
    return Evidence(value, float(weights.std(ddof=1) / weights.mean() / np.sqrt(n)) if n > 1 else np.nan)
