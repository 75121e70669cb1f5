"""What a structure is to the rest of the package, and what its arguments may be, in a call and in a file.

A class states each argument once, as a field with kind, unit and range. A call is checked against these
statements, and so is `update.toml`, whose values are passed on by name.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from enum import Enum
from typing import NamedTuple, dataclass_transform

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
# Of what is evaluated once: nothing is compiled, while rewrites that fold constants compile C code for each.
IN_PYTHON = Mode(linker="py", optimizer=None)


# ---- arguments ----


class Condition(NamedTuple):
    """What finite numbers must fulfil: the words after "must", and the places where they do."""

    words: str
    holds: Callable[[np.ndarray], np.ndarray]


POSITIVE = Condition("be positive and finite", lambda x: x > 0.0)
NOT_NEGATIVE = Condition("be finite and not negative", lambda x: x >= 0.0)
FINITE = Condition("be finite", np.isfinite)
SHARE = Condition("lie between 0 and 1", lambda x: (x >= 0.0) & (x <= 1.0))
AT_LEAST_ONE = Condition("be at least 1", lambda x: x >= 1.0)
NUMERIC = "Pass plain numbers."


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
    condition : Condition
        What numbers must be.
    advice : str
        A sentence for messages, what to pass.
    required : bool
        Whether a file must give it though it has a default.
    """

    kind: Kind
    unit: str = "-"
    condition: Condition = POSITIVE
    advice: str = ""
    required: bool = False


def scalar(unit: str, condition: Condition = POSITIVE, advice: str = "") -> Input:
    """A number that may be random."""
    return Input(Kind.SCALAR, unit, condition, advice or f"Pass values in {unit}.")


def vector(unit: str, condition: Condition = POSITIVE, advice: str = "") -> Input:
    """One value for all or one for each, which may be random."""
    return Input(Kind.VECTOR, unit, condition, advice or f"Pass values in {unit}.")


MATRIX = Input(Kind.MATRIX)
MATRICES = Input(Kind.MATRICES)
KINDS_OF_DAMPING = "RayleighDamping(alpha, beta) or ModalDamping(ratios)."
DAMPING = Input(Kind.DAMPING, advice=f"Pass {KINDS_OF_DAMPING}")
DAMPING_OR_MATRIX = Input(Kind.DAMPING_OR_MATRIX, advice=f"Pass C in N s/m, {KINDS_OF_DAMPING}")


class Described:
    """Base of what is made of arguments that `inputs` describe.

    Attributes
    ----------
    inputs : dict of str to Input
        Names of its arguments to what they may be.
    """

    inputs: dict[str, Input]

    def __post_init__(self):
        """Keep vectors as arrays or tensors, scalars as floats or tensors; refuse parts of another kind."""
        for field in fields(self):
            entry, name, value = field.type.__metadata__[0], field.name, getattr(self, field.name)
            if entry.kind in (Kind.SCALAR, Kind.VECTOR):
                value = as_vector(value, name, entry.advice, entry.condition)
            elif not isinstance(value, field.type.__origin__):
                what = f"a {entry.kind.name.title()}"
                raise TypeError(message(name, what, type(value).__name__, entry.advice))
            if entry.kind is Kind.SCALAR:
                if value.ndim:
                    one = entry.advice.replace("values", "one value")
                    raise ValueError(message(name, "a scalar", f"{value.ndim} dimension", one))
                value = value if isinstance(value, Variable) else float(value)
            setattr(self, name, value)


@dataclass_transform(eq_default=False)
def described[T](cls: type[T]) -> type[T]:
    """Make a dataclass whose fields are annotated with what they may be, its `inputs`."""
    made = dataclass(eq=False, repr=False)(cls)
    made.inputs = {field.name: field.type.__metadata__[0] for field in fields(made)}
    types = {field.name: field.type.__origin__ for field in fields(made)}
    made.__init__.__annotations__ = types | {"return": None}  # so that help shows types alone
    return made


def as_vector(value, name: str, advice: str, condition: Condition = POSITIVE):
    """Return numbers as a float64 array and anything symbolic as a float64 tensor, checked.

    Parameters
    ----------
    value : number, array_like, TensorVariable or sequence of numbers and TensorVariables
        Scalar or one-dimensional. A variable with `dims` has the length of its coordinates.
    name, advice : str
        For messages.
    condition : Condition
        What numbers must fulfil.

    Returns
    -------
    array or TensorVariable, of 0 or 1 dimension.
    """
    value = unpacked(value)
    tensor, numbers = as_variables(value, name, advice), np.ones(1)
    if tensor is None:
        numbers = as_numbers(value, name, advice, what=NUMBERS)
    elif not isinstance(value, Variable):
        numbers = as_numbers([x for x in value if not isinstance(x, Variable)], name, advice, what=NUMBERS)
    result = numbers if tensor is None else tensor
    if result.ndim > 1 or (tensor is None and numbers.size == 0):
        got = f"shape {numbers.shape}" if tensor is None else f"a tensor of {tensor.ndim} dimensions"
        advice = "Give one value for each degree of freedom."
        raise ValueError(message(name, "a scalar or a vector", got, advice))
    legal = np.isfinite(numbers) & condition.holds(numbers)
    if not legal.all():
        raise ValueError(f"`{name}` must {condition.words}, got {numbers[~legal][0]:g}. {advice}")
    return result


def static_length(value) -> int | None:
    """Length of a vector where it is known; None for scalars and unknown lengths."""
    if value.ndim == 0:
        return None
    return value.type.shape[0] if isinstance(value, Variable) else value.shape[0]


def check_length(value, name: str, n: int, things: str) -> None:
    """Refuse a vector that has not one value for each of n things."""
    if static_length(value) not in (None, n):
        got = static_length(value)
        raise ValueError(f"`{name}` must have one value or one for each of the {n} {things}, got {got}.")


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
    if not isinstance(value, Variable) and not holds_variables(value):
        return None
    return with_known_length(as_tensor(value, name, advice))


def as_tensor(value, name: str, advice: str = ""):
    """A float64 tensor from a variable, from numbers or from a list of both; refuse what holds no numbers."""
    value = unpacked(value)
    if holds_variables(value):
        tensors = [as_tensor(entry, name, advice) for entry in value]
        if len({tensor.ndim for tensor in tensors}) > 1:
            advice = "Pass a vector by itself, or join several by `pt.concatenate`."
            raise ValueError(message(name, "a list of scalars", "a vector among them", advice))
        return pt.stack(tensors)
    if not isinstance(value, Variable):
        return pt.as_tensor_variable(as_numbers(value, name, advice, what=NUMBERS))
    if not isinstance(value.type, TensorType) or value.type.dtype.startswith(("complex", "bool")):
        raise TypeError(message(name, "real numbers", f"a PyTensor variable of type {value.type}", advice))
    if isinstance(value, Constant):  # a cast of it would be none
        return pt.as_tensor_variable(np.asarray(value.data, dtype=np.float64))
    return value.astype("float64")


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
    return int(length.eval(mode=IN_PYTHON))


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
