"""The section [modal]: modes that were identified, and where on the structure."""

from typing import Literal

from pydantic import model_validator

from pymc_features.update.config.entries import Vector
from pymc_features.update.config.sections import Names, Section, key
from pymc_features.update.config.structure_sections import STRUCTURES

SCALE = "the name of a prior or a number, one or one for each mode"


class Modal(Section):
    """Which modes were identified, where on the structure, and how well the model is to meet them."""

    file: str | None = key("a file with identified modes", None)
    files: list[str] | None = key("a list of files, two or more, one for each set-up", None, min_length=2)
    references: Names | None = key("the names of the channels that several set-ups have", None)
    names: dict[str, str] | None = key(
        "a table of quantities to what the files call them, such as omega or damping_percent", None
    )
    modes: list[int] | None = key("a list of numbers of modes in the file, 1 the first", None, min_length=1)
    channels: dict[str, int] | None = key(
        "a table of channel names to degrees of freedom, 0 next to the base", None, min_length=1
    )
    scale: dict[str, float] | None = key(
        "a table of channel names to factors, -1.0 for an inverted one", None
    )
    shapes: bool = key("true or false, whether shapes are compared", True)
    labels: list[str | int] | None = key(
        "a list with a name for each mode, equal for several identifications of one", None, min_length=1
    )
    n_modes: int | None = key("the number of modes of the structure to choose from, positive", None, ge=1)
    sigma_f: Vector = key(f"{SCALE}, the error of the model in ln f", json_schema_extra={"unit": "-"})
    sigma_phi: Vector | None = key(
        f"{SCALE}, the scale of the root of 1 - MAC", None, json_schema_extra={"unit": "-"}
    )
    density: Literal["EXP", "TN"] | float = key('"EXP", "TN" or degrees of freedom, positive', "EXP")
    nodes: str | None = key("a CSV file with columns dof or name, x, y, z", None)

    @model_validator(mode="after")
    def one_source(self):
        """One file, or several with references."""
        if (self.file is None) == (self.files is None):
            raise ValueError("must have one of the keys `file` and `files`, got both or neither")
        if self.references is not None and self.files is None:
            raise ValueError("must have `references` only with `files`, got them with `file`")
        if not self.shapes:
            for name in ("channels", "scale", "sigma_phi", "nodes", "density"):
                if name in self.model_fields_set:
                    raise ValueError(f"must have `{name}` only with shapes, got it with shapes = false")
        if isinstance(self.density, float) and self.density <= 0.0:
            raise ValueError(f"must have positive degrees of freedom as `density`, got {self.density:g}")
        return self


def with_damping(raw):
    """The tables of a file; where only modes are compared a structure needs no damping, which moves none."""
    if not isinstance(raw, dict) or "data" in raw:
        return raw
    structure = raw.get("structure")
    if not isinstance(structure, dict) or "damping" in structure:
        return raw
    section = STRUCTURES.get(structure["type"]) if isinstance(structure.get("type"), str) else None
    if section is None or not section.model_fields["damping"].is_required():
        return raw
    return raw | {"structure": structure | {"damping": {"type": "ModalDamping", "ratios": 0.0}}}
