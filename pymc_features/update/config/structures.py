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
from pymc_features.structures import AffineStructure, Input, Kind, Structure, specimens
from pymc_features.update.config import entries
from pymc_features.update.config.entries import GROUPS, ONE, TAPER, Matrix, Taper, evaluated, key, priors_in
from pymc_features.update.config.keys import named_key
from pymc_features.update.config.sections import Section

MOST_MODES = 10
CATALOGUE = {cls.__name__: cls for cls in (*structures.STRUCTURES, *specimens.SPECIMENS)}
PARTS = {cls.__name__: cls for cls in (*structures.DAMPINGS, *specimens.DETERIORATIONS)}
A_MATRIX = "a file with matrices, {file = FILE, name = NAME}, or rows of numbers"
SYSTEM = 'a force, a length and a mass, such as "kN, m, t", in which the matrices are'
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
    is_part = cls in specimens.DETERIORATIONS  # of which a structure has one kind: its type is known
    is_structure = issubclass(cls, Structure)
    has_storeys = is_structure and cls.has_storeys
    fields: dict[str, Any] = {"type": (Literal[cls.__name__], cls.__name__ if is_part else ...)}
    signature = inspect.signature(cls).parameters
    for name, given in cls.inputs.items():
        default = signature[name].default
        default = ... if given.required or default is inspect.Parameter.empty else default
        kind, words = BY_STOREY if has_storeys and given.kind is Kind.VECTOR else TYPES[given.kind]
        if given.kind in (Kind.SCALAR, Kind.VECTOR):  # what may be random has its unit
            field = key(f"{words}, in {given.unit}", default, given.unit)
        else:
            kind, field = kind | None if default is None else kind, key(words, default)
        fields[name] = kind, field
    if has_storeys:
        fields["n"] = int | None, key("the number of storeys, positive", None, ge=1)
    if is_structure and cls.is_linear:
        fields["n_modes"] = int | None, key("the number of modes kept, positive", None, ge=1)
    if any(given.kind is Kind.MATRIX for given in cls.inputs.values()):
        fields["units"] = str, key(SYSTEM, "N, m, kg")
    summary = inspect.getdoc(cls).partition("\n")[0]
    return create_model(f"{cls.__name__}Section", __base__=Section, __doc__=summary, **fields)


def damping_kind(value):
    """Which of the dampings, or a matrix C."""
    if isinstance(value, dict) and "type" in value:
        return value["type"]
    return "matrix" if isinstance(value, dict | list) else getattr(value, "type", None)


DAMPINGS = {cls.__name__: section_of(cls) for cls in structures.DAMPINGS}
A_DAMPING = f"a table with `type`, {' or '.join(DAMPINGS)}"
TAGGED = [Annotated[section, Tag(name)] for name, section in DAMPINGS.items()]
TYPES[Kind.DAMPING] = Annotated[Union[*DAMPINGS.values()], Field(discriminator="type")], A_DAMPING  # noqa: UP007
TYPES[Kind.DAMPING_OR_MATRIX] = (
    Annotated[Union[*TAGGED, Annotated[entries.MatrixEntry, Tag("matrix")]], Discriminator(damping_kind)],
    f"{A_DAMPING}, or {A_MATRIX}",
)
STRUCTURES = {cls.__name__: section_of(cls) for cls in structures.STRUCTURES}
for kind, cls in zip((Kind.DEGRADATION, Kind.PINCHING), specimens.DETERIORATIONS, strict=True):
    TYPES[kind] = section_of(cls), f"a table with {', '.join(f'`{name}`' for name in cls.inputs)}"
SPECIMENS = {cls.__name__: section_of(cls) for cls in specimens.SPECIMENS}
StructureSection = Annotated[
    Union[*STRUCTURES.values(), *SPECIMENS.values()],  # noqa: UP007
    Field(discriminator="type"),
]


def with_damping(raw):
    """The tables of a file; where only modes are compared a structure needs no damping, which moves none."""
    structure = raw.get("structure") if isinstance(raw, dict) and "data" not in raw else None
    if not isinstance(structure, dict) or "damping" in structure:
        return raw
    if isinstance(raw.get("modal"), dict) and "sigma_zeta" in raw["modal"]:  # damping ratios are compared
        return raw
    section = STRUCTURES.get(structure["type"]) if isinstance(structure.get("type"), str) else None
    if section is None or not section.model_fields["damping"].is_required():
        return raw
    return raw | {"structure": structure | {"damping": {"type": "ModalDamping", "ratios": 0.0}}}


class StructureOf:
    """Values of the priors, by name, to a structure: random variables in a model, numbers of one draw.

    Its signature lists the names of the priors, so that `prediction.posterior_response` finds them. Files of
    matrices that the `section` of a file names are relative to `folder`.
    """

    def __init__(self, section, folder):
        self.section, self.type, self.title = section, CATALOGUE[section.type], section.type
        used = {at: list(priors_in(value)) for at, _, value in section.parameters("")}
        self.names = sorted({one.prior for priors in used.values() for one in priors})
        kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
        self.__signature__ = inspect.Signature([inspect.Parameter(name, kind) for name in self.names])
        self.has_modes = self.type not in specimens.SPECIMENS  # these have forces alone
        self.has_storeys = self.type.has_storeys
        self.n_modes = getattr(section, "n_modes", None)
        given = {name: getattr(section, name) for name in self.type.inputs}
        given |= spread_over_storeys(section, self.type.inputs) if self.has_storeys else {}
        units = getattr(section, "units", None)
        self.given = {
            name: in_si(loaded(value, f"structure.{name}", Path(folder)), name, units)
            for name, value in given.items()
        }
        items = [v for value in given.values() for v in (value if isinstance(value, list) else [value])]
        self.files = sorted({item.file for item in items if isinstance(item, Matrix)})
        is_damping_known = not any(priors for at, priors in used.items() if "damping" in at)
        self.is_kept, self.kept = self.type is AffineStructure and is_damping_known, None

    def __call__(self, **values):
        if self.kept is not None:
            return self.kept.with_parameters(evaluated(self.given["theta"], values))
        structure = self.type(**{name: built(value, values) for name, value in self.given.items()})
        self.kept = structure if self.is_kept else None
        return structure


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


def in_si(value, name: str, units: str | None):
    """Matrices, and lists of them, in kg, N/m and N s/m."""
    if value is None or units is None or name in ("influence", "theta") or isinstance(value, Section):
        return value
    with named_key("structure"):
        force, length, mass = system_of_units(units)
    factor = mass if name.startswith("mass") else force / length
    if factor == 1.0:
        return value
    if name.endswith("_terms"):
        return [in_si(item, name.removesuffix("_terms"), units) for item in value]
    return factor * (value if hasattr(value, "shape") else np.asarray(value, dtype=np.float64))


def loaded(value, at, folder):
    """A value of the file with matrices read."""
    if isinstance(value, list):
        return [loaded(item, f"{at}[{i}]", folder) for i, item in enumerate(value)]
    if not isinstance(value, Matrix):
        return value
    with named_key(at, path="file"):
        found = read_matrices(folder / value.file)
    name = next(iter(found)) if value.name is None and len(found) == 1 else value.name
    if name not in found:
        raise ConfigError(
            f"`{at}.name` must be one of the {', '.join(sorted(found))} of {value.file}, got {name!r}."
        )
    return found[name]


def spread_over_storeys(section, inputs: dict[str, Input]) -> dict:
    """Values of a section that are one for each storey, or one for all, by name."""
    given = {name: getattr(section, name) for name, of in inputs.items() if of.kind is Kind.VECTOR}
    sized = {name: value.times if isinstance(value, Taper) else value for name, value in given.items()}
    lengths = {name: len(value) for name, value in sized.items() if isinstance(value, list)}
    n = section.n or next(iter(lengths.values()), None)
    found = {}
    for name, value in given.items():
        length = lengths.get(name, n)
        if section.n is not None and length != n:
            raise ConfigError(
                f"`structure.{name}` must have one value or one for each of the n = {n} storeys, got "
                f"{length}. Groups add up to n."
            )
        found[name] = value
        if isinstance(value, Taper):
            if n is None:
                raise ConfigError(
                    f"`structure.{name}` must have a number of storeys to taper over, got neither `n` nor a "
                    "list of values. Add n = 42 to [structure]."
                )
            if n < 2 or length != n:
                what = f"{n} storey" if n < 2 else f"{length} values of `times` for {n} storeys"
                raise ConfigError(
                    f"`structure.{name}` must taper over two storeys or more, with one value of `times` for "
                    f"each or for all, got {what}."
                )
            found[name] = value.model_copy(update={"n": n})
        elif section.n is not None and not isinstance(value, list):
            found[name] = [value] * n
    return found
