"""What the posterior says of the spectra of channels whose forces nobody measured."""

import numpy as np
import pytensor
import xarray as xr
from pytensor.graph.replace import clone_replace

from pymc_features.ambient.bands import Bands, checked_bands
from pymc_features.ambient.density import parameters_of
from pymc_features.ambient.transfer import transfer_functions
from pymc_features.ambient.transforms import band_transform
from pymc_features.signals.spectra import averaged_spectra
from pymc_features.update.predict import QUANTILES, thinned

DRAWS = 50
LEAKS = 8  # quarters of a resolution on each side from which averaged spectra take in
FEWEST, PARTS = 24, 8  # frequencies of a part of a band, and parts of a band


def fitted_spectra(problem, model, posterior: xr.Dataset) -> xr.Dataset:
    """Singular values of the spectra that a model makes, and how far the channels are from them.

    Returns
    -------
    Dataset
        `response` (quantile, value, frequency), singular values of the expected spectra inside the bands
        [(m/s^2)^2/Hz], as Welch's method sees them; `ratio` (part), power of the channels over what is
        expected, in all directions alike, F' E^-1 F / s, its mean over the draws and over the frequencies
        between `low` and `high` [Hz], and its standard deviation `sd` if the model is right.
    """
    ambient = problem.ambient
    bands = checked_bands(ambient.bands, ambient.channels.sizes["time"], ambient.step, 0)
    spectra = averaged_spectra(ambient.channels.values, ambient.step)
    f = spectra.frequencies
    band = np.searchsorted(ambient.bands[:, 0], f, side="right") - 1
    inside = (band >= 0) & (f <= ambient.bands[band, 1])
    kernel, offsets = seen_by_welch(spectra.length)
    fine = f[inside, None] + f[1] * offsets
    of_channels, values = transforms(ambient, bands), []
    ratios = np.zeros(bands.bins.size)
    own_band = np.repeat(np.arange(len(bands.limits)), np.diff(bands.starts))
    for parameters in parts_of_draws(model, posterior):
        expected = covariance(parameters, fine.ravel(), np.repeat(band[inside], offsets.size))
        expected = expected.reshape(*fine.shape, *expected.shape[1:])
        values.append(np.linalg.eigvalsh(np.einsum("o,koij->kij", kernel, expected))[:, ::-1])
        whole = covariance(parameters, bands.frequencies, own_band)
        solved = np.linalg.solve(whole, of_channels[..., None])[..., 0]
        ratios += (of_channels.conj() * solved).sum(axis=1).real / of_channels.shape[1]
    low, high, ratio, sd = by_parts(bands, ratios / len(values), of_channels.shape[1])
    found = np.quantile(values, QUANTILES, axis=0)
    return xr.Dataset(
        {
            "response": (("quantile", "frequency", "value"), found, {"units": "(m/s^2)^2/Hz"}),
            "ratio": ("part", ratio),
            "sd": ("part", sd),
            "low": ("part", low, {"units": "Hz"}),
            "high": ("part", high, {"units": "Hz"}),
        },
        {"quantile": list(QUANTILES), "frequency": f[inside], "value": 1 + np.arange(found.shape[-1])},
    ).transpose("quantile", "value", "frequency", "part")


def seen_by_welch(length: int) -> tuple[np.ndarray, np.ndarray]:
    """Shares, and distances in resolutions, of the frequencies that an averaged spectrum takes together."""
    from scipy import signal  # a second to import

    offsets = np.arange(-LEAKS, LEAKS + 1) / 4.0
    wave = np.exp(-2j * np.pi * np.outer(offsets, np.arange(length) / length))
    power = np.abs(wave @ signal.get_window("hann", length)) ** 2
    return power / power.sum(), offsets


def transforms(ambient, bands: Bands) -> np.ndarray:
    """Complex transforms (k, s) of the channels at the frequencies of all bands."""
    found = band_transform(ambient.channels.values, bands.bins, bands.weights, ambient.step)
    return (found[:, 0] + 1j * found[:, 1]).T


def parts_of_draws(model, posterior: xr.Dataset):
    """Frequencies, damping ratios, shapes, factors of forces and errors at some draws of the posterior."""
    few = thinned(posterior, DRAWS)
    names = [rv.name for rv in model.free_RVs]
    inputs = [model[name].type(name) for name in names]
    parts = clone_replace(
        parameters_of(model["y"]), dict(zip((model[n] for n in names), inputs, strict=True))
    )
    function = pytensor.function(inputs, parts, mode="FAST_COMPILE", on_unused_input="ignore")
    for chain, draw in np.ndindex(few.sizes["chain"], few.sizes["draw"]):
        one = few.isel(chain=chain, draw=draw)
        yield function(*(one[name].values for name in names))


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
