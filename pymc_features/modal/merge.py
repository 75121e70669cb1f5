"""Several set-ups of one structure as one: sensors that stayed where they were give the scale of the others.

Each mode of a set-up has a scale and a sense of its own. Where set-ups share reference channels, the factor
a that minimises |a phi - psi|^2 there brings the shape phi of a set-up to the scale of what is merged so far,
psi: a = phi^H psi / (phi^H phi), complex for complex shapes. This is post separate estimation re-scaling.

Reynders, E., Magalhães, F., De Roeck, G. and Cunha, Á. (2009), Merging strategies for multi-setup
operational modal analysis, Proc. IMAC XXVII; Au, S.-K. (2011), Assembling mode shapes by least squares, Mech.
Syst. Signal Process. 25, 163-179.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from pymc_features._checks import check_number, check_texts, listed, require, shown
from pymc_features.modal.data import ModalData, agreement, demand, find_channels, warn_modes, without_nan

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
    shared = _shared_channels(setups, references)
    what, advice = "`frequency_tolerance` must be a fraction from 0 to 1", "Divide a percentage by 100."
    tolerance = check_number(frequency_tolerance, "frequency_tolerance")
    demand(0.0 < tolerance < 1.0, what, tolerance, advice)
    least = check_number(least_mac, "least_mac")
    demand(0.0 <= least <= 1.0, "`least_mac` must be from 0 to 1", least)
    found = Found(setups, shared)
    for number in found.order():
        found.join(number, tolerance, least)
    return found.merged()


def _checked_setups(setups) -> list[ModalData]:
    if isinstance(setups, ModalData) or not isinstance(setups, Sequence) or len(setups) < 2:
        raise TypeError(f"`setups` must be a sequence of at least two ModalData, got {shown(setups)}.")
    for number, setup in enumerate(setups):
        if not isinstance(setup, ModalData):
            got = f"{type(setup).__name__} at index {number}"
            raise TypeError(f"`setups` must be ModalData, got {got}. Read it with `read_modal`.")
        advice = "Average its frequencies yourself, or leave it out."
        what = f"`setups` must have shapes, set-up {number} has none. {advice}"
        require(setup.shapes is not None, what)
    return list(setups)


def _shared_channels(setups, references) -> list[str]:
    """Names of the channels that several set-ups have, which `references` name if they are given."""
    holders = Counter(name for setup in setups for name in setup.channels)
    shared = [name for name, count in holders.items() if count > 1]
    got = "; ".join(f"set-up {k}: {listed(s.channels, 8)}" for k, s in enumerate(setups))
    advice = "Give the same sensor the same name in all set-ups."
    demand(shared, "`setups` must have channels in common", f"none: {got}", advice)
    if references is not None:
        references = check_texts(references, "references", "a sequence of names")
        find_channels(references, shared, "several set-ups")
    for name in shared:
        where = [number for number, setup in enumerate(setups) if name in setup.channels]
        require(
            references is None or name in references,
            f"`references` must name all channels that set-ups share, {name!r} is in set-ups {where}. Add "
            "it, or rename it in one of them if these are two channels.",
        )
    return shared


class Found:
    """All modes of all set-ups, a row for each, at all channels; NaN for what a set-up does not have."""

    def __init__(self, setups: list[ModalData], shared: list[str]):
        self.setups, n = setups, len(setups)
        self.names = list(dict.fromkeys(name for setup in setups for name in setup.channels))
        self.numbers = np.repeat(np.arange(n), [len(setup) for setup in setups])
        self.frequencies = self.column("frequencies")
        self.shapes, self.shape_sd = self.column("shapes"), self.column("shape_sd")
        self.at = [self.names.index(name) for name in shared]
        parts = self.shapes[:, self.at]
        known = [~np.isnan(parts[self.numbers == number]).all(axis=0) for number in range(n)]
        self.known = np.array(known)  # (set-up, reference)
        has_references = np.array([not {*shared}.isdisjoint(setup.channels) for setup in setups])
        still = has_references[self.numbers] & ~without_nan(parts).any(axis=1)
        row = still.argmax()
        require(
            not still.any(),
            f"`references` must move in every mode, the mode at {self.frequencies[row]:.4g} Hz of set-up "
            f"{self.numbers[row]} has no entry there but zeros and NaN. Name others, or leave out this mode "
            "by `select`.",
        )
        self.modes = np.where(self.numbers == 0, np.arange(len(self.numbers)), -1)  # merged one of each row

    def column(self, name: str) -> np.ndarray:
        """What set-ups know of their modes, (row,) or (row, channel)."""
        values = {k: x for k, s in enumerate(self.setups) if (x := getattr(s, name)) is not None}
        of_channels = [len(self.names)] * name.startswith("shape")
        kind = np.result_type(np.float64, *values.values())
        whole = np.full((len(self.numbers), *of_channels), np.nan, kind)
        for k, x in values.items():
            places = [[self.names.index(channel) for channel in self.setups[k].channels]]
            whole[np.ix_(self.numbers == k, *places[: x.ndim - 1])] = x
        return whole

    def by_mode(self, function: Callable, *columns: np.ndarray) -> np.ndarray:
        """What a function makes of the rows of each merged mode."""
        modes = [self.modes == mode for mode in range(self.modes.max() + 1)]
        return np.array([function(*(column[rows] for column in columns)) for rows in modes])

    def order(self) -> Iterator[int]:
        """Set-ups but the first, each after one that it has a reference in common with."""
        joined, remaining = self.known[0], list(range(1, len(self.setups)))
        while remaining:
            number = next((k for k in remaining if (joined & self.known[k]).any()), None)
            require(
                number is not None,
                f"`setups` must be connected by references, set-ups {remaining} share none with the others. "
                "Give the same sensor the same name in all set-ups, or merge the parts by themselves.",
            )
            yield number
            joined = joined | self.known[number]
            remaining.remove(number)

    def join(self, number: int, tolerance: float, least: float) -> None:
        """Add the modes of a set-up to those they are the same as, or as new ones."""
        rows = np.flatnonzero(self.numbers == number)
        found, parts = self.frequencies[rows], self.shapes[np.ix_(rows, self.at)]
        means = self.by_mode(mean_entries, self.frequencies)[:, None]
        merged = self.by_mode(mean_entries, self.shapes[:, self.at])
        difference, likeness = abs(found - means) / means, agreement(merged, parts)
        allowed = (difference <= tolerance) & (likeness >= max(least, 1e-12))
        if not allowed.any():
            raise _nothing_in_common(number, found, means, likeness.max(), tolerance, least)
        cost = difference / tolerance + 1.0 - likeness
        # pairs that are not allowed cost more than all others together, so as few as possible are taken
        pairs = np.array(linear_sum_assignment(np.where(allowed, cost, 4.0 * cost.size)))
        for mode, k in pairs[:, allowed[*pairs]].T:
            factor = _factor(parts[k], merged[mode])
            self.modes[rows[k]] = mode
            self.shapes[rows[k]] *= factor
            self.shape_sd[rows[k]] *= abs(factor)
        new = rows[self.modes[rows] < 0]
        self.modes[new] = len(means) + np.arange(new.size)

    def merged(self) -> ModalData:
        """The modes in ascending order, with means over the set-ups; warns of what is uncertain."""
        means = self.by_mode(mean_entries, self.frequencies)
        order = np.argsort(means, kind="stable")
        self.modes = np.argsort(order)[self.modes]
        sizes = np.abs(without_nan(self.shapes))
        moving = sizes[:, self.at].max(axis=1) / sizes.max(axis=1)
        for mode, mean in enumerate(means[order]):
            rows = np.flatnonzero(self.modes == mode)
            if len(rows) < len(self.setups):
                warn_modes(
                    f"The mode at {mean:.4g} Hz is in set-ups {self.numbers[rows].tolist()} only; at the "
                    "other channels its shape is NaN. Leave it out by `select` if that is no mode."
                )
            for row in rows[moving[rows] < STILL]:
                warn_modes(
                    f"The references hardly move in the mode at {self.frequencies[row]:.4g} Hz of set-up "
                    f"{self.numbers[row]}, {moving[row]:.2g} of its largest entry: its scale is uncertain. "
                    "Leave the mode out by `select`, or name better `references`."
                )
        numbers = {"shapes": self.by_mode(mean_entries, self.shapes)}
        for values, sds in (("frequencies", "frequency_sd"), ("damping_ratios", "damping_sd")):
            numbers[values], numbers[sds] = self.by_mode(_average, self.column(values), self.column(sds)).T
        if np.isnan(numbers["frequency_sd"]).any():
            del numbers["frequency_sd"]
        numbers["shape_sd"] = self.by_mode(spread_of_mean, self.shapes, self.shape_sd)
        known = {name: values for name, values in numbers.items() if not np.isnan(values).all()}
        return ModalData(channels=self.names, **known)


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


@np.errstate(invalid="ignore")
def mean_entries(rows: np.ndarray) -> np.ndarray:
    """Mean of rows, without NaN; NaN where there is nothing else."""
    return without_nan(rows).sum(axis=0) / (~np.isnan(rows)).sum(axis=0)


@np.errstate(invalid="ignore")
def spread_of_mean(rows: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """Standard deviation of `mean_entries`."""
    known = ~np.isnan(rows)
    return np.sqrt(np.sum(np.where(known, sd, 0.0) ** 2, axis=0)) / known.sum(axis=0)


def _average(x: np.ndarray, sd: np.ndarray) -> tuple[float, float]:
    """Mean and its standard deviation: inverse variances as weights, and Birge's ratio if it is above 1.

    Birge, R. T. (1932), The calculation of errors by the method of least squares, Phys. Rev. 40, 207-227.
    """
    x, sd = x[~np.isnan(x)], sd[~np.isnan(x)]
    if x.size == 0:
        return np.nan, np.nan
    if not (sd > 0.0).all():
        return float(x.mean()), np.nan
    weights = (sd.min() / sd) ** 2
    mean = float(weights @ x / weights.sum())
    ratio = weights @ (x - mean) ** 2 / max(x.size - 1, 1) / sd.min() ** 2
    return mean, float(sd.min() / np.sqrt(weights.sum()) * np.sqrt(max(ratio, 1.0)))
