"""Damaged copies of a configuration file: its tables and values changed, or its bytes."""

import copy
import datetime

from pymc_features.update.config import sections
from pymc_features.update.config.priors import DISTRIBUTIONS, arguments_of
from pymc_features.update.config.structures import DAMPINGS, STRUCTURES
from pymc_features.update.kinds import ambient, cyclic, modal
from pymc_features.update.problem import Config
from support.mutations import mutated


class Text(str):
    """A value as it is written in the file, which needs not be TOML."""


NUMBERS = [0, 1, -1, 2, 10**19, 10**400, 0.5, -0.0, 1e-320, 1e308, float("nan"), -float("inf")]
NAMES = [
    *("", "k1", "sigma", "base", "floor1", "nothing", "größe", "a\0b", "x" * 5000, "EXP", "{0.__class__}"),
    *("..", "/", "/dev/zero", "measured.csv", "modes.csv", "nodes.csv", "roof", "[red]", "%s", "\\", "\n"),
]
OTHERS = [
    *(True, [], {}, [{}], {"": 1}, [1, "k1", {}], datetime.date(2020, 1, 1), {"prior": "k1", "times": 2.0}),
    *({"prior": "k1", "times": 10**400}, {"file": "/dev/zero", "name": "K"}, {"type": {}}, [0.0] * 2000),
    *({"type": "ModalDamping", "ratios": "zeta"}, [[1.0] * 40] * 40, [[1.0, 2.0], [3.0]], Text("9" * 5000)),
    *(Text("[" * 30000 + "]" * 30000), Text("{a = " * 400 + "1" + "}" * 400), Text("1e999"), Text("'''")),
    *(Text("a." * 2000 + "b = 1"), Text(""), Text("2020-13-45"), Text('"\\ud800"')),
]


def known_keys() -> list[str]:
    """All keys of the sections."""
    parts = [Config, *STRUCTURES.values(), *DAMPINGS.values()]
    parts += [value for module in (sections, modal, ambient, cyclic) for value in vars(module).values()]
    return sorted({name for part in parts for name in getattr(part, "model_fields", {})})


KEYS = known_keys()


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


def strange(rng):
    """A value of any kind."""
    return copy.deepcopy(pick(pick([NUMBERS, NUMBERS, NAMES, OTHERS], rng), rng))


def other_value(table, rng):
    above, at = place(table, rng, pick([object, int | float, str], rng))
    above[at] = strange(rng)


def near_number(table, rng):
    """Of the same kind, some way off."""
    above, at = place(table, rng, int | float)
    if isinstance(above[at], int):
        above[at] += int(rng.choice([-1, 1, 2, 10, 1000]))
    elif isinstance(above[at], float):
        above[at] *= float(rng.choice([-1.0, 0.0, 0.5, 2.0, 10.0, 1e3, 1e-3, 1e9, 1e-9, 1e150]))


def removed(table, rng):
    above, at = place(table, rng, pick([object, list], rng))
    if isinstance(above[at], list) and above[at]:
        above[at].pop()
    else:
        del above[at]


def renamed(table, rng):
    above, at = place(table, rng)
    if isinstance(above, dict):
        above[pick([*NAMES, *KEYS, at[:-1], at.upper()], rng)] = above.pop(at)


def added(table, rng):
    tables = [table, *(above[at] for above, at in places(table) if isinstance(above[at], dict))]
    pick(tables, rng)[pick([*KEYS, *KEYS, *NAMES], rng)] = strange(rng)


def moved(table, rng):
    """What stands in another place, of the same kind or not."""
    kind = pick([object, str], rng)
    (above, at), (other, there) = place(table, rng, kind), place(table, rng, kind)
    above[at] = copy.deepcopy(other[there])


def nested(table, rng):
    above, at = place(table, rng)
    if rng.random() < 0.5:
        above[at] = [above[at]] * int(rng.choice([1, 2, 3, 100]))
        return
    for _ in range(int(rng.choice([1, 5, 50, 150]))):
        above[at] = {"a": above[at]} if rng.random() < 0.5 else [above[at]]


def other_prior(table, rng):
    priors, name = table.get("priors"), pick(list(DISTRIBUTIONS), rng)
    if isinstance(priors, dict) and priors:
        known = arguments_of(name)
        arguments = {pick(known, rng): odd_number(rng) for _ in range(int(rng.integers(5))) if known}
        priors[pick(list(priors), rng)] = {"distribution": name, **arguments}


def odd_number(rng):
    """Most often an argument that a distribution may have."""
    return strange(rng) if rng.random() < 0.3 else float(rng.choice([0.1, 1.0, 5.0, -1.0, 1e-9, 1e9]))


CHANGES = (
    *(other_value, other_value, other_value, removed, removed, renamed, added, moved, nested),
    *(near_number, near_number, near_number, other_prior, other_prior, other_prior),
)


def as_toml(table: dict) -> str:
    """A parsed file as text again, each section in a line of its own."""
    lines = []
    for name, value in table.items():
        if isinstance(value, dict) and value and not isinstance(value, Text):
            lines += ["", f"[{key_text(name)}]", *(f"{key_text(k)} = {text_of(v)}" for k, v in value.items())]
        else:
            lines.insert(0, f"{key_text(name)} = {text_of(value)}")
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
            return f"{{{', '.join(f'{key_text(k)} = {text_of(v)}' for k, v in value.items())}}}"
        case datetime.date() | datetime.time():
            return value.isoformat()
    return str(value) if isinstance(value, int) else repr(value)


def key_text(name) -> str:
    """A key, quoted where it must be."""
    plain = name.isascii() and name.replace("_", "").replace("-", "").isalnum()
    return name if plain else quoted(name)


def quoted(text) -> str:
    """A string in TOML."""
    escaped = (c if c.isprintable() and c not in '"\\' else f"\\u{ord(c):04x}" for c in text)
    return f'"{"".join(escaped)}"'
