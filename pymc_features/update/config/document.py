"""The configuration file: TOML, validated, every name in it looked up."""

import keyword
import tomllib
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from pymc_features.exceptions import ConfigError
from pymc_features.update.config.ambient_section import Ambient, check_ambient
from pymc_features.update.config.cyclic_section import UNITS as CYCLIC_UNITS
from pymc_features.update.config.cyclic_section import Cyclic, check_cyclic
from pymc_features.update.config.entries import units_in
from pymc_features.update.config.events_section import Events, check_events
from pymc_features.update.config.messages import sentence, shown
from pymc_features.update.config.modal_section import Modal, with_damping
from pymc_features.update.config.sections import (
    ERRORS,
    MEASURED,
    SIGMA,
    Data,
    Likelihood,
    Processing,
    RecordFile,
    Report,
    Sampler,
    Section,
)
from pymc_features.update.config.sizes import check_sizes
from pymc_features.update.config.structure_sections import StructureSection

OF_MODES = {"modal", "modal_mode", "modal_entry"}
TAKEN = {"y", "chain", "draw", "sensor", "time", "sample", "mode", *OF_MODES}
OF_RESPONSES = ("record", "processing", "likelihood")  # sections that mean nothing without [data]


class PriorSection(BaseModel):
    """A prior: its distribution, and the distribution's own arguments besides."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True)
    distribution: str = Field(description="the name of a continuous distribution of PyMC")

    @property
    def arguments(self) -> dict:
        """Names of arguments to values."""
        return dict(self.model_extra)


class Config(Section):
    """The whole file."""

    data: Data | None = Field(None, description="a table")
    events: Events | None = Field(None, description="a table")
    modal: Modal | None = Field(None, description="a table")
    ambient: Ambient | None = Field(None, description="a table")
    cyclic: Cyclic | None = Field(None, description="a table")
    record: RecordFile | None = Field(None, description="a table")
    processing: Processing = Field(Processing(), description="a table")
    structure: StructureSection = Field(description="a table with `type`, the name of a structure")
    priors: dict[str, PriorSection] = Field(description="a table of priors, one or more", min_length=1)
    likelihood: Likelihood | None = Field(None, description="a table")
    sampler: Sampler = Field(Sampler(), description="a table")
    report: Report = Field(Report(), description="a table")

    @model_validator(mode="before")
    @classmethod
    def complete(cls, raw):
        """What a file may leave out, and the others imply."""
        return with_damping(raw)

    def uses(self) -> dict[str, list[tuple[str, str]]]:
        """Names of priors to (key, unit) of every place where they are used, in the order of use."""
        places = list(parameters_of("structure", self.structure))
        if self.likelihood is not None:
            asked = self.likelihood
            taken = dict(pair for kind in asked.kinds for pair in asked.parameters_of(kind))
            units = ERRORS | (CYCLIC_UNITS if self.cyclic is not None else {})
            if self.data is not None:
                units = units | {"sigma": SIGMA[MEASURED[self.data.quantity]]}
            places += [(f"likelihood.{name}", units[name], value) for name, value in taken.items()]
        if self.modal is not None:
            places += parameters_of("modal", self.modal)
        if self.ambient is not None:
            places += self.ambient.parameters()
        found: dict[str, list[tuple[str, str]]] = {}
        for key, of_key, value in places:
            for name, unit in units_in(value, of_key):
                listed = found.setdefault(name, [])
                if (key, unit) not in listed:
                    listed.append((key, unit))
        return found


def parameters_of(key, section):
    """Key, unit and value of every entry of a section that may be random."""
    for name, field in type(section).model_fields.items():
        value = getattr(section, name)
        if isinstance(value, Section):
            yield from parameters_of(f"{key}.{name}", value)
        elif isinstance(field.json_schema_extra, dict) and "unit" in field.json_schema_extra:
            yield f"{key}.{name}", field.json_schema_extra["unit"], value


def read_config(path) -> tuple[Config, dict]:
    """Read and validate a configuration file.

    Parameters
    ----------
    path : path
        TOML; the example of `write_example` shows every section.

    Returns
    -------
    Config, dict
        The configuration, and the file as it was parsed.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ConfigError
        If it is not TOML, a key is unknown, missing or out of its range, or a name refers to nothing.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(
            f"`CONFIG` must be an existing file, got {path}. `pymc-features init` writes an example."
        )
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
        check_sizes(raw)
    except ConfigError as error:
        raise ConfigError(f"{path.name}: {error}") from error
    except RecursionError:
        raise ConfigError(f"{path.name} must be a TOML file: lists in it are nested too deeply.") from None
    except ValueError as error:  # of TOML, of its encoding, or of a number with thousands of digits
        reason = str(error).partition(";")[0].rstrip(".")
        raise ConfigError(f"{path.name} must be a TOML file: {reason}.") from error
    try:
        config = Config.model_validate(raw)
    except ValidationError as error:
        raise ConfigError(f"{path.name}: {sentence(error, raw, Config)}") from error
    try:
        check_sources(config)
        check_names(config)
    except ConfigError as error:
        raise ConfigError(f"{path.name}: {error}") from error
    return config, raw


def check_sources(config: Config) -> None:
    """There is something to compare with, and no section that it does not need."""
    check_cyclic(config)
    if config.cyclic is not None:
        return
    if config.events is not None and (config.data is None or config.data.excitation == "measured"):
        check_events(config)
    elif config.data is not None and config.data.files is None and config.data.dataset is None:
        raise ConfigError(
            "`data` must have one of the keys `files` and `dataset`, got neither. Or name several events in "
            "[events]."
        )
    if config.data is None and config.modal is None:
        raise ConfigError(
            "`data` must be given: a table with the files of measured responses. Or give identified modes in "
            "[modal]."
        )
    is_ambient = config.data is not None and config.data.excitation == "ambient"
    if config.ambient is not None and not is_ambient:
        raise ConfigError('`ambient` must be left out without `data.excitation = "ambient"`, got it.')
    if is_ambient:
        check_ambient(config)
        return
    if config.data is None:
        for name in OF_RESPONSES:
            if name in config.model_fields_set:
                raise ConfigError(
                    f"`{name}` must be left out without [data], got it. Identified modes need none."
                )
        for name in ("natural_frequencies", "quantities"):
            if name in config.report.model_fields_set:
                raise ConfigError(
                    f"`report.{name}` must be left out without [data], got it. The report "
                    "has the frequencies of [modal], and no responses."
                )
        return
    if config.likelihood is None:
        raise ConfigError("`likelihood` must be given with [data]: a table.")
    if config.modal is not None and "ABC" in config.likelihood.kinds:
        raise ConfigError(
            "`likelihood.kinds` must not have ABC with [modal], for a tolerance on responses says nothing of "
            "modes. Leave one of them out."
        )
    if config.data.base is None and config.record is None:
        raise ConfigError(
            "`data.base` must name the sensor on the base, got none. Or give the ground motion in [record]."
        )
    if config.data.base is not None and config.record is not None:
        raise ConfigError("`record` must be left out with `data.base`, got both. One motion of the base.")


def check_names(config: Config) -> None:
    """Every name of a prior refers to one, every prior is used, and can be a variable's name."""
    for name in config.priors:
        if not name.isidentifier() or keyword.iskeyword(name) or name in TAKEN:
            raise ConfigError(
                f"`priors.{name}` must have a name of letters, digits and underscores that is not taken "
                f"({', '.join(sorted(TAKEN))}). Rename it."
            )
    used = config.uses()
    for name, places in used.items():
        if name not in config.priors:
            raise ConfigError(
                f"`{places[0][0]}` must name priors of the file, got {shown(name)}. Add it to [priors], or "
                "write a number."
            )
    for name in config.priors:
        if name not in used:
            raise ConfigError(
                f"`priors.{name}` must be used by the structure or a likelihood, it is nowhere. Use it or "
                "remove it."
            )
    structural = [p for p, places in used.items() if any(k.startswith("structure") for k, _ in places)]
    if not structural:
        raise ConfigError(
            "`structure` must have a parameter that is the name of a prior, got numbers only. There is "
            "nothing to update."
        )
