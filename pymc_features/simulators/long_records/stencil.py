"""Interpolation of an entire function of exponential type from its values at equally spaced points.

F(x) = sum_l f_l exp(i theta_l x), |theta_l| <= pi / 3, is known at the integers, divided in time by a window
b(theta) that falls towards both ends: G(n) = sum_l f_l / b(theta_l) exp(i theta_l n). For a complex x = nu in
the square of side one about zero

    F(nu) = sum_n a_n(nu) G(n),   n = -7 ... 7,

with polynomials a_n of degree 13, by least squares over both theta and nu, so that
|sum_n a_n(nu) exp(i theta n) - b(theta) exp(i theta nu)| / b(theta) is below 3e-14 everywhere. Windows that
allow so few points: Barnett, Magland and af Klinteberg, SIAM J. Sci. Comput. 41 (2019) C479, Eq. (1.8).
"""

from functools import cache

import numpy as np

OVERSAMPLING = 3  # integers to a period of the highest frequency, over the two that would just do
REACH = 7  # points on each side
TAPS = 2 * REACH + 1
DEGREE = 13
TERMS = (DEGREE + 1) // 2  # even, and odd
SHAPE = 0.95  # of the window, as a part of the widest


def window(theta: np.ndarray) -> np.ndarray:
    """b(theta), one at zero: the Fourier transform of a Kaiser-Bessel window as wide as the stencil."""
    beta = SHAPE * np.pi * TAPS * (1.0 - 0.5 / OVERSAMPLING)
    root = np.sqrt(beta**2 - (0.5 * TAPS * theta) ** 2)
    return np.sinh(root) / root * (beta / np.sinh(beta))


@cache
def coefficients() -> tuple[np.ndarray, np.ndarray]:
    """Even and odd coefficients (REACH + 1, 7) of a_n, n >= 0: a_(+-n)(nu) = even(nu^2) +- nu odd(nu^2)."""
    points = np.arange(-REACH, REACH + 1)
    theta = np.pi / OVERSAMPLING * np.cos(np.pi * (np.arange(200) + 0.5) / 200)
    edge = np.linspace(-0.5, 0.5, 17)
    nu = np.concatenate([edge - 0.5j, edge + 0.5j, -0.5 + 1j * edge, 0.5 + 1j * edge])
    basis = np.exp(1j * np.outer(theta, points)) / window(theta)[:, None]
    wave = np.exp(1j * np.outer(theta, nu))
    weights = np.linalg.lstsq(basis, wave, rcond=None)[0].T
    powers = nu[:, None] ** np.arange(DEGREE + 1)
    both = [np.concatenate([x.real, x.imag]) for x in (powers, weights)]
    found = np.linalg.lstsq(*both, rcond=None)[0]
    parity = (-1.0) ** np.arange(DEGREE + 1)[:, None]
    upper = (0.5 * (found + parity * found[:, ::-1]))[:, REACH:].T  # symmetric but for rounding
    return np.ascontiguousarray(upper[:, ::2]), np.ascontiguousarray(upper[:, 1::2])
