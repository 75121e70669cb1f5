"""Damaged copies of a configuration file: its tables and values changed, or its bytes."""

import copy

from pymc_features.update.config import sections
from pymc_features.update.config.priors import DISTRIBUTIONS
from pymc_features.update.kinds import ambient, cyclic, modal
from pymc_features.update.problem import Config
from support.mutations import mutated


class Text(str):
    """A value as it is written in the file, which needs not be TOML."""


MODULES = [value for module in (sections, modal, ambient, cyclic) for value in vars(module).values()]
KEYS = sorted({name for part in (Config, *MODULES) for name in getattr(part, "model_fields", {})})
STRANGE = [
    *(0, -1, 2, 10**400, 0.5, 1e-320, 1e308, float("nan"), -float("inf"), True, "", "k1", "roof", "größe"),
    *("EXP", "a\0b", "x" * 5000, "/dev/zero", "modes.csv", "[red]", "{0.__class__}", [], {}, [{}], [1, "k1"]),
    *(
        {"prior": "k1", "times": 10**400},
        {"file": "/dev/zero", "name": "K"},
        [[1.0, 2.0], [3.0]],
        [0.0] * 2000,
    ),
    *(Text("[" * 30000 + "]" * 30000), Text("1e999"), Text("'''"), Text("a." * 2000 + "b = 1"), Text("")),
    *(Text("2020-13-45"), Text('"\\ud800"'), *DISTRIBUTIONS),
]


def mutated_config(table: dict, rng) -> bytes:
    """A file with one or two changes of a configuration: in one of five of its bytes."""
    if rng.random() < 0.2:
        return mutated(as_toml(table).encode(), rng)[0]
    table = copy.deepcopy(table)
    for _ in range(int(rng.choice([1, 1, 1, 2]))):
        pick(CHANGES, rng)(table, rng)
    return as_toml(table).encode("utf-8", "surrogatepass")


def pick(choices, rng):
    """One of a sequence."""
    return choices[int(rng.integers(len(choices)))]


def places(node, above=None, at=None):
    """Every (container, key) in nested tables and lists."""
    if above is not None:
        yield above, at
    if isinstance(node, dict | list):
        for key, value in list(node.items() if isinstance(node, dict) else enumerate(node)):
            yield from places(value, node, key)


def place(table, rng, kind=object):
    """A random one of them that holds a value of this kind, or of any kind."""
    found = list(places(table))
    return pick([(above, at) for above, at in found if isinstance(above[at], kind)] or found, rng)


def other_value(table, rng):
    above, at = place(table, rng)
    above[at] = copy.deepcopy(pick(STRANGE, rng))


def near_number(table, rng):
    """Of the same kind, some way off."""
    above, at = place(table, rng, int | float)
    if isinstance(above[at], int | float):
        above[at] = type(above[at])(above[at] * rng.choice([-1, 0, 2, 10, 1000]))


def removed(table, rng):
    above, at = place(table, rng)
    del above[at]


def added(table, rng):
    """A key of any section, in any other."""
    tables = [table, *(above[at] for above, at in places(table) if isinstance(above[at], dict))]
    pick(tables, rng)[pick(KEYS, rng)] = copy.deepcopy(pick(STRANGE, rng))


def moved(table, rng):
    """What stands in another place, of the same kind or not."""
    (above, at), (other, there) = place(table, rng), place(table, rng)
    above[at] = copy.deepcopy(other[there])


CHANGES = other_value, other_value, near_number, near_number, removed, added, moved


def as_toml(table: dict) -> str:
    """A parsed file as text again, each section in a line of its own."""
    lines = []
    for name, value in table.items():
        if isinstance(value, dict) and value:
            lines += ["", f"[{quoted(name)}]", *(f"{quoted(k)} = {text_of(v)}" for k, v in value.items())]
        else:
            lines.insert(0, f"{quoted(name)} = {text_of(value)}")
    return "\n".join(lines) + "\n"


def text_of(value) -> str:
    """A value in TOML."""
    match value:
        case Text():
            return str(value)
        case bool():
            return str(value).lower()
        case str():
            return quoted(value)
        case list():
            return f"[{', '.join(map(text_of, value))}]"
        case dict():
            return f"{{{', '.join(f'{quoted(k)} = {text_of(v)}' for k, v in value.items())}}}"
    return repr(value)


def quoted(text) -> str:
    """A string in TOML."""
    escaped = (c if c.isprintable() and c not in '"\\' else f"\\u{ord(c):04x}" for c in text)
    return f'"{"".join(escaped)}"'
