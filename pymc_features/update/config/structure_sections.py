"""The section [structure]: one class for each structure of the package, made of the inputs that it states."""

import inspect
from typing import Annotated, Any, Literal, Union

from pydantic import Discriminator, Field, PlainValidator, Tag, create_model

from pymc_features import structures
from pymc_features.structures import Input, Kind, Structure
from pymc_features.structures.specimens import DETERIORATIONS
from pymc_features.structures.specimens import SPECIMENS as KINDS_OF_SPECIMENS
from pymc_features.update.config.entries import Entry, MatrixEntry, Terms, matrix
from pymc_features.update.config.sections import Section
from pymc_features.update.config.storeys import GROUPS, TAPER, ByStorey, Grouped

ONE = "a number, the name of a prior, or {prior = NAME, times = NUMBER}"
A_MATRIX = "a file with matrices, {file = FILE, name = NAME}, or rows of numbers"

#: Type and words of the keys of each kind; those of dampings follow below.
TYPES: dict[Kind, tuple[Any, str]] = {
    Kind.SCALAR: (Entry, ONE),
    Kind.VECTOR: (Grouped, f"{ONE}, or a list of these, or {GROUPS}"),
    Kind.MATRIX: (MatrixEntry, A_MATRIX),
    Kind.MATRICES: (Terms, "a list of matrices, {} where a parameter does not act"),
}


BY_STOREY = ByStorey, f"{ONE}, or a list of these, {GROUPS} or {TAPER}"


def section_of(cls) -> type[Section]:
    """The keys of a structure or damping: its type and its inputs, with the defaults of its signature."""
    has_storeys = issubclass(cls, Structure) and cls.has_storeys
    fields: dict[str, Any] = {"type": (Literal[cls.__name__], ...)} | inputs_of(cls, has_storeys)
    if has_storeys:
        fields["n"] = int | None, Field(None, description="the number of storeys, positive", ge=1)
    if issubclass(cls, Structure) and cls.is_linear:
        words = "the number of modes kept, positive"
        fields["n_modes"] = int | None, Field(None, description=words, ge=1)
    if any(given.kind is Kind.MATRIX for given in cls.inputs.values()):
        words = 'a force, a length and a mass, such as "kN, m, t", in which the matrices are'
        fields["units"] = str, Field("N, m, kg", description=words)
    return made(cls, fields)


def part_of(cls) -> type[Section]:
    """The keys of what a structure has one kind of: its inputs, without a type."""
    return made(cls, {"type": (Literal[cls.__name__], cls.__name__)} | inputs_of(cls))


def inputs_of(cls, has_storeys=False) -> dict[str, Any]:
    """Types and fields of the inputs of a class."""
    signature, fields = inspect.signature(cls).parameters, {}
    for name, given in cls.inputs.items():
        default = signature[name].default
        must = given.required or default is inspect.Parameter.empty
        words = BY_STOREY if has_storeys and given.kind is Kind.VECTOR else TYPES[given.kind]
        fields[name] = key_of(words, given, ... if must else default)
    return fields


def made(cls, fields) -> type[Section]:
    """A section of some keys."""
    summary = inspect.getdoc(cls).partition("\n")[0]
    return create_model(f"{cls.__name__}Section", __base__=Section, __doc__=summary, **fields)


def key_of(type_and_words, given: Input, default) -> tuple:
    """Type and field of one key; what may be random has its unit."""
    kind, words = type_and_words
    if given.kind in (Kind.SCALAR, Kind.VECTOR):
        unit = {"unit": given.unit}
        return kind, Field(default, description=f"{words}, in {given.unit}", json_schema_extra=unit)
    return (kind | None if default is None else kind), Field(default, description=words)


def damping_kind(value):
    """Which of the dampings, or a matrix C."""
    if isinstance(value, dict) and "type" in value:
        return value["type"]
    return "matrix" if isinstance(value, dict | list) else getattr(value, "type", None)


DAMPINGS = {cls.__name__: section_of(cls) for cls in structures.DAMPINGS}
A_DAMPING = f"a table with `type`, {' or '.join(DAMPINGS)}"
TYPES[Kind.DAMPING] = (
    Annotated[Union[tuple(DAMPINGS.values())], Field(discriminator="type")],  # noqa: UP007
    A_DAMPING,
)
OR_MATRIX = [
    *(Annotated[section, Tag(name)] for name, section in DAMPINGS.items()),
    Annotated[Any, PlainValidator(matrix), Tag("matrix")],
]
TYPES[Kind.DAMPING_OR_MATRIX] = (
    Annotated[Union[tuple(OR_MATRIX)], Discriminator(damping_kind)],  # noqa: UP007
    f"{A_DAMPING}, or {A_MATRIX}",
)
STRUCTURES = {cls.__name__: section_of(cls) for cls in structures.STRUCTURES}
for kind, cls in zip((Kind.DEGRADATION, Kind.PINCHING), DETERIORATIONS, strict=True):
    TYPES[kind] = part_of(cls), f"a table with {', '.join(f'`{name}`' for name in cls.inputs)}"
SPECIMENS = {cls.__name__: section_of(cls) for cls in KINDS_OF_SPECIMENS}
StructureSection = Annotated[
    Union[*STRUCTURES.values(), *SPECIMENS.values()],  # noqa: UP007
    Field(discriminator="type"),
]
