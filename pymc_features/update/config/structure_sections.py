"""The section [structure]: one class for each structure of the package, and for each kind of damping."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, Discriminator, Field, PlainValidator, Tag

from pymc_features.update.config.entries import Entry, MatrixEntry, Terms, Vector, matrix
from pymc_features.update.config.sections import Section

ONE = "a number, the name of a prior, or {prior = NAME, times = NUMBER}"
ONE_OR_MORE = f"{ONE}, or a list of these"
A_MATRIX = "a file with matrices, {file = FILE, name = NAME}, or rows of numbers"


def parameter(unit, default=..., words=ONE_OR_MORE):
    """A key that may be random, with its unit."""
    return Field(default, description=f"{words}, in {unit}", json_schema_extra={"unit": unit})


class RayleighSection(Section):
    """C = alpha M + beta K."""

    type: Literal["RayleighDamping"]
    alpha: Entry = parameter("1/s", words=ONE)
    beta: Entry = parameter("s", words=ONE)


class ModalSection(Section):
    """A ratio for each mode."""

    type: Literal["ModalDamping"]
    ratios: Vector = parameter("-")


DAMPINGS = {"RayleighDamping": RayleighSection, "ModalDamping": ModalSection}
Damping = Annotated[RayleighSection | ModalSection, Field(discriminator="type")]


def damping_kind(value):
    """Which of the dampings, or a matrix C."""
    if isinstance(value, dict) and "type" in value:
        return value["type"]
    return "matrix" if isinstance(value, dict | list) else getattr(value, "type", None)


DampingOrMatrix = Annotated[
    Annotated[RayleighSection, Tag("RayleighDamping")]
    | Annotated[ModalSection, Tag("ModalDamping")]
    | Annotated[Any, PlainValidator(matrix), Tag("matrix")],
    Discriminator(damping_kind),
]


class ChainSection(Section):
    """What chains have in common."""

    mass: Vector = parameter("kg")
    stiffness: Vector = parameter("N/m")
    damping: Damping = Field(description="a table with `type`, RayleighDamping or ModalDamping")


class SpringMassSection(ChainSection):
    """Linear springs."""

    type: Literal["SpringMassChain"]


class HystereticSection(ChainSection):
    """Bouc-Wen springs."""

    type: Literal["HystereticChain"]
    yield_displacement: Vector = parameter("m")
    post_yield_ratio: Vector = parameter("-")
    sharpness: Vector = parameter("-", 2.0)
    beta: Vector = parameter("-", 0.5)
    gamma: Vector = parameter("-", 0.5)


class DuffingSection(ChainSection):
    """Cubic springs."""

    type: Literal["DuffingChain"]
    cubic: Vector = parameter("N/m^3")


class MatrixSection(Section):
    """What structures given by matrices have in common."""

    mass: MatrixEntry = Field(description=A_MATRIX)
    stiffness: MatrixEntry = Field(description=A_MATRIX)
    damping: DampingOrMatrix = Field(
        description=f"a table with `type`, RayleighDamping or ModalDamping, or {A_MATRIX}"
    )
    influence: MatrixEntry | None = Field(None, description=A_MATRIX)
    n_modes: int | None = Field(None, description="the number of modes kept, positive", ge=1)


class LinearSection(MatrixSection):
    """Constant matrices; only damping coefficients can be random."""

    type: Literal["LinearStructure"]


class AffineSection(MatrixSection):
    """K_0 + sum theta_i K_i."""

    type: Literal["AffineStructure"]
    theta: Vector = parameter("-")
    stiffness_terms: Terms = Field([], description="a list of matrices, {} where a parameter does not act")
    mass_terms: Terms = Field([], description="a list of matrices, {} where a parameter does not act")
    damping_terms: Terms = Field([], description="a list of matrices, {} where a parameter does not act")


STRUCTURES: dict[str, type[BaseModel]] = {
    "SpringMassChain": SpringMassSection,
    "LinearStructure": LinearSection,
    "AffineStructure": AffineSection,
    "HystereticChain": HystereticSection,
    "DuffingChain": DuffingSection,
}
StructureSection = Annotated[
    SpringMassSection | LinearSection | AffineSection | HystereticSection | DuffingSection,
    Field(discriminator="type"),
]
