"""The response of a structure of numbers, as a labelled array."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from pymc_features.simulators.bouc_wen import BoucWen
from pymc_features.simulators.cubic import Cubic
from pymc_features.simulators.linear import linear_response
from pymc_features.simulators.nonlinear import nonlinear_response
from pymc_features.simulators.quantities import HISTORIES, at_outputs, checked_request, force_share, rows_of
from pymc_features.simulators.recursion import chain_response

NONLINEAR = {"hysteretic": BoucWen, "duffing": Cubic}  # the law of the springs

# Kernels that take parameters, then acceleration, dt, substeps, stride, sensors, number of modes and code of
# the quantity, and return the response (sensor, time), all NaN where there is no structure.
KERNELS = {"chain": chain_response} | {family: nonlinear_response(law) for family, law in NONLINEAR.items()}


def under_ground_motion(kernel):
    """Response of a family whose kernel takes its parameters and one ground acceleration."""

    def respond(structure, record, asked, outputs):
        if not hasattr(record, "acceleration"):
            raise TypeError(
                f"`record` must be a Record for a {type(structure).__name__}, got {type(record).__name__}. "
                "Several supports and forces act on LinearStructure(*structure.matrices())."
            )
        history = kernel(
            *structure.parameters(),
            record.acceleration,
            record.dt,
            asked.substeps,
            asked.stride,
            asked.sensors,
            asked.n_modes,
            asked.quantity_code,
        )
        return history if outputs is None else outputs @ history

    return respond


# For each family of structures: structure, record or loading, request and matrix of outputs (with all sensors
# asked for) or None, in; the response (sensor or output, time) out.
RESPONSES = {family: under_ground_motion(kernel) for family, kernel in KERNELS.items()}
RESPONSES["linear"] = linear_response


def simulate(
    structure,
    record,
    *,
    dt: float | None = None,
    sensors: Sequence[int] | None = None,
    quantity: str = "absolute_acceleration",
    n_modes: int | None = None,
    outputs=None,
) -> xr.DataArray:
    """Response history of a structure to a ground acceleration, Eqs. (17)-(24), or to other loads.

    Of a linear structure exact, to rounding, for an excitation that is linear between the record's
    samples, at any output step: nothing is integrated numerically. Nonlinear structures are integrated, under
    the same excitation, to 1e-6 of the peak or better.

    Parameters
    ----------
    structure : SpringMassChain, LinearStructure, AffineStructure, HystereticChain or DuffingChain
        With numbers as parameters.
    record : Record or Loading
        Ground acceleration, or, on linear structures, accelerations of several supports or forces; the
        structure is at rest at the first sample.
    dt : float, optional
        Output step [s], an integer multiple or divisor of the record's step, which is the default.
    sensors : sequence of int, optional
        Degrees of freedom, or storeys of a drift, 0 next to the base. All by default.
    quantity : str
        "absolute_acceleration" [m/s^2] (default), "relative_acceleration" [m/s^2],
        "relative_velocity" [m/s] or "relative_displacement" [m]; relative to the base,
        or to the quasi-static motion of several supports. Under forces both accelerations are the same.
        "inter_storey_drift" [m] of a chain, x_i - x_{i-1}, storey 0 against the base. "base_shear" [N], see
        Notes.
    n_modes : int, optional
        Number of modes kept, lowest first. All by default, and of a nonlinear structure always. The absolute
        acceleration keeps the ground's share of those left out.
    outputs : array_like or sparse matrix (s, n), optional
        S, for combinations S x of the quantity over all degrees of freedom instead of `sensors`: drifts,
        strains, forces in springs.

    Returns
    -------
    xarray.DataArray (sensor, time)
        With coordinates `sensor` (degree of freedom, or row of `outputs`) and `time` [s], and the units
        in `attrs`, without those of `outputs`. Drifts have the dimension storey instead of sensor, the base
        shear has neither, or support where there are several.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range or the structure has PyTensor variables.

    Notes
    -----
    Agrees with a matrix exponential to 1e-12 of the peak (tests/test_response.py); damping that the modes do
    not diagonalise to 1e-9 (tests/test_linear.py), at the cost of a dense transition matrix, (2 n_modes)^2
    multiplications per step; a nonlinear structure with a tight ODE solution to 1e-6
    (tests/test_hysteretic.py).

    The base shear is influence' M a, with the absolute accelerations a, less influence' f under forces f: the
    force of the ground on the structure, in the direction of positive ground acceleration, by the balance
    of all forces, influence' (C v + K x) = -shear. Of a chain without damping it is minus stiffness times
    drift of storey 0. With several supports it is what inertia and forces ask of each; what the supports
    force on each other by their quasi-static motion is not in M, C and K, and not in it. Forces on modes
    left out by `n_modes` go to the ground statically.
    """
    check_arguments(structure, record)
    asked, outputs = checked_request(
        structure, record, quantity, dt=dt, sensors=sensors, n_modes=n_modes, outputs=outputs
    )
    if sensors is not None and HISTORIES[quantity].dim == "support":
        raise ValueError(
            f"`sensors` must be left out for the base shear, got {sensors!r}. It is a sum over all masses."
        )
    rows = rows_of(structure, quantity, asked.sensors, outputs)
    if rows.outputs is not None:
        asked = asked._replace(sensors=np.arange(structure.n_dof))
    values = RESPONSES[structure.family](structure, record, asked, rows.outputs)
    share = force_share(structure, record, quantity)
    if share is not None:
        values = values + share @ at_outputs(record.values, asked)
    dims, coords = ("time",), {}
    if rows.dim:
        dims, coords = (rows.dim, "time"), {rows.dim: (rows.dim, rows.labels, {"long_name": rows.title})}
    return xr.DataArray(
        values if rows.dim else values[0],
        dims=dims,
        coords=coords | {"time": ("time", asked.times(record.dt, values.shape[1]), {"units": "s"})},
        name=quantity,
        attrs={"units": HISTORIES[quantity].units, "record": record.name},
    )


def check_arguments(structure, record):
    """Refuse what is no structure of numbers, or no record."""
    if not hasattr(structure, "parameters"):
        raise TypeError(f"`structure` must be a structure, got {type(structure).__name__}.")
    if not (hasattr(record, "acceleration") or hasattr(record, "values")) or not hasattr(record, "n_times"):
        raise TypeError(
            f"`record` must be a Record, got {type(record).__name__}. "
            "Use read_record(path) or Record(acceleration, dt)."
        )
    if structure.is_symbolic:
        advice = "Use `response(structure, record)` inside a model."
        if not structure.is_linear:
            advice = "Build it from numbers in a function of the parameters, for `DiscrepancySimulator`."
        raise TypeError(f"`structure` must have numbers as parameters, got PyTensor variables. {advice}")
