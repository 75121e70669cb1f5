"""What a parameter may be in the file: a number, the name of a prior, or a multiple of one; or a matrix."""

from dataclasses import dataclass
from typing import Annotated, Any

import pytensor.tensor as pt
from pydantic import PlainValidator
from pytensor.graph.basic import Variable

from pymc_features._checks import is_number


@dataclass(frozen=True)
class Parameter:
    """A random entry: `times` the variable of this prior."""

    prior: str
    times: float = 1.0


@dataclass(frozen=True)
class Matrix:
    """A matrix of a file, by its name there."""

    file: str
    name: str | None = None


WANTED = "must be a number, the name of a prior, or {prior = NAME, times = NUMBER}"


def entry(value):
    """One parameter."""
    if is_number(value) and abs(value) < float("inf"):
        return float(value)
    if isinstance(value, str) and value:
        return Parameter(value)
    if isinstance(value, dict) and set(value) == {"prior", "times"}:
        prior, times = value["prior"], value["times"]
        if isinstance(prior, str) and is_number(times) and 0.0 < times < float("inf"):
            return Parameter(prior, float(times))
    raise ValueError(f"{WANTED}, got {value!r}")


def vector(value):
    """One parameter for all, or a list of them."""
    if not isinstance(value, list):
        return entry(value)
    if not value:
        raise ValueError(f"{WANTED}, or a list of these, got an empty list")
    return [entry(item) for item in value]


def matrix(value):
    """A matrix by file, or as rows of numbers."""
    if isinstance(value, dict) and {"file"} <= set(value) <= {"file", "name"}:
        if all(isinstance(text, str) for text in value.values()):
            return Matrix(**value)
    elif isinstance(value, list) and value:
        rows = [row if isinstance(row, list) else [row] for row in value]
        if len({len(row) for row in rows}) == 1 and all(is_number(v) for row in rows for v in row):
            return value
    raise ValueError(
        f"must be a file with matrices, {{file = FILE, name = NAME}}, or rows of numbers, got {value!r}"
    )


def terms(value):
    """One matrix for each parameter; an empty table where a parameter does not act."""
    if not isinstance(value, list):
        raise ValueError(f"must be a list of matrices, got {value!r}")
    return [None if item == {} else matrix(item) for item in value]


Entry = Annotated[Any, PlainValidator(entry)]
Vector = Annotated[Any, PlainValidator(vector)]
MatrixEntry = Annotated[Any, PlainValidator(matrix)]
Terms = Annotated[Any, PlainValidator(terms)]


def priors_in(value):
    """All random entries in a value of the file, lists looked through."""
    if isinstance(value, Parameter):
        yield value
    elif isinstance(value, list | tuple):
        for item in value:
            yield from priors_in(item)


def evaluated(value, values):
    """A value of the file with the variables or numbers `values` in place of the names of priors."""
    if isinstance(value, Parameter):
        found = values[value.prior]
        return found if value.times == 1.0 else value.times * found
    if not isinstance(value, list):
        return value
    found = [evaluated(item, values) for item in value]
    if any(isinstance(item, Variable) for item in found):
        return pt.stack([pt.as_tensor_variable(item, dtype="float64") for item in found])
    return found
