"""What one run of a sampler gives, read from the DataTree that samplers of PyMC models return."""

from dataclasses import dataclass

import numpy as np
import xarray as xr

from benchmarks.known import flat_draws


@dataclass(frozen=True, eq=False)
class Run:
    """One run of one sampler.

    Attributes
    ----------
    draws : array (n, d)
        Equally weighted, in the order of the answer's labels.
    values, gradients : float
        Log-densities without and with gradient, warm-up included; NaN where the sampler does not tell.
    log_evidence, log_evidence_se : float
        NaN where the sampler gives none.
    counting : float
        Seconds that are not the sampler's.
    """

    draws: np.ndarray
    values: float
    gradients: float
    log_evidence: float = np.nan
    log_evidence_se: float = np.nan
    counting: float = 0.0


def total(idata, *names):
    """Sum of the first of these statistics that is there, warm-up included; NaN if none is."""
    sums = []
    for group in ("warmup_sample_stats", "sample_stats"):
        stats = idata[group] if group in idata.children else {}
        found = next((name for name in names if name in stats), None)
        if found is not None:
            sums.append(float(np.nansum(np.asarray(stats[found].values, dtype=float))))
    return sum(sums) if sums else np.nan


def of_search(idata):
    """Values and gradients of the search for modes, before the runs, of `pmf.sample`."""
    attributes = idata["sample_stats"].attrs if "sample_stats" in idata.children else {}
    return np.array([attributes.get(f"search_{kind}", 0.0) for kind in ("evaluations", "gradients")])


def evidence(idata):
    """Log evidence and its standard error: means of the chains'; the error falls with their number."""
    stats = idata["sample_stats"] if "sample_stats" in idata.children else {}
    if "log_marginal_likelihood" not in stats:
        return np.nan, np.nan
    of_chains = np.ravel(stats["log_marginal_likelihood"].values).astype(float)
    of_chains = of_chains[np.isfinite(of_chains)]
    error = np.nan
    if "log_marginal_likelihood_se" in stats:
        errors = np.ravel(stats["log_marginal_likelihood_se"].values).astype(float)
        errors = errors[np.isfinite(errors)]
        error = np.sqrt((errors**2).mean() / len(errors)) if len(errors) else np.nan
    return (float(of_chains.mean()) if len(of_chains) else np.nan), float(error)


def tree(parameters, evaluations, log_evidence, log_evidence_se=np.nan):
    """What samplers of PyMC models return, of one chain: its draws by name, and what they cost."""
    draws = {
        name: (("chain", "draw", *(f"{name}_dim_{i}" for i in range(np.ndim(x) - 1))), np.asarray(x)[None])
        for name, x in parameters.items()
    }
    found = {"log_marginal_likelihood": log_evidence, "log_marginal_likelihood_se": log_evidence_se}
    stats = {name: ("chain", [float(value)]) for name, value in found.items()}
    stats["evaluations"] = ("chain", [float(evaluations)])
    return xr.DataTree.from_dict({"posterior": xr.Dataset(draws), "sample_stats": xr.Dataset(stats)})


def of_idata(sample):
    """A sampler for the tables from `sample(model, seed) -> DataTree`.

    Statistics that are read where they are there: `evaluations` (or `values`), `gradients`, or where there is
    neither `n_steps`, of NUTS; `log_marginal_likelihood` and its `_se`.
    """

    def sampler(problem, seed):
        idata = sample(problem.model, seed)
        values, gradients = total(idata, "evaluations", "values"), total(idata, "gradients")
        if np.isnan(values) and np.isnan(gradients):
            gradients = total(idata, "n_steps")
        if np.isfinite(values) or np.isfinite(gradients):
            values, gradients = np.nan_to_num([values, gradients]) + of_search(idata)
        return Run(flat_draws(problem.model, idata), values, gradients, *evidence(idata))

    return sampler
