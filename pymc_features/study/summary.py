"""The study's result: sampled and exact statistics side by side."""

import numpy as np
import xarray as xr

from pymc_features.study import paper
from pymc_features.study.quadrature import (
    DiscrepancyCurve,
    exact_posterior,
    exponents,
    tolerance_interval,
)

PARAMETERS = ("theta", "sigma")
STATISTICS = ("map", "q05", "q50", "q95")
PROBABILITIES = (0.05, 0.5, 0.95)


def assemble(study, parts: dict) -> xr.DataTree:
    """Put the sampled parts and the exact posteriors side by side; see `sampling_rate_study`."""
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
    for j, multiplier in enumerate(study.multipliers):
        data = study.data(multiplier)
        curve = DiscrepancyCurve(study.total_discrepancy(multiplier), paper.THETA_RANGE, data.size)
        for i, kind in enumerate(study.likelihoods):
            part = parts[kind, multiplier]
            delta = part.attrs.get("tolerance")
            tolerance[j] = tolerance[j] if delta is None else delta
            exact, evidence = exact_statistics(kind, curve, data, delta)
            arrays["exact"][i, j] = exact
            arrays["log_evidence"][i, j] = evidence
            arrays["sampled"][i, j] = sampled_statistics(kind, curve, data, part)
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
    summary["tolerance"] = ("multiplier", tolerance)
    summary["step"] = ("multiplier", np.array(study.multipliers) * study.record.dt, {"units": "s"})
    nodes = {f"/{kind}/x{m:g}": part for (kind, m), part in parts.items()}
    tree = xr.DataTree.from_dict({"/summary": summary, "/data": _data_group(study)})
    for path, part in nodes.items():
        tree[path] = part
    tree.attrs = {key: value for key, value in study.settings().items() if not isinstance(value, list)}
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


def exact_statistics(kind, curve, data, delta):
    """Return (parameter, statistic) by quadrature, and the log evidence."""
    if kind == "ABC":
        low, high = tolerance_interval(curve, delta)
        theta = [curve.minimiser, *(low + np.array(PROBABILITIES) * (high - low))]
        prior = paper.THETA_RANGE[1] - paper.THETA_RANGE[0]
        return np.array([theta, [np.nan] * 4]), np.log((high - low) / prior)
    posterior = exact_posterior(curve, exponents(kind, *data.shape), paper.SIGMA_RANGE)
    rows = [
        [best, *marginal.quantile(PROBABILITIES)]
        for best, marginal in zip(posterior.map, (posterior.theta, posterior.sigma), strict=True)
    ]
    return np.array(rows), posterior.log_evidence


def sampled_statistics(kind, curve, data, part):
    """Return (parameter, statistic) of the draws; the maximum is the draw of the highest density."""
    posterior = part["posterior"]
    theta = posterior["theta"].values.ravel()
    discrepancy = np.interp(theta, curve.theta, curve.values)
    if kind == "ABC":
        row = [theta[discrepancy.argmin()], *np.quantile(theta, PROBABILITIES)]
        return np.array([row, [np.nan] * 4])
    sigma = posterior["sigma"].values.ravel()
    likelihood = exponents(kind, *data.shape)
    density = -likelihood.m * np.log(sigma) - likelihood.c * discrepancy / (2.0 * sigma**2)
    best = density.argmax()
    return np.array([[v[best], *np.quantile(v, PROBABILITIES)] for v in (theta, sigma)])


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
