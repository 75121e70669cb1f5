"""What is told at once of bands and records that cannot say much."""

import os
import warnings

import numpy as np
import pymc as pm

from pymc_features.exceptions import AmbientWarning

_PACKAGE = os.path.dirname(os.path.dirname(__file__))
LIBRARIES = _PACKAGE, os.path.dirname(pm.__file__)
FEWEST_IN_PEAK = 4.0  # frequencies of the record in the half-power width of a mode


def warn_at_start(rv, response, bands) -> None:
    """Warn where at the model's initial point a band has no mode, or a mode in a band a peak too narrow."""
    model = pm.modelcontext(None)
    try:
        frequencies, ratios = model_values(model, [response.frequencies, response.damping_ratios])
    except Exception:  # what cannot be evaluated here is no error of the user's
        return
    duration = bands.n_samples * bands.dt
    for low, high in bands.limits:
        inside = (frequencies >= low) & (frequencies <= high)
        if not inside.any():
            near = frequencies[np.argmin(np.abs(np.log(frequencies / np.sqrt(low * high))))]
            tell(
                f"the band {low:g} to {high:g} Hz of {rv.name} has no mode at the model's initial point; the "
                f"nearest is at {near:.4g} Hz. Move the band, or the start of the parameters."
            )
        for f, zeta in zip(frequencies[inside], ratios[inside], strict=True):
            warn_of_peak(f"the mode of {rv.name} at {f:.4g} Hz", f, zeta, duration)


def warn_of_peak(what: str, f: float, zeta: float, duration: float) -> None:
    """Warn if a record of some seconds has few frequencies in the half-power width of a mode."""
    count = 2.0 * zeta * f * duration
    if count < FEWEST_IN_PEAK:
        tell(
            f"a record of {duration:.4g} s is short for {what} with {100.0 * zeta:.3g} % damping: "
            f"{count:.2g} of its frequencies lie in the half-power width. Its damping will be uncertain and "
            f"biased; {FEWEST_IN_PEAK / (2 * zeta * f):.3g} s and more are better."
        )


def tell(text: str) -> None:
    """Warn at the line that called into this package from outside."""
    warnings.warn(text, AmbientWarning, skip_file_prefixes=LIBRARIES)


def model_values(model, variables) -> list[np.ndarray]:
    """Values of variables at the initial point of a model."""
    function = model.compile_fn(
        model.replace_rvs_by_values(variables), mode="FAST_COMPILE", on_unused_input="ignore"
    )
    return function(model.initial_point())
