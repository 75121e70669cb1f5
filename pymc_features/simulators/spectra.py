"""Likelihood of the Fourier transforms of output-only measurements, and its gradient, as compiled kernels.

The transform F_k of s channels at a frequency f_k is complex Gaussian with the covariance

    E_k = Phi H_k S H_k^* Phi' + diag(S_e),  S = L L^*,  H_k = diag(h_r),
    h_r = (2 pi i f_k)^(-q) / (1 - (f_r / f_k)^2 - 2 i zeta_r f_r / f_k)

with the spectral density S of the modal forces and S_e of the prediction error, both one-sided, and q = 0, 1,
2 for accelerations, velocities and displacements (S.-K. Au, Operational Modal Analysis, Springer 2017, ch. 10
and 12). Everything is reduced to matrices of the rank r of L: with B = H L, G = Phi diag(S_e)^-1 Phi' and
u = Phi diag(S_e)^-1 F, by the lemmas of Woodbury and Sylvester,

    K = I + B^* G B,  ln|E| = ln|S_e| + ln|K|,  F^* E^-1 F = F^* S_e^-1 F - v^* K^-1 v,  v = B^* u.

Frequencies lie in the lanes of vectors. With w = K^-1 v, N = K^-1 + w w^* and p = B w, the derivative of the
log-likelihood of a frequency is

    Re tr(X^* dB) + tr(g dG) + 2 Re(p^* du),  X = 2 (u w^* - G B N),  g = -Re B N B^*,

and terms of S_e and F alone.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.numbers.compiled_numbers import (
    conjugate,
    in_lanes,
    new_complex,
    square_root,
    squared_size,
)
from pymc_features.simulators.numbers.rows import moved, view
from pymc_features.simulators.numbers.vector_math import logarithm
from pymc_features.simulators.numbers.vectors import LANES, load, new_numbers, store, total

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


class Room(NamedTuple):
    """Memory of one block of frequencies, and of sums over those of a band, as `Rows`; its array comes last.

    Attributes
    ----------
    h, b, gb, u : complex (m), (m r), (m r), (m)
        h, B, G B and u.
    k : complex (r r)
        K, then its Cholesky factor, then (of gradients) N = K^-1 + w w^*.
    v : complex (r)
        v, then its solution with the factor, then (of gradients) w = K^-1 v.
    inverse, p, bn : complex (r r), (m), (m r)
        The inverse of the factor of K, p and B N.
    factor : complex (m r)
        Sum of the derivatives by L.
    natural, ratios, g, crossed : (m), (m), (m m), (m s)
        Sums of those by f_r, zeta_r and G, and of Re(conj(p_r) F_j).
    information : array (m, m)
        G of the band.
    """

    h: object
    b: object
    gb: object
    u: object
    k: object
    v: object
    inverse: object
    p: object
    bn: object
    factor: object
    natural: object
    ratios: object
    g: object
    crossed: object
    information: np.ndarray
    memory: np.ndarray


LOG_PI = np.log(np.pi)


@jit
def new_room(parameters):
    """Memory for m modes, s channels and forces of rank r."""
    (m, s), r = parameters.shapes.shape[1:], parameters.factor.shape[3]
    sizes = m, m * r, m * r, m, r * r, r, r * r, m, m * r, m * r
    begins, end = np.empty(len(sizes), dtype=np.int64), 0
    for i in range(len(sizes)):
        begins[i], end = end, end + 2 * sizes[i] * LANES
    memory, like = new_numbers(end + (2 * m + m * m + m * s) * LANES), in_lanes(0.0)
    numbers, reals = view(memory, new_complex(like, like)), moved(view(memory, like), end)
    return Room(
        moved(numbers, begins[0]),
        moved(numbers, begins[1]),
        moved(numbers, begins[2]),
        moved(numbers, begins[3]),
        moved(numbers, begins[4]),
        moved(numbers, begins[5]),
        moved(numbers, begins[6]),
        moved(numbers, begins[7]),
        moved(numbers, begins[8]),
        moved(numbers, begins[9]),
        reals,
        moved(reals, m * LANES),
        moved(reals, 2 * m * LANES),
        moved(reals, (2 * m + m * m) * LANES),
        np.empty((m, m)),
        memory,
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
def write_information(parameters, band, room):
    """Write G = Phi diag(S_e)^-1 Phi'."""
    shapes, error = parameters.shapes, parameters.error
    m, s = shapes.shape
    for a in range(m):
        for c in range(a + 1):
            x = 0.0
            for j in range(s):
                x += shapes[a, j] * shapes[c, j] / error[band, j]
            room.information[a, c] = room.information[c, a] = x


@jit
def transform(spectra, j, block):
    """F of channel j at a block of frequencies."""
    blocks = spectra.shape[2] // LANES
    return new_complex(load(spectra, 2 * j * blocks + block), load(spectra, (2 * j + 1) * blocks + block))


@jit
def factorise(parameters, lines, band, block, room):
    """Write h, B, G B, u, the Cholesky factor C of K and y = C^-1 v of the frequencies of a block.

    Returns ln|K| and |y|^2, lane by lane.
    """
    natural, ratios, shapes, factor, error, spectra = parameters
    (m, s), r, b, k, nil = shapes.shape, factor.shape[2], room.b, room.k, in_lanes(0.0)
    f, gain, zero = load(lines.frequencies, block), load(lines.gains, block), new_complex(nil, nil)
    for a in range(m):
        beta, u = natural[a] / f, zero
        h = new_complex(1.0 - beta * beta, beta * (2.0 * ratios[a]))
        h = h * (gain / squared_size(h))
        for c in range(r):
            b[a * r + c] = h * new_complex(factor[band, a, c, 0], factor[band, a, c, 1])
        for j in range(s):
            u = u + transform(spectra, j, block) * (shapes[a, j] / error[band, j])
        room.h[a], room.u[a] = h, u
    for a in range(m):
        for c in range(r):
            x = zero
            for e in range(m):
                x = x + b[e * r + c] * room.information[a, e]
            room.gb[a * r + c] = x
    log_det, square = nil, nil
    for c in range(r):
        v = zero
        for a in range(m):  # B^* u
            v = v + conjugate(b[a * r + c]) * room.u[a]
        for d in range(c + 1):
            x = zero + (1.0 if c == d else 0.0)
            for a in range(m):  # K = I + B^* G B
                x = x + conjugate(b[a * r + c]) * room.gb[a * r + d]
            for e in range(d):  # less C C^*
                x = x - k[c * r + e] * conjugate(k[d * r + e])
            if c == d:
                log_det = log_det + logarithm(x.re)
                k[c * r + c] = new_complex(square_root(x.re), nil)
            else:
                k[c * r + d] = x * (1.0 / k[d * r + d].re)
        for e in range(c):
            v = v - k[c * r + e] * room.v[e]
        v = v * (1.0 / k[c * r + c].re)
        room.v[c] = v
        square = square + squared_size(v)
    return log_det, square


@jit
def constant_part(parameters, lines, band, n_lines):
    """What S_e and the data alone give: - sum_k (s ln pi + ln|S_e| + F^* S_e^-1 F)."""
    logp = 0.0
    for j in range(parameters.spectra.shape[0]):
        error = parameters.error[band, j]
        logp -= n_lines * (LOG_PI + np.log(error)) + sum_of_squares(parameters, lines, band, j) / error
    return logp


@jit
def sum_of_squares(parameters, lines, band, j):
    """Sum of |F|^2 of channel j over the frequencies of a band."""
    squares = 0.0
    for part in range(2):
        for i in range(lines.starts[band], lines.starts[band + 1]):
            squares += parameters.spectra[j, part, i] ** 2
    return squares


@jit
def band_logp(parameters, lines, band, room):
    """The log-likelihood of a band."""
    write_information(parameters, band, room)
    sums = n_lines = in_lanes(0.0)
    for block in range(lines.starts[band] // LANES, lines.starts[band + 1] // LANES):
        log_det, square = factorise(parameters, lines, band, block, room)
        weight = load(lines.weights, block)
        sums = sums + (square - log_det) * weight
        n_lines = n_lines + weight
    return total(sums) + constant_part(parameters, lines, band, total(n_lines))


@jit
def spectral_logp(parameters: SpectralParameters, lines: Lines, logp):
    """Write the log-likelihoods (p,) of a population; -inf for impossible parameters."""
    room = new_room(parameters)
    for i in range(logp.shape[0]):
        row = row_of(parameters, i)
        logp[i] = -np.inf
        if is_possible(row):
            found = 0.0
            for band in range(lines.starts.size - 1):
                found += band_logp(row, lines, band, room)
            if np.isfinite(found):
                logp[i] = found


@jit
def invert_factor(room, r):
    """Write the inverse of the Cholesky factor C, lower triangular as it is, and w = C^-* y in place of y."""
    k, inverse, v, nil = room.k, room.inverse, room.v, in_lanes(0.0)
    for c in range(r):
        inverse[c * r + c] = new_complex(1.0 / k[c * r + c].re, nil)
        for d in range(c + 1, r):
            x = new_complex(nil, nil)
            for e in range(c, d):
                x = x - k[d * r + e] * inverse[e * r + c]
            inverse[d * r + c] = x * (1.0 / k[d * r + d].re)
    for c in range(r):
        x = new_complex(nil, nil)
        for d in range(c, r):
            x = x + conjugate(inverse[d * r + c]) * v[d]
        v[c] = x


@jit
def write_n(room, r):
    """Write N = C^-* C^-1 + w w^* in place of C."""
    for c in range(r):
        for d in range(c + 1):
            x = room.v[c] * conjugate(room.v[d])
            for e in range(c, r):
                x = x + conjugate(room.inverse[e * r + c]) * room.inverse[e * r + d]
            room.k[c * r + d], room.k[d * r + c] = x, conjugate(x)


@jit
def add_block(parameters, lines, band, block, room):
    """Add the derivatives of a block of frequencies; `factorise` was called before."""
    natural, ratios, shapes, factor, _, spectra = parameters
    (m, s), r, b, bn, v, nil = shapes.shape, factor.shape[2], room.b, room.bn, room.v, in_lanes(0.0)
    f, weight = load(lines.frequencies, block), load(lines.weights, block)
    invert_factor(room, r)
    write_n(room, r)
    for a in range(m):
        p = z = new_complex(nil, nil)
        for c in range(r):
            p = p + b[a * r + c] * v[c]
        room.p[a] = p
        for j in range(s):  # zero where the weight is zero, as F
            here = a * s + j
            room.crossed[here] = room.crossed[here] + (conjugate(p) * transform(spectra, j, block)).re
        for c in range(r):
            x, y, here = room.u[a] * conjugate(v[c]), new_complex(nil, nil), a * r + c
            for d in range(r):
                x = x - room.gb[a * r + d] * room.k[d * r + c]
                y = y + b[a * r + d] * room.k[d * r + c]
            bn[here], x = y, x * (2.0 * weight)  # X, and dB = h dL + dh L
            room.factor[here] = room.factor[here] + conjugate(room.h[a]) * x
            z = z + x * new_complex(factor[band, a, c, 0], -factor[band, a, c, 1])
        # dh = -h (da - i dc) / (a - i c), a = 1 - beta^2, c = 2 zeta beta
        beta = natural[a] / f
        x = new_complex(1.0 - beta * beta, beta * (2.0 * ratios[a]))
        z = z * conjugate(room.h[a] * x * (-1.0 / squared_size(x)))
        by_beta = (z.re * beta + z.im * ratios[a]) * -2.0
        room.natural[a] = room.natural[a] + by_beta / f
        room.ratios[a] = room.ratios[a] - 2.0 * (z.im * beta)
    for a in range(m):
        for e in range(a + 1):
            x = nil
            for c in range(r):
                x = x - (bn[a * r + c] * conjugate(b[e * r + c])).re
            room.g[a * m + e] = room.g[a * m + e] + x * weight


@jit
def add_band(row, band, n_lines, lines, room, gradient, i):
    """Add the derivatives of a band, and its log-likelihood less that of its frequencies."""
    natural, ratios, shapes, factor, error, _ = gradient
    (m, s), r = row.shapes.shape, row.factor.shape[2]
    for a in range(m):
        natural[i, a] += total(room.natural[a])
        ratios[i, a] += total(room.ratios[a])
        for c in range(r):
            factor[i, band, a, c, 0] += total(room.factor[a * r + c].re)
            factor[i, band, a, c, 1] += total(room.factor[a * r + c].im)
    for j in range(s):
        size = row.error[band, j]
        of_error = sum_of_squares(row, lines, band, j) / size - n_lines
        for a in range(m):
            by_u, by_g = 2.0 * total(room.crossed[a * s + j]), 0.0
            for e in range(m):
                by_g += total(room.g[max(a, e) * m + min(a, e)]) * row.shapes[e, j]
            shapes[i, a, j] += (by_u + 2.0 * by_g) / size
            of_error -= (by_u + by_g) * row.shapes[a, j] / size
        error[i, band, j] += of_error / size


@jit
def write_spectra(row, band, block, lines, room, gradient):
    """Write the derivatives by the transforms, 2 (Phi' p - F) / S_e."""
    (m, s), blocks = row.shapes.shape, lines.frequencies.size // LANES
    for j in range(s):
        x = transform(row.spectra, j, block) * -1.0
        for a in range(m):
            x = x + room.p[a] * row.shapes[a, j]
        x = x * (load(lines.weights, block) * (2.0 / row.error[band, j]))
        store(gradient, 2 * j * blocks + block, x.re)
        store(gradient, (2 * j + 1) * blocks + block, x.im)


@jit
def clear(gradient, i):
    """No gradient where there is no density."""
    natural, ratios, shapes, factor, error, spectra = gradient
    natural[i], ratios[i], shapes[i], factor[i], error[i] = 0.0, 0.0, 0.0, 0.0, 0.0
    if spectra.size:
        spectra[i] = 0.0


@jit
def clear_sums(room, m, s, r):
    """Begin the sums over a band."""
    nil = in_lanes(0.0)
    for i in range(m * r):
        room.factor[i] = new_complex(nil, nil)
    for i in range(2 * m + m * m + m * s):  # those that follow are behind
        room.natural[i] = nil


@jit
def spectral_gradient(parameters: SpectralParameters, lines: Lines, logp, gradient: SpectralParameters):
    """Write the log-likelihoods (p,), and add their gradients to arrays (p, ...) of the parameters' shapes.

    Zero where a log-likelihood is -inf. That by the transforms is left out if its array is empty.
    """
    (m, s), r, room = parameters.shapes.shape[1:], parameters.factor.shape[3], new_room(parameters)
    for i in range(logp.shape[0]):
        row = row_of(parameters, i)
        logp[i] = -np.inf
        if not is_possible(row):
            continue
        found = 0.0
        for band in range(lines.starts.size - 1):
            write_information(row, band, room)
            clear_sums(room, m, s, r)
            of_lines = n_lines = in_lanes(0.0)
            for block in range(lines.starts[band] // LANES, lines.starts[band + 1] // LANES):
                log_det, square = factorise(row, lines, band, block, room)
                weight = load(lines.weights, block)
                of_lines = of_lines + (square - log_det) * weight
                n_lines = n_lines + weight
                add_block(row, lines, band, block, room)
                if gradient.spectra.size:
                    write_spectra(row, band, block, lines, room, gradient.spectra[i])
            add_band(row, band, total(n_lines), lines, room, gradient, i)
            found += total(of_lines) + constant_part(row, lines, band, total(n_lines))
        if np.isfinite(found):
            logp[i] = found
        else:
            clear(gradient, i)
