"""The configuration file: TOML, validated, every name in it looked up."""

import keyword
from pathlib import Path

from pydantic import ValidationError, create_model, model_validator

from pymc_features.exceptions import ConfigError
from pymc_features.update.config import sections
from pymc_features.update.config.entries import units_in
from pymc_features.update.config.keys import check_keys, parsed, sentence, shown
from pymc_features.update.config.priors import Prior
from pymc_features.update.config.structures import SPECIMENS, StructureSection, with_damping
from pymc_features.update.kinds import KINDS_OF_DATA
from pymc_features.update.predictions import Predict

A_STRUCTURE = "a table with `type`, the name of a structure"
TAKEN = {"y", "chain", "draw", "sensor", "time", "sample", "mode", "modal", "modal_mode", "modal_entry"}


class File(sections.Section):
    """The sections that every file may have."""

    record: sections.RecordFile | None = sections.key("a table", None)
    processing: sections.Processing = sections.key("a table", sections.Processing())
    structure: StructureSection | None = sections.key(A_STRUCTURE, None)
    priors: dict[str, Prior] = sections.key("a table of priors, one or more", min_length=1)
    likelihood: sections.Likelihood | None = sections.key("a table", None)
    sampler: sections.Sampler = sections.key("a table", sections.Sampler())
    predict: list[Predict] = sections.key("a list of tables, each [[predict]]", [])
    compare: dict[str, sections.Candidate] = sections.key("a table of candidates, each [compare.NAME]", {})
    hierarchical: sections.Hierarchical | None = sections.key("a table", None)
    sensitivity: sections.Sensitivity | None = sections.key("a table", None)
    report: sections.Report = sections.key("a table", sections.Report())

    complete = model_validator(mode="before")(with_damping)

    def uses(self) -> dict[str, list[tuple[str, str]]]:
        """Names of priors to (key, unit) of every place where they are used, in the order of use."""
        places = [] if self.structure is None else list(sections.parameters_of("structure", self.structure))
        for name in type(self).model_fields:
            places += getattr(getattr(self, name), "parameters", lambda config: ())(self)
        found: dict[str, dict[tuple[str, str], None]] = {}
        for key, of_key, value in places:
            for name, unit in units_in(value, of_key):
                found.setdefault(name, {})[key, unit] = None
        return {name: list(pairs) for name, pairs in found.items()}


Config = create_model(
    "Config",
    __base__=File,
    __doc__="The whole file.",
    **{kind.key: (kind.section | None, sections.key("a table", None)) for kind in KINDS_OF_DATA},
)


def read_config(path) -> tuple[File, dict]:
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
    raw = parsed(path)
    try:
        return validated(raw), raw
    except ConfigError as error:
        raise ConfigError(f"{path.name}: {error}") from error


def validated(raw: dict, *, prune: bool = False) -> File:
    """The configuration of a parsed file; with `prune` priors that nothing uses are no error."""
    check_keys(raw)
    try:
        config = Config.model_validate(raw)
    except ValidationError as error:
        raise ConfigError(sentence(error, raw)) from error
    check_sources(config)
    check_names(config, prune)
    return config


def check_sources(config: File) -> None:
    """There is something to compare with, and no section that it does not need."""
    if config.structure is None and config.external is None:
        raise ConfigError(f"`structure` must be given: {A_STRUCTURE}.")
    if config.structure is not None and config.structure.type in SPECIMENS and config.cyclic is None:
        raise ConfigError(
            f"`cyclic` must be given for a {config.structure.type}: a table with the files of "
            "displacement and force."
        )
    asked = [kind for kind in KINDS_OF_DATA if kind.is_asked(config)]
    if config.ambient is not None and all(kind.key != "ambient" for kind in asked):
        raise ConfigError('`ambient` must be left out without `data.excitation = "ambient"`, got it.')
    for kind in asked:
        kind.check_sections(config)
    if not asked:
        raise ConfigError(
            "`data` must be given: a table with the files of measured responses. Or give identified modes in "
            "[modal]."
        )


def check_names(config: File, prune: bool) -> None:
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
        if name not in used and not prune:
            raise ConfigError(
                f"`priors.{name}` must be used by the structure or a likelihood, it is nowhere. Use it or "
                "remove it."
            )
    if not any(key.startswith(("structure", "external")) for places in used.values() for key, _ in places):
        raise ConfigError(
            "`structure` must have a parameter that is the name of a prior, got numbers only. There is "
            "nothing to update."
        )
