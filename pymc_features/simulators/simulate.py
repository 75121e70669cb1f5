"""The response of a structure of numbers, as a labelled array."""

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy import sparse

from pymc_features._checks import shown
from pymc_features.records import DynamicLoad
from pymc_features.simulators.excitation import excitation_of, refined_request
from pymc_features.simulators.families import FAMILIES
from pymc_features.simulators.linear.response import response_in_modes
from pymc_features.simulators.quantities import (
    HISTORIES,
    at_outputs,
    checked_request,
    force_share,
    quantities_of,
    rows_of,
)

SIMULATED = set()  # families of which this process has made data

if TYPE_CHECKING:
    from pymc_features.records import CyclicTest, Loading, Record
    from pymc_features.structures.base import Structure


def simulate(
    structure: "Structure",
    record: "Record | Loading | CyclicTest",
    *,
    dt: float | None = None,
    sensors: Sequence[int] | Sequence[str] | None = None,
    quantity: str | None = None,
    n_modes: int | None = None,
    outputs: ArrayLike | sparse.sparray | None = None,
) -> xr.DataArray:
    """Response history of a structure to a ground acceleration, Eqs. (17)-(24), or to other loads.

    Of a specimen the force under its prescribed displacement.

    Of a linear structure nothing is integrated numerically. Under a record that is linear between its samples
    the response is exact, to rounding, at any output step; under a band-limited one right to 1e-4 of the
    peak, 5e-4 where it begins or ends in motion (tests/simulators/test_band_limited.py). Nonlinear structures
    are integrated to 1e-6 of the peak or better.

    Parameters
    ----------
    structure : SpringMassChain, LinearStructure, AffineStructure, HystereticChain, DuffingChain, ...
        With numbers as parameters; or a HystereticSpecimen.
    record : Record, Loading or CyclicTest
        Ground acceleration, or, on linear structures, accelerations of several supports or forces; the
        structure is at rest at the first sample. Of a specimen the displacement that is prescribed.
    dt : float, optional
        Output step [s], an integer multiple or divisor of the record's step, which is the default.
    sensors : sequence of int or str, optional
        Degrees of freedom, or storeys of a drift, 0 next to the base; or their names, where the structure has
        any (`LinearStructure.with_names`). All by default.
    quantity : str, optional
        "absolute_acceleration" [m/s^2] (default), "relative_acceleration" [m/s^2],
        "relative_velocity" [m/s] or "relative_displacement" [m]; relative to the base,
        or to the quasi-static motion of several supports. Under forces both accelerations are the same.
        "inter_storey_drift" [m] of a chain, x_i - x_{i-1}, storey 0 against the base. "base_shear" [N], see
        Notes. Of a specimen "restoring_force" [N], its default, and no other.
    n_modes : int, optional
        Number of modes kept, lowest first. All by default, and of a nonlinear structure always. The absolute
        acceleration keeps the ground's share of those left out.
    outputs : array_like or sparse matrix (s, n), optional
        S, for combinations S x of the quantity over all degrees of freedom instead of `sensors`: drifts,
        strains, forces in springs.

    Returns
    -------
    xarray.DataArray (sensor, time)
        With coordinates `sensor` (degree of freedom, its name, or row of `outputs`) and `time` [s], and the
        units in `attrs`, without those of `outputs`. Drifts have the dimension storey instead of sensor, the
        base shear has neither, or support where there are several. Of a specimen the coordinate
        `displacement` (time) [m] besides.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range or the structure has PyTensor variables.

    Notes
    -----
    Agrees with a matrix exponential to 1e-12 of the peak (tests/simulators/test_response.py); damping that
    the modes do not diagonalise to 1e-9 (tests/simulators/test_linear.py), at the cost of a dense transition
    matrix, (2 n_modes)^2 multiplications per step; a nonlinear structure with a tight ODE solution to 1e-6
    (tests/simulators/test_hysteretic.py).

    The base shear is influence' M a, with the absolute accelerations a, less influence' f under forces f: the
    force of the ground on the structure, in the direction of positive ground acceleration, by the balance
    of all forces, influence' (C v + K x) = -shear. Of a chain without damping it is minus stiffness times
    drift of storey 0. With several supports it is what inertia and forces ask of each; what the supports
    force on each other by their quasi-static motion is not in M, C and K, and not in it. Forces on modes
    left out by `n_modes` go to the ground statically.
    """
    check_arguments(structure, record)
    quantity = quantities_of(structure)[0] if quantity is None else quantity
    asked, outputs = checked_request(
        structure, record, quantity, dt=dt, sensors=sensors, n_modes=n_modes, outputs=outputs
    )
    if sensors is not None and HISTORIES[quantity].dim == "support":
        raise ValueError(
            f"`sensors` must be left out for the base shear, got {shown(sensors)}. It is a sum over all "
            "masses."
        )
    asked = refined_request(structure, record, asked)
    rows = rows_of(structure, quantity, asked, outputs)
    values = history_of(structure, record, quantity, asked, rows)
    dims, coords = ("time",), {}
    if rows.dim:
        dims, coords = (rows.dim, "time"), {rows.dim: (rows.dim, rows.labels, {"long_name": rows.title})}
    return xr.DataArray(
        values if rows.dim else values[0],
        dims=dims,
        coords=coords | times_of(record, asked, values.shape[1]),
        name=quantity,
        attrs={"units": HISTORIES[quantity].units, "record": record.name},
    )


def history_of(structure, record, quantity: str, asked, rows) -> np.ndarray:
    """Response (row, time) of a quantity, with what forces go to the ground past the modes."""
    values, share = respond(structure, record, asked, rows.picked), force_share(structure, record, quantity)
    return values if share is None else values + share @ at_outputs(record, asked)


def times_of(record, asked, n_outputs: int) -> dict[str, tuple]:
    """Coordinates of the output samples: times [s], and of a cyclic test its displacement [m]."""
    coords = {"time": ("time", asked.times(record.dt, n_outputs), {"units": "s"})}
    if record.is_displacement:
        coords["displacement"] = "time", at_outputs(record, asked)[0], {"units": "m"}
    return coords


def respond(structure, record, asked, rows) -> np.ndarray:
    """Response (row, time) of degrees of freedom (row,), or of combinations (row, n) of all of them."""
    SIMULATED.add(structure.family)
    family = FAMILIES[structure.family]
    combined = rows.ndim == 2 and not family.takes_outputs
    picked = np.arange(structure.n_dof) if combined else family.rows(rows, structure.n_dof)
    kernel = family.history
    if structure.family == "linear":  # keeps its modes from one response to the next
        modes = structure.modes(asked.n_modes)
        kernel = partial(response_in_modes, modes.angular_frequencies, modes.mode_shapes)
    excitation = excitation_of(structure.excitation(record), record, asked)
    inputs = family.inputs_of(structure, record, excitation, picked, asked.n_modes)
    history = kernel(*family.assemble(inputs, asked.quantity_code))
    return rows @ history if combined else history


def check_arguments(structure, record):
    """Refuse what is no structure of numbers, or no record."""
    if not hasattr(structure, "parameters") or isinstance(structure, type):
        raise TypeError(f"`structure` must be a structure, got {type(structure).__name__}.")
    if not isinstance(record, DynamicLoad):
        raise TypeError(
            f"`record` must be a Record, got {type(record).__name__}. "
            "Use read_record(path) or Record(acceleration, dt)."
        )
    if structure.is_symbolic:
        raise TypeError(
            "`structure` must have numbers as parameters, got PyTensor variables. Use `response(structure, "
            "record)` inside a model."
        )
