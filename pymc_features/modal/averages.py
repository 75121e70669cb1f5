"""Means over set-ups of what their modes have in common, and how sure they are."""

import numpy as np

from pymc_features.modal.data import ModalData, find_channels


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
