"""Results of `pm.sample_smc` that can be saved."""

import json

import numpy as np
import xarray as xr
from pymc.distributions.simulator import SimulatorRV
from pytensor.graph.basic import Constant

PER_CHAIN = ("log_marginal_likelihood", "log_marginal_likelihood_se", "ess", "pareto_k", "largest_share")


def savable(idata: xr.DataTree) -> xr.DataTree:
    """Return the result with per-stage statistics as float arrays (chain, stage), padded with NaN.

    With more than one chain, `pm.sample_smc` returns them as object arrays or lists of unequal lengths,
    which neither netCDF nor Zarr can hold.

    Parameters
    ----------
    idata : DataTree
        As `pm.sample_smc` returns it; left as it is.

    Returns
    -------
    DataTree
        The same groups; `sample_stats` has the dimensions (chain, stage), but for
        `log_marginal_likelihood`, its standard error, `ess`, `pareto_k` and `largest_share`, which belong to
        the chain.
    """
    result = idata.copy()
    if "sample_stats" not in result.children:
        return result
    stats = result["sample_stats"].to_dataset()
    chains = np.atleast_1d(result["posterior"]["chain"].values)
    padded = {
        name: (("chain", "stage"), pad_stages(variable.values, len(chains)))
        for name, variable in stats.data_vars.items()
    }
    lengths = {values.shape[1] for _, values in padded.values()}
    n_stages = max(lengths, default=0)
    padded = {
        name: (
            dims,
            np.pad(values, [(0, 0), (0, n_stages - values.shape[1])], constant_values=np.nan),
        )
        for name, (dims, values) in padded.items()
    }
    for name in PER_CHAIN:
        if name in padded:
            padded[name] = (("chain",), last_values(padded[name][1]))
    attrs = {key: _plain(value) for key, value in stats.attrs.items()}
    coords = {"chain": chains, "stage": np.arange(n_stages)}
    result["sample_stats"] = xr.DataTree(xr.Dataset(padded, coords=coords, attrs=attrs))
    return result


def last_values(stages) -> np.ndarray:
    """The last number of each chain (chain,); NaN where there is none."""
    numbers = [row[~np.isnan(row)] for row in stages]
    return np.array([row[-1] if row.size else np.nan for row in numbers])


def pad_stages(values, n_chains: int) -> np.ndarray:
    """Return ragged per-chain lists as a float array (chain, stage), NaN behind each end."""
    values = np.asarray(values)
    if values.dtype != object and values.ndim == 2 and values.shape[0] == n_chains:
        return values.astype(np.float64)
    rows = list(values) if n_chains > 1 else [np.ravel(values)]
    rows = [np.ravel(np.asarray(row, dtype=np.float64)) for row in rows]
    padded = np.full((n_chains, max(map(len, rows))), np.nan)
    for row, stages in zip(padded, rows, strict=True):
        row[: len(stages)] = stages
    return padded


def _plain(value):
    """Attribute values that netCDF can hold."""
    return value if isinstance(value, str | int | float | np.number) else str(value)


def likelihood_kinds(model) -> str:
    """What each likelihood of a model is a density of, as JSON: by this evidences can be compared.

    "data" of PyMC's distributions and of ours with ``density="data"``; the class of those of a feature; of a
    simulator node the tolerance.
    """
    return json.dumps({rv.name: kind_of_density(rv.owner.op) for rv in model.observed_RVs}, sort_keys=True)


def kind_of_density(op) -> str:
    """What one likelihood is a density of."""
    if isinstance(op, SimulatorRV):
        epsilon = op.epsilon.data.tolist() if isinstance(op.epsilon, Constant) else "of pm.Data"
        return f"simulator with tolerance {epsilon}"
    density = getattr(op, "density", "data")
    return "data" if density == "data" else f"{density} of {type(op).__name__.removesuffix('RV')}"
