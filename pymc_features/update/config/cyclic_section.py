"""The section [cyclic]: displacement and force of a cyclic test, which stand for measured responses."""

from typing import Annotated, Any

from pydantic import PlainValidator

from pymc_features._checks import is_number
from pymc_features.exceptions import ConfigError
from pymc_features.io.reading.labels import FORCES, LENGTHS
from pymc_features.update.config.messages import shown
from pymc_features.update.config.sections import Section, key
from pymc_features.update.config.structure_sections import SPECIMENS

LENGTH_OR_FORCE = f"two units, of displacement ({', '.join(LENGTHS)}) and of force ({', '.join(FORCES)})"
UNITS = {"sigma": "N"}  # of the errors, where they are not those of an acceleration


def pair_of(accepts, words):
    """A list of two values, for displacement and force."""

    def pair(value):
        if not (isinstance(value, list) and len(value) == 2 and all(map(accepts, value))):
            raise ValueError(f"must be {words}, got {shown(value)}")
        return value

    return Annotated[Any, PlainValidator(pair)]


class Cyclic(Section):
    """A table with both, or one of each."""

    files: str | list[str] = key("a file, or a list of two, of the displacement and of the force")
    columns: (
        pair_of(lambda v: type(v) in (int, str), "two columns, by index from 0 or header name") | None
    ) = key("two columns, of displacement and force, by index from 0 or header name", None)
    units: pair_of(lambda v: isinstance(v, str) or is_number(v), LENGTH_OR_FORCE) | None = key(
        f"{LENGTH_OR_FORCE}, or m and N per file unit", None
    )
    skip: int = key("the number of rows to leave out at the start, not negative", 0, ge=0)
    wrapped: bool | None = key("true if one series runs along the lines, else false", None)


def check_cyclic(config) -> None:
    """A specimen and a cyclic test belong together, and other sections say nothing that means nothing.

    Raises
    ------
    ConfigError
        If one does; the message names the key.
    """
    is_specimen = config.structure.type in SPECIMENS
    if config.cyclic is None:
        if is_specimen:
            raise ConfigError(
                f"`cyclic` must be given for a {config.structure.type}: a table with the files of "
                "displacement and force."
            )
        return
    if not is_specimen:
        raise ConfigError(
            f"`structure.type` must be {' or '.join(SPECIMENS)} with [cyclic], got {config.structure.type}. "
            "Its displacement is prescribed."
        )
    for name in ("data", "record", "processing", "events", "modal", "ambient"):
        if name in config.model_fields_set:
            raise ConfigError(
                f"`{name}` must be left out with [cyclic], got it. Displacement and force are all there is."
            )
    for name in ("natural_frequencies", "quantities"):
        if name in config.report.model_fields_set:
            raise ConfigError(f"`report.{name}` must be left out with [cyclic], got it. There is no motion.")
    if config.likelihood is None:
        raise ConfigError("`likelihood` must be given with [cyclic]: a table.")
