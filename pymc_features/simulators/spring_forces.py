"""What the springs of a nonlinear chain do, and how accurate its integration is."""

from typing import TYPE_CHECKING

import xarray as xr

from pymc_features.simulators.excitation import excitation_of, refined_request
from pymc_features.simulators.families import NONLINEAR
from pymc_features.simulators.nonlinear.kernels import nonlinear_histories
from pymc_features.simulators.nonlinear.marches import DRIFT, INTERNAL_VARIABLE, SPRING_FORCE
from pymc_features.simulators.request import request
from pymc_features.simulators.simulate import check_arguments

if TYPE_CHECKING:
    from pymc_features.records import Record
    from pymc_features.structures.base import Structure


def spring_forces(structure: "Structure", record: "Record", *, dt: float | None = None) -> xr.Dataset:
    """Force and drift histories of the springs of a nonlinear chain: its hysteresis loops.

    Parameters
    ----------
    structure : HystereticChain or DuffingChain
        With numbers as parameters.
    record : Record
        Ground acceleration; the structure is at rest at its first sample.
    dt : float, optional
        Output step [s], as of `simulate`.

    Returns
    -------
    xarray.Dataset
        `force` [N] without damping, `drift` [m] and the internal variable `z` [-] (0 where there is none),
        each (spring, time); spring 0 is next to the base.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range or the structure is linear.
    """
    codes = [SPRING_FORCE, DRIFT, INTERNAL_VARIABLE]
    (force, drift, z), times = _histories(structure, record, codes, dt=dt)
    axes = ("spring", "time")
    return xr.Dataset(
        {
            "force": (axes, force, {"units": "N"}),
            "drift": (axes, drift, {"units": "m"}),
            "z": (axes, z, {"long_name": "internal variable"}),
        },
        coords={"spring": range(structure.n_dof), "time": ("time", times, {"units": "s"})},
        attrs={"record": record.name},
    )


def integration_error(
    structure: "Structure", record: "Record", *, quantity: str = "absolute_acceleration"
) -> float:
    """Estimate the largest error of a nonlinear chain's response, over its peak, by step doubling.

    Parameters
    ----------
    structure, record
        As of `structures.spring_forces`.
    quantity : str
        As of `simulate`.

    Returns
    -------
    float
        Largest difference, over degrees of freedom and time, between the response and that with half the
        step everywhere, over the largest absolute value of the latter [-]. NaN where the response is.

    Notes
    -----
    The error of the response itself is 32/31 of it for a fifth-order method. Costs three responses.
    """
    check_arguments(structure, record)
    codes = [request(1, record.dt, quantity=quantity).quantity_code]
    (coarse, _), (fine, _) = (_histories(structure, record, codes, refine=r) for r in (1, 2))
    return float(abs(coarse - fine).max() / abs(fine).max())


def _histories(structure, record, codes, *, dt=None, refine=1):
    """Histories (code, spring, time) and their times."""
    check_arguments(structure, record)
    if structure.family not in NONLINEAR:
        raise TypeError(
            f"`structure` must be a nonlinear chain, got {type(structure).__name__}. Use `simulate`, which "
            "of a linear structure is exact."
        )
    asked = refined_request(structure, record, request(structure.n_dof, record.dt, dt=dt))
    values = nonlinear_histories(
        NONLINEAR[structure.family],
        structure.parameters(),
        excitation_of(structure.excitation(record), record, asked),
        asked.sensors,
        codes,
        refine,
    )
    return values, asked.times(record.dt, values.shape[-1])
