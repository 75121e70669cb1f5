"""The configuration file, TOML, with everything it refers to, checked before anything is sampled."""

import hashlib
import json
import keyword
import warnings
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

from pydantic import ValidationError, create_model, model_validator

from pymc_features.exceptions import ConfigError, PriorWarning
from pymc_features.structures import Structure
from pymc_features.update.config import sections
from pymc_features.update.config.entries import units_in
from pymc_features.update.config.keys import check_keys, named_key, parsed, sentence, shown
from pymc_features.update.config.priors import Prior
from pymc_features.update.config.structures import (
    SPECIMENS,
    StructureOf,
    StructureSection,
    modes_of,
    with_damping,
)
from pymc_features.update.kinds import KINDS, KINDS_OF_DATA
from pymc_features.update.kinds.base import KindOfData, Verdict
from pymc_features.update.kinds.external import ProgramOf
from pymc_features.update.kinds.histories import Histories
from pymc_features.update.kinds.modal import Modal
from pymc_features.update.plausibility.findings import PriorModes, moved_mass, of_priors, prior_modes
from pymc_features.update.predictions import Predict, check_predictions

A_STRUCTURE = "a table with `type`, the name of a structure"
TAKEN = {"y", "chain", "draw", "sensor", "time", "sample", "mode", "modal", "modal_mode", "modal_entry"}
FIRST = 5  # natural frequencies in a sentence
#: Keys that change no draw, or, as the tolerance, those of ABC alone; an event is recognised by its data.
WITHOUT_EFFECT = (
    "report predict compare hierarchical sensitivity modal.nodes likelihood.kinds likelihood.epsilon "
    "sampler.cores external.cache events.folder events.pattern events.files"
)


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
        found: dict[str, dict[tuple[str, str], None]] = {}
        parts = [(name, getattr(self, name)) for name in ("structure", *type(self).model_fields)]
        of_parts = [part.parameters(key, self) for key, part in parts if isinstance(part, sections.Section)]
        for key, of_key, value in chain.from_iterable(of_parts):
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
    check_sections(config)
    check_names(config, prune)
    return config


def check_sections(config: File) -> None:
    """There is something to compare with, and no section that it does not need."""
    if config.structure is None and config.external is None:
        raise ConfigError(f"`structure` must be given: {A_STRUCTURE}.")
    if config.structure is not None and config.structure.type in SPECIMENS and config.cyclic is None:
        raise ConfigError(
            f"`cyclic` must be given for a {config.structure.type}: files of displacement and force."
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


@dataclass(frozen=True)
class Problem:
    """What is updated with what."""

    path: Path  # the configuration file
    text: str  # what it says
    config: Config  # the same, validated
    raw: dict  # the same, as it was parsed
    structure: StructureOf | ProgramOf  # values of the priors to a structure
    expected: Structure | Any  # that at the medians of the priors
    prior: PriorModes | None  # natural modes of draws of the priors; None without modes
    data: tuple[KindOfData, ...] = ()  # what was measured; the first decides what is sampled

    @property
    def folder(self) -> Path:
        """Files are relative to it."""
        return self.path.parent

    @property
    def priors(self) -> dict[str, Prior]:
        """Names to priors, in the order of the file."""
        return self.config.priors

    @property
    def first(self) -> KindOfData:
        """What decides which likelihoods are sampled."""
        return self.data[0]

    @property
    def shown(self) -> list[KindOfData]:
        """The data, and what was found in them and is only compared with the result."""
        return [one for data in self.data for one in (data, *data.beside)]

    @property
    def measured(self) -> Histories | None:
        """Excitation and responses; None where there is none of them."""
        return self.first if isinstance(self.first, Histories) else None

    @property
    def modal(self) -> Modal | None:
        """Identified modes; of ambient vibration those that the channels have."""
        return next((data for data in self.shown if isinstance(data, Modal)), None)

    def with_data(self, *data) -> "Problem":
        return replace(self, data=data)

    @property
    def kinds(self) -> list[str]:
        """Likelihoods in the order they are sampled: ABC may need EXP, and CAL what it calibrates."""
        asked = self.first.likelihoods
        kinds = dict.fromkeys([*asked, *filter(None, (KINDS[kind].calibrates for kind in asked))])
        return sorted(kinds, key=lambda kind: kind == "ABC" or bool(KINDS[kind].calibrates))

    @property
    def reported(self) -> list[str]:
        """Likelihoods of the report in their order: first those whose width the residuals decide."""
        return sorted(self.first.likelihoods, key=lambda kind: not KINDS[kind].calibrates)

    @property
    def units(self) -> dict[str, str]:
        """Names of the priors to their units, from where they are used."""
        uses = self.config.uses()
        return {name: uses[name][0][1] for name in self.priors}

    def verdict(self, result, kind: str) -> Verdict:
        found = [data.verdict(self, result, kind) for data in self.shown]
        return Verdict([s for one in found for s in one.sentences], all(one.explains for one in found))

    def settings(self) -> dict:
        """All that determines the draws, flat, for the folder they are kept in."""
        kept = {
            k: v for k, v in flattened(self.raw).items() if not k.startswith(tuple(WITHOUT_EFFECT.split()))
        }
        for data in self.data:
            kept |= data.prints()
        for file in self.structure.files:
            kept[f"{file}_sha256"] = hashlib.sha256((self.folder / file).read_bytes()).hexdigest()
        return json.loads(json.dumps(kept, default=str))

    @property
    def sentence(self) -> str:
        """Mass and first frequencies of the structure at the medians of the priors."""
        frequencies = modes_of(self.expected, FIRST).natural_frequencies[:FIRST]
        given = self.config.report.natural_frequencies
        beside = "" if given is None else f" (natural_frequencies: {', '.join(f'{f:.4g}' for f in given)} Hz)"
        return (
            f"structure: {self.expected.n_dof} degrees of freedom, {moved_mass(self.expected):.4g} kg that "
            "the base moves; natural frequencies at the medians of the priors: "
            f"{', '.join(f'{f:.4g}' for f in frequencies)} Hz{beside}"
        )


def model_of(config: Config, folder: Path) -> StructureOf | ProgramOf:
    """Values of the priors to a structure, or to what a program takes."""
    return StructureOf(config.structure, folder) if config.external is None else ProgramOf(config.external)


def flattened(table, prefix="") -> dict:
    """Dotted keys and values of a parsed file."""
    found = {}
    for name, value in table.items():
        found |= (
            flattened(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
        )
    return found


def read_problem(path) -> Problem:
    """Read a configuration file and everything it refers to.

    Parameters
    ----------
    path : path
        Of the configuration; other files are relative to its folder.

    Returns
    -------
    Problem

    Raises
    ------
    FileNotFoundError, ConfigError, DatasetUnavailableError
        Whatever is wrong with it; the message names the key.

    Warns
    -----
    PriorWarning
        If the priors expect what no structure has, or what the data contradict.
    ChannelWarning, ModalDataWarning
        If a channel or a mode is suspicious.
    """
    path = Path(path)
    config, raw = read_config(path)
    return problem_of(path, path.read_text(encoding="utf-8"), config, raw)


def problem_of(path: Path, text: str, config: Config, raw: dict) -> Problem:
    """A configuration with everything it refers to, as of `read_problem`."""
    structure, prior = model_of(config, path.parent), None
    with named_key("structure"):
        expected = structure(**{name: config.priors[name].median for name in structure.names})
        if structure.has_modes:
            draws = {name: config.priors[name].draw for name in structure.names}
            prior = prior_modes(structure, draws, expected, lambda one: modes_of(one, structure.n_modes))
    problem = Problem(path, text, config, raw, structure, expected, prior)
    if prior is not None:
        for sentence in of_priors(prior, problem.units):
            warnings.warn(sentence, PriorWarning, stacklevel=2)
    problem = problem.with_data(*(kind.read(problem) for kind in KINDS_OF_DATA if kind.is_asked(config)))
    check_predictions(config, structure)
    return problem
