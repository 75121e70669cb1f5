"""What the priors expect of a structure and of its responses, before anything is sampled."""

import warnings

import numpy as np
import xarray as xr

from pymc_features.exceptions import PredictionWarning
from pymc_features.prediction import posterior_response
from pymc_features.update.kinds.structure import modes_of
from pymc_features.update.plausibility.bands import QUANTILES, prior_bands

DRAWS = 200
FIRST = 5  # natural frequencies


def expected_bands(data, problem) -> np.ndarray:
    """Quantiles (quantile, sensor, time) of the responses that the priors expect where the sensors are."""
    measured = data.measured
    prior, record, stride = (
        measured.checked.compared.prior,
        measured.record,
        round(measured.step / measured.record.dt),
    )
    if prior.is_linear:
        found = prior_bands(record.acceleration, record.dt, prior, data.dofs, data.quantity)
        return found[..., ::stride][..., measured.compared]
    draws = xr.Dataset({name: (("chain", "draw"), values[None]) for name, values in prior.values.items()})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PredictionWarning)
        found = posterior_response(
            draws,
            problem.structure,
            record,
            data.quantity,
            sensors=data.dofs,
            dt=measured.step,
            draws=DRAWS,
            quantiles=QUANTILES,
        )[data.quantity]
    return found.transpose("quantile", ..., "time").values[..., measured.compared]


def structure_sentence(problem) -> str:
    """Mass and first frequencies of the structure at the medians of the priors."""
    medians = {name: problem.priors[name].median for name in problem.structure.names}
    at_medians = problem.structure(**medians)
    found = modes_of(at_medians, FIRST).natural_frequencies[:FIRST]
    influence = getattr(at_medians, "influence", None)
    moved = np.sum(at_medians.mass if influence is None else influence * (at_medians.mass @ influence))
    numbers = ", ".join(f"{frequency:.4g}" for frequency in found)
    given = problem.config.report.natural_frequencies
    beside = ""
    if given is not None:
        beside = f" (natural_frequencies: {', '.join(f'{frequency:.4g}' for frequency in given)} Hz)"
    return (
        f"structure: {at_medians.n_dof} degrees of freedom, {moved:.4g} kg that the base moves; natural "
        f"frequencies at the medians of the priors: {numbers} Hz{beside}"
    )
