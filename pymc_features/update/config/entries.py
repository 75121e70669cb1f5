"""What a parameter may be in the file: a number, the name of a prior, or a multiple of one; or a matrix.

Values of many storeys in few words: groups that share one, known values times a factor, and tapers.
"""

from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
import pytensor.tensor as pt
from pydantic import PlainValidator
from pytensor.graph.basic import Variable

from pymc_features._checks import is_number
from pymc_features.update.config.keys import shown


@dataclass(frozen=True)
class Parameter:
    """A random entry: `times` the variable of this prior."""

    prior: str
    times: float = 1.0


@dataclass(frozen=True)
class Taper:
    """Values from the first storey to the last, base + (top - base) x^exponent, x = (i - 1) / (n - 1)."""

    # values of storeys 1 and n, and how long it stays near the first: 1 is linear, 2 parabolic
    base: float | Parameter
    top: float | Parameter
    exponent: float | Parameter = 1.0
    times: float | tuple[float, ...] = 1.0  # known values to multiply
    n: int | None = None  # number of storeys, where it is known


@dataclass(frozen=True)
class Matrix:
    """A matrix of a file, by its name there."""

    file: str
    name: str | None = None


GROUPS = "{groups = [[VALUE, COUNT], ...]}"
TAPER = "{base = VALUE, top = VALUE, exponent = VALUE}"
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
    raise ValueError(f"{WANTED}, got {shown(value)}")


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
        f"must be a file with matrices, {{file = FILE, name = NAME}}, or rows of numbers, got {shown(value)}"
    )


def terms(value):
    """One matrix for each parameter; an empty table where a parameter does not act."""
    if not isinstance(value, list):
        raise ValueError(f"must be a list of matrices, got {shown(value)}")
    return [None if item == {} else matrix(item) for item in value]


def grouped(value):
    """Take what `vector` takes, or groups of equal entries, or one prior times a list of known values."""
    if isinstance(value, dict) and "groups" in value:
        allowed(value, "groups", "times")
        return multiplied(in_groups(value["groups"]), value.get("times", 1.0))
    if isinstance(value, dict) and set(value) == {"prior", "times"} and isinstance(value["times"], list):
        times = factors(value["times"])
        return multiplied([entry(value["prior"])] * len(times), list(times))
    return vector(value)


def by_storey(value):
    """Take what `grouped` takes, or a taper."""
    if not isinstance(value, dict) or "groups" in value or not {"base", "top", "exponent"} & set(value):
        return grouped(value)
    allowed(value, "base", "top", "exponent", "times")
    for name in ("base", "top"):
        if name not in value:
            raise ValueError(f"must have `base` and `top` as a taper, got no `{name}`")
    found = {name: entry(value[name]) for name in ("base", "top", "exponent") if name in value}
    for name, item in found.items():
        if isinstance(item, float) and (item < 0.0 or (item == 0.0 and name == "exponent")):
            condition = "positive" if name == "exponent" else "positive or zero"
            raise ValueError(f"must have a `{name}` that is {condition}, got {item:g}")
    return Taper(**found, times=factors(value.get("times", 1.0)))


def allowed(table, *keys):
    """Refuse other keys."""
    for name in table:
        if name not in keys:
            raise ValueError(f"must have the keys {', '.join(keys)} and no others, got {name!r}")


def in_groups(groups) -> list:
    """One entry for each member of the groups."""
    found = []
    for group in groups if isinstance(groups, list) and groups else [groups]:
        if not isinstance(group, list) or len(group) != 2:
            raise ValueError(f"must have pairs [VALUE, COUNT] in `groups`, got {group!r}")
        value, count = group
        if not isinstance(count, int) or isinstance(count, bool) or count < 1:
            raise ValueError(
                f"must have positive whole numbers as counts in `groups`, got {count!r} in {group}"
            )
        found += [entry(value)] * count
    return found


def factors(times):
    """A positive number, or a tuple of them."""
    numbers = times if isinstance(times, list) and times else [times]
    if not all(is_number(value) and 0.0 < value < float("inf") for value in numbers):
        raise ValueError(f"must have positive numbers as `times`, one or one for each, got {times!r}")
    return tuple(map(float, times)) if isinstance(times, list) else float(times)


def multiplied(entries, times) -> list:
    """Entries times a number, or each times its own."""
    times = factors(times)
    each = times if isinstance(times, tuple) else (times,) * len(entries)
    if len(each) != len(entries):
        raise ValueError(
            f"must have one value of `times` for each of the {len(entries)} of the groups, got {len(each)}"
        )
    return [
        replace(item, times=item.times * factor) if isinstance(item, Parameter) else item * factor
        for item, factor in zip(entries, each, strict=True)
    ]


Entry = Annotated[Any, PlainValidator(entry)]
Vector = Annotated[Any, PlainValidator(vector)]
MatrixEntry = Annotated[Any, PlainValidator(matrix)]
Terms = Annotated[Any, PlainValidator(terms)]
Grouped = Annotated[Any, PlainValidator(grouped)]
ByStorey = Annotated[Any, PlainValidator(by_storey)]


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
        return tapered(value, values)
    if not isinstance(value, list):
        return value
    if any(isinstance(values[item.prior], Variable) for item in priors_in(value)):
        return combined(value, values)
    return [evaluated(item, values) for item in value]


def tapered(taper, values):
    """The n values of a taper."""
    base, top, exponent = (evaluated(v, values) for v in (taper.base, taper.top, taper.exponent))
    x = np.arange(taper.n) / (taper.n - 1.0)
    above = x > 0.0  # the slope of x^exponent by the exponent is x^exponent log(x)
    share = above * np.where(above, x, 1.0) ** exponent
    return np.asarray(taper.times) * (base * (1.0 - share) + top * share)


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
