"""Modes from channels and what excited them: forces of a shaker or hammer, motions of a base.

The transform of a record over its whole length is the transfer function times that of the excitation, and the
difference of the free decays that begin with the state at its start and at its end. Both are in the fit, so
that no window is needed and nothing leaks.
"""

import numpy as np
import xarray as xr

from pymc_features._checks import as_list, message, require, shown
from pymc_features.ambient.bands import checked_bands
from pymc_features.modal.transfer import (
    BEYOND,
    NEAR,
    Experiment,
    Lines,
    TransferFit,
    fit_modes,
    without_modes,
)
from pymc_features.signals.channels import sampling_step, whole_values

SWEEPS = 2  # over bands, each without what the modes of the others move in it


def split_channels(channels: xr.DataArray, excitation) -> tuple[xr.DataArray, xr.DataArray]:
    """Responses and excitation, of which the names may be given."""
    if not isinstance(excitation, xr.DataArray):
        names = [excitation] if isinstance(excitation, str) else as_list(excitation)
        known = channels["sensor"].values.tolist()
        are_some = names and all(name in known for name in names) and len(names) < len(known)
        what = f"some of the channels {', '.join(map(str, known))}, or others"
        require(are_some, message("excitation", what, shown(excitation)))
        rest = [name for name in known if name not in names]
        return channels.sel(sensor=rest), channels.sel(sensor=names)
    step, other = sampling_step(channels), sampling_step(excitation)
    n, n_other = channels.sizes["time"], excitation.sizes["time"]
    expected, got = f"{n} samples at {step:.6g} s, as `channels`", f"{n_other} samples at {other:.6g} s"
    fits = n == n_other and abs(step - other) <= 1e-3 * step
    require(fits, message("excitation", expected, got, "Resample one of them."))
    return channels, excitation


def fitted_bands(
    channels, excitation, bands, numbers, integrals: int
) -> list[tuple[np.ndarray, TransferFit]]:
    """Limits of each band, and the modes in it; `integrals` is how often the acceleration was integrated."""
    y, x, dt = whole_values(channels), whole_values(excitation), sampling_step(channels)
    n = y.shape[1]
    checked = checked_bands(bands, n, dt, integrals)
    at_y, at_x = (dt * np.fft.rfft(z) for z in (y, x))
    parts = []
    for first, last in zip(checked.starts[:-1], checked.starts[1:], strict=True):
        bins = checked.bins[first:last][checked.weights[first:last] > 0.0]
        lines = Lines(bins / (n * dt), 2 - integrals, duration=n * dt, dt=dt, decays=True)
        parts.append((lines, Experiment(np.arange(len(x)), at_x[:, bins], at_y[:, bins])))
    fits: list[TransferFit] = []
    for sweep in range(1 + SWEEPS * (len(parts) > 1)):
        for band, ((lines, experiment), number) in enumerate(zip(parts, numbers, strict=True)):
            own = [experiment]
            for fit in fits[:band] + fits[band + 1 :] if sweep else ():
                own = without_modes(fit.modes, own, lines)
            tried = [fit_modes(own, lines._replace(rest=rest), number) for rest in (BEYOND, NEAR)]
            fits[band : band + 1] = [max(tried, key=lambda fit: fit.criterion)]
    return list(zip(checked.limits, fits, strict=True))


def rows_of_fit(fit: TransferFit) -> list[tuple]:
    """Frequency, damping ratio and shape of length one of each mode, their deviations; participation, too."""
    modes, sds, rows = fit.modes, fit.deviations, []
    (n, k), n_in = modes.table.shape, modes.inputs.shape[1]
    covariances = fit.covariance.reshape(n, k, n, k)
    for i, (f, z, sd) in enumerate(zip(modes.frequencies, modes.ratios, sds, strict=True)):
        length = np.linalg.norm(modes.outputs[i])
        unit = modes.outputs[i] / length
        of_shape, of_inputs = np.zeros((len(unit), k)), np.zeros((n_in, k))
        of_shape[:, 2 + n_in :] = (np.eye(len(unit)) - np.outer(unit, unit)) / length
        of_inputs[:, 2 : 2 + n_in] = length * np.eye(n_in)
        of_inputs[:, 2 + n_in :] = np.outer(modes.inputs[i], unit)
        variances = (np.diag(x @ covariances[i, :, i] @ x.T).clip(min=0.0) for x in (of_shape, of_inputs))
        shape_sd, participation_sd = map(np.sqrt, variances)
        rows.append((f, z, unit, f * sd[0], z * sd[1], shape_sd, length * modes.inputs[i], participation_sd))
    return rows
