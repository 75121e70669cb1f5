"""Values of many storeys in few words: groups that share one, known values times a factor, and tapers."""

from dataclasses import replace
from typing import Annotated, Any

from pydantic import PlainValidator

from pymc_features._checks import is_number
from pymc_features.update.config.entries import Parameter, Taper, entry, vector

GROUPS = "{groups = [[VALUE, COUNT], ...]}"
TAPER = "{base = VALUE, top = VALUE, exponent = VALUE}"


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
    if not isinstance(groups, list) or not groups:
        raise ValueError(f"must have pairs [VALUE, COUNT] in `groups`, got {groups!r}")
    found = []
    for group in groups:
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


Grouped = Annotated[Any, PlainValidator(grouped)]
ByStorey = Annotated[Any, PlainValidator(by_storey)]
