"""Modes from channels and what excited them: forces of a shaker or hammer, motions of a base.

The transform of a record over its whole length is the transfer function times that of the excitation, and the
difference of the free decays that begin with the state at its start and at its end. Both are in the fit, so
that no window is needed and nothing leaks.
"""

import numpy as np
import xarray as xr

from pymc_features._checks import as_list, message, shown
from pymc_features.ambient.bands import checked_bands
from pymc_features.modal.transfer import Experiment, Lines, TransferFit, fit_modes
from pymc_features.signals.channels import sampling_step, whole_values


def split_channels(channels: xr.DataArray, excitation) -> tuple[xr.DataArray, xr.DataArray]:
    """Responses and excitation, of which the names may be given."""
    if not isinstance(excitation, xr.DataArray):
        names = [excitation] if isinstance(excitation, str) else as_list(excitation)
        known = channels["sensor"].values.tolist()
        if not names or not all(name in known for name in names) or len(names) == len(known):
            listed = ", ".join(map(str, known))
            raise ValueError(
                message("excitation", f"some of the channels {listed}, or others", shown(excitation))
            )
        rest = [name for name in known if name not in names]
        return channels.sel(sensor=rest), channels.sel(sensor=names)
    step, other = sampling_step(channels), sampling_step(excitation)
    if excitation.sizes["time"] != channels.sizes["time"] or abs(step - other) > 1e-3 * step:
        expected = f"{channels.sizes['time']} samples at {step:.6g} s, as `channels`"
        got = f"{excitation.sizes['time']} samples at {other:.6g} s"
        raise ValueError(message("excitation", expected, got, "Resample one of them."))
    return channels, excitation


def fitted_bands(
    channels, excitation, bands, numbers, integrals: int
) -> list[tuple[np.ndarray, TransferFit]]:
    """Limits of each band, and the modes in it; `integrals` is how often the acceleration was integrated."""
    y, x, dt = whole_values(channels), whole_values(excitation), sampling_step(channels)
    n = y.shape[1]
    checked = checked_bands(bands, n, dt, integrals)
    at_y, at_x = (dt * np.fft.rfft(z) for z in (y, x))
    found = []
    for limits, first, last, number in zip(
        checked.limits, checked.starts[:-1], checked.starts[1:], numbers, strict=True
    ):
        bins = checked.bins[first:last][checked.weights[first:last] > 0.0]
        lines = Lines(bins / (n * dt), 2 - integrals, duration=n * dt, dt=dt, decays=True)
        experiment = Experiment(np.arange(len(x)), at_x[:, bins], at_y[:, bins])
        found.append((limits, fit_modes([experiment], lines, number)))
    return found


def rows_of_fit(fit: TransferFit) -> list[tuple]:
    """Frequency, damping ratio and shape of length one of each mode, and their standard deviations."""
    modes, rows = fit.modes, []
    k, n_in = modes.table.shape[1], modes.inputs.shape[1]
    covariance = fit.covariance
    for i, (w, z, shape) in enumerate(zip(modes.natural, modes.ratios, modes.outputs, strict=True)):
        own = covariance[i * k : (i + 1) * k, i * k : (i + 1) * k]
        sd, length = np.sqrt(np.diag(own).clip(min=0.0)), np.linalg.norm(shape)
        unit = shape / length
        turn = (np.eye(len(unit)) - np.outer(unit, unit)) / length
        of_shape = np.sqrt(np.diag(turn @ own[2 + n_in :, 2 + n_in :] @ turn).clip(min=0.0))
        f = w / (2.0 * np.pi)
        rows.append((f, z, unit, f * sd[0], z * sd[1], of_shape))
    return rows
