"""The response of a structure of numbers, as a labelled array."""

from collections.abc import Sequence

import xarray as xr

from pymc_features.simulators.bouc_wen import BoucWen
from pymc_features.simulators.cubic import Cubic
from pymc_features.simulators.nonlinear import nonlinear_response
from pymc_features.simulators.recursion import chain_response
from pymc_features.simulators.sampling import UNITS, request

NONLINEAR = {"hysteretic": BoucWen, "duffing": Cubic}  # the law of the springs

# For each family of structures: its parameters, then acceleration, dt, substeps, stride, sensors, number of
# modes and code of the quantity, in; the response (sensor, time), all NaN where there is no structure, out.
RESPONSES = {"chain": chain_response} | {family: nonlinear_response(law) for family, law in NONLINEAR.items()}


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

    Of a linear structure exact, to rounding, for an excitation that is linear between the record's
    samples, at any output step: nothing is integrated numerically. Nonlinear structures are integrated, under
    the same excitation, to 1e-6 of the peak or better.

    Parameters
    ----------
    structure : SpringMassChain, HystereticChain or DuffingChain
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
        Number of modes kept, lowest first. All by default, and of a nonlinear structure always.

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
    Agrees with a matrix exponential to 1e-12 of the peak (tests/test_response.py), and with a tight ODE
    solution to 1e-6 (tests/test_hysteretic.py).
    """
    check_arguments(structure, record)
    if n_modes is not None and not structure.is_linear:
        raise ValueError(
            f"`n_modes` must be left out for a nonlinear structure, got {n_modes}. "
            f"{type(structure).__name__} has no superposition of modes."
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
    times = asked.times(record.dt, values.shape[1])
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


def check_arguments(structure, record):
    """Refuse what is no structure of numbers, or no record."""
    if not hasattr(structure, "parameters"):
        raise TypeError(f"`structure` must be a structure, got {type(structure).__name__}.")
    if not hasattr(record, "acceleration"):
        raise TypeError(
            f"`record` must be a Record, got {type(record).__name__}. "
            "Use read_record(path) or Record(acceleration, dt)."
        )
    if structure.is_symbolic:
        advice = "Use `response(structure, record)` inside a model."
        if not structure.is_linear:
            advice = "Build it from numbers in a function of the parameters, for `DiscrepancySimulator`."
        raise TypeError(f"`structure` must have numbers as parameters, got PyTensor variables. {advice}")
