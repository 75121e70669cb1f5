"""By which factor all natural frequencies that the priors expect miss those of the data.

On a logarithmic axis of frequency another stiffness, mass or sampling step shifts the transfer functions of
a structure, H(f / r). The share of a sensor's mean square that H(f / r) X explains, with the best gain and
sign, is for all r at once a cross-correlation.
"""

from typing import NamedTuple

import numpy as np

SAME = 0.08  # relative distance of a measured frequency from the mode it is taken for
SPACING = 0.01  # of the logarithm of frequency
FARTHEST = 1200.0  # factor: stiffness in MN/m is off by 1000
MOST_DRAWS = 60
RATIOS = 0.01, 0.1  # within which damping is taken as it is drawn: judged by itself


class Scale(NamedTuple):
    """The factor that explains most.

    Attributes
    ----------
    factor : float
        On all natural frequencies of the draw.
    draw : int
        Of the priors, the one that explains most.
    explained : array (s,)
        Share of the mean square of each sensor, with the factor.
    as_drawn : float
        The same by the best draw without a factor, mean over sensors.
    gains : array (s,)
        Of the sensors: measured over expected, -1 where a sensor is inverted.
    """

    factor: float
    draw: int
    explained: np.ndarray
    as_drawn: float
    gains: np.ndarray


def factor_of(identified, frequencies) -> tuple[float, int]:
    """The factor closest to one, and the draw (d, m), that bring most identified frequencies to modes."""
    some = np.linspace(0, len(frequencies) - 1, min(MOST_DRAWS, len(frequencies))).astype(int)
    best = (-1, 0.0, 1.0, 0)
    for draw in some:
        factors = np.append(np.divide.outer(identified, frequencies[draw]).ravel(), 1.0)
        away = np.abs(np.log(factors[:, None, None] * frequencies[draw] / identified[:, None]))
        number = (away.min(axis=-1) < SAME).sum(axis=-1)
        for count, factor in zip(number, factors, strict=True):
            best = max(best, (int(count), -abs(float(np.log(factor))), float(factor), int(draw)))
    return best[2:]


def transfer(f, frequencies, ratios, shares, quantity) -> np.ndarray:
    """Transfer functions (s, d, k) of a quantity against the acceleration of the base; shares (d, s, m)."""
    omega, natural = 2.0 * np.pi * f, 2.0 * np.pi * frequencies[..., None]
    found = np.zeros((shares.shape[1], len(frequencies), f.size), complex)
    for mode in range(frequencies.shape[1]):
        d = 1.0 / (natural[:, mode] ** 2 - omega**2 + 2.0j * ratios[:, mode, None] * natural[:, mode] * omega)
        found -= shares[:, :, mode].T[..., None] * d
    if quantity in ("relative_displacement", "inter_storey_drift"):
        return found
    found *= 1.0j * omega if quantity == "relative_velocity" else -(omega**2)
    if quantity == "absolute_acceleration":
        found += 1.0
    return found


def log_spectra(spectra) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
    """Spectra summed over even steps of the logarithm of frequency.

    Returns
    -------
    int, array (k,), array (s, k), array (s,)
        Number of the first step from 1 Hz on, power of the base, cross-spectra of the sensors with it, and
        their whole power.
    """
    x, y = spectra.base[1:], spectra.sensors[:, 1:]
    place = np.rint(np.log(spectra.frequency[1:]) / SPACING).astype(int)
    first = int(place.min())
    cross = y * np.conj(x)
    parts = [np.bincount(place - first, c.real) + 1.0j * np.bincount(place - first, c.imag) for c in cross]
    power = np.bincount(place - first, np.abs(x) ** 2)
    return first, power, np.array(parts), (np.abs(y) ** 2).sum(axis=1)


def scale_of(spectra, frequencies, ratios, shares, quantity) -> Scale:
    """Compare transforms of channels with draws (d, m) of modes and their shares (d, s, m) at the sensors."""
    first, power, crosses, totals = log_spectra(spectra)
    reach = int(np.log(FARTHEST) / SPACING)
    size = power.size + 2 * reach
    grid = np.exp(SPACING * (np.arange(size) + first - reach))
    n_fft = 1 << int(np.ceil(np.log2(size + power.size)))
    some = np.linspace(0, len(frequencies) - 1, min(MOST_DRAWS, len(frequencies))).astype(int)
    zeta = np.clip(ratios[some], *RATIOS)
    at_power = np.conj(np.fft.rfft(power, n_fft))
    histories = transfer(grid, frequencies[some], zeta, shares[some], quantity)
    explained, gains = [], []
    for j, cross in enumerate(crosses):
        h = histories[j]
        # sum over the data's frequencies of H(f / r) conj(cross), for shifts of H from -reach to reach
        along = np.fft.ifft(np.fft.fft(h, n_fft) * np.conj(np.fft.fft(cross, n_fft))).real[:, : 2 * reach + 1]
        total = np.fft.irfft(np.fft.rfft(np.abs(h) ** 2, n_fft) * at_power, n_fft)[:, : 2 * reach + 1]
        total = np.maximum(total, 1e-9 * total.max())
        explained.append(along**2 / (total * totals[j]))
        gains.append(along / total)
    mean = np.mean(explained, axis=0)
    draw, shift = np.unravel_index(mean.argmax(), mean.shape)
    return Scale(
        float(np.exp(SPACING * (reach - shift))),
        int(some[draw]),
        np.array([share[draw, shift] for share in explained]),
        float(mean[:, reach].max()),
        np.array([gain[draw, shift] for gain in gains]),
    )
