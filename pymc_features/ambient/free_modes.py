"""The posterior of free modes in one band: coordinates, values, gradients and the way to its mode."""

from collections.abc import Iterator
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import optimize
from scipy.linalg import null_space

from pymc_features.ambient.bands import transfer_functions
from pymc_features.simulators.spectra import Lines, SpectralParameters, spectral_gradient

STEP = 1e-4  # of differences of gradients, in coordinates of order one
TOLERANCE = 1e-5  # of the gradient, relative to the number of data


class BandData(NamedTuple):
    """Transforms of all channels in one band."""

    spectra: np.ndarray  # (s, 2, k), real and imaginary parts
    lines: Lines
    limits: np.ndarray  # (2,) [Hz]
    duration: float  # of the record [s]

    @property
    def used(self) -> np.ndarray:
        """Complex transforms (s, n) of the frequencies that count."""
        kept = self.lines.weights > 0.0
        return self.spectra[:, 0, kept] + 1j * self.spectra[:, 1, kept]

    @property
    def frequencies(self) -> np.ndarray:
        """Frequencies of `used` [Hz]."""
        return self.lines.frequencies[self.lines.weights > 0.0]


class FreeModes(NamedTuple):
    """Parameters of the modes of one band; with the factor L, L L^* is the spectral density of the forces."""

    natural: np.ndarray  # frequencies (m,) [Hz]
    ratios: np.ndarray  # of damping (m,)
    shapes: np.ndarray  # (m, s), of length one, the largest entry positive
    factor: np.ndarray  # (m, m), complex, lower triangular with a positive diagonal
    error: float  # spectral density of the error of each channel

    def normalised(self) -> "FreeModes":
        """Shapes of length one and one sign; the forces take the rest."""
        lengths = np.linalg.norm(self.shapes, axis=1)
        largest = self.shapes[np.arange(len(lengths)), np.abs(self.shapes).argmax(axis=1)]
        signs = np.sign(largest)
        factor = self.factor * (lengths * signs)[:, None] * signs
        return self._replace(shapes=self.shapes / (lengths * signs)[:, None], factor=factor)


class Posterior:
    """The log-likelihood of a band in coordinates (d,) that are zero at some modes and of order one near.

    They are, of each mode, ln f over the damping ratio, ln zeta, and the tangent of the shape (s - 1 numbers:
    its length belongs to the forces); the entries of L, logarithms on its diagonal; and ln S_e. The prior is
    flat in them.
    """

    def __init__(self, data: BandData, centre: FreeModes):
        self.data, self.centre = data, centre
        m, s = centre.shapes.shape
        self.basis = np.array([null_space(shape[None]) for shape in centre.shapes]).reshape(m, s, s - 1)
        self.below = np.tril_indices(m, -1)
        sizes = [m, m, m * (s - 1), m, len(self.below[0]), len(self.below[0]), 1]
        self.parts = np.split(np.arange(sum(sizes)), np.cumsum(sizes)[:-1])
        self.size = sum(sizes)

    def parameters(self, x) -> SpectralParameters:
        """Return the parameters of points (n, d)."""
        c, n = self.centre, len(x)
        m, s = c.shapes.shape
        u, v, t, a, real, imaginary, e = (x[:, part] for part in self.parts)
        shapes = c.shapes + np.einsum("mst,nmt->nms", self.basis, t.reshape(n, m, s - 1))
        factor, diagonal = np.zeros((n, 1, m, m), complex), np.diag(c.factor).real
        factor[:, 0, np.arange(m), np.arange(m)] = diagonal * np.exp(a)
        off = diagonal[self.below[0]] * (real + 1j * imaginary)
        factor[:, 0, *self.below] = c.factor[self.below] + off
        parameters = (
            c.natural * np.exp(c.ratios * u),
            c.ratios * np.exp(v),
            shapes,
            factor.view(np.float64).reshape(n, 1, m, m, 2),
            np.repeat(c.error * np.exp(e)[:, :, None], s, axis=2),
            np.repeat(self.data.spectra[None], n, axis=0),
        )
        return SpectralParameters(*map(np.ascontiguousarray, parameters))  # one kernel serves all

    def modes(self, x) -> FreeModes:
        """The modes of a point (d,)."""
        p = self.parameters(x[None])
        factor = p.factor[0, 0, ..., 0] + 1j * p.factor[0, 0, ..., 1]
        return FreeModes(p.natural[0], p.ratios[0], p.shapes[0], factor, float(p.error[0, 0, 0])).normalised()

    def value_and_gradient(self, x) -> tuple[np.ndarray, np.ndarray]:
        """Log-likelihoods (n,) and gradients (n, d) of points (n, d); -inf and zero for impossible ones."""
        with np.errstate(over="ignore"):
            p = self.parameters(x)
        logp = np.empty(len(x))
        slopes = SpectralParameters(
            *(np.zeros(y.shape) for y in p[:-1]), np.zeros((0, *self.data.spectra.shape))
        )
        spectral_gradient(p, self.data.lines, logp, slopes)
        diagonal, each = np.diag(self.centre.factor).real, np.arange(len(self.centre.natural))
        below = slopes.factor[:, 0, *self.below] * diagonal[self.below[0], None]
        with np.errstate(invalid="ignore", over="ignore"):
            parts = (
                slopes.natural * p.natural * self.centre.ratios,
                slopes.ratios * p.ratios,
                np.einsum("mst,nms->nmt", self.basis, slopes.shapes).reshape(len(x), -1),
                slopes.factor[:, 0, each, each, 0] * p.factor[:, 0, each, each, 0],
                below[..., 0],
                below[..., 1],
                (slopes.error * p.error).sum(axis=(1, 2))[:, None],
            )
        return logp, np.nan_to_num(np.concatenate(parts, axis=1))

    def information(self, x) -> np.ndarray:
        """Minus the second derivatives (d, d) at a point, by differences of gradients."""
        moved = x + STEP * np.vstack([np.eye(self.size), -np.eye(self.size)])
        up, down = np.split(self.value_and_gradient(moved)[1], 2)
        found = (down - up) / (2.0 * STEP)
        return 0.5 * (found + found.T)

    def value(self) -> float:
        """The log-likelihood of the modes it is centred at."""
        return float(self.value_and_gradient(np.zeros((1, self.size)))[0][0])

    def climbed(self) -> "Posterior":
        """Centred at the mode of the posterior that lies uphill, by Newton's method with a trust region."""

        def minus(x):
            logp, gradient = self.value_and_gradient(x[None])
            return -logp[0], -gradient[0]

        done = optimize.minimize(
            minus,
            np.zeros(self.size),
            jac=True,
            hess=self.information,
            method="trust-exact",
            options={"gtol": TOLERANCE * self.data.used.size, "maxiter": 60, "initial_trust_radius": 0.5},
        )
        return Posterior(self.data, self.modes(done.x))

    @cached_property
    def covariance(self) -> np.ndarray | None:
        """Covariance of the coordinates (d, d), Laplace's approximation; None where there is no maximum."""
        values, vectors = np.linalg.eigh(self.information(np.zeros(self.size)))
        if not (np.isfinite(values).all() and values[0] > 0.0):
            return None
        return (vectors / values) @ vectors.T

    def standard_deviations(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Standard deviations of frequencies (m,) [Hz], damping ratios (m,) and shapes (m, s)."""
        c, covariance = self.centre, self.covariance
        m, s = c.shapes.shape
        sd = np.sqrt(np.diag(covariance))
        u, v, t, *_ = self.parts
        tangent = covariance[np.ix_(t, t)].reshape(m, s - 1, m, s - 1)
        own = tangent[np.arange(m), :, np.arange(m), :]
        of_shapes = np.sqrt(np.einsum("mst,mtr,msr->ms", self.basis, own, self.basis))
        return c.natural * c.ratios * sd[u], c.ratios * sd[v], of_shapes


def noise_logp(data: BandData) -> float:
    """The largest log-likelihood without any mode."""
    spectra = data.used
    return -spectra.size * (np.log(np.pi * np.mean(np.abs(spectra) ** 2)) + 1.0)


# --- where the search for the modes of a band begins ----------------------------------------------------

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
