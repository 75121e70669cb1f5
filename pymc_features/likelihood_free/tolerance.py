"""The tolerance of ABC that corresponds to a scale of the EXP likelihood."""

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from pymc_features._checks import as_numbers, check_integer, shown

QUANTILE = 0.9


def abc_tolerance(
    sigma: ArrayLike | xr.DataTree | xr.Dataset | xr.DataArray, n_sensors: int
) -> float | np.ndarray:
    """Tolerance delta = 2 N_0 sigma^2 on rho = sum_j e_j, Eq. (16).

    Parameters
    ----------
    sigma : float, array_like (sensor,), DataTree, Dataset or DataArray
        The 90 % quantile of the EXP posterior of sigma, in the units of the data; positive. Its most
        probable value would give the smallest rho there is, and an empty set. Of a posterior (the result of
        sampling an EXP model, with its variable `sigma`, or draws of it with dimensions chain and draw) that
        quantile is taken.
    n_sensors : int
        N_0, at least 1.

    Returns
    -------
    float or array (sensor,)
        delta, in squared units of the data; one for each sensor where sigma has one for each.

    Examples
    --------
    >>> abc_tolerance(0.5, n_sensors=10)
    5.0
    >>> draws = xr.DataArray([[0.1, 0.2, 0.5, 0.6]], dims=("chain", "draw"))
    >>> round(abc_tolerance(draws, n_sensors=10), 4)  # 90 % quantile 0.57
    6.498
    """
    n_sensors = check_integer(n_sensors, "n_sensors")
    if isinstance(sigma, xr.DataTree | xr.Dataset | xr.DataArray):
        sigma = posterior_quantile(sigma)
    values = as_numbers(sigma, "sigma", "Pass a quantile of its posterior.", what="one number")
    if values.shape not in ((), (n_sensors,)):
        raise ValueError(
            f"`sigma` must be one number or one for each of the {n_sensors} sensors, got shape "
            f"{values.shape}. Pass draws as a DataArray with dimensions chain and draw."
        )
    if not (np.isfinite(values) & (values > 0)).all():
        raise ValueError(
            f"`sigma` must be positive and finite, got {shown(values.tolist())}. Pass the 90 % quantile of "
            "the EXP posterior, in the units of the data."
        )
    delta = 2.0 * n_sensors * values**2
    return delta if delta.ndim else float(delta)


def posterior_quantile(posterior):
    """The 90 % quantile of sigma over chains and draws."""
    if isinstance(posterior, xr.DataTree):
        if "posterior" not in posterior.children:
            raise ValueError(
                "`sigma` must hold a posterior, got a DataTree without that group. Pass the result of "
                "sampling an EXP model."
            )
        posterior = posterior["posterior"].to_dataset()
    if isinstance(posterior, xr.Dataset):
        if "sigma" not in posterior:
            raise ValueError(
                f"`sigma` must hold a variable of that name, got {', '.join(map(str, posterior)) or 'none'}. "
                "Pass its draws, posterior[name]."
            )
        posterior = posterior["sigma"]
    over = [dim for dim in ("chain", "draw", "sample") if dim in posterior.dims]
    if not over:
        raise ValueError(f"`sigma` must have the dimensions chain and draw, got {posterior.dims}.")
    if posterior.dtype.kind not in "iuf" or not posterior.size:
        raise TypeError(f"`sigma` must hold draws, got {posterior.size} values of type {posterior.dtype}.")
    return posterior.quantile(QUANTILE, dim=over).values
