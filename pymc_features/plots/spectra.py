"""Spectra of channels, poles against the order of a model, and frequency response functions."""

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from pymc_features._checks import as_numbers, message, shown
from pymc_features.modal.data import ModalData
from pymc_features.plots.axes import AxesLike, check_dataset, checked_axes, figure
from pymc_features.signals import sampling_step
from pymc_features.signals.channels import whole_values
from pymc_features.signals.spectra import averaged_spectra

BESIDE = 1.25  # of the highest band: what is drawn
HERTZ = "Pass them in Hz."
DECADES = 6.0  # below the largest value


@figure("One", "array of one matplotlib Axes")
def singular_values(
    channels: xr.DataArray,
    bands: ArrayLike | None = None,
    *,
    frequencies: ArrayLike | None = None,
    fitted: xr.Dataset | None = None,
    axes: AxesLike = None,
) -> np.ndarray:
    """Singular values of the spectra of all channels against each other: peaks are modes, or machines.

    Spectra are averaged over twenty parts of the record (Welch), as `ambient.propose_bands` sees them.

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
    """
    spectra = averaged_spectra(whole_values(channels), sampling_step(channels))
    f, levels = spectra.frequencies[1:], spectra.singular_values[1:]
    limits = np.atleast_2d(as_numbers(np.empty((0, 2)) if bands is None else bands, "bands", HERTZ))
    if limits.shape[1:] != (2,) or not (limits[:, 0] < limits[:, 1]).all():
        raise ValueError(message("bands", "rising pairs of frequencies in Hz", shown(bands)))
    marked = np.ravel(as_numbers([] if frequencies is None else frequencies, "frequencies", HERTZ))
    if fitted is not None:
        check_dataset(fitted, "fitted", "`spectra` of a likelihood of `run_update`", "response")
    [ax] = axes = checked_axes(axes, figsize=(9.0, 4.0))
    for number, values in enumerate(levels.T):
        ax.plot(f, values, color="0.6" if number else "0.15", lw=0.7 if number else 1.2)
    for low, high in limits:
        ax.axvspan(low, high, color="C0", alpha=0.12, lw=0.0)
    for value in marked:
        ax.axvline(value, color="0.4", ls=":", lw=0.9, zorder=0)
    if fitted is not None and fitted["frequency"].size:
        draw_fitted(ax, fitted["frequency"].values, fitted["response"])
    seen = f <= BESIDE * limits.max(initial=f[-1] if not limits.size else 0.0)
    drawn, top = levels[seen], float(levels[seen, 0].max())
    ax.set(yscale="log", xlabel="frequency [Hz]", ylabel="singular values [(m/s²)²/Hz]")
    ax.set_xlim(0.0, f[seen][-1])
    if top > 0.0:
        lowest = float(drawn[drawn > 0.0].min())
        ax.set_ylim(max(0.5 * lowest, top / 10.0**DECADES), 3.0 * top)
    return axes


@figure("One", "array of one matplotlib Axes")
def stabilisation(poles: xr.Dataset, modes: ModalData | None = None, *, axes: AxesLike = None) -> np.ndarray:
    """Stabilisation diagram: poles of state-space models of rising order.

    Poles that stay where they are as the order rises, in frequency (5 %), damping (10 %) and shape (MAC
    0.95), are drawn large, with two standard deviations to both sides; identified modes are vertical bands
    of the same width.

    Parameters
    ----------
    poles : Dataset
        What `ambient.subspace_poles` returned.
    modes : modal.ModalData, optional
        To compare with, such as `identify_modes` returned.
    """
    names = "order", "frequency", "frequency_sd", "is_stable"
    check_dataset(poles, "poles", "what `ambient.subspace_poles` returned", *names)
    if modes is not None and not isinstance(modes, ModalData):
        raise TypeError(message("modes", "`modal.ModalData`", shown(modes)))
    [ax] = axes = checked_axes(axes, figsize=(9.0, 4.5))
    stable = poles["is_stable"].values
    order, f, sd = (poles[name].values for name in names[:3])
    ax.plot(f[~stable], order[~stable], ".", color="0.7", ms=3.0, label="other poles")
    bars = {"color": "C0", "ms": 4.0, "elinewidth": 0.8, "label": "stable poles"}
    ax.errorbar(f[stable], order[stable], xerr=2.0 * np.nan_to_num(sd[stable]), fmt="o", **bars)
    if modes is not None:
        widths = np.zeros(len(modes)) if modes.frequency_sd is None else 2.0 * modes.frequency_sd
        for mode, width in zip(modes.frequencies, widths, strict=True):
            ax.axvspan(mode - width, mode + width, color="C1", alpha=0.5, lw=1.0, zorder=0)
    ax.set(xlabel="frequency [Hz]", ylabel="order of the model", ylim=(0, order.max(initial=1) + 1))
    ax.set_xlim(0.0, poles.attrs["highest_frequency"])
    ax.legend(loc="upper right", fontsize="small")
    return axes


@figure("One for each response", "array of matplotlib Axes")
def response_functions(functions: xr.Dataset, axes: AxesLike = None) -> np.ndarray:
    """Magnitudes of frequency response functions: measured, and the median and 5 to 95 % of a model.

    Parameters
    ----------
    functions : Dataset
        `functions` of a likelihood of `run_update`: `size` (quantile, response, reference, frequency) and
        `measured`, without quantiles.
    """
    check_dataset(functions, "functions", "`functions` of a likelihood of `run_update`", "size", "measured")
    f, responses = functions["frequency"].values, functions["response"].values
    axes = checked_axes(axes, len(responses), "response", figsize=(9.0, 2.6 * len(responses)), sharex=True)
    for ax, label in zip(axes, responses, strict=True):
        for i, reference in enumerate(functions["reference"].values):
            low, middle, high = functions["size"].sel(response=label, reference=reference).values
            ax.fill_between(f, low, high, color=f"C{i}", alpha=0.25, lw=0.0)
            ax.plot(f, middle, color=f"C{i}", lw=0.8, ls="--")
            measured = functions["measured"].sel(response=label, reference=reference)
            ax.plot(f, measured, color=f"C{i}", lw=1.0, label=f"{reference}")
        ax.set(yscale="log", ylabel=f"{label} [{functions.attrs['units']}]")
    axes[0].legend(title="reference", ncols=6, fontsize="small")
    axes[-1].set_xlabel("frequency [Hz]")
    return axes


def draw_fitted(ax, f: np.ndarray, response: xr.DataArray) -> None:
    """Intervals and medians of the singular values that a model makes, each band a curve of its own."""
    step = np.diff(f).min() if f.size > 1 else 1.0
    for part in np.split(np.arange(f.size), np.flatnonzero(np.diff(f) > 1.5 * step) + 1):
        for value in response["value"].values:
            low, middle, high = response.sel(value=value).isel(frequency=part).values
            ax.fill_between(f[part], low, high, color="C3", alpha=0.25, lw=0.0)
            ax.plot(f[part], middle, color="C3", lw=1.2 if value == 1 else 0.8)
