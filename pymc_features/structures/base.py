"""What a structure is to the rest of the package, and the vectors its parameters come in."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pytensor.tensor as pt
from numpy.typing import ArrayLike
from pytensor.graph.basic import Variable
from scipy import sparse

from pymc_features._checks import as_numbers
from pymc_features.records import DynamicLoad, Record
from pymc_features.structures.inputs import Input
from pymc_features.structures.variables import (
    NUMBERS,
    as_float_tensor,
    holds_variables,
    stacked,
    unpacked,
    with_known_length,
)

# numbers, what PyTensor computes, or a list of both
type Values = ArrayLike | Variable | Sequence[float | Variable]


class Structure(ABC):
    """A structure whose response to a ground acceleration can be computed.

    A structure is a value: changing a parameter makes a new one. Its parameters are numbers, arrays
    or PyTensor variables; degree of freedom 0 is next to the base.

    Attributes
    ----------
    family : str
        Which kernels compute its response, a key of `simulators.FAMILIES`; `parameters` are what they take.
    is_linear : bool
        Whether its response is a sum of modes.
    has_storeys : bool
        Whether degree of freedom i moves against i - 1, so that there are inter-storey drifts.
    dof_names : tuple of str or None
        Names of its degrees of freedom, where they have any.
    inputs : dict
        Names of its arguments to what they may be in a file, `Input`.
    """

    family: str
    is_linear: bool = True
    has_storeys: bool = False
    dof_names: tuple[str, ...] | None = None
    inputs: dict[str, Input]

    @property
    @abstractmethod
    def n_dof(self) -> int:
        """Number of degrees of freedom."""

    @property
    def n_modes(self) -> int:
        """Number of modes: of degrees of freedom, less those that have no mass of their own."""
        return self.n_dof

    @abstractmethod
    def parameters(self) -> tuple:
        """Return what the response kernels of its family take."""

    def constants(self, record: DynamicLoad) -> tuple:
        """Return the arrays its kernels take besides, which are never random, for a record or loading."""
        return ()

    def excitation(self, record: DynamicLoad) -> np.ndarray:
        """Return the ground acceleration (time,) of a record, or the inputs (input, time) of a loading."""
        if not isinstance(record, Record):
            raise TypeError(
                f"`record` must be a Record for a {type(self).__name__}, got {type(record).__name__}. "
                "Several supports and forces act on LinearStructure(**structure.matrices()._asdict())."
            )
        return record.acceleration

    def check_load(self, record: DynamicLoad) -> None:
        """Refuse a load that cannot act on it."""
        if record.is_displacement:
            raise TypeError(
                f"`record` must be a Record for a {type(self).__name__}, got {type(record).__name__}. Only a "
                "HystereticSpecimen follows a prescribed displacement."
            )

    @abstractmethod
    def matrices(self) -> "Matrices":
        """Return mass [kg], damping [N s/m] and (initial) stiffness [N/m] matrices, each (n, n)."""

    @abstractmethod
    def modes(self) -> "Modes":
        """Return natural frequencies, mode shapes and damping ratios."""

    @abstractmethod
    def inertia(self) -> np.ndarray | Variable:
        """Return influence' M (supports, n) [kg]: times the absolute accelerations, the base shear [N]."""

    def check_numbers(self) -> None:
        """Refuse variables where numbers are needed."""
        if self.is_symbolic:
            raise TypeError(
                "`matrices` and `modes` must be asked of a structure of numbers, got PyTensor "
                "variables. Build the structure with values, for example a posterior draw."
            )

    @property
    def is_symbolic(self) -> bool:
        """Whether a parameter is a PyTensor variable."""
        return any(isinstance(value, Variable) for value in self.parameters())


class Matrices(NamedTuple):
    """Matrices of M x" + C x' + K x, in this order.

    Attributes
    ----------
    mass, damping, stiffness : array (n, n), or sparse
        M [kg], C [N s/m] and (initial) K [N/m]. `LinearStructure` takes them by name: `**matrices._asdict()`.
    """

    mass: np.ndarray | sparse.csc_array
    damping: np.ndarray | sparse.csc_array
    stiffness: np.ndarray | sparse.csc_array


@dataclass(frozen=True, eq=False)
class Modes:
    """Undamped modes of a structure, m of n degrees of freedom, in ascending order of frequency.

    Attributes
    ----------
    angular_frequencies : array (m,)
        omega_r [rad/s].
    mode_shapes : array (n, m)
        **Columns** are the mass-normalised shapes, phi_r' M phi_r = 1, positive at the top of a chain.
    participation_factors : array (m,), or (m, supports) with several supports
        Gamma_r = phi_r' M 1 [kg^(1/2)].
    damping_ratios : array (m,)
        zeta_r [-].
    """

    angular_frequencies: np.ndarray
    mode_shapes: np.ndarray
    participation_factors: np.ndarray
    damping_ratios: np.ndarray

    @property
    def natural_frequencies(self) -> np.ndarray:
        """f_r = omega_r / (2 pi) [Hz], shape (m,)."""
        return self.angular_frequencies / (2.0 * np.pi)

    @property
    def effective_modal_masses(self) -> np.ndarray:
        """Gamma_r^2 [kg]; those of all modes add up to the total mass."""
        return self.participation_factors**2


def as_vector(value, name: str, unit: str, *, allow_zero: bool = False):
    """Return numbers as a float64 array and anything symbolic as a float64 tensor, checked.

    Parameters
    ----------
    value : number, array_like, TensorVariable or sequence of numbers and TensorVariables
        Scalar or one-dimensional. A variable with `dims` has the length of its coordinates.
    name, unit : str
        For messages.
    allow_zero : bool
        Whether zero is a legal value.

    Returns
    -------
    array or TensorVariable, of 0 or 1 dimension.
    """
    value, advice = unpacked(value), f"Pass values in {unit}."
    if isinstance(value, Variable):
        symbolic = with_known_length(as_float_tensor(value, name, advice))
    elif holds_variables(value):
        symbolic = stacked(value, name, advice)
        _as_numbers([1.0, *(x for x in value if not isinstance(x, Variable))], name, unit, allow_zero)
    else:
        return _as_numbers(value, name, unit, allow_zero)
    if symbolic.ndim > 1:
        raise ValueError(
            f"`{name}` must be a scalar or a vector, got a tensor of {symbolic.ndim} dimensions. "
            "Give one value for each degree of freedom."
        )
    return symbolic


def _as_numbers(value, name, unit, allow_zero):
    numbers = as_numbers(value, name, f"Pass values in {unit}.", what=NUMBERS)
    if numbers.ndim > 1 or numbers.size == 0:
        raise ValueError(
            f"`{name}` must be a scalar or a vector, got shape {numbers.shape}. "
            "Give one value for each degree of freedom."
        )
    legal = np.isfinite(numbers) & (numbers >= 0 if allow_zero else numbers > 0)
    if not legal.all():
        wrong = np.atleast_1d(numbers)[np.flatnonzero(~np.atleast_1d(legal))[0]]
        condition = "finite and not negative" if allow_zero else "positive and finite"
        raise ValueError(f"`{name}` must be {condition}, got {wrong:g}. Pass values in {unit}.")
    return numbers


def static_length(value) -> int | None:
    """Length of a vector where it is known; None for scalars and unknown lengths."""
    if value.ndim == 0:
        return None
    return value.type.shape[0] if isinstance(value, Variable) else value.shape[0]


def spread(value, n: int):
    """Return a scalar as `n` equal entries, a vector as it is."""
    if value.ndim:
        return value
    return value * pt.ones(n) if isinstance(value, Variable) else np.full(n, float(value))
