"""What is wrong with the priors or the data, the cause first, before anything is sampled."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from pymc_features.update.plausibility.prior_modes import PriorModes
from pymc_features.update.plausibility.resonances import Resonance, resonances, spectra_of
from pymc_features.update.plausibility.scale import SAME, Scale, factor_of, scale_of
from pymc_features.update.plausibility.sensors import Placement, placement

BEYOND = 3.5  # standard deviations of the prior beyond which it excludes a peak
CLOSEST = 0.02  # relative distance that excludes nothing, however narrow the prior is
BETTER = 0.8  # what a factor leaves unexplained over what the draws leave as they are
SOFTENED = 0.5  # of a frequency, that springs which yield may lose
PERIODS = 5.0  # of the first mode, in a record that tells something of it
SAMPLES, FEWEST = 5.0, 2.5  # in a period of the first mode; of the next ones
NEXT = 3  # modes whose sampling counts
DAMPED = 0.5  # ratio above which it must be in per cent
FAR = 3.0  # factor between the damping of priors and data that is worth a word
LIGHTEST, HEAVIEST = 1e-4, 1e10  # kg
MANY = 8.0  # factor in stiffness over mass that is no matter of a width

#: What stiffness over mass of the priors is multiplied by where a unit is mistaken, and what to ask.
UNITS = {
    1e3: "Are the masses in t? They are expected in kg.",
    1e3 / 9.81: "Are the masses weights in kN? They are expected in kg.",
    1e-3: "Are the stiffnesses in kN/m or N/mm? They are expected in N/m.",
    1e-6: "Are the stiffnesses in MN/m or kN/mm? They are expected in N/m.",
    1.0 / 9.81: "Are the masses weights in N? They are expected in kg.",
    1.0 / 175.127: "Are the stiffnesses in lb/in? They are expected in N/m.",
    1e-3 / 175.127: "Are the stiffnesses in kip/in? They are expected in N/m.",
}


class Compared(NamedTuple):
    """What the data say beside the priors.

    Attributes
    ----------
    sentences : list of str
        What is wrong, the cause first; empty if nothing was found.
    checked : str
        What was compared, or why it was not.
    peaks : dict
        Modes, 0 the first, to the resonances that were taken for them.
    others : list of Resonance
        Resonances that are none of these.
    first : float or None
        First natural frequency that the data show [Hz]; None if they do not.
    is_contradicted : bool
        Whether frequencies of the data are outside of what the priors allow.
    scale : Scale or None
        The factor between both; None of a record without resonances.
    placed : Placement or None
        How sensors fit their places; None where the priors cannot tell.
    prior, step, duration
        As they were given.
    """

    sentences: list[str]
    checked: str
    peaks: dict[int, Resonance]
    others: list[Resonance]
    first: float | None
    is_contradicted: bool
    scale: Scale | None
    placed: Placement | None
    prior: PriorModes
    step: float
    duration: float


class ModeRow(NamedTuple):
    """A natural frequency in words: of the priors 5 to 95 %, and of the data; empty where there is none."""

    name: str
    prior: str
    data: str
    prior_damping: str
    data_damping: str
    sensors: str


def mode_rows(compared: Compared) -> list[ModeRow]:
    """Modes that the priors expect beside those of the data, and what the data show besides."""
    prior, peaks = compared.prior, compared.peaks
    number = min(prior.frequencies.shape[1], max(NEXT, 1 + max(peaks, default=0)))
    rows = []
    for k in range(number):
        low, high = np.quantile(prior.ratios[:, k], [0.05, 0.95])
        expected = to_from(*prior.range_of(k)), to_from(100.0 * low, 100.0 * high)
        rows.append(((peaks.get(k)), f"f{k + 1}", *expected))
    rows += [(peak, "", "", "") for peak in compared.others]
    return [
        ModeRow(name, of_f, "", of_damping, "", "")
        if peak is None
        else ModeRow(
            name,
            of_f,
            f"{peak.frequency:.4g}",
            of_damping,
            to_from(100.0 * peak.damping[0], 100.0 * peak.damping[-1], 2),
            ", ".join(peak.sensors),
        )
        for peak, name, of_f, of_damping in rows
    ]


def to_from(low, high, digits=3) -> str:
    """A range for a table."""
    low, high = f"{low:.{digits}g}", f"{high:.{digits}g}"
    return low if low == high else f"{low} to {high}"


def scales(compared: Compared) -> str:
    """One sentence on what the record can resolve, and how far the structure would move."""
    first = compared.first or compared.prior.first
    return (
        f"{compared.duration:.4g} s are {compared.duration * first:.3g} periods of the first mode, with "
        f"{1.0 / (first * compared.step):.3g} samples in each; above {0.5 / compared.step:.4g} Hz nothing is "
        f"seen. An acceleration of 1 g would move the structure by {compared.prior.deflection:.3g} m."
    )


def of_priors(prior: PriorModes, units: Mapping[str, str]) -> list[str]:
    """What no structure has: damping above critical, masses beyond reason. `units` are of the parameters."""
    found = []
    low, middle, high = np.quantile(prior.ratios[:, 0], [0.05, 0.5, 0.95])
    if middle > DAMPED:
        names = [name for name, power in prior.exponents(prior.ratios[:, 0]).items() if abs(power) > 0.3]
        of_ratio = [name for name in names if units.get(name, "-") == "-"]
        named = ", ".join(of_ratio or ["`structure.damping`"])
        question = f"Is {named} in per cent? Ratios are expected, 0.03 for 3 %."
        if names and not of_ratio:
            question = f"Check {', '.join(f'{name} [{units[name]}]' for name in names)}."
        found.append(
            f"The priors expect a damping ratio {between(low, high)} in the first mode, "
            f"{100.0 * middle:.3g} % of critical damping. {question}"
        )
    if not LIGHTEST < prior.mass < HEAVIEST:
        found.append(
            f"The base moves {prior.mass:.3g} kg at the medians of the priors, "
            f"{'less' if prior.mass < 1.0 else 'more'} than any structure has. Check the unit of "
            "`structure.mass`: kg are expected."
        )
    return found


def of_data(channels, step, prior: PriorModes, dofs, quantity, *, duration, pass_band) -> Compared:
    """Compare channels with what the priors expect.

    Parameters
    ----------
    channels : DataArray (sensor, time)
        As they were measured, the base first; NaN in gaps.
    step : float
        [s]
    prior : PriorModes
    dofs : list of int
        Degree of freedom of each sensor.
    quantity : str
        What the sensors measure.
    duration : float
        Of the part that is compared [s].
    pass_band : tuple of two floats
        Frequencies [Hz] that filters leave; (0, inf) without filters.
    """
    spectra = spectra_of(channels, step)
    found, scale, placed = resonances(spectra), None, None
    peaks, is_contradicted, sentences = {}, False, []
    if found:
        at_sensors = prior.at_sensors(dofs, quantity)
        scale = scale_of(spectra, prior.frequencies, prior.ratios, at_sensors, quantity)
        peaks = matched(scale.factor * prior.frequencies[scale.draw], found)
    if peaks:
        mode = min(peaks)
        is_contradicted = excludes(prior, mode, peaks[mode].frequency, scale)
        if is_contradicted:
            sentences.append(contradiction(prior, peaks, step))
        else:
            placed = placement(spectra, prior, dofs, quantity, scale.factor)
    first = peaks[0].frequency if 0 in peaks else None
    if first is None and peaks:
        first = float(scale.factor * prior.frequencies[scale.draw, 0])
    expected = np.median(prior.frequencies, axis=0)
    shown = expected * (scale.factor if is_contradicted else 1.0)
    sentences += too_short(duration, *((first, "data") if first else (shown[0], "priors")))
    sentences += too_coarse(step, shown, len(spectra.names), pass_band[1])
    sentences += outside_pass_band(pass_band, first or shown[0])
    if peaks and not is_contradicted:
        sentences += odd_damping(prior, peaks, mode)
    if peaks:
        named = ", ".join(f"f{k + 1}" for k in peaks)
        checked = f"compared with the priors: {named} of the data beside theirs"
    elif found:
        checked = "not compared with the priors: no factor brings their frequencies to the peaks of the data"
    else:
        checked = "not compared with the priors: no resonance stands out of the sensors' motion"
    others = [one for one in found if one not in peaks.values()]
    return Compared(
        sentences, checked, peaks, others, first, is_contradicted, scale, placed, prior, step, duration
    )


def matched(frequencies, found) -> dict[int, Resonance]:
    """Modes, lowest first, to the closest resonance, each taken once."""
    pairs = {}
    distances = np.abs(np.log(np.divide.outer(frequencies, [one.frequency for one in found])))
    while distances.size and distances.min() < SAME:
        mode, peak = np.unravel_index(distances.argmin(), distances.shape)
        pairs[int(mode)] = found[peak]
        distances[mode], distances[:, peak] = np.inf, np.inf
    return dict(sorted(pairs.items()))


def of_modes(identified, prior: PriorModes) -> list[str]:
    """What the priors exclude of identified natural frequencies (m,) [Hz]."""
    factor, draw = factor_of(np.asarray(identified), prior.frequencies)
    found = [Resonance(float(f), 0.0, (0.0, 0.0, 0.0), (), 0.0) for f in identified]
    peaks = matched(factor * prior.frequencies[draw], found)
    if not peaks or not is_outside(prior, min(peaks), peaks[min(peaks)].frequency):
        return []
    return [contradiction(prior, peaks, None)]


def excludes(prior, mode, peak, scale) -> bool:
    """Whether the priors leave no room for a peak, and a factor would bring them much closer to the data."""
    return is_outside(prior, mode, peak) and 1.0 - scale.explained.mean() < BETTER * (1.0 - scale.as_drawn)


def is_outside(prior, mode, peak) -> bool:
    """Whether a peak is none of the frequencies that the priors allow a mode."""
    low, middle, high = np.log(np.quantile(prior.frequencies[:, mode], [0.05, 0.5, 0.95]))
    away = np.log(peak) - middle
    if not prior.is_linear:
        away = max(0.0, away) if away > np.log(SOFTENED) else away
    spread = max(CLOSEST, BEYOND * 0.5 * (high - low) / 1.645)
    return abs(away) > spread


def contradiction(prior, peaks, step) -> str:
    """One sentence or two on frequencies that the priors exclude, and what would explain it."""
    mode = min(peaks)
    peak, (low, high) = peaks[mode], prior.range_of(mode)
    middle = float(np.median(prior.frequencies[:, mode]))
    name, factor = f"f{mode + 1}", (middle / peak.frequency) ** 2
    smallest, largest = 0.95 * (low / peak.frequency) ** 2, 1.05 * (high / peak.frequency) ** 2
    at = f" ({', '.join(peak.sensors)})" if peak.sensors else ""
    start = f"The priors expect {name} {between(low, high)} Hz, the data peak at {peak.frequency:.3g} Hz{at}"
    fitting = [known for known in UNITS if smallest < known < largest]
    if fitting:
        known = min(fitting, key=lambda known: abs(np.log(known / factor)))
        number = max(known, 1.0 / known)
        return f"{start}: a factor {number:.4g} in mass or stiffness. {UNITS[known]}"
    for ratio in (2.0, 0.5) if step else ():
        if low < 1.03 * peak.frequency / ratio and peak.frequency / ratio < 1.03 * high:
            which = "all peaks lie" if len(peaks) > 1 else "it lies"
            return (
                f"{start}: {which} at {ratio:g} times what is expected. Is the sampling step, {step:.4g} s, "
                f"wrong by two ({ratio * step:.4g} s)? Or stiffness over mass by 4."
            )
    names = {name: power for name, power in prior.exponents().items() if power > 0.02}
    if max(factor, 1.0 / factor) > MANY:
        number = f"{max(factor, 1.0 / factor):.2g}"
        which = "large" if factor > 1.0 else "small"
        start = f"{start}: stiffness over mass is {number} times too {which}, which no usual unit explains"
    if not names:
        return f"{start}. No prior moves it: check mass and stiffness."
    times = factor ** (-0.5 / sum(names.values()))
    many = len(names) > 1
    return (
        f"{start}. {listing(names)}, which scale{'' if many else 's'} it, would have to be {times:.2g} times "
        f"as large{', all together' if many else ''}."
    )


def too_short(duration, first, source) -> list[str]:
    """A record of a few periods."""
    if not duration * first < PERIODS:
        return []
    return [
        f"The record lasts {duration:.3g} s, {duration * first:.2g} periods of the first mode "
        f"({first:.3g} Hz by the {source}): it tells next to nothing of it. Take {PERIODS / first:.3g} s or "
        "more."
    ]


def too_coarse(step, frequencies, n_sensors, top) -> list[str]:
    """Modes that are sampled too rarely to be seen, or lie above half the sampling rate."""
    number = min(NEXT, max(2, n_sensors), len(frequencies))
    samples = {k: 1.0 / (f * step) for k, f in enumerate(frequencies[:number]) if f < top or k == 0}
    few = {k: each for k, each in samples.items() if each < (SAMPLES if k == 0 else FEWEST)}
    if not few:
        return []
    rare = [
        f"{each:.2g} times in a period of {mode_name(k, frequencies)}"
        for k, each in few.items()
        if each > 2.0
    ]
    above = [mode_name(k, frequencies) for k, each in few.items() if each <= 2.0]
    if above:
        rare.append(f"{listing(above)} {'lies' if len(above) == 1 else 'lie'} above half of that")
    return [
        f"The data are sampled at {1.0 / step:.4g} Hz: {', and '.join(rare)}. That tells next to nothing of "
        f"{'it' if len(few) == 1 else 'them'}. Take files of a higher rate."
    ]


def mode_name(k, frequencies) -> str:
    """A mode by its number and its frequency."""
    return f"f{k + 1} ({frequencies[k]:.3g} Hz)"


def outside_pass_band(pass_band, first) -> list[str]:
    """Filters that leave nothing of the first mode."""
    low, high = pass_band
    if high > first:
        return []
    return [
        f"`processing.band_pass` leaves {low:.3g} to {high:.3g} Hz, below the first mode ({first:.3g} Hz): "
        "no resonance is left to learn from. Raise `high`."
    ]


def odd_damping(prior, peaks, mode) -> list[str]:
    """Damping of the data that is far from what the priors allow."""
    low, high = np.quantile(prior.ratios[:, mode], [0.05, 0.95])
    least, _, most = peaks[mode].damping
    if not prior.is_linear or high > DAMPED or (most > low / FAR and least < FAR * high):
        return []
    return [
        f"The priors expect a damping ratio {between(low, high)} in mode {mode + 1}, the data ring with "
        f"{100.0 * least:.2g} to {100.0 * most:.2g} %. Widen the prior of the damping."
    ]


def between(low, high) -> str:
    """A range in words, or a number where it is none."""
    low, high = f"{low:.3g}", f"{high:.3g}"
    return f"of {low}" if low == high else f"between {low} and {high}"


def listing(names) -> str:
    """Names with `and` before the last."""
    names = list(names)
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
