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
from pymc_features.modal.data import ModalData, agreement, find_channels, warn_modes

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
        raise ValueError(
            f"`frequency_tolerance` must be a fraction from 0 to 1, got {tolerance}. Divide a percentage by "
            "100."
        )
    if not 0.0 <= least <= 1.0:
        raise ValueError(f"`least_mac` must be from 0 to 1, got {least}.")
    parts = [_at(setup, references, number) for number, setup in enumerate(setups)]
    modes = [[(0, k, 1.0)] for k in range(len(setups[0]))]
    for number in _order(parts):
        _join(modes, setups, parts, number, (tolerance, least))
    modes.sort(key=lambda members: _frequency(setups, members))
    _check_found(setups, modes, parts)
    return merged(setups, modes)


def _checked_setups(setups) -> list[ModalData]:
    if isinstance(setups, ModalData) or not isinstance(setups, Sequence) or len(setups) < 2:
        raise TypeError(f"`setups` must be a sequence of at least two ModalData, got {shown(setups)}.")
    for number, setup in enumerate(setups):
        if not isinstance(setup, ModalData):
            raise TypeError(
                f"`setups` must be ModalData, got {type(setup).__name__} at index {number}. Read it with "
                "`read_modal`."
            )
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
        raise ValueError(
            "`setups` must have channels in common, got none: "
            + "; ".join(f"set-up {k}: {listed(s.channels, 8)}" for k, s in enumerate(setups))
            + ". Give the same sensor the same name in all set-ups."
        )
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


def _at(setup: ModalData, references: list[str], number: int) -> np.ndarray:
    """Entries (mode, reference), NaN at those of other set-ups; one at least must move in each mode."""
    places = [index for index, name in enumerate(references) if name in setup.channels]
    own = find_channels([references[index] for index in places], setup.channels, "it") if places else []
    part = np.full((len(setup), len(references)), np.nan, dtype=setup.shapes.dtype)
    part[:, places] = setup.shapes[:, own]
    for mode, entries in enumerate(part):
        if places and not (np.abs(entries) > 0.0).any():
            raise ValueError(
                f"`references` must move in every mode, the mode at {setup.frequencies[mode]:.4g} Hz of "
                f"set-up {number} has no entry there but zeros and NaN. Name others, or leave out this mode "
                "by `select`."
            )
    return part


def _order(parts) -> Iterator[int]:
    """Set-ups but the first, each after one that it has a reference in common with."""
    measured = [~np.isnan(part).all(axis=0) for part in parts]
    joined, remaining = measured[0], list(range(1, len(parts)))
    while remaining:
        number = next((k for k in remaining if (joined & measured[k]).any()), None)
        if number is None:
            raise ValueError(
                f"`setups` must be connected by references, set-ups {remaining} share none with the others. "
                "Give the same sensor the same name in all set-ups, or merge the parts by themselves."
            )
        yield number
        joined = joined | measured[number]
        remaining.remove(number)


def _frequency(setups, members) -> float:
    return float(np.mean([setups[number].frequencies[k] for number, k, _ in members]))


def _reference(parts, members) -> np.ndarray:
    """Mean of the scaled entries (reference,) of what is merged so far."""
    return mean_entries(np.array([factor * parts[number][k] for number, k, factor in members]))


def _join(modes, setups, parts, number, limits) -> None:
    """Add the modes of a set-up to those they are the same as, or as new ones."""
    tolerance, least = limits
    found = setups[number].frequencies
    cost = np.full((len(modes), found.size), np.inf)
    for row, members in enumerate(modes):
        frequency, shape = _frequency(setups, members), _reference(parts, members)
        for k in range(found.size):
            difference = abs(found[k] - frequency) / frequency
            likeness = agreement(shape, parts[number][k])
            if difference <= tolerance and likeness >= max(least, 1e-12):
                cost[row, k] = difference / tolerance + 1.0 - likeness
    allowed = np.isfinite(cost)
    if not allowed.any():
        raise _nothing_in_common(modes, setups, parts, number, limits)
    taken = set()
    # pairs that are not allowed cost more than all that are allowed together, so as few as possible are taken
    for row, k in zip(*linear_sum_assignment(np.where(allowed, cost, 4.0 * cost.size)), strict=True):
        if allowed[row, k]:
            factor = _factor(parts[number][k], _reference(parts, modes[row]))
            modes[row].append((number, int(k), factor))
            taken.add(k)
    modes += [[(number, k, 1.0)] for k in range(found.size) if k not in taken]


def _factor(shape: np.ndarray, wanted: np.ndarray):
    """The factor that brings a shape closest to another, on the entries that both have."""
    both = ~np.isnan(shape) & ~np.isnan(wanted)
    size = np.abs(shape[both]).max()
    scaled = shape[both] / size
    return np.vdot(scaled, wanted[both]) / np.vdot(scaled, scaled).real / size


def _nothing_in_common(modes, setups, parts, number, limits) -> ValueError:
    """The error about a set-up without a mode of the others, and why that may be."""
    tolerance, least = limits
    others = np.array([_frequency(setups, members) for members in modes])
    found = setups[number].frequencies
    ratio = found[None] / others[:, None]
    pairs = {factor: (np.abs(ratio / factor - 1.0) <= tolerance).sum() for factor in (1.0, *RADIANS)}
    likely = max(pairs, key=pairs.get)
    advice = "Raise `frequency_tolerance`, or leave this set-up out."
    if pairs[likely] and likely in RADIANS:
        whose = f"set-up {number}" if likely > 1.0 else "the others"
        advice = f'They differ by 2 pi: are those of {whose} in rad/s? Read them with names={{"omega": ...}}.'
    elif pairs[likely]:
        best = max(agreement(_reference(parts, m), part) for m in modes for part in parts[number])
        advice = (
            "Frequencies agree, shapes do not: the best modal assurance criterion at the references is "
            f"{best:.2f}. Check the names and senses of the reference channels, or lower `least_mac`."
        )
    return ValueError(
        f"`setups` must have modes in common, set-up {number} ({_hz(found)}) has none of the others "
        f"({_hz(others)}) within {100.0 * tolerance:g} % and with a modal assurance criterion of at least "
        f"{least:g}. {advice}"
    )


def _hz(frequencies) -> str:
    return listed([f"{value:.4g}" for value in frequencies], 8) + " Hz"


def _check_found(setups, modes, parts) -> None:
    """Warn of modes that are not in all set-ups, and of references that hardly move."""
    for members in modes:
        where = [number for number, _, _ in members]
        if len(where) < len(setups):
            warn_modes(
                f"The mode at {_frequency(setups, members):.4g} Hz is in set-ups {where} only; at the other "
                "channels its shape is NaN. Leave it out by `select` if that is no mode."
            )
        for number, k, _ in members:
            largest = np.nanmax(np.abs(setups[number].shapes[k]))
            moving = np.nanmax(np.abs(parts[number][k])) / largest
            if moving < STILL:
                warn_modes(
                    f"The references hardly move in the mode at {setups[number].frequencies[k]:.4g} Hz of "
                    f"set-up {number}, {moving:.2g} of its largest entry: its scale is uncertain. Leave the "
                    "mode out by `select`, or name better `references`."
                )


# --- means over set-ups of what their modes have in common, and how sure they are --------------------------


def merged(setups: list[ModalData], modes: list[list[tuple]]) -> ModalData:
    """The modes as one: of each the set-ups that have it, its place there, and the factor of its shape."""
    names = list(dict.fromkeys(name for setup in setups for name in setup.channels))
    places = [find_channels(setup.channels, names, "all") for setup in setups]
    kind = np.complex128 if any(setup.is_complex for setup in setups) else np.float64
    shapes, spreads = [], []
    for members in modes:
        entries = np.full((len(members), len(names)), np.nan, dtype=kind)
        sds = np.full(entries.shape, np.nan)
        for row, (number, k, factor) in enumerate(members):
            entries[row, places[number]] = factor * setups[number].shapes[k]
            if setups[number].shape_sd is not None:
                sds[row, places[number]] = abs(factor) * setups[number].shape_sd[k]
        sds[np.isnan(entries)] = 0.0
        count = (~np.isnan(entries)).sum(axis=0)
        shapes.append(mean_entries(entries))
        spreads.append(np.where(count > 0, np.sqrt((sds**2).sum(axis=0)) / np.maximum(count, 1), np.nan))
    frequencies, frequency_sd = _averages(setups, modes, "frequencies", "frequency_sd")
    damping, damping_sd = _averages(setups, modes, "damping_ratios", "damping_sd")
    return ModalData(
        frequencies,
        np.array(shapes),
        names,
        frequency_sd=None if np.isnan(frequency_sd).any() else frequency_sd,
        damping_ratios=None if np.isnan(damping).all() else damping,
        damping_sd=None if np.isnan(damping_sd).all() else damping_sd,
        shape_sd=None if all(setup.shape_sd is None for setup in setups) else np.array(spreads),
    )


def mean_entries(rows: np.ndarray) -> np.ndarray:
    """Mean of the rows of an array, without NaN; NaN where there is nothing else."""
    count = (~np.isnan(rows)).sum(axis=0)
    total = np.where(np.isnan(rows), 0.0, rows).sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _averages(setups, modes, values: str, sds: str) -> tuple[np.ndarray, np.ndarray]:
    """Means (m,) over the set-ups and their standard deviations, NaN where these are not known."""
    pairs = []
    for members in modes:
        x = np.array([_number(setups[number], values, k) for number, k, _ in members])
        sd = np.array([_number(setups[number], sds, k) for number, k, _ in members])[~np.isnan(x)]
        pairs.append(_average(x[~np.isnan(x)], sd))
    means, spreads = np.array(pairs).T
    return means, spreads


def _number(setup: ModalData, name: str, mode: int) -> float:
    values = getattr(setup, name)
    return np.nan if values is None else float(values[mode])


def _average(x: np.ndarray, sd: np.ndarray) -> tuple[float, float]:
    """Mean and its standard deviation: inverse variances as weights, and Birge's ratio if it is above 1.

    Birge, R. T. (1932), The calculation of errors by the method of least squares, Phys. Rev. 40, 207-227.
    """
    if x.size == 0:
        return np.nan, np.nan
    if np.isnan(sd).any() or (sd == 0.0).any():
        return float(x.mean()), np.nan
    weights = (sd.min() / sd) ** 2
    mean = float(weights @ x / weights.sum())
    ratio = weights @ (x - mean) ** 2 / max(x.size - 1, 1) / sd.min() ** 2
    return mean, float(sd.min() / np.sqrt(weights.sum()) * np.sqrt(max(ratio, 1.0)))
