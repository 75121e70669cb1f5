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
    cells, tolerances, intervals = {}, [], []
    for j, multiplier in enumerate(study.multipliers):
        shown(f"exact_x{multiplier:g}", len(parts) + j)
        step, has_abc = study.misfit(multiplier), "ABC" in study.likelihoods
        tolerances.append(exact_tolerance(step) if has_abc else np.nan)
        intervals.append(exact_interval(step) if has_abc else (np.nan, np.nan))
        for kind in study.likelihoods:
            cells[kind, multiplier] = cell(LIKELIHOODS[kind].reference(step), parts[kind, multiplier])
    dims = ("likelihood", "multiplier", "parameter", "statistic")
    table = {}
    for name in cells[kind, multiplier]:
        rows = [[cells[kind, m][name] for m in study.multipliers] for kind in study.likelihoods]
        table[name] = (dims[: np.ndim(rows)], np.array(rows))
    table["epsilon"] = ("multiplier", tolerances)
    table["epsilon_interval"] = (("multiplier", "end"), intervals)
    table["step"] = ("multiplier", np.array(study.multipliers) * study.record.dt, {"units": "s"})
    labels = list(study.likelihoods), list(study.multipliers), list(PARAMETERS), list(STATISTICS)
    coords = dict(zip(dims, labels, strict=True)) | {"end": ["low", "high"]}
    groups = {"/summary": xr.Dataset(table, coords), "/data": data_of(study)}
    if not study.at().is_linear:
        groups["/loops"] = loops_of(study)
    tree = xr.DataTree.from_dict(groups)
    for (kind, multiplier), part in parts.items():
        tree[f"/{kind}/x{multiplier:g}"] = part
    tree.attrs = {key: value for key, value in study.settings().items() if not isinstance(value, list)}
    tree.attrs |= {"structure": study.structure.name, "title": study.title}
    return tree


def data_of(study) -> xr.Dataset:
    """The record, and the finest measurements."""
    record = study.record
    return xr.Dataset(
        {
            "ground_acceleration": ("record_time", record.acceleration, {"units": "m/s^2"}),
            "measured": study.finest.drop_attrs(),
        },
        coords={"record_time": ("record_time", record.time, {"units": "s"})},
        attrs={"record": record.name},
    )


def loops_of(study) -> xr.Dataset:
    """Force and drift of every spring at the true theta, and the largest drift over that of yielding."""
    structure = study.at()
    loops = spring_forces(structure, study.record)[["force", "drift"]]
    limit = np.broadcast_to(structure.yield_displacement, structure.n_dof)
    loops["yield_displacement"] = ("spring", limit, {"units": "m"})
    loops["ductility"] = abs(loops["drift"]).max("time") / loops["yield_displacement"]
    return loops


def cell(reference, part) -> dict:
    """What is said of one likelihood at one sampling step; NaN of parameters that it does not infer.

    The maximum of the draws is the draw of the highest density. There is no R-hat of one chain.
    """
    import arviz as az  # here: half a second that a mere import of the package need not take

    posterior = part["posterior"].to_dataset()
    draws = {name: posterior[name].values.ravel() for name in PARAMETERS if name in posterior}
    best = reference.log_density(draws).argmax()
    sampled = np.full((len(PARAMETERS), len(STATISTICS)), np.nan)
    r_hat, ess = np.full(len(PARAMETERS), np.nan), np.full(len(PARAMETERS), np.nan)
    for name, values in draws.items():
        k = PARAMETERS.index(name)
        sampled[k] = [values[best], *np.quantile(values, PROBABILITIES)]
        if posterior.sizes["chain"] > 1:
            r_hat[k] = float(az.rhat(posterior[[name]])[name])
        ess[k] = float(az.ess(posterior[[name]], method="bulk")[name])
    of_part = {"seconds": part.attrs["seconds"], "log_evidence": reference.log_evidence}
    return {"sampled": sampled, "exact": reference.statistics, "r_hat": r_hat, "ess_bulk": ess, **of_part}
