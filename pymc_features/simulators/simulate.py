"""The response of a structure of numbers, as a labelled array."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from scipy import sparse

from pymc_features.simulators.bouc_wen import BoucWen
from pymc_features.simulators.cubic import Cubic
from pymc_features.simulators.linear.response import response_in_modes
from pymc_features.simulators.nonlinear import nonlinear_response
from pymc_features.simulators.recursion import chain_response
from pymc_features.simulators.sampling import UNITS, check_outputs, request

NONLINEAR = {"hysteretic": BoucWen, "duffing": Cubic}  # the law of the springs

# Kernels that take parameters, then acceleration, dt, substeps, stride, sensors, number of modes and code of
# the quantity, and return the response (sensor, time), all NaN where there is no structure.
KERNELS = {"chain": chain_response} | {family: nonlinear_response(law) for family, law in NONLINEAR.items()}


def under_ground_motion(kernel):
    """Response of a family whose kernel takes its parameters and one ground acceleration."""

    def respond(structure, record, asked, outputs):
        history = kernel(
            *structure.parameters(),
            structure.excitation(record),
            record.dt,
            asked.substeps,
            asked.stride,
            asked.sensors,
            asked.n_modes,
            asked.quantity_code,
        )
        return history if outputs is None else outputs @ history

    return respond


def linear(structure, record, asked, outputs):
    """Response of a `LinearStructure` to whatever acts on it."""
    if outputs is None:
        rows = np.arange(asked.sensors.size)
        outputs = sparse.csr_array(
            (np.ones(rows.size), (rows, asked.sensors)), shape=(rows.size, structure.n_dof)
        )
    modes = structure.modes(asked.n_modes)  # kept by the structure from one response to the next
    return response_in_modes(
        modes.angular_frequencies,
        modes.mode_shapes,
        *structure.parameters(),
        *structure.constants(record),
        structure.excitation(record),
        record.dt,
        asked.substeps,
        asked.stride,
        outputs,
        asked.n_modes,
        asked.quantity_code,
    )


# For each family of structures: structure, record or loading, request and matrix of outputs (with all sensors
# asked for) or None, in; the response (sensor or output, time) out.
RESPONSES = {family: under_ground_motion(kernel) for family, kernel in KERNELS.items()}
RESPONSES["linear"] = linear


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
        Degrees of freedom, 0 next to the base. All by default.
    quantity : str
        "absolute_acceleration" [m/s^2] (default), "relative_acceleration" [m/s^2],
        "relative_velocity" [m/s] or "relative_displacement" [m]; relative to the base,
        or to the quasi-static motion of several supports. Under forces both accelerations are the same.
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
        in `attrs`, without those of `outputs`.

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
    """
    check_arguments(structure, record)
    if n_modes is not None and not structure.is_linear:
        raise ValueError(
            f"`n_modes` must be left out for a nonlinear structure, got {n_modes}. "
            f"{type(structure).__name__} has no superposition of modes."
        )
    asked = request(structure.n_dof, record.dt, dt=dt, sensors=sensors, quantity=quantity, n_modes=n_modes)
    if outputs is not None:
        if sensors is not None:
            raise ValueError("`sensors` must be left out with `outputs`, got both. Choose rows of `outputs`.")
        outputs = check_outputs(outputs, structure.n_dof)
    values = RESPONSES[structure.family](structure, record, asked, outputs)
    times = asked.times(record.dt, values.shape[1])
    return xr.DataArray(
        values,
        dims=("sensor", "time"),
        coords={
            "sensor": ("sensor", *_labels(asked, outputs)),
            "time": ("time", times, {"units": "s"}),
        },
        name=quantity,
        attrs={"units": UNITS[quantity], "record": record.name},
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


def _labels(asked, outputs):
    """Values and attributes of the coordinate `sensor`."""
    if outputs is None:
        return asked.sensors, {"long_name": "degree of freedom"}
    return np.arange(outputs.shape[0]), {"long_name": "row of outputs"}
