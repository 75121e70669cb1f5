"""What a parameter may be in the file: a number, the name of a prior, or a multiple of one; or a matrix.

Values of many storeys in few words: groups that share one, known values times a factor, and tapers.
"""

from typing import Annotated, Any, ClassVar

import numpy as np
import pytensor.tensor as pt
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Strict,
    Tag,
    model_validator,
)
from pytensor.graph.basic import Variable

from pymc_features._checks import is_number

STRICT = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)
GROUPS = "{groups = [[VALUE, COUNT], ...]}"
TAPER = "{base = VALUE, top = VALUE, exponent = VALUE}"
ONE = "a number, the name of a prior, or {prior = NAME, times = NUMBER}"


def key(description, default=..., unit=None, **limits):
    """A key with the words that complete "must be", and the unit of what may be random."""
    extra = None if unit is None else {"unit": unit}
    return Field(default, description=description, json_schema_extra=extra, **limits)


class Value(BaseModel):
    """A table that stands for a value."""

    model_config = STRICT


class Parameter(Value):
    """A random entry: `times` the variable of this prior."""

    prior: str = key("the name of a prior", min_length=1)
    times: float = key("a positive number", 1.0, gt=0)

    def __mul__(self, factor):
        return Parameter(prior=self.prior, times=self.times * factor)


class Matrix(Value):
    """A matrix of a file, by its name there."""

    file: str = key("a file with matrices")
    name: str | None = key("the name of one of the matrices", None)


def form(value) -> str:
    """Which form of a value the file has."""
    if isinstance(value, dict):
        if "groups" in value:
            return "as groups"
        if {"base", "top", "exponent"} & set(value):
            return "as taper"
        return "as multiples" if isinstance(value.get("times"), list) else "as multiple"
    return {list: "as list", str: "as name", Parameter: "as multiple"}.get(type(value), "as number")


Positive = Annotated[float, Field(gt=0)]
Number = Annotated[float, Tag("as number")]
Name = Annotated[str, Field(min_length=1), AfterValidator(lambda name: Parameter(prior=name)), Tag("as name")]
Multiple = Annotated[Parameter, Tag("as multiple")]
type Entry = Annotated[Number | Name | Multiple, Discriminator(form)]
List = Annotated[list[Entry], Field(min_length=1), Tag("as list")]
type Vector = Annotated[Number | Name | Multiple | List, Discriminator(form)]
Group = Annotated[tuple[Entry, Annotated[int, Field(ge=1)]], Strict(False)]


class Groups(Value):
    """Groups of equal entries, perhaps each times a known value."""

    groups: list[Group] = key("a list of pairs [VALUE, COUNT], COUNT a positive whole number", min_length=1)
    times: Positive | list[Positive] = key("a positive number, or a list with one for each", 1.0)

    def entries(self) -> list:
        found = [value for value, count in self.groups for _ in range(count)]
        times = self.times if isinstance(self.times, list) else [self.times] * len(found)
        if len(times) != len(found):
            raise ValueError(
                f"must have one value of `times` for each of the {len(found)} of the groups, got {len(times)}"
            )
        return [value * factor for value, factor in zip(found, times, strict=True)]


class Multiples(Value):
    """One prior times a list of known values."""

    prior: str = key("the name of a prior", min_length=1)
    times: list[Positive] = key("a list of positive numbers", min_length=1)

    def entries(self) -> list[Parameter]:
        return [Parameter(prior=self.prior, times=factor) for factor in self.times]


class Taper(Value):
    """Values from the first storey to the last, base + (top - base) x^exponent, x = (i - 1) / (n - 1)."""

    base: Entry = key(f"{ONE}, at the first storey")
    top: Entry = key(f"{ONE}, at the last storey")
    exponent: Entry = key(f"{ONE}: 1 is linear, more stays longer near the first", 1.0)
    times: Positive | list[Positive] = key("a positive number, or a list with one for each", 1.0)
    n: ClassVar[int | None] = None  # number of storeys, where it is known

    @model_validator(mode="after")
    def positive(self):
        for name in ("base", "top", "exponent"):
            value = getattr(self, name)
            if isinstance(value, float) and (value < 0.0 or (value == 0.0 and name == "exponent")):
                condition = "positive" if name == "exponent" else "positive or zero"
                raise ValueError(f"must have a `{name}` that is {condition}, got {value:g}")
        return self

    def of_storeys(self, values):
        """The n values, with the variables or numbers `values` in place of the names of priors."""
        base, top, exponent = (evaluated(v, values) for v in (self.base, self.top, self.exponent))
        x = np.arange(self.n) / (self.n - 1.0)
        above = x > 0.0  # the slope of x^exponent by the exponent is x^exponent log(x)
        share = above * np.where(above, x, 1.0) ** exponent
        return np.asarray(self.times) * (base * (1.0 - share) + top * share)


InGroups = Annotated[Groups, AfterValidator(Groups.entries), Tag("as groups")]
Listed = Annotated[Multiples, AfterValidator(Multiples.entries), Tag("as multiples")]
Tapered = Annotated[Taper, Tag("as taper")]
type Grouped = Annotated[Number | Name | Multiple | List | InGroups | Listed, Discriminator(form)]
type ByStorey = Annotated[Number | Name | Multiple | List | InGroups | Listed | Tapered, Discriminator(form)]


def even_rows(value):
    """Rows of numbers, or single numbers; the words of the key say what is right."""
    rows = [row if isinstance(row, list) else [row] for row in value]
    assert len({len(row) for row in rows}) == 1 and all(is_number(v) for row in rows for v in row)
    return value


Rows = Annotated[list[Any], AfterValidator(even_rows), Tag("as list")]
type MatrixEntry = Annotated[
    Annotated[Matrix, Tag("as dict")] | Rows, Discriminator(lambda value: f"as {type(value).__name__}")
]
Terms = list[Annotated[MatrixEntry | None, BeforeValidator(lambda value: None if value == {} else value)]]


def priors_in(value):
    """All random entries in a value of the file, lists looked through."""
    if isinstance(value, Parameter):
        yield value
    elif isinstance(value, Taper):
        yield from priors_in([value.base, value.top, value.exponent])
    elif isinstance(value, list | tuple):
        for item in value:
            yield from priors_in(item)


def units_in(value, unit):
    """Name and unit of every random entry of a value in `unit`: what is multiplied has none."""
    if isinstance(value, Taper):
        yield from units_in([value.base, value.top], unit if value.times == 1.0 else "-")
        yield from units_in(value.exponent, "-")
    else:
        for item in priors_in(value):
            yield item.prior, unit if item.times == 1.0 else "-"


def evaluated(value, values):
    """A value of the file with the variables or numbers `values` in place of the names of priors."""
    if isinstance(value, Parameter):
        found = values[value.prior]
        return found if value.times == 1.0 else value.times * found
    if isinstance(value, Taper):
        return value.of_storeys(values)
    if not isinstance(value, list):
        return value
    if any(isinstance(values[item.prior], Variable) for item in priors_in(value)):
        return combined(value, values)
    return [evaluated(item, values) for item in value]


def combined(entries, values):
    """Entries as constants and shares of their variables: one product, however many share a variable."""
    names = list(dict.fromkeys(item.prior for item in priors_in(entries)))
    constant, shares = np.zeros(len(entries)), np.zeros((len(entries), len(names)))
    for i, item in enumerate(entries):
        if isinstance(item, Parameter):
            shares[i, names.index(item.prior)] = item.times
        else:
            constant[i] = item
    variables = pt.stack([pt.as_tensor_variable(values[name], dtype="float64") for name in names])
    return constant + pt.sum(shares * variables, axis=-1)
