"""Which sensors are swapped or inverted, by the modes that the priors expect where the data have theirs.

Where a structure follows its base, below its first mode, floors move nearly alike; at its modes they do not.
Each sensor is compared with the motion that draws of the priors expect at each of the places, with either
sign.
"""

from itertools import combinations
from typing import NamedTuple

import numpy as np

from pymc_features.update.plausibility.scale import SPACING, log_spectra, transfer

REACH = 15  # steps of the logarithm of frequency about the factor of the data
MOST_DRAWS, FEW_DRAWS, MANY_SENSORS = 60, 30, 5
LEVEL = 0.15  # half the width, in the logarithm of frequency, over which levels are averaged
QUIET = 0.01  # of the highest level: what is lower counts less, for it may be noise
SWAPPED = 0.5  # of what the sensors leave unexplained where they are said to be
EXPLAINED = 0.6  # share of the mean square of a sensor whose sign can be told


class Placement(NamedTuple):
    """How sensors fit their places.

    Attributes
    ----------
    swapped : tuple of two ints, or None
        Sensors that fit each other's place much better.
    inverted : tuple of int
        Sensors whose opposite sign fits.
    unexplained, unexplained_swapped : float
        Share of the mean square, mean over sensors: as they are, and with the best two of them swapped.
    """

    swapped: tuple[int, int] | None
    inverted: tuple[int, ...]
    unexplained: float
    unexplained_swapped: float


def told_by_modes(gains, placed) -> str:
    """What modes show of swapped or inverted sensors where gains (sensor) against the base do not.

    It is written into `scale` and the attribute `order` of the gains; empty if there is nothing to tell.
    """
    if placed is None or gains.attrs.get("order") or (gains["scale"].values != 1.0).any():
        return ""
    names = [str(name) for name in gains["sensor"].values]
    share, swapped_share = (
        max(0.0, 100.0 * (1.0 - left)) for left in (placed.unexplained, placed.unexplained_swapped)
    )
    if placed.swapped is not None:
        i, j = (sensor + 1 for sensor in placed.swapped)
        swapped = f"{names[i]} and {names[j]}"
        names[i], names[j] = names[j], names[i]
        gains.attrs["order"] = names
        return (
            f"{swapped} may be swapped: the modes that the priors expect explain {swapped_share:.0f} % of "
            f"the sensors' motion if they are, {share:.0f} % as it is."
        )
    if placed.inverted:
        inverted = [names[sensor + 1] for sensor in placed.inverted]
        what = "The base" if len(inverted) == len(names) - 1 else ", ".join(inverted)
        gains["scale"] = "sensor", np.where(np.isin(names, inverted), -1.0, 1.0)
        return (
            f"{what} may be inverted: the modes that the priors expect explain {share:.0f} % of the sensors' "
            "motion with the opposite sign."
        )
    return ""


def placement(spectra, prior, dofs, quantity, factor=1.0) -> Placement:
    """Compare sensors with the modes of draws, near whose frequencies times a factor the data have theirs."""
    draws = FEW_DRAWS if len(dofs) > MANY_SENSORS else MOST_DRAWS
    left, _ = unexplained(flattened(spectra), prior, dofs, quantity, factor, draws)
    least = np.diagonal(left, axis1=-2, axis2=-1).mean(axis=-1)  # (shift, draw)
    swaps = {}
    for i, j in combinations(range(len(dofs)), 2):
        change = left[..., i, j] + left[..., j, i] - left[..., i, i] - left[..., j, j]
        swaps[i, j] = float((least + change / len(dofs)).min())
    pair = min(swaps, key=swaps.get, default=None)
    if pair is not None and swaps[pair] < SWAPPED * least.min():
        return Placement(pair, (), float(least.min()), swaps[pair])
    left, signs = unexplained(spectra, prior, dofs, quantity, factor, draws)
    own = np.diagonal(left, axis1=-2, axis2=-1)  # (shift, draw, sensor)
    best = np.unravel_index(own.mean(axis=-1).argmin(), own.shape[:2])
    inverted = np.flatnonzero((np.diagonal(signs[best]) < 0.0) & (own[best] < 1.0 - EXPLAINED))
    return Placement(None, tuple(map(int, inverted)), float(own[best].mean()), swaps.get(pair, np.inf))


def flattened(spectra):
    """Spectra over the level of the sensors, so that higher modes, which tell floors apart, count as well."""
    f, power = spectra.frequency, (np.abs(spectra.sensors) ** 2).mean(axis=0)
    total = np.cumsum(np.append(0.0, power))
    low, high = (np.searchsorted(f, f * np.exp(side * LEVEL)) for side in (-1.0, 1.0))
    high = np.maximum(high, low + 1)
    level = (total[high] - total[low]) / (high - low)
    weight = 1.0 / np.sqrt(level + QUIET * level.max())
    return spectra._replace(base=weight * spectra.base, sensors=weight * spectra.sensors)


def lags_confirmed(spectra, prior, dofs, quantity, *, factor, delays) -> bool:
    """Whether delays (s,) of sensors [s], taken back, bring them closer to the modes of draws."""
    least = []
    for taken in (np.zeros(len(dofs)), np.asarray(delays)):
        turned = spectra.sensors * np.exp(2.0j * np.pi * spectra.frequency * taken[:, None])
        left, _ = unexplained(spectra._replace(sensors=turned), prior, dofs, quantity, factor, FEW_DRAWS)
        least.append(np.diagonal(left, axis1=-2, axis2=-1).mean(axis=-1).min())
    return least[1] < least[0]


def unexplained(spectra, prior, dofs, quantity, factor, draws) -> tuple[np.ndarray, np.ndarray]:
    """Share left of each sensor at each place, and the sign that leaves it, (shift, draw, sensor, place)."""
    some = np.linspace(0, len(prior.frequencies) - 1, min(draws, len(prior.frequencies))).astype(int)
    first, power, cross, total = log_spectra(spectra)
    grid = np.exp(SPACING * (np.arange(-REACH, power.size + REACH) + first)) / factor
    shares = prior.at_sensors(dofs, quantity)[some]
    zeta = np.clip(prior.ratios[some], 0.005, 0.2)
    h = transfer(grid, prior.frequencies[some], zeta, shares, quantity).swapaxes(0, 1)
    left, signs = [], []
    for shift in range(2 * REACH + 1):
        part = h[..., shift : shift + power.size]
        along = (part @ cross.conj().T).real.swapaxes(-1, -2)  # (draw, sensor, place)
        size = (np.abs(part) ** 2 @ power)[:, None, :]
        left.append(1.0 - (2.0 * np.abs(along) - size) / total[:, None])
        signs.append(np.sign(along))
    return np.array(left), np.array(signs)
