"""The log-likelihood of a population, and what its gradient begins with."""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, load, splat, square_root, store
from pymc_features.simulators.compiled.vector_math import logarithm
from pymc_features.simulators.compiled.vector_memory import total
from pymc_features.simulators.spectra.arguments import Lines, Scratch, SpectralParameters

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
