"""Whether a model explains what was measured, and where it does not, in plain sentences."""

from typing import NamedTuple

import numpy as np

from pymc_features.update.kinds.coarseness import too_coarse
from pymc_features.update.presentation.shown import Verdict

UNEXPLAINED = 0.35  # rms error over measured rms: more is no explanation, unless it is noise
WORSE = 0.9  # the same, of a model with which nothing is gained
NARROW, DENSE = 0.1, 0.3  # white noise has less than this share of its energy in a tenth of the frequencies
RINGS = 0.4  # share of the error's energy near natural frequencies
ROUGH = 0.15  # rms error over measured rms that is worth a word where it is structured
FOLLOWS = 0.6  # coherence of the error with the base: noise has it in one of 20,000 frequencies
BESIDE = 0.1  # relative distance within which a peak is that of a natural frequency
SEGMENTS = 8  # of a record, for coherences
DAMPING = (5e-4, 0.2)  # ratios that structures have


class Residuals(NamedTuple):
    """What the median response of a likelihood leaves over.

    Attributes
    ----------
    relative : array (sensor,)
        Its rms over that of the measured response.
    turned : array (sensor,)
        The same for the response to the base with the opposite sign.
    frequency : array (frequency,)
        [Hz]
    coherence : array (sensor, frequency)
        Of what is left with the base [-].
    left : array (sensor, frequency)
        Its power over that of the measured response [-].
    densest : array (sensor,)
        Largest share of its energy in a tenth of the frequencies of the data.
    near : array (sensor, mode)
        Share of its energy near the natural frequencies of the model.
    """

    relative: np.ndarray
    turned: np.ndarray
    frequency: np.ndarray
    coherence: np.ndarray
    left: np.ndarray
    densest: np.ndarray
    near: np.ndarray


def verdict_of_responses(data, result, kind: str) -> Verdict:
    """Judge how one likelihood of a result meets measured responses."""
    part = result[kind]
    modes = part["modal"].to_dataset().median(["chain", "draw"])
    frequencies, ratios = (modes[name].values for name in ("natural_frequency", "damping_ratio"))
    found = residuals_of(data, part, frequencies)
    sensors = [str(name) for name in part["bands"]["sensor"].values]
    structured = found.densest > DENSE
    bad = (found.relative > UNEXPLAINED) & structured
    sentences = [headline(sensors, found.relative, bad)]
    if turned := turned_base(found):
        sentences += turned
    else:
        peaks = result["data"]["peak_frequency"].values
        sentences += no_noise(sensors, found, structured & (found.relative > ROUGH), frequencies)
        sentences += missing_modes(found, peaks, frequencies, data.band)
    sentences += extrapolated(frequencies, data.band)
    sentences += odd_damping(ratios)
    of_sampling = []
    if "coarseness" in part["bands"]:
        ratios = part["bands"]["coarseness"].values
        of_sampling = too_coarse(ratios, sensors, data.measured.record.interpolation)
    return Verdict([*sentences, *of_sampling], not bad.any() and not of_sampling)


def residuals_of(data, part, frequencies) -> Residuals:
    """Spectra of what the median response leaves over, and of the base."""
    from scipy import signal  # a second to import

    measured = part["observed_data"]["y"].values
    gaps = np.isnan(measured)  # zero in both: nothing is left over there
    measured = np.where(gaps, 0.0, measured)
    response = np.where(gaps, 0.0, part["bands"]["response"].sel(quantile=0.5).values)
    left, size = np.sqrt((measured**2).sum(axis=1)), measured.shape[1]
    error = measured - response
    if not error.any():  # a response without any error has no spectrum of it
        error = np.finfo(float).eps * measured
    fs = 1.0 / data.measured.step
    rough = {"fs": fs, "nperseg": min(size, max(16, size // SEGMENTS))}
    with np.errstate(divide="ignore", invalid="ignore"):  # of frequencies without any motion
        frequency, coherence = signal.coherence(data.measured.base[:size], error, **rough)
    fine = min(size, max(64, size // 3))
    at, power = signal.welch(error, fs=fs, nperseg=fine, nfft=4 * fine)
    close = np.maximum(BESIDE * frequencies, 2.0 * fs / fine)[:, None]
    beside = np.abs(at - frequencies[:, None]) < close
    beside &= np.cumsum(beside, axis=0) == 1  # each frequency counts once
    spectrum = signal.welch(error, **rough)[1]
    return Residuals(
        np.sqrt((error**2).sum(axis=1)) / left,
        np.sqrt(((measured + response) ** 2).sum(axis=1)) / left,
        frequency,
        np.nan_to_num(coherence),
        spectrum / signal.welch(measured, **rough)[1],
        densest_share(error, data.measured.step, data.band),
        power @ beside.T / power.sum(axis=1, keepdims=True),
    )


def densest_share(error, step, band) -> np.ndarray:
    """Largest share (sensor,) of the energy of errors (sensor, time) in a tenth of a band."""
    from scipy import signal  # a second to import

    size = error.shape[1]
    frequency, spectrum = signal.welch(error, 1.0 / step, nperseg=min(size, max(16, size // SEGMENTS)))
    low, high = band
    inside = np.sort(spectrum[:, (frequency >= low) & (frequency <= high)], axis=1)
    some = max(1, round(NARROW * inside.shape[1]))
    with np.errstate(divide="ignore", invalid="ignore"):  # of no error at all
        return np.nan_to_num(inside[:, -some:].sum(axis=1) / inside.sum(axis=1))


def headline(sensors, relative, bad) -> str:
    """One sentence on all sensors."""
    named = ", ".join(
        f"{100 * max(0.0, 1.0 - error**2):.0f} % of {name}"
        for name, error in zip(sensors, relative, strict=True)
    )
    if bad.any():
        worst = ", ".join(name for name, is_bad in zip(sensors, bad, strict=True) if is_bad)
        return f"This model does not explain {worst}: it accounts for {named} (share of the mean square)."
    noise = relative > UNEXPLAINED
    if noise.any():
        return f"The model explains the measurements but for noise: it accounts for {named}."
    return f"The model explains the measurements: it accounts for {named} (share of the mean square)."


def turned_base(found) -> list[str]:
    """Whether the opposite sign of the base would do better."""
    if (found.relative > WORSE).all() and (found.turned < found.relative).all():
        return [
            "With the opposite sign of the base the same model comes closer: the base, or all sensors, may "
            "be inverted. Try scale = { ... = -1.0 } in [data]."
        ]
    return []


def no_noise(sensors, found, rough, frequencies) -> list[str]:
    """Errors of the model: where they are, and at which mode they ring."""
    if not rough.any():
        return []
    names = ", ".join(name for name, is_rough in zip(sensors, rough, strict=True) if is_rough)
    near = found.near[rough].mean(axis=0)
    mode = int(near.argmax())
    where = f", most of it at mode {mode + 1} ({frequencies[mode]:.3g} Hz)" if near.sum() > RINGS else ""
    return [
        f"The error at {names} is no noise but an error of the model{where}: stiffness or damping may change "
        "during the motion, as where springs yield, or the model lacks a part."
    ]


def missing_modes(found, peaks, frequencies, band) -> list[str]:
    """Peaks of the measured gain where the model has no natural frequency, and the error follows the base."""
    alone = []
    for peak in peaks:
        inside = np.abs(found.frequency - peak) <= 1.5 * found.frequency[1]
        follows = (found.coherence[:, inside] > FOLLOWS) & (found.left[:, inside] > 0.5)
        is_known = (np.abs(frequencies - peak) < BESIDE * peak).any()
        if band[0] < peak < band[1] and not is_known and follows.any():
            alone.append(f"{peak:.3g}")
    if not alone:
        return []
    return [
        f"The measurements have a peak at {', '.join(alone)} Hz, where the model has no natural frequency: a "
        "storey, a direction or a support may be missing."
    ]


def extrapolated(frequencies, band) -> list[str]:
    """Natural frequencies about which the data say nothing by themselves."""
    outside = [k for k, f in enumerate(frequencies) if not band[0] <= f <= band[1]]
    if not outside:
        return []
    named = ", ".join(f"f{k + 1} ({frequencies[k]:.3g} Hz)" for k in outside[:5])
    named += f" and {len(outside) - 5} more" if len(outside) > 5 else ""
    return [
        f"{named} {'lies' if len(outside) == 1 else 'lie'} outside the band of the data, {band[0]:.3g} to "
        f"{band[1]:.3g} Hz: what is said of them is extrapolated from the others."
    ]


def odd_damping(ratios) -> list[str]:
    """Damping that structures do not have."""
    odd = (ratios < DAMPING[0]) | (ratios > DAMPING[1])
    if not odd.any():
        return []
    named = ", ".join(f"{100 * ratios[k]:.3g} % at mode {k + 1}" for k in np.flatnonzero(odd)[:5])
    return [
        f"The damping is beyond what structures have: {named}. It may stand for something that the model "
        "lacks."
    ]
