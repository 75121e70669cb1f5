"""Modal assurance criterion."""

import numpy as np
import pytensor.tensor as pt
from numpy.typing import ArrayLike

from pymc_features._checks import as_numbers


def mac(shapes: ArrayLike, others: ArrayLike) -> np.ndarray:
    r"""Modal assurance criterion of each pair of shapes.

    .. math:: \mathrm{MAC} = \frac{|\phi^H \hat\phi|^2}{(\phi^H \phi)(\hat\phi^H \hat\phi)}

    One where the shapes are the same up to a factor, real or complex; zero where they are orthogonal. With
    the best factor a, ``1 - MAC = ||a phi - phi^||^2 / ||phi^||^2``.

    Parameters
    ----------
    shapes, others : array_like (m, s), (i, s)
        One shape in each row; entries that are NaN in either are left out of the pair.

    Returns
    -------
    array (m, i)
        NaN where a pair has no entry in common.

    References
    ----------
    R. J. Allemang & D. L. Brown, Proc. 1st Int. Modal Analysis Conf. (1982) 110-116.

    Examples
    --------
    >>> mac([[1.0, 2.0], [2.0, -1.0]], [[-2.0, -4.0]])
    array([[1.],
           [0.]])
    """
    shapes = as_numbers(shapes, "shapes", "Give one shape in each row.", allow_complex=True)
    others = as_numbers(others, "others", "Give one shape in each row.", allow_complex=True)
    if shapes.ndim != 2 or others.ndim != 2 or shapes.shape[1] != others.shape[1]:
        raise ValueError(
            f"`shapes` and `others` must have rows of equal length, got shapes {shapes.shape} and "
            f"{others.shape}. Give one shape in each row, at the same channels."
        )
    one, two = ~np.isnan(shapes), ~np.isnan(others)
    a, b = np.where(one, shapes, 0.0), np.where(two, others, 0.0)
    products = abs(a.conj() @ b.T) ** 2
    norms = (abs(a) ** 2 @ two.T) * (one @ (abs(b) ** 2).T)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(norms > 0.0, products / norms, np.nan)


def one_minus_mac(shapes, parts, known):
    """1 - MAC of each measured shape and each of the model, a tensor (i, m).

    Parameters
    ----------
    shapes : tensor (m, s)
        Of the model, real.
    parts : list of tensor (i, s)
        Real, and imaginary, part of the measured shapes, zero where an entry is missing.
    known : tensor (i, s)
        1 where an entry is known; rows of zeros are shapes that are missing, and give zero.
    """
    products = sum(pt.sqr(pt.dot(part, shapes.T)) for part in parts)
    own = sum(pt.sum(pt.sqr(part), axis=-1) for part in parts)[:, None]
    norms = own * pt.dot(known, pt.sqr(shapes).T)
    there = pt.gt(norms, 0.0)
    mac = products / pt.switch(there, norms, 1.0)
    has_shape = pt.gt(pt.sum(known, axis=-1), 0.0)[:, None]
    return pt.switch(has_shape, pt.switch(there, 1.0 - mac, 1.0), 0.0)
