"""What an argument of a structure or a damping may be in a file, for those who build them from one.

A class states its arguments in `inputs`; their defaults are those of its signature. `update.toml` is checked
against these statements, and its values are passed on by name.
"""

from enum import Enum
from typing import NamedTuple


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
    """One argument: its kind, its unit, and whether a file must give it though it has a default."""

    kind: Kind
    unit: str = "-"
    required: bool = False


def scalar(unit: str) -> Input:
    """A number that may be random."""
    return Input(Kind.SCALAR, unit)


def vector(unit: str, *, required: bool = False) -> Input:
    """One value for all or one for each, which may be random."""
    return Input(Kind.VECTOR, unit, required)


MATRIX = Input(Kind.MATRIX)
MATRICES = Input(Kind.MATRICES)
DAMPING = Input(Kind.DAMPING)
DAMPING_OR_MATRIX = Input(Kind.DAMPING_OR_MATRIX)
DEGRADATION = Input(Kind.DEGRADATION)
PINCHING = Input(Kind.PINCHING)
