"""`identify_modes`: the modes of a structure from its response to forces that nobody measured."""

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from pymc_features._checks import as_list, check_choice, check_integer, message, shown
from pymc_features.ambient.bands import checked_bands
from pymc_features.ambient.spectral import MEASURED
from pymc_features.ambient.transforms import band_transform
from pymc_features.ambient.warn import tell, warn_of_peak
from pymc_features.identification.posterior import BandData, Posterior, noise_logp
from pymc_features.identification.propose import propose_bands
from pymc_features.identification.start import best_posterior
from pymc_features.modal import ModalData
from pymc_features.signals import sampling_step
from pymc_features.signals.channels import whole_values
from pymc_features.simulators.spectra import Lines

MOST = 4  # modes in a band that are looked for
NARROW = 2.0  # frequencies of the record in a half-power width: a sine between two of them has as many


def identify_modes(
    channels: xr.DataArray,
    bands: ArrayLike | None = None,
    *,
    n_modes: int | list[int] | None = None,
    quantity: str = "acceleration",
) -> ModalData:
    """Identify natural frequencies, damping ratios and shapes from channels alone, with their uncertainty.

    The likelihood is that of `AmbientResponse`, with free modes in the place of a structure's: in each band
    real shapes, correlated forces on the modes of constant spectral density, and errors of one spectral
    density on all channels. Modes may be close. What is returned is the maximum of the posterior under flat
    priors (on logarithms of frequencies, ratios and densities) with the standard deviations of Laplace's
    approximation, as `ModalFeature` and `[modal]` of `update` take it.

    Parameters
    ----------
    channels : DataArray (sensor, time)
        As `read_channels` returns them, without gaps.
    bands : array_like (band, 2), optional
        Lower and upper ends of the bands [Hz], one around each mode or group of close modes, apart from each
        other; `propose_bands(channels)` by default.
    n_modes : int or list of int, optional
        In each band. By default the number, up to four, with the best Bayesian information criterion; beside
        modes whose half-power widths are inside the band, wider ones that reach over its ends are taken for
        what comes in from other modes, and left out.
    quantity : str
        What was measured: "acceleration", "velocity" or "displacement".

    Returns
    -------
    ModalData
        Modes by ascending frequency, with `frequency_sd`, `damping_ratios`, `damping_sd` and `shape_sd`;
        shapes have length one.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range, or no band has a mode.

    Warns
    -----
    AmbientWarning
        If a band has no mode; a mode lies at the edge of its band, is as narrow as a machine at constant
        speed, or the record is too short for its damping.

    Notes
    -----
    Forces act on the structure. Where the base moves as well, its motion is in all channels: take it off.

    The standard deviations hold for long records: of a single mode, and with many frequencies in the band,
    they follow the laws of Au (Sec. 15), for frequencies zeta / (2 pi n) of the squared coefficient of
    variation, for damping 1 / (2 pi zeta n), n cycles being measured.

    References
    ----------
    S.-K. Au, Operational Modal Analysis, Springer 2017, ch. 12, 13 and 15. K.-V. Yuen & L. S. Katafygiotis,
    Adv. Struct. Eng. 6 (2003) 81-95.

    Examples
    --------
    >>> from pymc_features import LinearStructure, Loading, ModalDamping, simulate
    >>> stiffness = [[1800.0, -900.0], [-900.0, 900.0]]
    >>> frame = LinearStructure(mass=[1.0, 1.0], stiffness=stiffness, damping=ModalDamping(0.01))
    >>> wind = Loading(np.random.default_rng(1).standard_normal((2, 12_000)), 0.05, kind="force")
    >>> found = identify_modes(simulate(frame, wind), [[2.7, 3.2], [7.3, 8.2]])
    >>> abs(found.frequencies - frame.modes().natural_frequencies) < 4.0 * found.frequency_sd
    array([ True,  True])
    """
    check_choice(quantity, "quantity", list(MEASURED))
    if bands is None:
        bands = propose_bands(channels)
    parts = transformed(channels, bands, quantity)
    found = []
    for data, number in zip(parts, checked_numbers(n_modes, len(parts)), strict=True):
        posterior = of_band(data, number)
        own = [] if posterior is None else modes_of(data, posterior, is_free=number is None)
        if not own:
            low, high = data.limits
            tell(
                f"the band {low:.4g} to {high:.4g} Hz has no mode: it is noise, or what comes in from beside "
                "it. Leave it out."
            )
        found += own
    if not found:
        advice = "Look at the spectra, and pass bands around their peaks."
        raise ValueError(message("bands", "bands with modes", "none with any", advice))
    found.sort(key=lambda mode: mode[0])
    natural, ratios, shapes, frequency_sd, damping_sd, shape_sd = map(np.array, zip(*found, strict=True))
    return ModalData(
        natural,
        shapes,
        [str(name) for name in channels["sensor"].values],
        frequency_sd=frequency_sd,
        damping_ratios=ratios,
        damping_sd=damping_sd,
        shape_sd=shape_sd,
        name="identified modes",
    )


def transformed(channels: xr.DataArray, bands: ArrayLike, quantity: str) -> list[BandData]:
    """Transforms of channels, less their means, in each band."""
    values, dt = whole_values(channels), sampling_step(channels)
    duration = values.shape[1] * dt
    checked = checked_bands(bands, values.shape[1], dt, MEASURED[quantity])
    spectra = band_transform(values - values.mean(axis=1, keepdims=True), checked.bins, checked.weights, dt)
    parts = []
    for limits, first, last in zip(checked.limits, checked.starts[:-1], checked.starts[1:], strict=True):
        part = slice(first, last)
        columns = (checked.frequencies[part], checked.weights[part], checked.gains[part])
        lines = Lines(*map(np.ascontiguousarray, columns), np.array([0, last - first]))
        parts.append(BandData(np.ascontiguousarray(spectra[..., part]), lines, limits, duration))
    return parts


def checked_numbers(n_modes, n_bands: int) -> list[int | None]:
    """The number of modes in each band, None where it is to be found."""
    if n_modes is None:
        return [None] * n_bands
    listed = as_list(n_modes)
    if listed is None:
        return [check_integer(n_modes, "n_modes", least=1)] * n_bands
    if len(listed) != n_bands:
        raise ValueError(message("n_modes", f"one number for each of the {n_bands} bands", shown(n_modes)))
    return [check_integer(number, "n_modes", least=1) for number in listed]


def of_band(data: BandData, n_modes: int | None) -> Posterior | None:
    """The posterior of so many modes, or of the number with the best criterion; None for noise."""
    if n_modes is not None:
        return best_posterior(data, n_modes)
    charge = 0.5 * np.log(2.0 * data.used.size)  # for each parameter
    best, score = None, noise_logp(data) - charge
    for m in range(1, min(MOST, len(data.spectra) + 1) + 1):
        posterior = best_posterior(data, m)
        if posterior is None:  # as of a sine among what comes in from other modes
            continue
        if (new := posterior.value() - charge * posterior.size) <= score:
            break
        best, score = posterior, new
    return best


def modes_of(data: BandData, posterior: Posterior, is_free: bool) -> list[tuple]:
    """Frequency, damping ratio and shape of each mode within the band, and their standard deviations.

    If the number of modes `is_free`, some of them may only stand for what comes in from beside the band.
    """
    centre, (low, high) = posterior.centre, data.limits
    f, half = centre.natural, centre.natural * centre.ratios
    whole = (f - half > low) & (f + half < high)
    taken = whole if is_free and whole.any() else (f > low) & (f < high)
    rows = zip(f, centre.ratios, centre.shapes, *posterior.standard_deviations(), strict=True)
    found = []
    for row in (row for row, is_taken in zip(rows, taken, strict=True) if is_taken):
        f, zeta = row[:2]
        if min(f - low, high - f) < zeta * f:
            tell(
                f"the mode at {f:.4g} Hz lies at the edge of its band, {low:.4g} to {high:.4g} Hz. Widen it."
            )
        if (count := 2.0 * zeta * f * data.duration) < NARROW:
            tell(
                f"the mode at {f:.4g} Hz is no wider than a single frequency looks in {data.duration:.4g} s "
                f"({count:.2g} frequencies of the record): is it a machine at constant speed? Else take a "
                "longer record."
            )
        else:
            warn_of_peak(f"the mode at {f:.4g} Hz", f, zeta, data.duration)
        found.append(row)
    return found
