"""Singular values of the spectra of channels, with the bands of frequency and what a model makes of them."""

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from pymc_features._checks import as_numbers, check_finite, message, shown
from pymc_features.plots.drawing.axes import AxesLike, checked_axes
from pymc_features.signals import sampling_step
from pymc_features.signals.channels import whole_values
from pymc_features.signals.spectra import averaged_spectra

BESIDE = 1.25  # of the highest band: what is drawn
DECADES = 6.0  # below the largest value


def plot_singular_values(
    channels: xr.DataArray,
    bands: ArrayLike | None = None,
    *,
    frequencies: ArrayLike | None = None,
    fitted: xr.Dataset | None = None,
    axes: AxesLike = None,
) -> np.ndarray:
    """Singular values of the spectra of all channels against each other: peaks are modes, or machines.

    Spectra are averaged over twenty parts of the record (Welch), as `propose_bands` sees them.

    Parameters
    ----------
    channels : DataArray (sensor, time)
        As `read_channels` returns them, without gaps.
    bands : array_like (band, 2), optional
        Lower and upper ends of bands [Hz] to shade.
    frequencies : array_like (n,), optional
        To mark [Hz], such as those that were identified.
    fitted : Dataset, optional
        What a model makes of them: `response` (quantile, value, frequency), as in a likelihood of
        `run_update`.
    axes : matplotlib Axes, optional
        A new figure by default.

    Returns
    -------
    array of one matplotlib Axes
    """
    spectra = averaged_spectra(whole_values(channels), sampling_step(channels))
    f, levels = spectra.frequencies[1:], spectra.singular_values[1:]
    limits = np.empty((0, 2)) if bands is None else checked_limits(bands)
    marked = np.empty(0) if frequencies is None else checked_frequencies(frequencies)
    if not (fitted is None or (isinstance(fitted, xr.Dataset) and "response" in fitted)):
        advice = "Pass `spectra` of a likelihood of `run_update`."
        raise TypeError(message("fitted", "a Dataset with `response`", shown(fitted), advice))
    [ax] = axes = checked_axes(axes, figsize=(9.0, 4.0))
    for number, values in enumerate(levels.T):
        ax.plot(f, values, color="0.15" if number == 0 else "0.6", lw=1.2 if number == 0 else 0.7)
    for low, high in limits:
        ax.axvspan(low, high, color="C0", alpha=0.12, lw=0.0)
    for value in marked:
        ax.axvline(value, color="0.4", ls=":", lw=0.9, zorder=0)
    if fitted is not None:
        draw_fitted(ax, fitted)
    seen = f <= min(f[-1], BESIDE * limits.max() if limits.size else f[-1])
    top = float(levels[seen, 0].max())
    drawn = levels[seen]
    ax.set(
        yscale="log", xlabel="frequency [Hz]", ylabel="singular values [(m/s²)²/Hz]", xlim=(0.0, f[seen][-1])
    )
    if top > 0.0:
        lowest = float(drawn[drawn > 0.0].min())
        ax.set_ylim(max(0.5 * lowest, top / 10.0**DECADES), 3.0 * top)
    return axes


def checked_limits(bands) -> np.ndarray:
    """Pairs of rising frequencies (band, 2)."""
    limits = np.atleast_2d(as_numbers(bands, "bands", "Pass pairs in Hz."))
    if limits.ndim != 2 or limits.shape[1] != 2 or not limits.size:
        raise ValueError(message("bands", "pairs of frequencies (band, 2)", limits.shape))
    check_finite(limits, "bands")
    if not (limits[:, 0] < limits[:, 1]).all():
        raise ValueError(message("bands", "pairs of rising frequencies in Hz", limits.tolist()))
    return limits


def checked_frequencies(frequencies) -> np.ndarray:
    """Frequencies in a row."""
    marked = as_numbers(frequencies, "frequencies", "Pass them in Hz.")
    if marked.ndim != 1:
        raise ValueError(message("frequencies", "a list of frequencies in Hz", marked.shape))
    check_finite(marked, "frequencies")
    if (marked < 0.0).any():
        raise ValueError(message("frequencies", "at least zero", marked.tolist()))
    return marked


def draw_fitted(ax, fitted) -> None:
    """Intervals and medians of the singular values that a model makes, each band a curve of its own."""
    f, found = fitted["frequency"].values, fitted["response"]
    if not f.size:
        return
    step = np.diff(f).min() if f.size > 1 else 1.0
    starts = np.flatnonzero(np.diff(f) > 1.5 * step) + 1
    for part in np.split(np.arange(f.size), starts):
        for value in found["value"].values:
            low, middle, high = found.sel(value=value).isel(frequency=part).values
            ax.fill_between(f[part], low, high, color="C3", alpha=0.25, lw=0.0)
            ax.plot(f[part], middle, color="C3", lw=1.2 if value == 1 else 0.8)
