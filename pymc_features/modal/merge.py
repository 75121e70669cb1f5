"""Several set-ups of one structure as one: sensors that stayed where they were give the scale of the others.

Each mode of a set-up has a scale and a sense of its own. Where set-ups share reference channels, the factor
a that minimises |a phi - psi|^2 there brings the shape phi of a set-up to the scale of what is merged so far,
psi: a = phi^H psi / (phi^H phi), complex for complex shapes. This is post separate estimation re-scaling.

Reynders, E., Magalhães, F., De Roeck, G. and Cunha, Á. (2009), Merging strategies for multi-setup
operational modal analysis, Proc. IMAC XXVII; Au, S.-K. (2011), Assembling mode shapes by least squares, Mech.
Syst. Signal Process. 25, 163-179.
"""

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from pymc_features._checks import check_number, check_texts, listed, shown
from pymc_features.modal.data import ModalData, agreement, find_channels, refusal, warn_modes

RADIANS = (2.0 * np.pi, 0.5 / np.pi)  # ratios of rad/s and Hz
STILL = 0.1  # of the largest entry of a shape: references below it give its scale poorly


def merge_setups(
    setups: Sequence[ModalData],
    references: Sequence[str] | None = None,
    *,
    frequency_tolerance: float = 0.05,
    least_mac: float = 0.8,
) -> ModalData:
    """Merge the modes of several set-ups by the channels that they have in common.

    Modes of two set-ups are the same if their frequencies differ by at most `frequency_tolerance` and their
    shapes agree at the references; of several such pairs, those with the least differences in total. Shapes
    are brought to the scale of the first set-up by least squares at the references, where the scaled shapes
    are averaged.

    Parameters
    ----------
    setups : sequence of ModalData
        At least two, with shapes, and the same names for the same channels.
    references : sequence of str, optional
        Names of the reference channels, each in at least two set-ups, which connect all of them; by default
        every channel that is in several.
    frequency_tolerance : float
        Largest relative difference of the frequencies of one mode, positive and less than 1.
    least_mac : float
        Least modal assurance criterion at the references, from 0 to 1. With one reference it is always 1.

    Returns
    -------
    ModalData
        Modes in ascending order of frequency, channels in the order of the set-ups. Frequencies and damping
        ratios are means; weighted by their variances where all set-ups have these, and the standard deviation
        of the mean is then raised by Birge's ratio if the set-ups scatter more than they say. Entries that no
        set-up measured, of a mode that some did not find, are NaN. Standard deviations of entries are scaled
        with them; that of the factor is not added.

    Raises
    ------
    ValueError, TypeError
        If set-ups have no shapes, are not connected by references, have no common modes, or other channels
        than references in common.

    Warns
    -----
    ModalDataWarning
        If a mode is not in all set-ups, or hardly moves the references.

    Examples
    --------
    >>> first = ModalData([2.0], [[1.0, 0.5]], ["roof", "floor 2"])
    >>> second = ModalData([2.02], [[-2.0, -0.6]], ["roof", "floor 1"])
    >>> merged = merge_setups([first, second])
    >>> merged.channels, merged.shapes
    (('roof', 'floor 2', 'floor 1'), array([[1. , 0.5, 0.3]]))
    """
    setups = _checked_setups(setups)
    references = _checked_references(setups, references)
    tolerance = check_number(frequency_tolerance, "frequency_tolerance")
    least = check_number(least_mac, "least_mac")
    if not 0.0 < tolerance < 1.0:
        what = "`frequency_tolerance` must be a fraction from 0 to 1"
        raise refusal(what, tolerance, "Divide a percentage by 100.")
    if not 0.0 <= least <= 1.0:
        raise refusal("`least_mac` must be from 0 to 1", least)
    merged = Merged(setups, references)
    for number in merged.order():
        merged.join(number, tolerance, least)
    return merged.result()


def _checked_setups(setups) -> list[ModalData]:
    if isinstance(setups, ModalData) or not isinstance(setups, Sequence) or len(setups) < 2:
        raise TypeError(f"`setups` must be a sequence of at least two ModalData, got {shown(setups)}.")
    for number, setup in enumerate(setups):
        if not isinstance(setup, ModalData):
            got = f"{type(setup).__name__} at index {number}"
            raise TypeError(f"`setups` must be ModalData, got {got}. Read it with `read_modal`.")
        if setup.shapes is None:
            raise ValueError(
                f"`setups` must have shapes, set-up {number} has none. Average its frequencies yourself, or "
                "leave it out."
            )
    return list(setups)


def _checked_references(setups, references) -> list[str]:
    """Names of the references: all channels that several set-ups have."""
    holders = Counter(name for setup in setups for name in setup.channels)
    shared = [name for name, count in holders.items() if count > 1]
    if not shared:
        got = "; ".join(f"set-up {k}: {listed(s.channels, 8)}" for k, s in enumerate(setups))
        advice = "Give the same sensor the same name in all set-ups."
        raise refusal("`setups` must have channels in common", f"none: {got}", advice)
    if references is None:
        return shared
    references = check_texts(references, "references", "a sequence of names")
    find_channels(references, shared, "several set-ups")
    for name in shared:
        if name not in references:
            where = [number for number, setup in enumerate(setups) if name in setup.channels]
            raise ValueError(
                f"`references` must name all channels that set-ups share, {name!r} is in set-ups {where}. "
                "Add it, or rename it in one of them if these are two channels."
            )
    return [str(name) for name in references]


class Merged:
    """Modes of several set-ups as one: of each mode and set-up, the row of the set-up's and its factor.

    Tables of the set-ups have a last row of NaN, which stands for what a set-up does not have: row -1.
    """

    def __init__(self, setups: list[ModalData], references: list[str]):
        self.setups = setups
        self.names = list(dict.fromkeys(name for setup in setups for name in setup.channels))
        self.at = find_channels(references, self.names, "all")
        self.shapes, self.frequencies = self.table("shapes"), self.table("frequencies")
        parts = self.shapes[:, :, self.at]
        self.measured = (~np.isnan(parts)).any(axis=1)  # (set-up, reference)
        for number, setup in enumerate(setups):
            still = ~np.nan_to_num(parts[number, : len(setup)]).any(axis=1)
            if still.any() and set(setup.channels) & set(references):
                raise ValueError(
                    f"`references` must move in every mode, the mode at {setup.frequencies[still][0]:.4g} Hz "
                    f"of set-up {number} has no entry there but zeros and NaN. Name others, or leave out "
                    "this mode by `select`."
                )
        self.rows = np.full((len(setups[0]), len(setups)), -1)  # (mode, set-up)
        self.rows[:, 0] = range(len(setups[0]))
        self.factors = np.ones(self.rows.shape, dtype=self.shapes.dtype)

    def table(self, name: str) -> np.ndarray:
        """What set-ups know of their modes, (set-up, mode) or (set-up, mode, channel), NaN elsewhere."""
        is_complex = name == "shapes" and any(setup.is_complex for setup in self.setups)
        size = len(self.setups), 1 + max(map(len, self.setups)), len(self.names)
        table = np.full(size, np.nan, dtype=np.complex128 if is_complex else np.float64)
        for part, setup in zip(table, self.setups, strict=True):
            if (values := getattr(setup, name)) is not None and values.ndim == 1:
                part[: len(setup)] = values[:, None]
            elif values is not None:
                part[: len(setup), find_channels(setup.channels, self.names, "all")] = values
        return table if name.startswith("shape") else table[:, :, 0]

    def of_modes(self, table: np.ndarray) -> np.ndarray:
        """What a table says of the merged modes, (mode, set-up) or (mode, set-up, channel)."""
        return table[np.arange(len(self.setups)), self.rows]

    @property
    def means(self) -> np.ndarray:
        """Mean frequencies (mode,) [Hz]."""
        return mean_entries(self.of_modes(self.frequencies))

    @property
    def scaled(self) -> np.ndarray:
        """Shapes (mode, set-up, channel) in the scale of the first set-up."""
        return self.factors[:, :, None] * self.of_modes(self.shapes)

    def order(self) -> Iterator[int]:
        """Set-ups but the first, each after one that it has a reference in common with."""
        joined, remaining = self.measured[0], list(range(1, len(self.setups)))
        while remaining:
            number = next((k for k in remaining if (joined & self.measured[k]).any()), None)
            if number is None:
                raise ValueError(
                    f"`setups` must be connected by references, set-ups {remaining} share none with the "
                    "others. Give the same sensor the same name in all set-ups, or merge the parts by "
                    "themselves."
                )
            yield number
            joined = joined | self.measured[number]
            remaining.remove(number)

    def join(self, number: int, tolerance: float, least: float) -> None:
        """Add the modes of a set-up to those they are the same as, or as new ones."""
        found, parts = self.setups[number].frequencies, self.shapes[number][:, self.at]
        means, merged = self.means[:, None], mean_entries(self.scaled[..., self.at])
        difference, likeness = abs(found - means) / means, agreement(merged, parts[: found.size])
        allowed = (difference <= tolerance) & (likeness >= max(least, 1e-12))
        if not allowed.any():
            raise _nothing_in_common(number, found, means, likeness.max(), tolerance, least)
        cost = difference / tolerance + 1.0 - likeness
        # pairs that are not allowed cost more than all others together, so as few as possible are taken
        pairs = np.array(linear_sum_assignment(np.where(allowed, cost, 4.0 * cost.size)))
        pairs = pairs[:, allowed[*pairs]]
        for mode, k in pairs.T:
            self.rows[mode, number] = k
            self.factors[mode, number] = _factor(parts[k], merged[mode])
        new = np.setdiff1d(np.arange(found.size), pairs[1])
        self.rows = np.vstack([self.rows, np.full((new.size, len(self.setups)), -1)])
        self.rows[len(means) :, number] = new
        self.factors = np.vstack([self.factors, np.ones((new.size, len(self.setups)))])

    def result(self) -> ModalData:
        """The modes in ascending order, with means over the set-ups; warns of what is uncertain."""
        order = np.argsort(self.means, kind="stable")
        self.rows, self.factors = self.rows[order], self.factors[order]
        self._warn()
        entries, numbers = self.scaled, {}
        for values, sds in (("frequencies", "frequency_sd"), ("damping_ratios", "damping_sd")):
            pair = (self.of_modes(self.table(name)) for name in (values, sds))
            numbers[values], numbers[sds] = _averages(*pair)
        if np.isnan(numbers["frequency_sd"]).any():
            del numbers["frequency_sd"]
        numbers = {name: values for name, values in numbers.items() if not np.isnan(values).all()}
        if any(setup.shape_sd is not None for setup in self.setups):
            sds = np.abs(self.factors)[:, :, None] * self.of_modes(self.table("shape_sd"))
            squares = np.where(np.isnan(entries), 0.0, sds) ** 2
            numbers["shape_sd"] = np.sqrt(squares.sum(axis=1)) / _count(entries)
        return ModalData(shapes=mean_entries(entries), channels=self.names, **numbers)

    def _warn(self) -> None:
        """Warn of modes that are not in all set-ups, and of references that hardly move."""
        for mean, rows in zip(self.means, self.rows, strict=True):
            where = np.flatnonzero(rows >= 0).tolist()
            if len(where) < len(rows):
                warn_modes(
                    f"The mode at {mean:.4g} Hz is in set-ups {where} only; at the other channels its shape "
                    "is NaN. Leave it out by `select` if that is no mode."
                )
            for number in where:
                shape = np.abs(self.shapes[number, rows[number]])
                moving = np.nanmax(shape[self.at]) / np.nanmax(shape)
                if moving < STILL:
                    warn_modes(
                        "The references hardly move in the mode at "
                        f"{self.setups[number].frequencies[rows[number]]:.4g} Hz of set-up {number}, "
                        f"{moving:.2g} of its largest entry: its scale is uncertain. Leave the mode out by "
                        "`select`, or name better `references`."
                    )


def _factor(shape: np.ndarray, wanted: np.ndarray):
    """The factor that brings a shape closest to another, on the entries that both have."""
    both = ~np.isnan(shape) & ~np.isnan(wanted)
    size = np.abs(shape[both]).max()
    scaled = shape[both] / size
    return np.vdot(scaled, wanted[both]) / np.vdot(scaled, scaled).real / size


def _nothing_in_common(number, found, means, best, tolerance, least) -> ValueError:
    """The error about a set-up without a mode of the others, and why that may be."""
    ratio = found / means
    pairs = {factor: (np.abs(ratio / factor - 1.0) <= tolerance).sum() for factor in (1.0, *RADIANS)}
    likely = max(pairs, key=pairs.get)
    advice = "Raise `frequency_tolerance`, or leave this set-up out."
    if pairs[likely] and likely in RADIANS:
        whose = f"set-up {number}" if likely > 1.0 else "the others"
        advice = f'They differ by 2 pi: are those of {whose} in rad/s? Read them with names={{"omega": ...}}.'
    elif pairs[likely]:
        advice = (
            "Frequencies agree, shapes do not: the best modal assurance criterion at the references is "
            f"{best:.2f}. Check the names and senses of the reference channels, or lower `least_mac`."
        )
    ours, theirs = (listed([f"{f:.4g}" for f in values.ravel()], 8) for values in (found, means))
    return ValueError(
        f"`setups` must have modes in common, set-up {number} ({ours} Hz) has none of the others "
        f"({theirs} Hz) within {100.0 * tolerance:g} % and with a modal assurance criterion of at least "
        f"{least:g}. {advice}"
    )


def mean_entries(values: np.ndarray) -> np.ndarray:
    """Mean over set-ups, the second axis, of what is not NaN; NaN where there is nothing else."""
    mean = np.nan_to_num(values).sum(axis=1) / np.nan_to_num(_count(values), nan=1.0)
    return np.where(np.isnan(_count(values)), np.nan, mean)


def _count(values: np.ndarray) -> np.ndarray:
    """How many along the second axis are not NaN, NaN where none is."""
    count = (~np.isnan(values)).sum(axis=1)
    return np.where(count > 0, count, np.nan)


def _averages(x: np.ndarray, sd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means (mode,) over set-ups and their standard deviations: inverse variances as weights, Birge's ratio.

    Plain means, and NaN, where a standard deviation is not known. Birge, R. T. (1932), The calculation of
    errors by the method of least squares, Phys. Rev. 40, 207-227.
    """
    known = ~np.isnan(x)
    weighed = (known <= (sd > 0.0)).all(axis=1, keepdims=True) & known.any(axis=1, keepdims=True)
    sd = np.where(known & weighed, sd, np.inf)
    smallest = np.where(weighed, sd.min(axis=1, keepdims=True), 1.0)
    weights = np.where(weighed, (smallest / sd) ** 2, known)
    total, count = weights.sum(axis=1), known.sum(axis=1)
    with np.errstate(invalid="ignore"):
        means = np.sum(weights * np.where(known, x, 0.0), axis=1) / total
    off = np.where(known, x - means[:, None], 0.0)
    ratio = np.sum(weights * off**2, axis=1) / np.maximum(count - 1, 1) / smallest[:, 0] ** 2
    spread = np.sqrt(np.maximum(ratio, 1.0) / np.where(total > 0.0, total, 1.0))
    return means, np.where(weighed[:, 0], smallest[:, 0] * spread, np.nan)
