"""Modes from channels and what excited them: forces of a shaker or hammer, motions of a base.

The transform of a record over its whole length is the transfer function times that of the excitation, and the
difference of the free decays that begin with the state at its start and at its end. Both are in the fit, so
that no window is needed and nothing leaks.
"""

import numpy as np
import xarray as xr

from pymc_features._checks import as_list, message, shown
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
    modes, whole, rows = fit.modes, fit.covariance, []
    k, n_in = modes.table.shape[1], modes.inputs.shape[1]
    for i, (w, z) in enumerate(np.exp(modes.table[:, :2])):
        p_in, p_out = modes.inputs[i], modes.outputs[i]
        covariance = whole[i * k : (i + 1) * k, i * k : (i + 1) * k]
        length = np.linalg.norm(p_out)
        unit = p_out / length
        of_shape, of_inputs = np.zeros((len(unit), k)), np.zeros((n_in, k))
        of_shape[:, 2 + n_in :] = (np.eye(len(unit)) - np.outer(unit, unit)) / length
        of_inputs[:, 2 : 2 + n_in], of_inputs[:, 2 + n_in :] = length * np.eye(n_in), np.outer(p_in, unit)
        slopes = [np.eye(2, k) * [[w / (2.0 * np.pi)], [z]], of_shape, of_inputs]
        of_f_and_z, *sds = (np.sqrt(np.diag(x @ covariance @ x.T).clip(min=0.0)) for x in slopes)
        rows.append((w / (2.0 * np.pi), z, unit, *of_f_and_z, sds[0], length * p_in, sds[1]))
    return rows
