"""Where the search for the modes of a band begins."""

from collections.abc import Iterator

import numpy as np

from pymc_features.ambient.transfer import transfer_functions
from pymc_features.identification.posterior import BandData, FreeModes, Posterior

RATIOS = (0.005, 0.02)  # damping ratios that are tried
BESIDE = 0.05  # damping ratio of what comes in from beside the band, at first
STARTS = 3  # from which the posterior is climbed, the likeliest first, until there is a maximum
SMALLEST = 1e-3  # force or error, over the mean of the band


def best_posterior(data: BandData, m: int, fewer: FreeModes | None = None) -> Posterior | None:
    """The posterior of m modes, centred at a maximum uphill from the best guess; None if there is none.

    `fewer` are the modes that were found before, one less, to which guesses add another.
    """
    guesses = [*first_guesses(data, m), *([] if fewer is None else one_more(data, fewer))]
    starts = [Posterior(data, modes) for modes in guesses]
    ordered = sorted(starts, key=lambda one: -one.value())
    for start in ordered[: STARTS if fewer is None else 1]:
        found = start.climbed() if np.isfinite(start.value()) else start
        if np.isfinite(found.value()) and found.covariance is not None:
            return found
    return None


def first_guesses(data: BandData, m: int) -> Iterator[FreeModes]:
    """Modes at peaks of the spectrum, at equal shares of its energy, and close together at its peak."""
    from scipy import signal  # a second to import

    power = (np.abs(data.used) ** 2).sum(axis=0)
    width = max(3, power.size // 25)
    smooth = np.convolve(np.pad(power, width, mode="edge"), np.ones(width) / width, "same")[width:-width]
    f = data.frequencies
    peaks, _ = signal.find_peaks(smooth, distance=width)
    peaks = peaks[np.argsort(-smooth[peaks])][:m]
    main, share = f[smooth.argmax()], np.cumsum(power) / power.sum()
    close = np.linspace(-1.0, 1.0, m) if m > 1 else np.zeros(1)
    sets = [np.interp((np.arange(m) + 0.5) / m, share, f), main * (1.0 + 0.01 * close)]
    if peaks.size == m:
        sets.append(np.sort(f[peaks]))
    for natural in sets:
        for ratio in RATIOS:
            yield fitted(data, natural, np.full(m, ratio))


def one_more(data: BandData, fewer: FreeModes) -> Iterator[FreeModes]:
    """Modes with another one: where the spectrum stands highest above them, or what comes in from beside."""
    spectra, f = data.used, data.frequencies
    gains = data.lines.gains[data.lines.weights > 0.0]
    transfer = gains[:, None] * transfer_functions(fewer.natural, fewer.ratios, f)
    roots = np.einsum("ms,km,mr->ksr", fewer.shapes, transfer, fewer.factor)
    expected = (np.abs(roots) ** 2).sum(axis=(1, 2)) + len(spectra) * fewer.error
    width = max(3, f.size // 25)
    ratio = np.convolve((np.abs(spectra) ** 2).sum(axis=0) / expected, np.ones(width) / width, "same")
    low, high = data.limits
    additions = [(f[ratio.argmax()], ratio_of_mode) for ratio_of_mode in RATIOS]
    for natural, damping in [*additions, (0.97 * low, BESIDE), (1.03 * high, BESIDE)]:
        yield fitted(data, np.append(fewer.natural, natural), np.append(fewer.ratios, damping))


def fitted(data: BandData, natural, ratios) -> FreeModes:
    """Shapes, forces and errors of given frequencies, by least squares.

    The spectral matrix Re(F F^*) is close to sum_r |h_r|^2 S_r phi_r phi_r' + S_e I where modes do not
    interfere; the best matrices in the place of S_r phi_r phi_r' have shape and force as their first
    eigenvector and eigenvalue.
    """
    spectra, f, m = data.used, data.frequencies, len(natural)
    s = len(spectra)
    matrices = np.einsum("ik,jk->kij", spectra, spectra.conj()).real
    gains = data.lines.gains[data.lines.weights > 0.0]
    transfer = np.abs(gains[:, None] * transfer_functions(natural, ratios, f)) ** 2
    columns = np.column_stack([transfer, np.ones(f.size)])
    weight = 1.0 / (columns @ (1.0 / columns.mean(axis=0)))  # as large as the spectrum may be
    solved = np.linalg.lstsq(
        columns * weight[:, None], matrices.reshape(f.size, -1) * weight[:, None], rcond=None
    )
    values, vectors = np.linalg.eigh(solved[0].reshape(m + 1, s, s))
    level = np.mean(np.abs(spectra) ** 2)
    force = np.maximum(values[:m, -1], SMALLEST * level / transfer.mean(axis=0))
    error = max(values[m].mean(), SMALLEST * level)
    shapes = vectors[:m, :, -1]
    return FreeModes(natural, ratios, shapes, np.diag(np.sqrt(force)).astype(complex), error).normalised()
