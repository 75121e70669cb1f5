"""The section [structure]: a class for each structure of the package, and the structure that a file makes."""

import inspect
from pathlib import Path
from typing import Annotated, Any, Literal, Union

import numpy as np
from pydantic import Discriminator, Field, Tag, create_model

from pymc_features import structures
from pymc_features.exceptions import ConfigError
from pymc_features.io import read_matrices
from pymc_features.io.reading.labels import system_of_units
from pymc_features.structures import AffineStructure, Input, Kind, Structure
from pymc_features.structures import specimens as specimens_of
from pymc_features.update.config import entries
from pymc_features.update.config.entries import GROUPS, ONE, TAPER, Matrix, Taper, evaluated, priors_in
from pymc_features.update.config.keys import named_key
from pymc_features.update.config.sections import Section, parameters_of

MOST_MODES = 10
CATALOGUE = {cls.__name__: cls for cls in (*structures.STRUCTURES, *specimens_of.SPECIMENS)}
PARTS = {cls.__name__: cls for cls in (*structures.DAMPINGS, *specimens_of.DETERIORATIONS)}
A_MATRIX = "a file with matrices, {file = FILE, name = NAME}, or rows of numbers"
BY_STOREY = entries.ByStorey, f"{ONE}, or a list of these, {GROUPS} or {TAPER}"
#: Type and words of the keys of each kind; those of dampings follow below.
TYPES: dict[Kind, tuple[Any, str]] = {
    Kind.SCALAR: (entries.Entry, ONE),
    Kind.VECTOR: (entries.Grouped, f"{ONE}, or a list of these, or {GROUPS}"),
    Kind.MATRIX: (entries.MatrixEntry, A_MATRIX),
    Kind.MATRICES: (entries.Terms, "a list of matrices, {} where a parameter does not act"),
}


def section_of(cls) -> type[Section]:
    """The keys of a structure or a part of one: its type and its inputs, with the defaults of the class."""
    is_part = cls in specimens_of.DETERIORATIONS  # of which a structure has one kind: its type is known
    has_storeys = issubclass(cls, Structure) and cls.has_storeys
    fields: dict[str, Any] = {"type": (Literal[cls.__name__], cls.__name__ if is_part else ...)}
    signature = inspect.signature(cls).parameters
    for name, given in cls.inputs.items():
        default = signature[name].default
        default = ... if given.required or default is inspect.Parameter.empty else default
        kind, words = BY_STOREY if has_storeys and given.kind is Kind.VECTOR else TYPES[given.kind]
        fields[name] = key_of(kind, words, given, default)
    if has_storeys:
        fields["n"] = int | None, Field(None, description="the number of storeys, positive", ge=1)
    if issubclass(cls, Structure) and cls.is_linear:
        words = "the number of modes kept, positive"
        fields["n_modes"] = int | None, Field(None, description=words, ge=1)
    if any(given.kind is Kind.MATRIX for given in cls.inputs.values()):
        words = 'a force, a length and a mass, such as "kN, m, t", in which the matrices are'
        fields["units"] = str, Field("N, m, kg", description=words)
    summary = inspect.getdoc(cls).partition("\n")[0]
    return create_model(f"{cls.__name__}Section", __base__=Section, __doc__=summary, **fields)


def key_of(kind, words: str, given: Input, default) -> tuple:
    """Type and field of one key; what may be random has its unit."""
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
    Annotated[entries.MatrixEntry, Tag("matrix")],
]
TYPES[Kind.DAMPING_OR_MATRIX] = (
    Annotated[Union[tuple(OR_MATRIX)], Discriminator(damping_kind)],  # noqa: UP007
    f"{A_DAMPING}, or {A_MATRIX}",
)
STRUCTURES = {cls.__name__: section_of(cls) for cls in structures.STRUCTURES}
for kind, cls in zip((Kind.DEGRADATION, Kind.PINCHING), specimens_of.DETERIORATIONS, strict=True):
    TYPES[kind] = section_of(cls), f"a table with {', '.join(f'`{name}`' for name in cls.inputs)}"
SPECIMENS = {cls.__name__: section_of(cls) for cls in specimens_of.SPECIMENS}
StructureSection = Annotated[
    Union[*STRUCTURES.values(), *SPECIMENS.values()],  # noqa: UP007
    Field(discriminator="type"),
]


def with_damping(raw):
    """The tables of a file; where only modes are compared a structure needs no damping, which moves none."""
    structure = raw.get("structure") if isinstance(raw, dict) and "data" not in raw else None
    if not isinstance(structure, dict) or "damping" in structure:
        return raw
    section = STRUCTURES.get(structure["type"]) if isinstance(structure.get("type"), str) else None
    if section is None or not section.model_fields["damping"].is_required():
        return raw
    return raw | {"structure": structure | {"damping": {"type": "ModalDamping", "ratios": 0.0}}}


class StructureOf:
    """Values of the priors, by name, to a structure: random variables in a model, numbers of one draw.

    Its signature lists the names of the priors, so that `prediction.posterior_response` finds them.

    Parameters
    ----------
    section : Section
        [structure] of the file.
    folder : path
        Files of matrices are relative to it.
    """

    def __init__(self, section, folder):
        self.section, self.type, self.title = section, CATALOGUE[section.type], section.type
        used = {key: list(priors_in(value)) for key, _, value in parameters_of("", section)}
        self.names = sorted({one.prior for entries in used.values() for one in entries})
        kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
        self.__signature__ = inspect.Signature([inspect.Parameter(name, kind) for name in self.names])
        self.has_modes = self.type not in specimens_of.SPECIMENS  # these have forces alone
        self.has_storeys = self.type.has_storeys
        self.n_modes = getattr(section, "n_modes", None)
        storeys = spread_over_storeys(section, self.type.inputs) if self.has_storeys else {}
        self.given = {}
        for name in self.type.inputs:
            value = storeys.get(name, getattr(section, name))
            self.given[name] = in_si(loaded(value, f"structure.{name}", Path(folder)), name, section)
        items = [v for _, v in section for v in (v if isinstance(v, list) else [v])]
        self.files = sorted({item.file for item in items if isinstance(item, Matrix)})
        is_damping_known = not any(entries for key, entries in used.items() if "damping" in key)
        self.is_kept, self.kept = self.type is AffineStructure and is_damping_known, None

    def __call__(self, **values):
        """Return the structure."""
        if self.kept is not None:
            return self.kept.with_parameters(evaluated(self.given["theta"], values))
        structure = self.type(**{name: built(value, values) for name, value in self.given.items()})
        self.kept = structure if self.is_kept else None
        return structure

    def modes(self, structure):
        """The lowest modes of one of them."""
        return modes_of(structure, self.n_modes)


def modes_of(structure, n_modes):
    """The lowest modes of a structure; of one without storeys at most ten, if it has no number."""
    if structure.has_storeys:
        return structure.modes()
    return structure.modes(min(n_modes or MOST_MODES, structure.n_modes))


def built(value, values):
    """A damping, degradation or pinching as an object, anything else with values in place of names."""
    if isinstance(value, Section):
        part = PARTS[value.type]
        return part(**{name: evaluated(getattr(value, name), values) for name in part.inputs})
    return evaluated(value, values)


def in_si(value, name: str, section):
    """Matrices, and lists of them, in kg, N/m and N s/m."""
    if not hasattr(section, "units") or name in ("influence", "theta") or isinstance(value, Section):
        return value
    with named_key("structure"):
        force, length, mass = system_of_units(section.units)
    factor = mass if name.startswith("mass") else force / length
    if factor == 1.0 or value is None:
        return value
    if name.endswith("_terms"):
        return [item if item is None else in_si(item, name.removesuffix("_terms"), section) for item in value]
    return factor * (value if hasattr(value, "shape") else np.asarray(value, dtype=np.float64))


def loaded(value, key, folder):
    """A value of the file with matrices read."""
    if isinstance(value, list | tuple):
        return [loaded(item, f"{key}[{i}]", folder) for i, item in enumerate(value)]
    if not isinstance(value, Matrix):
        return value
    with named_key(key, path="file"):
        found = read_matrices(folder / value.file)
    if value.name is None and len(found) == 1:
        return next(iter(found.values()))
    if value.name not in found:
        raise ConfigError(
            f"`{key}.name` must be one of the matrices {', '.join(sorted(found))} of {value.file}, got "
            f"{value.name!r}."
        )
    return found[value.name]


def spread_over_storeys(section, inputs: dict[str, Input]) -> dict:
    """Values of a section that are one for each storey, or one for all, by name."""
    given = {name: getattr(section, name) for name, of in inputs.items() if of.kind is Kind.VECTOR}
    lengths = {name: length for name, value in given.items() if (length := length_of(value)) is not None}
    n = section.n if section.n is not None else next(iter(lengths.values()), None)
    for name, length in lengths.items():
        if section.n is not None and length != n:
            raise ConfigError(
                f"`structure.{name}` must have one value or one for each of the n = {n} storeys, got "
                f"{length}. Groups add up to n."
            )
    return {name: spread(name, value, n, section.n is not None) for name, value in given.items()}


def length_of(value) -> int | None:
    """How many storeys a value is for, None if it can be any number."""
    value = value.times if isinstance(value, Taper) else value
    return len(value) if isinstance(value, list | tuple) else None


def spread(name, value, n, every):
    """A taper over n storeys; one value n times if `every` is to have its own; anything else as it is."""
    if not isinstance(value, Taper):
        return [value] * n if every and not isinstance(value, list) else value
    if n is None:
        raise ConfigError(
            f"`structure.{name}` must have a number of storeys to taper over, got neither `n` nor a list of "
            "values. Add n = 42 to [structure]."
        )
    if n < 2 or length_of(value) not in (None, n):
        what = f"{n} storey" if n < 2 else f"{length_of(value)} values of `times` for {n} storeys"
        raise ConfigError(
            f"`structure.{name}` must taper over two storeys or more, with one value of `times` for each or "
            f"for all, got {what}."
        )
    return value.model_copy(update={"n": n})
