"""The study's result: sampled and exact statistics side by side."""

import numpy as np
import xarray as xr

from pymc_features.likelihoods import LIKELIHOODS
from pymc_features.likelihoods.exact.step import PARAMETERS, PROBABILITIES, STATISTICS
from pymc_features.likelihoods.free import exact_interval, exact_tolerance
from pymc_features.simulators import spring_forces


def assemble(study, parts: dict, shown) -> xr.DataTree:
    """Put the sampled parts and the exact posteriors side by side; see `sampling_rate_study`.

    `shown` is called with what is in work and the number of parts that are finished.
    """
    shape = (len(study.likelihoods), len(study.multipliers))
    arrays = {
        "sampled": np.full((*shape, len(PARAMETERS), len(STATISTICS)), np.nan),
        "exact": np.full((*shape, len(PARAMETERS), len(STATISTICS)), np.nan),
        "r_hat": np.full((*shape, len(PARAMETERS)), np.nan),
        "ess_bulk": np.full((*shape, len(PARAMETERS)), np.nan),
        "seconds": np.full(shape, np.nan),
        "log_evidence": np.full(shape, np.nan),
    }
    tolerance = np.full(len(study.multipliers), np.nan)
    interval = np.full((len(study.multipliers), 2), np.nan)
    for j, multiplier in enumerate(study.multipliers):
        shown(f"exact_x{multiplier:g}", len(parts) + j)
        step = study.misfit(multiplier)
        if "ABC" in study.likelihoods:
            tolerance[j], interval[j] = exact_tolerance(step), exact_interval(step)
        for i, kind in enumerate(study.likelihoods):
            part = parts[kind, multiplier]
            reference = LIKELIHOODS[kind].reference(step)
            arrays["exact"][i, j] = reference.statistics
            arrays["log_evidence"][i, j] = reference.log_evidence
            arrays["sampled"][i, j] = sampled_statistics(reference, part)
            arrays["r_hat"][i, j], arrays["ess_bulk"][i, j] = diagnostics(part)
            arrays["seconds"][i, j] = part.attrs["seconds"]
    dims = ("likelihood", "multiplier", "parameter", "statistic")
    summary = xr.Dataset(
        {name: (dims[: values.ndim], values) for name, values in arrays.items()},
        coords={
            "likelihood": list(study.likelihoods),
            "multiplier": list(study.multipliers),
            "parameter": list(PARAMETERS),
            "statistic": list(STATISTICS),
        },
    )
    summary["epsilon"] = ("multiplier", tolerance)
    summary["epsilon_interval"] = (("multiplier", "end"), interval)
    summary = summary.assign_coords(end=["low", "high"])
    summary["step"] = ("multiplier", np.array(study.multipliers) * study.record.dt, {"units": "s"})
    nodes = {f"/{kind}/x{m:g}": part for (kind, m), part in parts.items()}
    groups = {"/summary": summary, "/data": _data_group(study)}
    if not study.at().is_linear:
        groups["/loops"] = _loops_group(study)
    tree = xr.DataTree.from_dict(groups)
    for path, part in nodes.items():
        tree[path] = part
    tree.attrs = {key: value for key, value in study.settings().items() if not isinstance(value, list)}
    tree.attrs |= {"structure": study.structure.name, "title": study.title}
    return tree


def _data_group(study):
    record = study.record
    return xr.Dataset(
        {
            "ground_acceleration": ("record_time", record.acceleration, {"units": "m/s^2"}),
            "measured": study.finest.drop_attrs(),
        },
        coords={"record_time": ("record_time", record.time, {"units": "s"})},
        attrs={"record": record.name},
    )


def _loops_group(study):
    """Force and drift of every spring at the true theta, and the largest drift over that of yielding."""
    structure = study.at()
    loops = spring_forces(structure, study.record)[["force", "drift"]]
    limit = np.broadcast_to(structure.yield_displacement, structure.n_dof)
    loops["yield_displacement"] = ("spring", limit, {"units": "m"})
    loops["ductility"] = abs(loops["drift"]).max("time") / loops["yield_displacement"]
    return loops


def sampled_statistics(reference, part):
    """Return (parameter, statistic) of the draws; the maximum is the draw of the highest density."""
    posterior = part["posterior"]
    draws = {name: posterior[name].values.ravel() for name in PARAMETERS if name in posterior}
    best = reference.log_density(draws).argmax()
    table = np.full((len(PARAMETERS), len(STATISTICS)), np.nan)
    for name, values in draws.items():
        table[PARAMETERS.index(name)] = [values[best], *np.quantile(values, PROBABILITIES)]
    return table


def diagnostics(part):
    """R-hat and bulk effective sample size of each parameter; NaN where there is none."""
    import arviz as az  # here: half a second that a mere import of the package need not take

    posterior = part["posterior"].to_dataset()
    r_hat, ess = np.full(len(PARAMETERS), np.nan), np.full(len(PARAMETERS), np.nan)
    for k, name in enumerate(PARAMETERS):
        if name in posterior:
            if posterior.sizes["chain"] > 1:
                r_hat[k] = float(az.rhat(posterior[[name]])[name])
            ess[k] = float(az.ess(posterior[[name]], method="bulk")[name])
    return r_hat, ess
