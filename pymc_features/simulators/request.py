"""What is asked of a response: output step, sensors, quantity and number of modes, checked."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import sparse

from pymc_features._checks import (
    as_array,
    as_list,
    as_numbers,
    check_choice,
    check_finite,
    check_integer,
    check_positive,
    is_number,
    message,
    shown,
    single,
)
from pymc_features.simulators.oscillators.arguments import QUANTITIES

FINEST = 1e-6  # output step over the record's

RESTORING_FORCE = "restoring_force"  # the only quantity of a specimen
UNITS = dict(zip(QUANTITIES, ("m/s^2", "m/s^2", "m/s", "m"), strict=True)) | {RESTORING_FORCE: "N"}
CODES = {name: code for code, name in enumerate(QUANTITIES)} | {RESTORING_FORCE: 0}


class Request(NamedTuple):
    """A checked request: the response of `sensors` at every `stride`-th of `substeps` per step.

    `labels` are the names by which rows were asked for, None if by numbers; a band-limited record is refined
    by `factor` before it is marched.
    """

    substeps: int
    stride: int
    sensors: np.ndarray
    n_modes: int
    quantity: str
    labels: np.ndarray | None = None
    factor: int = 1

    @property
    def quantity_code(self) -> int:
        """What the kernels call the quantity."""
        return CODES[self.quantity]

    def n_outputs(self, n_times: int) -> int:
        """Number of output samples for a record of `n_times` samples."""
        return (n_times - 1) * self.substeps // self.stride + 1

    def times(self, record_dt: float, n_outputs: int) -> np.ndarray:
        """Output times (n_outputs,) [s], from 0."""
        return np.arange(n_outputs) * (record_dt * self.stride / self.substeps)


def request(
    n_dof: int,
    record_dt: float,
    *,
    dt: float | None = None,
    sensors: Sequence[int] | None = None,
    quantity: str = "absolute_acceleration",
    n_modes: int | None = None,
    most_modes: int | None = None,
) -> Request:
    """Check what a user asks of a structure of `n_dof` degrees of freedom and as many modes, or `most_modes`.

    Raises
    ------
    ValueError
        With a message that names the argument, what it was and what to pass.
    """
    substeps, stride = sampling_grid(record_dt, dt)
    check_choice(quantity, "quantity", CODES)
    most_modes = n_dof if most_modes is None else most_modes
    n_modes = most_modes if n_modes is None else n_modes
    n_modes = check_integer(n_modes, "n_modes", most=most_modes, advice="Leave it out for all modes.")
    return Request(substeps, stride, check_sensors(sensors, n_dof), n_modes, quantity)


class Picked(NamedTuple):
    """Sensors as numbers, or as combinations S x where a name stands for one; and their names, if given."""

    sensors: np.ndarray | None
    outputs: np.ndarray | None
    names: np.ndarray | None


def picked_by_name(structure, sensors) -> Picked:
    """Translate names of degrees of freedom; numbers stay as they are, and None where there are no names."""
    names = structure.dof_names if sensors is None else sensors
    listed = [names] if isinstance(names, str) else as_list(names)
    if not listed or not any(isinstance(name, str) for name in listed):
        return Picked(sensors, None, None)
    if not all(isinstance(name, str) for name in listed):
        raise TypeError(message("sensors", "all names or all numbers", shown(sensors)))
    if structure.dof_names is None:
        what = f"a list of degrees of freedom (integers) of a {type(structure).__name__} without names"
        advice = "Name those of a LinearStructure by `with_names`."
        raise ValueError(message("sensors", what, shown(sensors), advice))
    rows, names = structure.rows_named(listed), np.array(listed)
    return Picked(None, rows, names) if rows.ndim == 2 else Picked(rows, None, names)


def check_sensors(sensors, n_dof: int) -> np.ndarray:
    """Return the sensors as an integer array; None stands for all degrees of freedom."""
    if sensors is None:
        return np.arange(n_dof)
    indices = np.atleast_1d(as_array(sensors))
    if indices.ndim != 1 or indices.size == 0 or indices.dtype.kind not in "iu":
        raise ValueError(message("sensors", "a list of degrees of freedom (integers)", shown(sensors)))
    if not ((indices >= 0) & (indices < n_dof)).all():
        raise ValueError(
            f"`sensors` must lie between 0 and {n_dof - 1}, got {indices.tolist()}. "
            "Degree of freedom 0 is next to the base."
        )
    return indices.astype(np.int64)


def check_outputs(outputs, n_dof: int) -> np.ndarray:
    """Return the matrix S (s, n) of wanted combinations S x as an array of its own."""
    outputs = outputs.toarray() if sparse.issparse(outputs) else outputs
    advice = "Combine a response by variables with `pt.dot`."
    matrix = as_numbers(outputs, "outputs", advice, what="a matrix of numbers").copy()
    if matrix.ndim != 2 or matrix.shape[1] != n_dof or matrix.shape[0] == 0:
        raise ValueError(
            f"`outputs` must have shape (s, {n_dof}), got {matrix.shape}. "
            "Give one row for each combination and one column for each degree of freedom."
        )
    check_finite(matrix, "outputs", "Pass real coefficients.")
    return matrix


def sampling_grid(record_dt: float, dt: float | None) -> tuple[int, int]:
    """Return (substeps, stride) such that dt = record_dt * stride / substeps.

    Parameters
    ----------
    record_dt, dt : float
        Steps of the record and of the output [s]; one must be an integer multiple of the other.
        `dt=None` is the record's own step.
    """
    if dt is None:
        return 1, 1
    if not is_number(single(dt)):
        raise TypeError(
            f"`dt` must be a number, got {type(dt).__name__}. Pass the output step in seconds; in a model it "
            "may be pm.Data."
        )
    dt = check_positive(dt, "dt", "Pass the output step in seconds.")
    ratio = dt / record_dt
    if not FINEST < ratio < 1.0 / FINEST:
        raise ValueError(
            f"`dt` must be within a factor of {1.0 / FINEST:g} of the record's step {record_dt:g} s, got "
            f"{dt:g} s. Resample the record first."
        )
    factor = round(max(ratio, 1.0 / ratio))
    if abs(max(ratio, 1.0 / ratio) / factor - 1.0) > 1e-6:
        raise ValueError(
            f"`dt` must be an integer multiple or divisor of the record's step {record_dt:g} s, "
            f"got {dt:g} s. Resample the record first."
        )
    return (1, factor) if ratio >= 1.0 else (factor, 1)
