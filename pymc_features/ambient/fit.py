"""What a fitted `AmbientResponse` makes of the spectra: singular values, and the power in each band."""

import numpy as np
import pytensor
import xarray as xr
from pytensor.graph.basic import Constant

from pymc_features.ambient.bands import Bands, band_transform, checked_bands, transfer_functions
from pymc_features.ambient.response import parameters_of
from pymc_features.signals.channels import sampling_step
from pymc_features.signals.spectra import averaged_spectra

LEAKS = 8  # quarters of a resolution on each side from which averaged spectra take in
FEWEST, PARTS = 24, 8  # frequencies of a part of a band, and parts of a band
QUANTILES = (0.05, 0.5, 0.95)
DENSITY = "(m/s^2)^2/Hz"


def fitted_spectra(channels, bands, model, posterior: xr.Dataset, name: str = "y") -> xr.Dataset:
    """Singular values of the spectra that a model makes, and how far channels (sensor, time) are from them.

    `name` is that of the `AmbientResponse` in the model, with `bands` (band, 2) in Hz. In what is returned
    `response` (quantile, value, frequency) are singular values of the expected spectra inside the bands, as
    Welch's method sees them; `ratio` (part) is the power of the channels over what is expected, in all
    directions alike, F' E^-1 F / s, on average, `sd` its error if the model is right. Where the base is
    known, channels are less the response to it, on average, which is the `residual`.
    """
    from scipy import signal  # a second to import

    is_driven = not isinstance(parameters_of(model[name])[-1], Constant)
    if is_driven:
        channels = channels - np.mean([mean for *_, mean in parts_of_draws(model, posterior, name)], axis=0)
    step = sampling_step(channels)
    bands = checked_bands(bands, channels.sizes["time"], step, 0)
    spectra = averaged_spectra(channels.values, step)
    f, length = spectra.frequencies, spectra.length
    band = np.searchsorted(bands.limits[:, 0], f, side="right") - 1
    inside = (band >= 0) & (f <= bands.limits[band, 1])
    # an averaged spectrum takes neighbouring frequencies together, by the transform of its window
    offsets = np.arange(-LEAKS, LEAKS + 1) / 4.0
    wave = np.exp(-2j * np.pi * np.outer(offsets, np.arange(length) / length))
    kernel = np.abs(wave @ signal.get_window("hann", length)) ** 2
    kernel /= kernel.sum()
    fine = f[inside, None] + f[1] * offsets
    transformed = band_transform(channels.values, bands.bins, bands.weights, step)
    of_channels = (transformed[:, 0] + 1j * transformed[:, 1]).T
    values, ratios = [], np.zeros(bands.bins.size)
    own_band = np.repeat(np.arange(len(bands.limits)), np.diff(bands.starts))
    for *parameters, _ in parts_of_draws(model, posterior, name):
        expected = covariance(parameters, fine.ravel(), np.repeat(band[inside], offsets.size))
        expected = expected.reshape(*fine.shape, *expected.shape[1:])
        values.append(np.linalg.eigvalsh(np.einsum("o,koij->kij", kernel, expected))[:, ::-1])
        whole = covariance(parameters, bands.frequencies, own_band)
        solved = np.linalg.solve(whole, of_channels[..., None])[..., 0]
        ratios += (of_channels.conj() * solved).sum(axis=1).real / of_channels.shape[1]
    low, high, ratio, sd = by_parts(bands, ratios / len(values), of_channels.shape[1])
    found = np.quantile(values, QUANTILES, axis=0).swapaxes(1, 2)
    parts = {"response": (("quantile", "value", "frequency"), found, {"units": DENSITY})}
    parts |= {"ratio": ("part", ratio), "sd": ("part", sd)}
    parts |= {"low": ("part", low, {"units": "Hz"}), "high": ("part", high, {"units": "Hz"})}
    coords = {"quantile": list(QUANTILES), "frequency": f[inside], "value": 1 + np.arange(found.shape[1])}
    return xr.Dataset(parts | ({"residual": channels} if is_driven else {}), coords)


def parts_of_draws(model, posterior: xr.Dataset, name: str):
    """Frequencies, damping ratios, shapes, factors of forces, errors and means at draws (chain, draw)."""
    names = [rv.name for rv in model.free_RVs]
    settings = {"mode": "FAST_COMPILE", "on_unused_input": "ignore"}
    function = pytensor.function([model[n] for n in names], parameters_of(model[name]), **settings)
    for chain, draw in np.ndindex(posterior.sizes["chain"], posterior.sizes["draw"]):
        one = posterior.isel(chain=chain, draw=draw)
        yield function(*(one[n].values for n in names))


def covariance(parameters, frequencies, band) -> np.ndarray:
    """E (k, s, s) of accelerations at frequencies [Hz], each in a band."""
    natural, ratios, shapes, factor, error = parameters
    transfer = transfer_functions(natural, ratios, np.maximum(frequencies, 1e-12))
    forces = (factor[..., 0] + 1j * factor[..., 1])[band]
    roots = shapes.T @ (transfer[..., None] * forces)
    found = roots @ roots.conj().transpose(0, 2, 1)
    diagonal = np.arange(shapes.shape[1])
    found[:, diagonal, diagonal] += error[band]
    return found


def by_parts(bands: Bands, values, n_sensors: int) -> np.ndarray:
    """First and last frequency [Hz], mean, and its standard deviation, of parts of each band (4, part)."""
    rows = []
    for first, last in zip(bands.starts[:-1], bands.starts[1:], strict=True):
        used = first + np.flatnonzero(bands.weights[first:last])
        n_parts = int(np.clip(used.size // FEWEST, 1, PARTS))
        for part in np.array_split(used, n_parts):
            ends = bands.frequencies[part[[0, -1]]]
            rows.append((*ends, values[part].mean(), 1.0 / np.sqrt(part.size * n_sensors)))
    return np.array(rows).T
