"""Modes of a structure from its response to forces that nobody measured, with their uncertainty.

Bands around the peaks of the spectra are proposed, and machines, which are no modes, taken off.
"""

from itertools import combinations

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy.fft import next_fast_len

from pymc_features._checks import (
    as_list,
    check_choice,
    check_integer,
    check_positive,
    message,
    require,
    shown,
)
from pymc_features.ambient.bands import band_transform, checked_bands, transfer_functions
from pymc_features.ambient.free_modes import BandData, FreeModes, Posterior, best_posterior, noise_logp
from pymc_features.ambient.known_input import fitted_bands, rows_of_fit, split_channels
from pymc_features.ambient.response import MEASURED, tell, warn_of_peak
from pymc_features.modal import ModalData
from pymc_features.signals import sampling_step
from pymc_features.signals.channels import whole_values
from pymc_features.signals.spectra import averaged_spectra
from pymc_features.simulators.spectra import Lines

PROMINENCE = 6.0  # dB above the valleys beside a peak
HALF_WIDTH = 0.06  # of a band, relative to the frequency of its peak
FEWEST = 3.0  # resolutions of the averaged spectrum on each side
MOST = 4  # modes in a band that are looked for
NARROW = 2.0  # frequencies of the record in a half-power width: a sine between two of them has as many
WIDEST = 0.1  # damping ratio above which one only stands for what comes in, if their number is free
SAME = 0.9  # MAC of shapes of one mode that was found twice
ALIKE = 3.0  # ratio of the damping of two that may be one


def identify_modes(
    channels: xr.DataArray,
    bands: ArrayLike | None = None,
    *,
    n_modes: int | list[int] | None = None,
    quantity: str = "acceleration",
    excitation: xr.DataArray | str | list[str] | None = None,
) -> ModalData:
    """Identify natural frequencies, damping ratios and shapes from channels, with their uncertainty.

    The likelihood is that of `AmbientResponse`, with free modes in the place of a structure's: in each band
    real shapes, correlated forces on the modes of constant spectral density, and errors of one spectral
    density on all channels. Modes may be close. What is returned is the maximum of the posterior under flat
    priors (on logarithms of frequencies, ratios and densities) with the standard deviations of Laplace's
    approximation, as `ModalFeature` and `[modal]` of `update` take it.

    With a known `excitation`, forces or motions of a base, the transforms of the channels are those of the
    excitation times the transfer functions of free modes, and of the free vibration with which the record
    begins and ends, so that it needs no window; errors have one spectral density for each channel and band.
    No machine is taken off then, and the only warning is of bands without a mode. What modes of one band move
    in another is taken off there; modes that lie in no band may leave a part of their motion in the shapes of
    neighbours.

    Parameters
    ----------
    channels : DataArray (sensor, time)
        As `read_channels` returns them, without gaps.
    bands : array_like (band, 2), optional
        Lower and upper ends of the bands [Hz], one around each mode or group of close modes, apart from each
        other; `ambient.propose_bands(channels)` by default.
    n_modes : int or list of int, optional
        In each band. By default the number, up to four, with the best Bayesian information criterion. Left
        out are then what comes in from other modes, that is, what reaches over the ends of the band beside
        modes whose half-power widths are inside, is three times as wide as one and below it, or has 10 %
        damping or more; what is as narrow as a single frequency; and modes that were found twice.
    quantity : str
        What was measured: "acceleration", "velocity" or "displacement".
    excitation : DataArray (input, time), str or list of str, optional
        Forces [N] or accelerations of the base [m/s^2] that were measured, or which of the channels they are.

    Returns
    -------
    ModalData
        Modes by ascending frequency, with `frequency_sd`, `damping_ratios`, `damping_sd` and `shape_sd`;
        shapes have length one. With an `excitation` also `participation` and its standard deviations.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range, or no band has a mode.

    Warns
    -----
    AmbientWarning
        If a band has no mode; a machine at constant speed was taken off; a mode lies at the edge of its band,
        is as narrow as a machine, or the record is too short for its damping.

    Notes
    -----
    A sine that stands 60 times above its neighbours in the spectrum is a machine and taken off all channels
    first. Modes missed and too many are counted by `python -m benchmarks --only coverage --names modes`, and
    for one record of each kind in tests/identification.

    Forces act on the structure. Where the base moves as well, its motion is in all channels: take it off, or
    pass it as `excitation`.

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
    found, of_inputs = [], {}  # limits of each band, and rows of its modes
    if excitation is not None:
        channels, excitation = split_channels(channels, excitation)
        limits = np.atleast_2d(propose_bands(channels) if bands is None else bands)
        numbers = checked_numbers(n_modes, len(limits))
        fits = fitted_bands(channels, excitation, limits, numbers, MEASURED[quantity])
        found = [(band, rows_of_fit(fit)) for band, fit in fits]
    else:
        values, tones = without_tones(whole_values(channels), sampling_step(channels))
        channels = channels.copy(data=values)
        parts = transformed(channels, propose_bands(channels) if bands is None else bands, quantity)
        for tone in tones:
            if any(low < tone < high for low, high in (data.limits for data in parts)):
                tell(
                    f"the channels move at {tone:.4g} Hz as by a machine at constant speed, no wider than a "
                    "single frequency looks: it is no mode, and is taken off."
                )
        for data, number in zip(parts, checked_numbers(n_modes, len(parts)), strict=True):
            posterior = of_band(data, number)
            rows = [] if posterior is None else modes_of(data, posterior, is_free=number is None)
            found.append((data.limits, rows))
    for (low, high), rows in found:
        if not rows:
            tell(
                f"the band {low:.4g} to {high:.4g} Hz has no mode: it is noise, or what comes in from beside "
                "it. Leave it out."
            )
    rows = each_once([row for _, rows in found for row in rows])
    advice = "Look at the spectra, and pass bands around their peaks."
    require(rows, message("bands", "bands with modes", "none with any", advice))
    columns = map(np.array, zip(*rows, strict=True))
    natural, ratios, shapes, frequency_sd, damping_sd, shape_sd, *of_excitation = columns
    if excitation is not None:
        names = [str(name) for name in excitation["sensor"].values]
        of_inputs = {"inputs": names, "participation": of_excitation[0], "participation_sd": of_excitation[1]}
    return ModalData(
        natural,
        shapes,
        [str(name) for name in channels["sensor"].values],
        frequency_sd=frequency_sd,
        damping_ratios=ratios,
        damping_sd=damping_sd,
        shape_sd=shape_sd,
        name="identified modes",
        **of_inputs,
    )


def each_once(found: list[tuple]) -> list[tuple]:
    """Modes by ascending frequency; of two that are the same the one whose frequency is known better."""
    kept = []
    for mode in sorted(found, key=lambda mode: mode[3]):
        if not any(is_same(mode, other) for other in kept):
            kept.append(mode)
    return sorted(kept, key=lambda mode: mode[0])


def is_same(one: tuple, other: tuple) -> bool:
    """Whether frequencies are closer than their standard deviations, and shapes and damping are alike."""
    (f, zeta, shape, sd, *_), (g, eta, other_shape, other_sd, *_) = one, other
    near = abs(f - g) < sd + other_sd and max(zeta, eta) < ALIKE * min(zeta, eta)
    return bool(near and (shape @ other_shape) ** 2 > SAME)


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
    what = f"one number for each of the {n_bands} bands"
    require(len(listed) == n_bands, message("n_modes", what, shown(n_modes)))
    return [check_integer(number, "n_modes", least=1) for number in listed]


def of_band(data: BandData, n_modes: int | None) -> Posterior | None:
    """The posterior of so many modes, or of the number with the best criterion; None for noise."""
    if n_modes is not None:
        return best_posterior(data, n_modes)
    charge = 0.5 * np.log(2.0 * data.used.size)  # for each parameter
    best, score = None, noise_logp(data) - charge
    for m in range(1, min(MOST, len(data.spectra) + 1) + 1):
        posterior = best_posterior(data, m, None if best is None else best.centre)
        if posterior is None and best is None:
            continue
        if posterior is None or (new := posterior.value() - charge * posterior.size) <= score:
            break
        if any(is_same(*pair) for pair in combinations(rows_of(posterior), 2)):
            break
        best, score = posterior, new
    return best


def rows_of(posterior: Posterior) -> list[tuple]:
    """Frequency, damping ratio and shape of each mode, and their standard deviations."""
    centre = posterior.centre
    columns = centre.natural, centre.ratios, centre.shapes, *posterior.standard_deviations()
    return list(zip(*columns, strict=True))


def is_hidden(modes: FreeModes, whole) -> np.ndarray:
    """Whether each is far wider than one of the `whole` ones, and below the others at its own frequency."""
    wider = (modes.ratios[:, None] > ALIKE * modes.ratios) & whole
    power = np.abs(transfer_functions(modes.natural, modes.ratios, modes.natural)) ** 2
    power *= (np.abs(modes.factor) ** 2).sum(axis=1)
    return wider.any(axis=1) & (2.0 * np.diag(power) < power.sum(axis=1))


def modes_of(data: BandData, posterior: Posterior, is_free: bool) -> list[tuple]:
    """Frequency, damping ratio and shape of each mode within the band, and their standard deviations.

    If the number of modes `is_free`, some of them may only stand for what comes in from beside the band.
    """
    centre, (low, high) = posterior.centre, data.limits
    f, half = centre.natural, centre.natural * centre.ratios
    whole = (f - half > low) & (f + half < high)
    taken = whole if is_free and whole.any() else (f > low) & (f < high)
    if is_free:
        taken &= (centre.ratios < WIDEST) & ~is_hidden(centre, whole)
    found = []
    for row in (row for row, is_taken in zip(rows_of(posterior), taken, strict=True) if is_taken):
        f, zeta = row[:2]
        if min(f - low, high - f) < zeta * f:
            tell(
                f"the mode at {f:.4g} Hz lies at the edge of its band, {low:.4g} to {high:.4g} Hz. Widen it."
            )
        if (count := 2.0 * zeta * f * data.duration) < NARROW:
            tell(
                f"the mode at {f:.4g} Hz is no wider than a single frequency looks in {data.duration:.4g} s "
                f"({count:.2g} frequencies of the record): is it a machine at constant speed? Else take a "
                "longer record." + (" It is left out; say by `n_modes` that it is one." if is_free else "")
            )
            if is_free:
                continue
        else:
            warn_of_peak(f"the mode at {f:.4g} Hz", f, zeta, data.duration)
        found.append(row)
    return found


def propose_bands(channels: xr.DataArray, *, highest: float | None = None) -> np.ndarray:
    """Bands around the peaks of the first singular value of the spectra, to begin with.

    Spectra are averaged over twenty parts of the record (Welch); a peak stands 6 dB above the valleys on both
    of its sides. The lowest band does not begin below the valley beside a drift. Look at the bands in the
    spectra: a machine is a peak as well.

    Parameters
    ----------
    channels : DataArray (sensor, time)
        As `read_channels` returns them.
    highest : float, optional
        Frequency [Hz] up to which to look; 0.4 of the sampling rate by default.

    Returns
    -------
    array (band, 2)
        Lower and upper ends [Hz], apart from each other.

    Raises
    ------
    ValueError
        If there is no peak.
    """
    from scipy import signal  # a second to import

    values, dt = whole_values(channels), sampling_step(channels)
    highest = 0.4 / dt if highest is None else check_positive(highest, "highest", "Pass it in Hz.")
    spectra = averaged_spectra(values, dt)
    f, first = spectra.frequencies, spectra.singular_values[:, 0]
    inside = (f > 0.0) & (f <= highest)
    f, level = f[inside], 10.0 * np.log10(np.maximum(first[inside], np.finfo(float).tiny))
    peaks, _ = signal.find_peaks(level, prominence=PROMINENCE)
    what, advice = "of a structure that moves in its modes", "Pass `bands`."
    require(peaks.size, message("channels", what, "spectra without a peak", advice))
    half = np.maximum(HALF_WIDTH * f[peaks], FEWEST * (f[1] - f[0]))
    bands = np.column_stack([np.maximum(f[peaks] - half, 0.5 * f[0]), np.minimum(f[peaks] + half, 0.49 / dt)])
    valley = int(level[: peaks[0]].argmin())
    if np.interp(bands[0, 0], f, level) > level[valley] + PROMINENCE:  # in the drift
        bands[0, 0] = f[valley]
    begins = np.append(True, bands[1:, 0] > np.maximum.accumulate(bands[:-1, 1]))
    ends = np.append(np.flatnonzero(begins)[1:], len(bands)) - 1
    return np.column_stack([bands[begins, 0], bands[ends, 1]])


# --- machines at constant speed: sines in a record, found in its spectrum and taken off -------------------

FINER = 4  # frequencies of the padded spectrum for one of the record
BESIDE = np.arange(3, 9)  # frequencies of the record away, on both sides, with which a peak is compared
HIGHER = 60.0  # than the mean there: noise is so once in 1e8 frequencies, a mode 2.4 of them wide once in 40
MOST_TONES = 50
LOWEST = 10  # frequencies of the record below which a peak may be a drift


def without_tones(values: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Channels (s, n) without means and sines, and the frequencies of these [Hz], ascending.

    A sine looks as a record of its length makes it: it falls to 1/470 of its height, in the mean, between
    three and eight frequencies away. A mode does so only if it is narrower than a frequency. Each channel
    loses one of an amplitude and a phase of its own.
    """
    values, found = values - values.mean(axis=1, keepdims=True), []
    while len(found) < MOST_TONES and (f := highest_tone(values, dt)) is not None:
        columns = waves(f, values.shape[1], dt)
        values = values - np.linalg.lstsq(columns, values.T)[0].T @ columns.T
        found.append(f)
    return values, np.array(sorted(found))


def highest_tone(values, dt) -> float | None:
    """Frequency [Hz] of the sine that stands highest above what is beside it; None if there is none."""
    n = values.shape[1]
    size = next_fast_len(FINER * n)
    power = (np.abs(np.fft.rfft(values, size)) ** 2).sum(axis=0)
    step = size / n  # of the padded spectrum in a frequency of the record
    apart = np.round(step * BESIDE).astype(int)
    inside = np.arange(int(LOWEST * step), power.size - apart[-1])
    beside = [power[inside[:, None] + sign * apart].mean(axis=1) for sign in (-1, 1)]
    ratio = power[inside] / np.maximum(np.maximum(*beside), np.finfo(float).tiny)
    best = int(ratio.argmax())
    if ratio[best] < HIGHER:
        return None
    from scipy import optimize  # a second to import

    def minus_energy(f):
        return -np.sum((waves(f, n, dt).T @ values.T) ** 2)

    middle, half = inside[best] / (size * dt), 0.5 / (n * dt)
    found = optimize.minimize_scalar(
        minus_energy, bounds=(middle - half, middle + half), method="bounded", options={"xatol": 1e-3 * half}
    )
    return float(found.x)


def waves(f, n, dt) -> np.ndarray:
    """Cosine and sine (n, 2)."""
    phase = 2.0 * np.pi * f * dt * np.arange(n)
    return np.column_stack([np.cos(phase), np.sin(phase)])
