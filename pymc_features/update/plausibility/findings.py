"""What is wrong with the priors or the data, the cause first, before anything is sampled.

Modes of all draws of the priors are computed, without anything compiled, and compared with the data.
"""

import contextlib
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from pymc_features.update.plausibility import transfer
from pymc_features.update.plausibility.resonances import Resonance, resonances, spectra_of

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
DRAWS, DRAWS_OF_LARGE = 200, 24
LARGE = 300  # degrees of freedom, from which on there are fewer draws
GRAVITY = 9.81  # [m/s^2]

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


class PriorModes(NamedTuple):
    """What draws of the priors have in common, d draws and m modes."""

    values: dict[str, np.ndarray]  # names of the parameters to their draws (d,)
    frequencies: np.ndarray  # (d, m) natural frequencies [Hz] and damping ratios [-]
    ratios: np.ndarray  # (d, m)
    # (d, n, m) displacement of each degree of freedom under a unit displacement of the base, mode by mode [-]
    shares: np.ndarray
    mass: float  # that the base moves, at the medians [kg]
    deflection: float  # largest displacement under an acceleration of 1 g across the base, at the medians [m]
    is_linear: bool  # whether springs keep their stiffness
    quantity: str = "relative_displacement"  # that the shares are of

    @property
    def first(self) -> float:
        """Median of the first natural frequency [Hz]."""
        return float(np.median(self.frequencies[:, 0]))

    def few(self, n: int) -> "PriorModes":
        """At most n of the draws, evenly spaced."""
        size = len(self.frequencies)
        some = np.linspace(0, size - 1, min(n, size)).astype(int)
        rows = {name: getattr(self, name)[some] for name in ("frequencies", "ratios", "shares")}
        return self._replace(values={name: draws[some] for name, draws in self.values.items()}, **rows)

    def range_of(self, mode: int) -> tuple[float, float]:
        """5 and 95 % of a natural frequency [Hz], mode 0 the first."""
        low, high = np.quantile(self.frequencies[:, mode], [0.05, 0.95])
        return float(low), float(high)

    def at_sensors(self, dofs, quantity) -> "PriorModes":
        """Modes with their shares (d, s, m) in a quantity at some degrees of freedom."""
        below = np.pad(self.shares, ((0, 0), (1, 0), (0, 0)))[:, :-1] * (quantity == "inter_storey_drift")
        return self._replace(shares=(self.shares - below)[:, dofs], quantity=quantity)

    def exponents(self, of: np.ndarray | None = None) -> dict[str, float]:
        """d ln f_1 / d ln(parameter) over the draws of positive parameters, or of other numbers (d,)."""
        of = self.frequencies[:, 0] if of is None else np.maximum(of, 1e-12)
        names = [name for name, draws in self.values.items() if (draws > 0.0).all() and np.ptp(draws) > 0.0]
        columns = [np.log(self.values[name]) for name in names]
        terms = np.column_stack([np.ones(len(self.frequencies)), *columns])
        found = np.linalg.lstsq(terms, np.log(of), rcond=None)[0]
        return dict(zip(names, found[1:].tolist(), strict=True))


def prior_modes(
    structure: Callable, draws: Mapping[str, Callable], at_medians, modes_of: Callable
) -> PriorModes:
    """Modes of structures whose parameters are drawn, by functions of n and seed, but of impossible ones."""
    n = DRAWS if at_medians.n_dof <= LARGE else DRAWS_OF_LARGE
    columns = {name: draw(n, k) for k, (name, draw) in enumerate(draws.items())}
    with np.errstate(all="ignore"):  # the inverse of a tiny mass is no number
        of_medians = modes_of(at_medians)
        modes = {k: one for k, one in possible_modes(structure, columns, modes_of) if is_structure(one)}
    for is_there, where in ((is_structure(of_medians), "the medians"), (modes, "draws")):
        if not is_there:
            raise ValueError(
                f"masses and stiffnesses must have a natural frequency at {where} of the priors, got none. "
                "Check their units."
            )
    kept, found = list(modes), list(modes.values())
    n_modes = min(one.natural_frequencies.size for one in found)
    shares = shares_of(of_medians)
    with np.errstate(divide="ignore"):
        deflection = np.abs((shares / of_medians.angular_frequencies**2).sum(axis=-1)).max() * GRAVITY
    return PriorModes(
        {name: column[kept] for name, column in columns.items()},
        np.array([one.natural_frequencies[:n_modes] for one in found]),
        np.array([one.damping_ratios[:n_modes] for one in found]),
        np.array([shares_of(one)[:, :n_modes] for one in found]),
        moved_mass(at_medians),
        float(deflection),
        at_medians.is_linear,
    )


def possible_modes(structure: Callable, columns, modes_of: Callable):
    """Number and modes of each draw, values by name, but of those at which there is no structure."""
    for k in range(len(next(iter(columns.values()), [0]))):
        with contextlib.suppress(ValueError, ArithmeticError, np.linalg.LinAlgError):
            yield k, modes_of(structure(**{name: float(column[k]) for name, column in columns.items()}))


def is_structure(modes) -> bool:
    """Whether there are modes, and all of them have a frequency."""
    return bool(modes.natural_frequencies.size and np.isfinite(modes.natural_frequencies).all())


def shares_of(modes) -> np.ndarray:
    """Shape times participation factor (n, m), summed over supports that move together."""
    factors = modes.participation_factors
    return modes.mode_shapes * (factors if factors.ndim == 1 else factors.sum(axis=1))


def moved_mass(structure) -> float:
    """Mass that the base moves [kg]."""
    influence = getattr(structure, "influence", None)
    return float(np.sum(structure.mass if influence is None else influence * (structure.mass @ influence)))


# ---- what data say beside them ----


class Compared(NamedTuple):
    """What the data say beside the priors."""

    sentences: list[str]  # what is wrong, the cause first; empty if nothing was found
    checked: str  # what was compared, or why it was not
    peaks: dict[int, Resonance]  # modes, 0 the first, to the resonances that were taken for them
    others: list[Resonance]  # resonances that are none of these
    first: float | None  # first natural frequency that the data show [Hz]; None if they do not
    is_contradicted: bool  # whether frequencies of the data are outside of what the priors allow
    scale: transfer.Scale | None  # the factor between both; None of a record without resonances
    placed: transfer.Placement | None  # how sensors fit their places; None where the priors cannot tell
    prior: PriorModes  # as they were given
    step: float
    duration: float


def of_data(channels, step, prior: PriorModes, *, duration, pass_band) -> Compared:
    """Compare channels (sensor, time) as they were measured, the base first, with priors at the sensors.

    `duration` is that of the part that is compared [s]; filters leave the frequencies `pass_band` [Hz].
    """
    spectra, few = spectra_of(channels, step), prior.few(transfer.MOST_DRAWS)
    found, scale, placed, first = resonances(spectra), None, None, None
    shown, is_contradicted, told, peaks = np.median(prior.frequencies, axis=0), False, [], {}
    if found:
        scale = transfer.scale_of(spectra, few)
        peaks = matched(scale.factor * few.frequencies[scale.draw], found)
    if peaks:
        mode = min(peaks)
        better = 1.0 - scale.explained < BETTER * (1.0 - scale.as_drawn)
        is_contradicted = better and is_outside(prior, mode, peaks[mode].frequency)
        if is_contradicted:
            told.append(contradiction(prior, peaks, step))
            shown = scale.factor * shown
        else:
            placed = transfer.placement(spectra, prior, scale.factor)
        first = scale.factor * few.frequencies[scale.draw, 0] if mode else peaks[0].frequency
    told += too_little(duration, step, first, shown, len(spectra.names), pass_band)
    if peaks and not is_contradicted:
        told += odd_damping(prior, peaks, mode)
    checked = "not compared with the priors: no resonance stands out of the sensors' motion"
    if peaks:
        named = ", ".join(f"f{k + 1}" for k in peaks)
        checked = f"compared with the priors: {named} of the data beside theirs"
    elif found:
        checked = "not compared with the priors: no factor brings their frequencies to the peaks of the data"
    others = [one for one in found if one not in peaks.values()]
    of_both = scale, placed, prior, step, duration
    return Compared(told, checked, peaks, others, first, is_contradicted, *of_both)


def of_modes(identified, prior: PriorModes) -> list[str]:
    """What the priors exclude of identified natural frequencies (m,) [Hz]."""
    few = prior.few(transfer.MOST_DRAWS).frequencies
    factor, draw = transfer.factor_of(np.asarray(identified), few)
    found = [Resonance(float(f), (0.0, 0.0, 0.0), (), 0.0) for f in identified]
    peaks = matched(factor * few[draw], found)
    if not peaks or not is_outside(prior, min(peaks), peaks[min(peaks)].frequency):
        return []
    return [contradiction(prior, peaks, None)]


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


def mode_rows(compared: Compared) -> list[tuple[str, ...]]:
    """Modes that the priors expect beside those of the data: frequencies, damping, which sensors show it."""

    def to_from(low, high, digits=3):
        low, high = f"{low:.{digits}g}", f"{high:.{digits}g}"
        return low if low == high else f"{low} to {high}"

    prior, peaks, found = compared.prior, compared.peaks, []
    n_modes = min(prior.frequencies.shape[1], max(NEXT, 1 + max(peaks, default=0)))
    for k, peak in [*((k, peaks.get(k)) for k in range(n_modes)), *((None, one) for one in compared.others)]:
        name, of_f, of_damping, data, damping, sensors = [""] * 6
        if k is not None:
            name, of_f = f"f{k + 1}", to_from(*prior.range_of(k))
            of_damping = to_from(*(100.0 * np.quantile(prior.ratios[:, k], [0.05, 0.95])))
        if peak is not None:
            data, sensors = f"{peak.frequency:.4g}", ", ".join(peak.sensors)
            damping = to_from(100.0 * peak.damping[0], 100.0 * peak.damping[-1], 2)
        found.append((name, of_f, data, of_damping, damping, sensors))
    return found


def scales(compared: Compared) -> str:
    """One sentence on what the record can resolve, and how far the structure would move."""
    first = compared.first or compared.prior.first
    return (
        f"{compared.duration:.4g} s are {compared.duration * first:.3g} periods of the first mode, with "
        f"{1.0 / (first * compared.step):.3g} samples in each; above {0.5 / compared.step:.4g} Hz nothing is "
        f"seen. An acceleration of 1 g would move the structure by {compared.prior.deflection:.3g} m."
    )


def matched(frequencies, found) -> dict[int, Resonance]:
    """Modes, lowest first, to the closest resonance, each taken once."""
    pairs = {}
    distances = np.abs(np.log(np.divide.outer(frequencies, [one.frequency for one in found])))
    while distances.size and distances.min() < transfer.SAME:
        mode, peak = np.unravel_index(distances.argmin(), distances.shape)
        pairs[int(mode)] = found[peak]
        distances[mode], distances[:, peak] = np.inf, np.inf
    return dict(sorted(pairs.items()))


def is_outside(prior, mode, peak) -> bool:
    """Whether a peak is none of the frequencies that the priors allow a mode."""
    low, middle, high = np.log(np.quantile(prior.frequencies[:, mode], [0.05, 0.5, 0.95]))
    away = np.log(peak) - middle
    if not prior.is_linear:
        away = max(0.0, away) if away > np.log(SOFTENED) else away
    spread = max(CLOSEST, BEYOND * 0.5 * (high - low) / 1.645)
    return bool(abs(away) > spread)


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
        number, which = f"{max(factor, 1.0 / factor):.2g}", "large" if factor > 1.0 else "small"
        start = f"{start}: stiffness over mass is {number} times too {which}, which no usual unit explains"
    if not names:
        return f"{start}. No prior moves it: check mass and stiffness."
    times = factor ** (-0.5 / sum(names.values()))
    scale, all_of_them = ("scale", ", all together") if len(names) > 1 else ("scales", "")
    which = f"{listing(names)}, which {scale} it,"
    return f"{start}. {which} would have to be {times:.2g} times as large{all_of_them}."


def too_little(duration, step, first, frequencies, n_sensors, pass_band):
    """Yield what a record cannot tell: it is too short, sampled too rarely, or filters leave no mode."""
    lowest, source = (first, "data") if first else (frequencies[0], "priors")
    if duration * lowest < PERIODS:
        yield (
            f"The record lasts {duration:.3g} s, {duration * lowest:.2g} periods of the first mode "
            f"({lowest:.3g} Hz by the {source}): it tells next to nothing of it. Take {PERIODS / lowest:.3g} "
            "s or more."
        )
    low, top = pass_band
    used = frequencies[: min(NEXT, max(2, n_sensors))]
    samples = {k: 1.0 / (f * step) for k, f in enumerate(used) if f < top or k == 0}
    few = {k: each for k, each in samples.items() if each < (SAMPLES if k == 0 else FEWEST)}
    names = {k: f"f{k + 1} ({frequencies[k]:.3g} Hz)" for k in few}
    rare = [f"{each:.2g} times in a period of {names[k]}" for k, each in few.items() if each > 2.0]
    if above := [names[k] for k, each in few.items() if each <= 2.0]:
        rare.append(f"{listing(above)} {'lies' if len(above) == 1 else 'lie'} above half of that")
    if few:
        yield (
            f"The data are sampled at {1.0 / step:.4g} Hz: {', and '.join(rare)}. That tells next to nothing "
            f"of {'it' if len(few) == 1 else 'them'}. Take files of a higher rate."
        )
    if top <= lowest:
        yield (
            f"`processing.band_pass` leaves {low:.3g} to {top:.3g} Hz, below the first mode ({lowest:.3g} "
            "Hz): no resonance is left to learn from. Raise `high`."
        )


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
    *others, last = names
    return f"{', '.join(others)} and {last}" if others else last
