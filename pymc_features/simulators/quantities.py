"""The quantities of a response: those of the kernels, and those that are combinations of them."""

from typing import NamedTuple

import numpy as np

from pymc_features import band_limited
from pymc_features._checks import check_choice, shown
from pymc_features.simulators.oscillators.arguments import QUANTITIES
from pymc_features.simulators.request import (
    RESTORING_FORCE,
    UNITS,
    Picked,
    Request,
    check_outputs,
    picked_by_name,
    request,
)


class Response(NamedTuple):
    """What a response is made of: a quantity of the kernels, the dimension of its rows, its unit."""

    source: str
    dim: str
    units: str


# Names that users type; the kernels know those of `QUANTITIES` only. The dimension support is left out where
# there is one support.
HISTORIES = {name: Response(name, "sensor", unit) for name, unit in UNITS.items()} | {
    "inter_storey_drift": Response("relative_displacement", "storey", "m"),
    "base_shear": Response("absolute_acceleration", "support", "N"),
}


class Rows(NamedTuple):
    """What the rows of a response are.

    Attributes
    ----------
    picked : integer array (row,), or array (row, n)
        Degrees of freedom, or combinations S x of all of them.
    dim : str or None
        None for a single row without a dimension.
    labels : array (row,)
        Coordinate of the dimension.
    title : str
        What the coordinate counts.
    """

    picked: np.ndarray
    dim: str | None
    labels: np.ndarray
    title: str

    @property
    def outputs(self) -> np.ndarray | None:
        """S (row, n), None where rows are degrees of freedom."""
        return self.picked if self.picked.ndim == 2 else None

    def of(self, values) -> np.ndarray:
        """The rows of values (n, ...) at all degrees of freedom."""
        return self.picked @ values if self.picked.ndim == 2 else values[self.picked]


def quantities_of(structure) -> list[str]:
    """Quantities that a structure has, the usual one first."""
    if structure.family == "specimen":
        return [RESTORING_FORCE]
    return [name for name in HISTORIES if name != RESTORING_FORCE]


def rows_of(structure, quantity: str, asked: Request, outputs=None) -> Rows:
    """Rows of a quantity; sensors stand for storeys in a drift, and for nothing in a shear."""
    sensors, labels = asked.sensors, asked.labels
    dim = HISTORIES[quantity].dim
    if dim == "support":
        inertia = structure.inertia()
        return Rows(inertia, "support" if len(inertia) > 1 else None, np.arange(len(inertia)), "support")
    if dim == "storey":  # x_i - x_{i-1}, the first against the base
        drifts = np.eye(structure.n_dof) - np.eye(structure.n_dof, k=-1)
        return Rows(drifts[sensors], dim, sensors, "storey, 0 against the base")
    if outputs is not None and labels is None:
        return Rows(outputs, dim, np.arange(len(outputs)), "row of outputs")
    picked = sensors if outputs is None else outputs
    return Rows(picked, dim, sensors if labels is None else labels, "degree of freedom")


def checked_request(structure, record, quantity, *, dt=None, sensors=None, n_modes=None, outputs=None):
    """The request of what a quantity is made of, and `outputs` as an array or None.

    Raises
    ------
    ValueError
        If an argument is out of range or has no meaning for the structure or the quantity.
    TypeError
        If the record cannot act on the structure.
    """
    structure.check_load(record)
    check_choice(quantity, "quantity", quantities_of(structure))
    if n_modes is not None and not structure.is_linear:
        raise ValueError(
            f"`n_modes` must be left out for a nonlinear structure, got {shown(n_modes)}. "
            f"{type(structure).__name__} has no superposition of modes."
        )
    source, dim, _ = HISTORIES[quantity]
    if dim == "storey" and not structure.has_storeys:
        others = ", ".join(name for name, response in HISTORIES.items() if response.dim != dim)
        raise ValueError(
            f"`quantity` must be one of {others} for a {type(structure).__name__}, got {quantity!r}. Its "
            f"degrees of freedom are no storeys: pass {source!r} and outputs=S with one row for each drift, "
            "1 and -1 in the columns of its ends."
        )
    picked = picked_by_name(structure, sensors) if outputs is None else Picked(sensors, None, None)
    asked = request(
        structure.n_dof,
        record.dt,
        dt=dt,
        sensors=picked.sensors,
        quantity=source,
        n_modes=n_modes,
        most_modes=structure.n_modes,
    )
    asked = asked._replace(labels=picked.names)
    if picked.outputs is not None:
        structure.check_sensors(record, picked.outputs)
        return asked, picked.outputs
    if outputs is None:
        if structure.family == "linear" and dim != "support":
            structure.check_sensors(record, asked.sensors)
        return asked, None
    if sensors is not None:
        raise ValueError("`sensors` must be left out with `outputs`, got both. Choose rows of `outputs`.")
    if quantity not in QUANTITIES:
        raise ValueError(
            f"`outputs` must be left out for {quantity!r}, got an array. It is itself a combination: combine "
            f"{source!r} instead."
        )
    outputs = check_outputs(outputs, structure.n_dof)
    if structure.family == "linear":
        structure.check_sensors(record, outputs)
    return asked, outputs


def force_share(structure, record, quantity: str) -> np.ndarray | None:
    """What a quantity takes from the forces of a `Loading` directly, (row, input); None for nothing."""
    if HISTORIES[quantity].dim != "support" or not record.is_force:
        return None
    return record.applied(-structure.influence.reshape(structure.n_dof, -1).T)


def at_outputs(record, asked: Request) -> np.ndarray:
    """Inputs of a record at the output samples, (d, u)."""
    values = record.inputs
    if record.interpolation == "band-limited":
        return band_limited.evaluated(values, record.dt, asked.substeps, asked.stride)[0]
    places = np.arange(asked.n_outputs(values.shape[1])) * (asked.stride / asked.substeps)
    return np.array([np.interp(places, np.arange(values.shape[1]), row) for row in values])
