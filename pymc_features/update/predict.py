"""What the posterior says of the measured responses and of natural frequencies, and what the data say."""

import numpy as np
import pymc as pm
import xarray as xr

from pymc_features.exceptions import ConfigError
from pymc_features.prediction import posterior_response
from pymc_features.update.problem.coarseness import coarse_sampling
from pymc_features.update.problem.kinds import KINDS
from pymc_features.update.problem.structure import modes_of

QUANTILES = (0.05, 0.5, 0.95)
DRAWS = 200
MODAL_DRAWS = 500
PROMINENCE = 2.0  # of a peak of the gain over the valleys beside it, a factor


def thinned(posterior: xr.Dataset, draws: int) -> xr.Dataset:
    """At most `draws` draws, evenly spaced along each chain."""
    n = posterior.sizes["draw"]
    wanted = min(n, max(1, draws // posterior.sizes["chain"]))
    return posterior.isel(draw=(np.arange(wanted) * n / wanted).astype(int))


def bands(problem, kind, model, idata) -> xr.Dataset:
    """Bands of the response and of data like those measured, at the sensors.

    Returns
    -------
    Dataset
        `response` (quantile, sensor, time), of the parameters' uncertainty alone; `predictive`, the same
        of draws of the likelihood, errors included (ABC has none); `normalised_error` (sensor), rms of
        measured less median response over rms measured; `coverage` (sensor), share of the samples in the
        predictive band, both without the gaps in what was measured; `coarseness` (sensor), see
        `coarse_sampling`. Peaks of other responses
        (`<quantity>_peak`) if the report asks for them.
    """
    measured = problem.measured
    usual = problem.quantity
    settings = {"draws": DRAWS, "quantiles": QUANTILES, "random_seed": 0}
    settings |= {"dt": measured.step, "n_modes": problem.structure.n_modes}
    at_sensors = posterior_response(
        idata, problem.structure, measured.record, usual, sensors=problem.dofs, **settings
    )
    observed = measured.channels
    coords = {"quantile": list(QUANTILES), "sensor": observed["sensor"], "time": observed["time"]}
    dims = ("quantile", "sensor", "time")
    compared = at_sensors[usual].values[..., measured.compared]
    found = xr.Dataset({"response": (dims, compared)}, coords=coords)
    if problem.is_cyclic:
        found = found.assign_coords(displacement=("time", measured.record.displacement))
    if not problem.is_cyclic:
        ratios = coarse_sampling(problem, idata["posterior"], found["response"])
        found["coarseness"] = "sensor", ratios
    off = observed - found["response"].sel(quantile=0.5, drop=True)
    with np.errstate(divide="ignore", invalid="ignore"):  # of a channel of zeros
        found["normalised_error"] = np.sqrt((off**2).mean("time") / (observed**2).mean("time"))
    if not KINDS[kind].is_likelihood_free:
        found["predictive"] = dims, predictive(model, idata)
        low, high = found["predictive"].isel(quantile=0), found["predictive"].isel(quantile=-1)
        inside = ((observed >= low) & (observed <= high)).where(observed.notnull())
        found["coverage"] = inside.mean("time")
    if problem.config.report.quantities:
        rest = posterior_response(
            idata, problem.structure, measured.record, problem.config.report.quantities, **settings
        )
        for name in problem.config.report.quantities:
            peak = rest[f"{name}_peak"]
            rows = {dim: f"{name}_{dim}" for dim in peak.dims if dim != "sample"}
            kept = peak.rename(rows).quantile(QUANTILES, dim="sample", keep_attrs=True)
            found[f"{name}_peak"] = kept.drop_vars([c for c in kept.coords if c not in kept.dims])
    return found


def predictive(model, idata) -> np.ndarray:
    """Quantiles (quantile, sensor, time) of draws of the data."""
    posterior = thinned(idata["posterior"].to_dataset(), DRAWS)
    drawn = pm.sample_posterior_predictive(
        xr.DataTree.from_dict({"posterior": posterior}),
        model=model,
        var_names=["y"],
        random_seed=0,
        progressbar=False,
        compile_kwargs={"mode": "FAST_COMPILE"},
    )
    values = drawn["posterior_predictive"]["y"].values
    return np.nanquantile(values.reshape(-1, *values.shape[2:]), QUANTILES, axis=0)


def frequencies(problem, idata) -> xr.Dataset:
    """Natural frequencies [Hz] and damping ratios [-] of draws (chain, draw, mode); NaN if impossible."""
    posterior = thinned(idata["posterior"].to_dataset()[problem.structure.names], MODAL_DRAWS)
    columns = {name: posterior[name].transpose("chain", "draw").values for name in problem.structure.names}
    shape = posterior.sizes["chain"], posterior.sizes["draw"]
    found = None
    for index in np.ndindex(shape):
        try:
            structure = problem.structure(**{name: float(c[index]) for name, c in columns.items()})
            modes = modes_of(structure, problem.structure.n_modes)
        except (ValueError, ArithmeticError, np.linalg.LinAlgError):
            continue
        if found is None:
            found = np.full((2, *shape, len(modes.natural_frequencies)), np.nan)
        found[(slice(None), *index)] = modes.natural_frequencies, modes.damping_ratios
    if found is None:
        raise ConfigError("`structure` must have natural frequencies, got none at any draw of the posterior.")
    dims = ("chain", "draw", "mode")
    parts = {
        "natural_frequency": (dims, found[0], {"units": "Hz"}),
        "damping_ratio": (dims, found[1], {"units": "1"}),
    }
    coords = {"chain": posterior["chain"], "draw": posterior["draw"], "mode": 1 + np.arange(found.shape[-1])}
    return xr.Dataset(parts, coords=coords)


def measured_gain(problem) -> tuple[xr.DataArray, np.ndarray]:
    """Gain of each sensor against the base (sensor, frequency) [-], and the frequencies of its peaks [Hz].

    The root of S_yy / S_xx by Welch's method, half-overlapping Hann windows of a third of the record: where a
    structure rings for longer than a window, a cross-spectrum would cancel at its natural frequencies. Peaks
    are those of the root mean square over sensors, where the base moves and they stand out twofold.
    """
    from scipy import signal  # a second to import

    channels, step = problem.measured.channels, problem.measured.step
    base = problem.measured.base
    size = max(min(64, base.size), base.size // 3)
    settings = {"fs": 1.0 / step, "nperseg": size, "nfft": 4 * size}
    frequency, power = signal.welch(base, **settings)
    answer = signal.welch(np.nan_to_num(channels.values), **settings)[1]
    answer *= channels.sizes["time"] / problem.measured.samples[:, None]  # gaps have no power
    gain = np.sqrt(answer / np.maximum(power, 1e-6 * power.max()))
    total = np.log(np.maximum(np.sqrt((gain**2).mean(axis=0)), 1e-12))
    peaks, _ = signal.find_peaks(total, prominence=np.log(PROMINENCE))
    peaks = peaks[(power[peaks] > 1e-4 * power.max()) & (total[peaks] > 0.0)]
    dims, coords = ("sensor", "frequency"), {"sensor": channels["sensor"].values, "frequency": frequency}
    return xr.DataArray(gain, coords, dims), frequency[peaks]
