"""The tolerance of ABC that corresponds to a scale of the EXP likelihood."""

import numpy as np


def abc_tolerance(sigma, n_sensors: int) -> float:
    """Tolerance delta = 2 N_0 sigma^2 on rho = sum_j e_j, Eq. (16).

    Parameters
    ----------
    sigma : float
        The 90 % quantile of the EXP posterior of sigma, in the units of the data; positive. Its most
        probable value would give the smallest rho there is, and an empty set.
    n_sensors : int
        N_0, at least 1.

    Returns
    -------
    float
        delta, in squared units of the data.

    Examples
    --------
    >>> abc_tolerance(0.5, n_sensors=10)
    5.0
    """
    try:
        value = float(sigma)
    except (TypeError, ValueError):
        raise TypeError(
            f"`sigma` must be one number, got {type(sigma).__name__}. Pass a quantile of its posterior."
        ) from None
    if not 0.0 < value < np.inf:
        raise ValueError(
            f"`sigma` must be positive and finite, got {value}. Pass the 90 % quantile of the EXP "
            "posterior, in the units of the data."
        )
    if isinstance(n_sensors, bool) or int(n_sensors) != n_sensors or n_sensors < 1:
        raise ValueError(f"`n_sensors` must be a positive integer, got {n_sensors}.")
    return 2.0 * int(n_sensors) * value**2
