"""Likelihood of the Fourier transforms of output-only measurements, and its gradient, as compiled kernels.

The transform F_k of s channels at a frequency f_k is complex Gaussian with the covariance

    E_k = Phi H_k S H_k^* Phi' + diag(S_e),  S = L L^*,  H_k = diag(h_r),
    h_r = (2 pi i f_k)^(-q) / (1 - (f_r / f_k)^2 - 2 i zeta_r f_r / f_k)

with the spectral density S of the modal forces and S_e of the prediction error, both one-sided, and q = 0, 1,
2 for accelerations, velocities and displacements (S.-K. Au, Operational Modal Analysis, Springer 2017, ch. 10
and 12). Everything is reduced to matrices of the rank r of L: with B = H L, G = Phi diag(S_e)^-1 Phi' and
u = Phi diag(S_e)^-1 F, by the lemmas of Woodbury and Sylvester,

    K = I + B^* G B,  ln|E| = ln|S_e| + ln|K|,  F^* E^-1 F = F^* S_e^-1 F - v^* K^-1 v,  v = B^* u.

Frequencies lie in the lanes of vectors.

The gradient of the log-likelihood, of a population.

With w = K^-1 v, N = K^-1 + w w^* and p = B w, the derivative of the log-likelihood of a frequency is

    Re tr(X^* dB) + tr(g dG) + 2 Re(p^* du),  X = 2 (u w^* - G B N),  g = -Re B N B^*,

and terms of S_e and F alone.

What the kernels of the spectral likelihood take.

The log-likelihood of a population, and what its gradient begins with.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, load, splat, square_root, store
from pymc_features.simulators.compiled.vector_math import logarithm
from pymc_features.simulators.compiled.vector_memory import total

MULTIPLE = 8  # frequencies of a band are filled up to a multiple of this, with the weight zero


class Lines(NamedTuple):
    """Frequencies of all bands, one band after the other.

    Attributes
    ----------
    frequencies : array (k,)
        f_k [Hz]; the number in each band is a multiple of `MULTIPLE`.
    weights : array (k,)
        1, or 0 for those that only fill up.
    gains : array (k,)
        |2 pi i f_k|^(-q), the size of what was measured of a unit acceleration.
    starts : array of int (b + 1,)
        Where each band begins, and the last one ends.
    """

    frequencies: np.ndarray
    weights: np.ndarray
    gains: np.ndarray
    starts: np.ndarray


class SpectralParameters(NamedTuple):
    """Parameters of one structure under unmeasured forces; of a population, with an axis in front.

    Attributes
    ----------
    natural : array (m,)
        Natural frequencies f_r [Hz].
    ratios : array (m,)
        Damping ratios zeta_r [-].
    shapes : array (m, s)
        Rows are the mode shapes at the sensors.
    factor : array (b, m, r, 2)
        L in each band, real and imaginary parts: L L^* is the spectral density S of the modal forces.
    error : array (b, s)
        S_e of each channel in each band [unit^2/Hz].
    spectra : array (s, 2, k)
        Real and imaginary parts of the transforms, zero where the weight is zero.
    """

    natural: np.ndarray
    ratios: np.ndarray
    shapes: np.ndarray
    factor: np.ndarray
    error: np.ndarray
    spectra: np.ndarray


class Scratch(NamedTuple):
    """Memory of one block of frequencies, a row for each number; complex ones take two.

    Attributes
    ----------
    g : array (m, m)
        G of the band.
    h : array (2 m, LANES)
    b, gb : array (2 m r, LANES)
        B and G B.
    u : array (2 m, LANES)
    k : array (2 r r, LANES)
        K, then its Cholesky factor, then (of gradients) N = K^-1 + w w^*.
    v : array (2 r, LANES)
        v, then its solution with the factor, then (of gradients) w = K^-1 v.
    """

    g: np.ndarray
    h: np.ndarray
    b: np.ndarray
    gb: np.ndarray
    u: np.ndarray
    k: np.ndarray
    v: np.ndarray


LOG_PI = np.log(np.pi)


@jit
def scratch_for(m, r):
    """Memory for m modes and forces of rank r."""
    return Scratch(
        np.empty((m, m)),
        np.empty((2 * m, LANES)),
        np.empty((2 * m * r, LANES)),
        np.empty((2 * m * r, LANES)),
        np.empty((2 * m, LANES)),
        np.empty((2 * r * r, LANES)),
        np.empty((2 * r, LANES)),
    )


@jit
def row_of(parameters, i):
    """One of the population; an array with one row stands for all."""
    natural, ratios, shapes, factor, error, spectra = parameters
    return SpectralParameters(
        natural[min(i, natural.shape[0] - 1)],
        ratios[min(i, ratios.shape[0] - 1)],
        shapes[min(i, shapes.shape[0] - 1)],
        factor[min(i, factor.shape[0] - 1)],
        error[min(i, error.shape[0] - 1)],
        spectra[min(i, spectra.shape[0] - 1)],
    )


@jit
def is_possible(parameters):
    """Whether frequencies, damping and errors are positive numbers."""
    natural, ratios, _, _, error, _ = parameters
    possible = True
    for x in natural:
        possible &= x > 0.0
    for x in ratios:
        possible &= x >= 0.0
    for x in error.ravel():
        possible &= x > 0.0
    return possible


@jit
def information(parameters, band, scratch):
    """Write G = Phi diag(S_e)^-1 Phi'."""
    shapes, error = parameters.shapes, parameters.error
    m, s = shapes.shape
    for a in range(m):
        for c in range(a + 1):
            x = 0.0
            for j in range(s):
                x += shapes[a, j] * shapes[c, j] / error[band, j]
            scratch.g[a, c] = scratch.g[c, a] = x


@jit
def factorise(parameters, lines, band, block, scratch):
    """Write h, B, G B, u, the Cholesky factor C of K and y = C^-1 v of the frequencies of a block.

    Returns ln|K| and |y|^2, lane by lane.
    """
    natural, ratios, shapes, factor, error, spectra = parameters
    g, h, b, gb, u, k, v = scratch
    m, s = shapes.shape
    r = factor.shape[2]
    blocks = lines.frequencies.size // LANES
    f = load(lines.frequencies, block)
    gain = load(lines.gains, block)
    for a in range(m):
        beta = natural[a] / f
        real, imaginary = 1.0 - beta * beta, beta * (2.0 * ratios[a])
        size = gain / (real * real + imaginary * imaginary)
        real, imaginary = real * size, imaginary * size
        store(h, 2 * a, real)
        store(h, 2 * a + 1, imaginary)
        for c in range(r):
            x, y = factor[band, a, c, 0], factor[band, a, c, 1]
            store(b, 2 * (a * r + c), real * x - imaginary * y)
            store(b, 2 * (a * r + c) + 1, real * y + imaginary * x)
        real, imaginary = splat(0.0), splat(0.0)
        for j in range(s):
            x = shapes[a, j] / error[band, j]
            real = real + load(spectra, 2 * j * blocks + block) * x
            imaginary = imaginary + load(spectra, (2 * j + 1) * blocks + block) * x
        store(u, 2 * a, real)
        store(u, 2 * a + 1, imaginary)
    for a in range(m):
        for c in range(r):
            real, imaginary = splat(0.0), splat(0.0)
            for e in range(m):
                x = g[a, e]
                real = real + load(b, 2 * (e * r + c)) * x
                imaginary = imaginary + load(b, 2 * (e * r + c) + 1) * x
            store(gb, 2 * (a * r + c), real)
            store(gb, 2 * (a * r + c) + 1, imaginary)
    log_det, square = splat(0.0), splat(0.0)
    for c in range(r):
        real, imaginary = splat(0.0), splat(0.0)
        for a in range(m):  # v = B^* u
            x, y = load(b, 2 * (a * r + c)), load(b, 2 * (a * r + c) + 1)
            p, q = load(u, 2 * a), load(u, 2 * a + 1)
            real = real + (x * p + y * q)
            imaginary = imaginary + (x * q - y * p)
        for d in range(c + 1):
            k_real, k_imaginary = splat(1.0 if c == d else 0.0), splat(0.0)
            for a in range(m):  # K = I + B^* G B
                x, y = load(b, 2 * (a * r + c)), load(b, 2 * (a * r + c) + 1)
                p, q = load(gb, 2 * (a * r + d)), load(gb, 2 * (a * r + d) + 1)
                k_real = k_real + (x * p + y * q)
                k_imaginary = k_imaginary + (x * q - y * p)
            for e in range(d):  # less C C^*
                x, y = load(k, 2 * (c * r + e)), load(k, 2 * (c * r + e) + 1)
                p, q = load(k, 2 * (d * r + e)), load(k, 2 * (d * r + e) + 1)
                k_real = k_real - (x * p + y * q)
                k_imaginary = k_imaginary - (y * p - x * q)
            if c == d:
                log_det = log_det + logarithm(k_real)
                store(k, 2 * (c * r + c), square_root(k_real))
                store(k, 2 * (c * r + c) + 1, splat(0.0))
            else:
                diagonal = load(k, 2 * (d * r + d))
                store(k, 2 * (c * r + d), k_real / diagonal)
                store(k, 2 * (c * r + d) + 1, k_imaginary / diagonal)
        for e in range(c):
            x, y = load(k, 2 * (c * r + e)), load(k, 2 * (c * r + e) + 1)
            p, q = load(v, 2 * e), load(v, 2 * e + 1)
            real = real - (x * p - y * q)
            imaginary = imaginary - (x * q + y * p)
        diagonal = load(k, 2 * (c * r + c))
        real, imaginary = real / diagonal, imaginary / diagonal
        store(v, 2 * c, real)
        store(v, 2 * c + 1, imaginary)
        square = square + (real * real + imaginary * imaginary)
    return log_det, square


@jit
def constant_part(parameters, lines, band, n_lines):
    """What S_e and the data alone give: - sum_k (s ln pi + ln|S_e| + F^* S_e^-1 F)."""
    error, spectra = parameters.error, parameters.spectra
    first, last = lines.starts[band], lines.starts[band + 1]
    logp = 0.0
    for j in range(spectra.shape[0]):
        squares = 0.0
        for part in range(2):
            for i in range(first, last):
                squares += spectra[j, part, i] ** 2
        logp -= n_lines * (LOG_PI + np.log(error[band, j])) + squares / error[band, j]
    return logp


@jit
def band_logp(parameters, lines, band, scratch):
    """The log-likelihood of a band."""
    information(parameters, band, scratch)
    sums, n_lines = splat(0.0), splat(0.0)
    for block in range(lines.starts[band] // LANES, lines.starts[band + 1] // LANES):
        log_det, square = factorise(parameters, lines, band, block, scratch)
        weight = load(lines.weights, block)
        sums = sums + (square - log_det) * weight
        n_lines = n_lines + weight
    return total(sums) + constant_part(parameters, lines, band, total(n_lines))


@jit
def spectral_logp(parameters: SpectralParameters, lines: Lines, logp):
    """Write the log-likelihoods (p,) of a population; -inf for impossible parameters."""
    scratch = scratch_for(parameters.shapes.shape[1], parameters.factor.shape[3])
    for i in range(logp.shape[0]):
        row = row_of(parameters, i)
        logp[i] = -np.inf
        if is_possible(row):
            found = 0.0
            for band in range(lines.starts.size - 1):
                found += band_logp(row, lines, band, scratch)
            if np.isfinite(found):
                logp[i] = found


class Sums(NamedTuple):
    """Sums over the frequencies of a band, lane by lane.

    Attributes
    ----------
    natural, ratios : array (m, LANES)
    factor : array (2 m r, LANES)
    g : array (m m, LANES)
    crossed : array (m s, LANES)
        Re(conj(p_r) F_j).
    inverse : array (2 r r, LANES)
        The inverse of the factor of K, of the present frequencies.
    p : array (2 m, LANES)
        Of the present frequencies, as x.
    bn : array (2 m r, LANES)
        B N.
    """

    natural: np.ndarray
    ratios: np.ndarray
    factor: np.ndarray
    g: np.ndarray
    crossed: np.ndarray
    inverse: np.ndarray
    p: np.ndarray
    bn: np.ndarray


@jit
def sums_for(m, s, r):
    """Memory for m modes, s channels and forces of rank r."""
    return Sums(
        np.empty((m, LANES)),
        np.empty((m, LANES)),
        np.empty((2 * m * r, LANES)),
        np.empty((m * m, LANES)),
        np.empty((m * s, LANES)),
        np.empty((2 * r * r, LANES)),
        np.empty((2 * m, LANES)),
        np.empty((2 * m * r, LANES)),
    )


@jit
def add_to(array, row, value):
    """Add to a row of sums."""
    store(array, row, load(array, row) + value)


@jit
def invert_factor(scratch, sums, r):
    """Write the inverse of the Cholesky factor C, lower triangular as it is, and w = C^-* y in place of y."""
    k, inverse, v = scratch.k, sums.inverse, scratch.v
    for c in range(r):
        store(inverse, 2 * (c * r + c), 1.0 / load(k, 2 * (c * r + c)))
        store(inverse, 2 * (c * r + c) + 1, splat(0.0))
        for d in range(c + 1, r):
            real, imaginary = splat(0.0), splat(0.0)
            for e in range(c, d):
                x, y = load(k, 2 * (d * r + e)), load(k, 2 * (d * r + e) + 1)
                p, q = load(inverse, 2 * (e * r + c)), load(inverse, 2 * (e * r + c) + 1)
                real = real - (x * p - y * q)
                imaginary = imaginary - (x * q + y * p)
            diagonal = load(k, 2 * (d * r + d))
            store(inverse, 2 * (d * r + c), real / diagonal)
            store(inverse, 2 * (d * r + c) + 1, imaginary / diagonal)
    for c in range(r):
        real, imaginary = splat(0.0), splat(0.0)
        for d in range(c, r):  # conj(inverse[d, c]) y[d]
            x, y = load(inverse, 2 * (d * r + c)), load(inverse, 2 * (d * r + c) + 1)
            p, q = load(v, 2 * d), load(v, 2 * d + 1)
            real = real + (x * p + y * q)
            imaginary = imaginary + (x * q - y * p)
        store(v, 2 * c, real)
        store(v, 2 * c + 1, imaginary)


@jit
def write_n(scratch, sums, r):
    """Write N = C^-* C^-1 + w w^* in place of C."""
    k, inverse, v = scratch.k, sums.inverse, scratch.v
    for c in range(r):
        for d in range(c + 1):
            x, y = load(v, 2 * c), load(v, 2 * c + 1)
            p, q = load(v, 2 * d), load(v, 2 * d + 1)
            real, imaginary = x * p + y * q, y * p - x * q
            for e in range(c, r):  # conj(inverse[e, c]) inverse[e, d]
                x, y = load(inverse, 2 * (e * r + c)), load(inverse, 2 * (e * r + c) + 1)
                p, q = load(inverse, 2 * (e * r + d)), load(inverse, 2 * (e * r + d) + 1)
                real = real + (x * p + y * q)
                imaginary = imaginary + (x * q - y * p)
            store(k, 2 * (c * r + d), real)
            store(k, 2 * (c * r + d) + 1, imaginary)
            store(k, 2 * (d * r + c), real)
            store(k, 2 * (d * r + c) + 1, 0.0 - imaginary)


@jit
def add_block(parameters, lines, band, block, scratch, sums):
    """Add the derivatives of a block of frequencies; `factorise` was called before."""
    natural, ratios, shapes, factor, _, spectra = parameters
    _, h, b, gb, u, k, v = scratch
    m, s = shapes.shape
    r = factor.shape[2]
    blocks = lines.frequencies.size // LANES
    f, weight = load(lines.frequencies, block), load(lines.weights, block)
    invert_factor(scratch, sums, r)
    write_n(scratch, sums, r)
    for a in range(m):
        p_real, p_imaginary = splat(0.0), splat(0.0)
        for c in range(r):
            x, y = load(b, 2 * (a * r + c)), load(b, 2 * (a * r + c) + 1)
            p, q = load(v, 2 * c), load(v, 2 * c + 1)
            p_real = p_real + (x * p - y * q)
            p_imaginary = p_imaginary + (x * q + y * p)
        store(sums.p, 2 * a, p_real)
        store(sums.p, 2 * a + 1, p_imaginary)
        for j in range(s):  # zero where the weight is zero, as F
            x, y = load(spectra, 2 * j * blocks + block), load(spectra, (2 * j + 1) * blocks + block)
            add_to(sums.crossed, a * s + j, p_real * x + p_imaginary * y)
        h_real, h_imaginary = load(h, 2 * a), load(h, 2 * a + 1)
        u_real, u_imaginary = load(u, 2 * a), load(u, 2 * a + 1)
        z_real, z_imaginary = splat(0.0), splat(0.0)
        for c in range(r):
            p, q = load(v, 2 * c), load(v, 2 * c + 1)
            real, imaginary = u_real * p + u_imaginary * q, u_imaginary * p - u_real * q
            bn_real, bn_imaginary = splat(0.0), splat(0.0)
            for d in range(r):
                n_real, n_imaginary = load(k, 2 * (d * r + c)), load(k, 2 * (d * r + c) + 1)
                x, y = load(gb, 2 * (a * r + d)), load(gb, 2 * (a * r + d) + 1)
                real = real - (x * n_real - y * n_imaginary)
                imaginary = imaginary - (x * n_imaginary + y * n_real)
                x, y = load(b, 2 * (a * r + d)), load(b, 2 * (a * r + d) + 1)
                bn_real = bn_real + (x * n_real - y * n_imaginary)
                bn_imaginary = bn_imaginary + (x * n_imaginary + y * n_real)
            store(sums.bn, 2 * (a * r + c), bn_real)
            store(sums.bn, 2 * (a * r + c) + 1, bn_imaginary)
            real, imaginary = real * (weight * 2.0), imaginary * (weight * 2.0)  # X
            # dB = h dL + dh L
            add_to(sums.factor, 2 * (a * r + c), h_real * real + h_imaginary * imaginary)
            add_to(sums.factor, 2 * (a * r + c) + 1, h_real * imaginary - h_imaginary * real)
            x, y = factor[band, a, c, 0], factor[band, a, c, 1]
            z_real = z_real + (real * x + imaginary * y)
            z_imaginary = z_imaginary + (imaginary * x - real * y)
        # dh = -h (da - i dc) / (a - i c), a = 1 - beta^2, c = 2 zeta beta
        beta = natural[a] / f
        real, imaginary = 1.0 - beta * beta, beta * (2.0 * ratios[a])
        size = 1.0 / (real * real + imaginary * imaginary)
        real, imaginary = real * size, imaginary * size
        x = h_imaginary * imaginary - h_real * real
        y = 0.0 - (h_real * imaginary + h_imaginary * real)
        of_a, of_c = z_real * x + z_imaginary * y, z_real * y - z_imaginary * x
        add_to(sums.natural, a, (of_c * (2.0 * ratios[a]) - of_a * beta * 2.0) / f)
        add_to(sums.ratios, a, of_c * beta * 2.0)
    for a in range(m):
        for e in range(a + 1):
            real = splat(0.0)
            for c in range(r):
                x, y = load(sums.bn, 2 * (a * r + c)), load(sums.bn, 2 * (a * r + c) + 1)
                p, q = load(b, 2 * (e * r + c)), load(b, 2 * (e * r + c) + 1)
                real = real - (x * p + y * q)
            add_to(sums.g, a * m + e, real * weight)


@jit
def lane_sum(array, row):
    """Sum over the lanes of a row."""
    return total(load(array, row))


@jit
def add_band(row, band, n_lines, lines, sums, gradient, i):
    """Add the derivatives of a band, and its log-likelihood less that of its frequencies."""
    natural, ratios, shapes, factor, error, _ = gradient
    m, s = row.shapes.shape
    r = row.factor.shape[2]
    first, last = lines.starts[band], lines.starts[band + 1]
    for a in range(m):
        natural[i, a] += lane_sum(sums.natural, a)
        ratios[i, a] += lane_sum(sums.ratios, a)
        for c in range(r):
            for part in range(2):
                factor[i, band, a, c, part] += lane_sum(sums.factor, 2 * (a * r + c) + part)
    for j in range(s):
        squares = 0.0
        for part in range(2):
            for line in range(first, last):
                squares += row.spectra[j, part, line] ** 2
        size = row.error[band, j]
        of_error = squares / size - n_lines
        for a in range(m):
            by_u, by_g = 2.0 * lane_sum(sums.crossed, a * s + j), 0.0
            for e in range(m):
                by_g += lane_sum(sums.g, max(a, e) * m + min(a, e)) * row.shapes[e, j]
            shapes[i, a, j] += (by_u + 2.0 * by_g) / size
            of_error -= (by_u + by_g) * row.shapes[a, j] / size
        error[i, band, j] += of_error / size


@jit
def write_spectra(row, band, block, lines, sums, gradient):
    """Write the derivatives by the transforms, 2 (Phi' p - F) / S_e."""
    m, s = row.shapes.shape
    blocks = lines.frequencies.size // LANES
    weight = load(lines.weights, block) * 2.0
    for j in range(s):
        for part in range(2):
            at = (2 * j + part) * blocks + block
            x = 0.0 - load(row.spectra, at)
            for a in range(m):
                x = x + load(sums.p, 2 * a + part) * row.shapes[a, j]
            store(gradient, at, x * weight / row.error[band, j])


@jit
def clear(gradient, i):
    """No gradient where there is no density."""
    natural, ratios, shapes, factor, error, spectra = gradient
    natural[i], ratios[i], shapes[i], factor[i], error[i] = 0.0, 0.0, 0.0, 0.0, 0.0
    if spectra.size:
        spectra[i] = 0.0


@jit
def spectral_gradient(parameters: SpectralParameters, lines: Lines, logp, gradient: SpectralParameters):
    """Write the log-likelihoods (p,), and add their gradients to arrays (p, ...) of the parameters' shapes.

    Zero where a log-likelihood is -inf. That by the transforms is left out if its array is empty.
    """
    m, s, r = parameters.shapes.shape[1], parameters.shapes.shape[2], parameters.factor.shape[3]
    scratch, sums = scratch_for(m, r), sums_for(m, s, r)
    for i in range(logp.shape[0]):
        row = row_of(parameters, i)
        logp[i] = -np.inf
        if not is_possible(row):
            continue
        found = 0.0
        for band in range(lines.starts.size - 1):
            information(row, band, scratch)
            for array in (sums.natural, sums.ratios, sums.factor, sums.g, sums.crossed):
                array[:] = 0.0
            of_lines, n_lines = splat(0.0), splat(0.0)
            for block in range(lines.starts[band] // LANES, lines.starts[band + 1] // LANES):
                log_det, square = factorise(row, lines, band, block, scratch)
                weight = load(lines.weights, block)
                of_lines = of_lines + (square - log_det) * weight
                n_lines = n_lines + weight
                add_block(row, lines, band, block, scratch, sums)
                if gradient.spectra.size:
                    write_spectra(row, band, block, lines, sums, gradient.spectra[i])
            add_band(row, band, total(n_lines), lines, sums, gradient, i)
            found += total(of_lines) + constant_part(row, lines, band, total(n_lines))
        if np.isfinite(found):
            logp[i] = found
        else:
            clear(gradient, i)
