"""Comparison of mode shapes, and complex ones on their way to the real axis."""

import numpy as np

from pymc_features._checks import warn_caller
from pymc_features.exceptions import ModalDataWarning

COLLINEAR = 0.9  # modal phase collinearity below which a real shape stands badly for a complex one


def mac(a: np.ndarray, b: np.ndarray) -> float:
    """Modal assurance criterion |a^H b|^2 / (a^H a b^H b) of two shapes (s,), real or complex.

    Entries that are NaN in either are left out; 0 if nothing is left.

    Examples
    --------
    >>> mac(np.array([3.0, 4.0]), np.array([-6.0, -8.0])), mac(np.array([3.0, 4.0]), np.array([5.0, 0.0]))
    (1.0, 0.36)
    """
    both = ~np.isnan(a) & ~np.isnan(b)
    a, b = _unit(a[both]), _unit(b[both])
    return round(min(float(np.abs(np.vdot(a, b)) ** 2), 1.0), 15)


def _unit(shape: np.ndarray) -> np.ndarray:
    """A shape of length 1, of zeros if it is zero."""
    largest = np.abs(shape).max(initial=0.0)
    if largest == 0.0:
        return shape
    shape = shape / largest  # squares of tiny or huge entries would leave the range of numbers
    return shape / np.linalg.norm(shape)


def phase_collinearity(shape: np.ndarray) -> float:
    """Modal phase collinearity of a shape (s,): 1 if its entries lie on a line through 0, less else.

    With the products S of its real and imaginary parts, ((S_xx - S_yy)^2 + 4 S_xy^2) / (S_xx + S_yy)^2,
    which is |phi^T phi|^2 / (phi^H phi)^2, the MAC of the shape and its conjugate.

    Examples
    --------
    >>> phase_collinearity(np.array([1.0, -2.0]) * np.exp(0.7j)), phase_collinearity(np.array([1.0, 1.0j]))
    (1.0, 0.0)
    """
    return mac(shape, shape.conj())


def real_shape(shape: np.ndarray) -> np.ndarray:
    """Real part of a shape (s,), turned by the phase that leaves the least imaginary part.

    That is half the phase of phi^T phi; of the two senses, the one with the largest entry positive.
    """
    measured = shape[~np.isnan(shape)]
    unit = _unit(measured)
    turned = (shape * np.exp(-0.5j * np.angle(unit @ unit))).real
    turned[np.isnan(shape)] = np.nan
    return turned if turned[np.nanargmax(np.abs(turned))] > 0.0 else -turned


def warn_modes(message: str) -> None:
    """Warn at the line that called into this package from outside."""
    warn_caller(message, ModalDataWarning)
