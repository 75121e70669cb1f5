"""Transfer functions that the priors expect, beside the spectra of the data: scale, places, signs and bands.

On a logarithmic axis of frequency another stiffness, mass or sampling step shifts the transfer functions of
a structure, H(f / r). The share of a sensor's mean square that H(f / r) X explains, with the best gain and
sign, is for all r at once a cross-correlation: so the factor r is found by which all natural frequencies that
the priors expect miss those of the data.

Where a structure follows its base, below its first mode, floors move nearly alike; at its modes they do not.
There each sensor is compared with the motion that draws of the priors expect at each of the places, with
either sign: so swapped and inverted sensors are found.
"""

from itertools import combinations
from typing import NamedTuple

import numpy as np

SAME = 0.08  # relative distance of a measured frequency from the mode it is taken for
SPACING = 0.01  # of the logarithm of frequency
FARTHEST = 1200.0  # factor: stiffness in MN/m is off by 1000
MOST_DRAWS, FEW_DRAWS, MANY_SENSORS = 60, 30, 5
RATIOS = 0.01, 0.1  # within which damping is taken as it is drawn: judged by itself
OWN_RATIOS = 0.005, 0.2  # the same, where places are judged
REACH = 15  # steps of the logarithm of frequency about the factor of the data
LEVEL = 0.15  # half the width, in the logarithm of frequency, over which levels are averaged
QUIET = 0.01  # of the highest level: what is lower counts less, for it may be noise
SWAPPED = 0.5  # of what the sensors leave unexplained where they are said to be
EXPLAINED = 0.6  # share of the mean square of a sensor whose sign can be told


class Scale(NamedTuple):
    """The factor that explains most."""

    factor: float  # on all natural frequencies of the draw
    draw: int  # the one that explains most
    # share of the mean square of the sensors, with the factor, and by the best draw without it
    explained: float
    as_drawn: float


class Placement(NamedTuple):
    """How sensors fit their places."""

    swapped: tuple[int, int] | None  # sensors that fit each other's place much better
    inverted: tuple[int, ...]  # sensors whose opposite sign fits
    # share of the mean square, mean over sensors: as they are, and with the best two of them swapped
    unexplained: float
    unexplained_swapped: float


def transfer(f, prior, limits=(0.0, np.inf)) -> np.ndarray:
    """Transfer functions (s, d, k) of draws at sensors, see `PriorModes.at_sensors`, against the base."""
    omega, natural = 2.0 * np.pi * f, 2.0 * np.pi * prior.frequencies[..., None]
    ratios, shares, quantity = np.clip(prior.ratios, *limits), prior.shares, prior.quantity
    found = np.zeros((shares.shape[1], len(natural), f.size), complex)
    for mode in range(natural.shape[1]):
        d = 1.0 / (natural[:, mode] ** 2 - omega**2 + 2.0j * ratios[:, mode, None] * natural[:, mode] * omega)
        found -= shares[:, :, mode].T[..., None] * d
    if quantity in ("relative_displacement", "inter_storey_drift"):
        return found
    found *= 1.0j * omega if quantity == "relative_velocity" else -(omega**2)
    return found + 1.0 if quantity == "absolute_acceleration" else found


def log_spectra(spectra) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
    """Spectra summed over even steps of the logarithm of frequency, and which step is the first one.

    Then power of the base (k,), cross-spectra of the sensors with it (s, k), and their whole power (s,).
    """
    x, y = spectra.base[1:], spectra.sensors[:, 1:]
    place = np.rint(np.log(spectra.frequency[1:]) / SPACING).astype(int)
    first = int(place.min())
    cross = y * np.conj(x)
    parts = [np.bincount(place - first, c.real) + 1.0j * np.bincount(place - first, c.imag) for c in cross]
    power = np.bincount(place - first, np.abs(x) ** 2)
    return first, power, np.array(parts), (np.abs(y) ** 2).sum(axis=1)


def factor_of(identified, frequencies) -> tuple[float, int]:
    """The factor closest to one, and the draw (d, m), that bring most identified frequencies to modes."""
    best = (-1, 0.0, 1.0, 0)
    for draw, modes in enumerate(frequencies):
        factors = np.append(np.divide.outer(identified, modes).ravel(), 1.0)
        away = np.abs(np.log(factors[:, None, None] * modes / identified[:, None]))
        number = (away.min(axis=-1) < SAME).sum(axis=-1)
        for count, factor in zip(number, factors, strict=True):
            best = max(best, (int(count), -abs(float(np.log(factor))), float(factor), draw))
    return best[2:]


def scale_of(spectra, prior) -> Scale:
    """Compare transforms of channels with draws of modes at the places of the sensors."""
    first, power, crosses, totals = log_spectra(spectra)
    reach = int(np.log(FARTHEST) / SPACING)
    size = power.size + 2 * reach
    grid = np.exp(SPACING * (np.arange(size) + first - reach))
    n_fft = 1 << int(np.ceil(np.log2(size + power.size)))
    at_power, explained = np.conj(np.fft.rfft(power, n_fft)), 0.0
    for h, cross, whole in zip(transfer(grid, prior, RATIOS), crosses, totals, strict=True):
        # sum over the data's frequencies of H(f / r) conj(cross), for shifts of H from -reach to reach
        along = np.fft.ifft(np.fft.fft(h, n_fft) * np.conj(np.fft.fft(cross, n_fft))).real[:, : 2 * reach + 1]
        total = np.fft.irfft(np.fft.rfft(np.abs(h) ** 2, n_fft) * at_power, n_fft)[:, : 2 * reach + 1]
        explained += along**2 / (np.maximum(total, 1e-9 * total.max()) * whole) / len(crosses)
    draw, shift = np.unravel_index(explained.argmax(), explained.shape)
    factor = float(np.exp(SPACING * (reach - shift)))
    return Scale(factor, int(draw), float(explained.max()), float(explained[:, reach].max()))


def placement(spectra, prior, factor=1.0) -> Placement:
    """Compare sensors with the modes of draws, near whose frequencies times a factor the data have theirs."""
    n = len(spectra.names)
    prior = prior.few(FEW_DRAWS if n > MANY_SENSORS else MOST_DRAWS)
    left, _ = unexplained(flattened(spectra), prior, factor)
    least = np.diagonal(left, axis1=-2, axis2=-1).mean(axis=-1)  # (shift, draw)
    swaps = {}
    for i, j in combinations(range(n), 2):
        change = left[..., i, j] + left[..., j, i] - left[..., i, i] - left[..., j, j]
        swaps[i, j] = float((least + change / n).min())
    pair = min(swaps, key=swaps.get, default=None)
    if pair is not None and swaps[pair] < SWAPPED * least.min():
        return Placement(pair, (), float(least.min()), swaps[pair])
    left, signs = unexplained(spectra, prior, factor)
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


def unexplained(spectra, prior, factor) -> tuple[np.ndarray, np.ndarray]:
    """Share left of each sensor at each place, and the sign that leaves it, (shift, draw, sensor, place)."""
    first, power, cross, total = log_spectra(spectra)
    grid = np.exp(SPACING * (np.arange(-REACH, power.size + REACH) + first)) / factor
    h = transfer(grid, prior, OWN_RATIOS).swapaxes(0, 1)
    left, signs = [], []
    for shift in range(2 * REACH + 1):
        part = h[..., shift : shift + power.size]
        along = (part @ cross.conj().T).real.swapaxes(-1, -2)  # (draw, sensor, place)
        size = (np.abs(part) ** 2 @ power)[:, None, :]
        left.append(1.0 - (2.0 * np.abs(along) - size) / total[:, None])
        signs.append(np.sign(along))
    return np.array(left), np.array(signs)


def lags_confirmed(spectra, prior, *, factor, delays) -> bool:
    """Whether delays (s,) of sensors [s], taken back, bring them closer to the modes of draws."""
    least, prior = [], prior.few(FEW_DRAWS)
    for taken in (np.zeros(len(delays)), np.asarray(delays)):
        turned = spectra.sensors * np.exp(2.0j * np.pi * spectra.frequency * taken[:, None])
        left, _ = unexplained(spectra._replace(sensors=turned), prior, factor)
        least.append(np.diagonal(left, axis1=-2, axis2=-1).mean(axis=-1).min())
    return least[1] < least[0]


def told_by_modes(gains, placed: Placement | None) -> str:
    """What modes show of swapped or inverted sensors where gains do not, in words and within the gains."""
    if placed is None or gains.attrs.get("order") or (gains["scale"].values != 1.0).any():
        return ""
    names = gains["sensor"].values.astype(str).tolist()
    left = placed.unexplained, placed.unexplained_swapped
    share, swapped_share = (max(0.0, 100.0 * (1.0 - one)) for one in left)
    if placed.swapped is not None:
        i, j = (sensor + 1 for sensor in placed.swapped)
        names[i], names[j] = names[j], names[i]
        gains.attrs["order"] = names
        return (
            f"{names[j]} and {names[i]} may be swapped: the modes that the priors expect explain "
            f"{swapped_share:.0f} % of the sensors' motion if they are, {share:.0f} % as it is."
        )
    if not placed.inverted:
        return ""
    inverted = [names[sensor + 1] for sensor in placed.inverted]
    what = "The base" if len(inverted) == len(names) - 1 else ", ".join(inverted)
    gains["scale"] = "sensor", np.where(np.isin(names, inverted), -1.0, 1.0)
    return (
        f"{what} may be inverted: the modes that the priors expect explain {share:.0f} % of the sensors' "
        "motion with the opposite sign."
    )
