"""The response of a structure of numbers, as a labelled array."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from pymc_features.simulators.recursion import chain_response
from pymc_features.simulators.sampling import UNITS, request

# For each family of structures: its parameters, then acceleration, dt, substeps, stride, sensors, number of
# modes and code of the quantity, in; the response (sensor, time), all NaN where there is no structure, out.
RESPONSES = {"chain": chain_response}


def simulate(
    structure,
    record,
    *,
    dt: float | None = None,
    sensors: Sequence[int] | None = None,
    quantity: str = "absolute_acceleration",
    n_modes: int | None = None,
) -> xr.DataArray:
    """Response history of a structure to a ground acceleration, Eqs. (17)-(24).

    Exact, to rounding, for an excitation that is linear between the record's samples, at any output
    step: nothing is integrated numerically.

    Parameters
    ----------
    structure : SpringMassChain
        With numbers as parameters.
    record : Record
        Ground acceleration; the structure is at rest at its first sample.
    dt : float, optional
        Output step [s], an integer multiple or divisor of the record's step, which is the default.
    sensors : sequence of int, optional
        Degrees of freedom, 0 next to the base. All by default.
    quantity : str
        "absolute_acceleration" [m/s^2] (default), "relative_acceleration" [m/s^2],
        "relative_velocity" [m/s] or "relative_displacement" [m]; relative to the base.
    n_modes : int, optional
        Number of modes kept, lowest first. All by default.

    Returns
    -------
    xarray.DataArray (sensor, time)
        With coordinates `sensor` (degree of freedom) and `time` [s], and the units in `attrs`.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range or the structure has PyTensor variables.

    Notes
    -----
    Agrees with a matrix exponential to 1e-12 of the peak (tests/test_response.py).
    """
    if not hasattr(structure, "parameters"):
        raise TypeError(f"`structure` must be a structure, got {type(structure).__name__}.")
    if not hasattr(record, "acceleration"):
        raise TypeError(
            f"`record` must be a Record, got {type(record).__name__}. "
            "Use read_record(path) or Record(acceleration, dt)."
        )
    if structure.is_symbolic:
        raise TypeError(
            "`structure` must have numbers as parameters, got PyTensor variables. "
            "Use `response(structure, record)` inside a model."
        )
    asked = request(structure.n_dof, record.dt, dt=dt, sensors=sensors, quantity=quantity, n_modes=n_modes)
    values = RESPONSES[structure.family](
        *structure.parameters(),
        record.acceleration,
        record.dt,
        asked.substeps,
        asked.stride,
        asked.sensors,
        asked.n_modes,
        asked.quantity_code,
    )
    times = np.arange(values.shape[1]) * (record.dt * asked.stride / asked.substeps)
    return xr.DataArray(
        values,
        dims=("sensor", "time"),
        coords={
            "sensor": ("sensor", asked.sensors, {"long_name": "degree of freedom"}),
            "time": ("time", times, {"units": "s"}),
        },
        name=quantity,
        attrs={"units": UNITS[quantity], "record": record.name},
    )
