"""What a structure is to the rest of the package, and what its arguments may be, in a call and in a file.

A class states its arguments in `inputs`, with kind, unit and range; defaults are those of its signature.
A call is checked against these statements, and so is `update.toml`, whose values are passed on by name.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np
import pytensor.tensor as pt
from numpy.typing import ArrayLike
from pytensor.compile.mode import Mode
from pytensor.graph.basic import Constant, Variable
from pytensor.graph.fg import FunctionGraph
from pytensor.graph.traversal import ancestors
from pytensor.tensor import TensorType
from pytensor.tensor.random.op import RandomVariable
from pytensor.tensor.rewriting.shape import ShapeFeature
from pytensor.xtensor.type import XTensorVariable
from scipy import sparse

from pymc_features._checks import as_numbers, message
from pymc_features.records import DynamicLoad, Record

# numbers, what PyTensor computes, or a list of both
type Values = ArrayLike | Variable | Sequence[float | Variable]

NUMBERS = "numbers or PyTensor variables"
PLAIN = Mode(linker="py", optimizer=None)  # nothing to compile
POSITIVE, NOT_NEGATIVE, FINITE = "positive and finite", "finite and not negative", "finite"


# ---- arguments ----


class Kind(Enum):
    """The kinds of values."""

    SCALAR = "one number, which may be random"
    VECTOR = "one number or a list of them, which may be random"
    MATRIX = "a constant matrix"
    MATRICES = "a list of constant matrices, some of them left out"
    DAMPING = "a damping"
    DAMPING_OR_MATRIX = "a damping or a constant matrix"
    DEGRADATION = "a degradation, or nothing"
    PINCHING = "a pinching, or nothing"


class Input(NamedTuple):
    """One argument.

    Attributes
    ----------
    kind : Kind
    unit : str
    required : bool
        Whether a file must give it though it has a default.
    condition : str
        What numbers must be.
    words : str
        What messages say in place of the unit of a ratio.
    """

    kind: Kind
    unit: str = "-"
    required: bool = False
    condition: str = POSITIVE
    words: str = ""


def scalar(unit: str, condition: str = POSITIVE, words: str = "") -> Input:
    """A number that may be random."""
    return Input(Kind.SCALAR, unit, condition=condition, words=words)


def vector(unit: str, condition: str = POSITIVE, words: str = "", *, required: bool = False) -> Input:
    """One value for all or one for each, which may be random."""
    return Input(Kind.VECTOR, unit, required, condition, words)


MATRIX = Input(Kind.MATRIX)
MATRICES = Input(Kind.MATRICES)
DAMPING = Input(Kind.DAMPING)
DAMPING_OR_MATRIX = Input(Kind.DAMPING_OR_MATRIX)


class Described:
    """Base of what is made of arguments that `inputs` describe.

    Attributes
    ----------
    inputs : dict of str to Input
        Names of its arguments to what they may be.
    """

    inputs: dict[str, Input]

    def take(self, **values: Values) -> None:
        """Keep arguments as attributes: vectors, floats or scalar tensors, checked."""
        for name, value in values.items():
            entry = self.inputs[name]
            unit = entry.words or entry.unit
            checked = as_vector(value, name, unit, entry.condition)
            if entry.kind is Kind.SCALAR:
                if checked.ndim:
                    raise ValueError(
                        f"`{name}` must be a scalar, got {checked.ndim} dimension. Pass one value in {unit}."
                    )
                checked = checked if isinstance(checked, Variable) else float(checked)
            setattr(self, name, checked)


def as_vector(value, name: str, unit: str, condition: str = POSITIVE):
    """Return numbers as a float64 array and anything symbolic as a float64 tensor, checked.

    Parameters
    ----------
    value : number, array_like, TensorVariable or sequence of numbers and TensorVariables
        Scalar or one-dimensional. A variable with `dims` has the length of its coordinates.
    name, unit : str
        For messages.
    condition : str
        What numbers must be: `POSITIVE`, `NOT_NEGATIVE` or `FINITE`.

    Returns
    -------
    array or TensorVariable, of 0 or 1 dimension.
    """
    value, advice = unpacked(value), f"Pass values in {unit}."
    symbolic = as_variables(value, name, advice)
    if symbolic is None:
        return _as_numbers(value, name, advice, condition)
    if not isinstance(value, Variable):
        _as_numbers([1.0, *(x for x in value if not isinstance(x, Variable))], name, advice, condition)
    if symbolic.ndim > 1:
        raise ValueError(
            f"`{name}` must be a scalar or a vector, got a tensor of {symbolic.ndim} dimensions. "
            "Give one value for each degree of freedom."
        )
    return symbolic


def _as_numbers(value, name, advice, condition):
    numbers = as_numbers(value, name, advice, what=NUMBERS)
    if numbers.ndim > 1 or numbers.size == 0:
        raise ValueError(
            f"`{name}` must be a scalar or a vector, got shape {numbers.shape}. "
            "Give one value for each degree of freedom."
        )
    legal = np.isfinite(numbers)
    if condition != FINITE:
        legal &= numbers >= 0 if condition == NOT_NEGATIVE else numbers > 0
    if not legal.all():
        wrong = np.atleast_1d(numbers)[np.flatnonzero(~np.atleast_1d(legal))[0]]
        raise ValueError(message(name, condition, f"{wrong:g}", advice))
    return numbers


def static_length(value) -> int | None:
    """Length of a vector where it is known; None for scalars and unknown lengths."""
    if value.ndim == 0:
        return None
    return value.type.shape[0] if isinstance(value, Variable) else value.shape[0]


def is_numeric(value) -> bool:
    """Whether an argument holds numbers, and no variable."""
    return not isinstance(value, Variable)


def spread(value, n: int):
    """Return a scalar as `n` equal entries, a vector as it is."""
    if value.ndim:
        return value
    return value * pt.ones(n) if isinstance(value, Variable) else np.full(n, float(value))


# ---- PyTensor variables as arguments ----


def unpacked(value):
    """Arrays that hold variables as lists, variables of `pymc.dims` as tensors, anything else as it is."""
    if isinstance(value, np.ndarray) and value.dtype == object:
        return value.tolist()
    return value.values if isinstance(value, XTensorVariable) else value


def holds_variables(value) -> bool:
    """Whether a value is a sequence, and an entry of it is a variable."""
    return isinstance(value, Sequence) and any(isinstance(entry, Variable) for entry in value)


def as_variables(value, name: str, advice: str = "") -> Variable | None:
    """A variable, or a list with variables in it, as a float64 tensor; None of numbers."""
    if isinstance(value, Variable):
        return with_known_length(as_float_tensor(value, name, advice))
    return stacked(value, name, advice) if holds_variables(value) else None


def as_tensor(value, name: str, advice: str = ""):
    """A float64 tensor from a variable, from numbers or from a list of both; refuse what holds no numbers."""
    value = unpacked(value)
    if isinstance(value, Variable):
        return as_float_tensor(value, name, advice)
    if holds_variables(value):
        return stacked(value, name, advice)
    return pt.as_tensor_variable(as_numbers(value, name, advice, what=NUMBERS))


def as_float_tensor(variable, name: str, advice: str = ""):
    """A variable as a float64 tensor; refuse what has no real numbers."""
    kind = variable.type
    if not isinstance(kind, TensorType) or kind.dtype.startswith(("complex", "bool")):
        got = f"a PyTensor variable of type {kind}"
        raise TypeError(message(name, "real numbers", got, advice))
    if isinstance(variable, Constant):  # a cast of it would be none
        return pt.as_tensor_variable(np.asarray(variable.data, dtype=np.float64))
    return variable.astype("float64")


def stacked(entries, name: str, advice: str = ""):
    """Numbers and variables of one number of dimensions as a float64 tensor; its first axis counts them."""
    tensors = [as_tensor(entry, name, advice) for entry in entries]
    if len({tensor.ndim for tensor in tensors}) > 1:
        raise ValueError(
            f"`{name}` must be a list of scalars, got a vector among them. "
            "Pass a vector by itself, or join several by `pt.concatenate`."
        )
    return pt.stack(tensors)


def with_known_length(tensor):
    """A vector with its length in its type where the graph fixes it, as that of `dims` of a model does."""
    if tensor.ndim != 1 or tensor.type.shape[0] is not None:
        return tensor
    length = computed_length(tensor)
    if length is None:
        return tensor
    known = pt.specify_shape(tensor, (length,))
    known.name = tensor.name
    return known


def computed_length(vector) -> int | None:
    """Length of a vector by the constants and data of its graph; None if inputs or draws decide it."""
    graph = FunctionGraph(outputs=[vector], clone=True, features=[ShapeFeature()])
    length = graph.shape_feature.get_shape(graph.outputs[0], 0)
    for variable in ancestors([length]):
        if variable.owner is None:
            if not hasattr(variable, "data") and not hasattr(variable, "get_value"):
                return None
        elif isinstance(variable.owner.op, RandomVariable):
            return None
    return int(length.eval(mode=PLAIN))


# ---- structures ----


class Structure(Described, ABC):
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
    """

    family: str
    is_linear: bool = True
    has_storeys: bool = False
    dof_names: tuple[str, ...] | None = None

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
