"""One structure in several events, one after another: [events], and what their sequence says."""

import hashlib
import json
import re
import warnings
from dataclasses import dataclass, field, fields
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
import xarray as xr
from pydantic import model_validator

from pymc_features import plots
from pymc_features._checks import listed
from pymc_features.events.sequence import states_in_sequence
from pymc_features.exceptions import ConfigError, StudyMismatchError
from pymc_features.update.config.entries import Positive
from pymc_features.update.config.keys import shown
from pymc_features.update.config.sections import Section, key
from pymc_features.update.kinds.base import declare, kinds_of, table
from pymc_features.update.kinds.channels import checked_dofs
from pymc_features.update.kinds.histories import WITH_EVIDENCE
from pymc_features.update.kinds.responses import Responses

FEWEST_DRAWS = 100  # to which a density is fitted
FOLDER = "sequence"  # beside the parts of an update
SCORES = ("event", "log score", "standard error", "of a structure unknown before", "probability of a change")
COLUMNS = ("likelihood", *SCORES, "")
UNTOLD = 10.0  # standard error of a log score from which on its draws are too few to tell it
CANNOT_BE_TOLD = "cannot be told"
MEANING = (
    "Log score: ln of the density that the events before predicted for the measurements of this one; beside "
    "it the same of a structure of which only the priors are known. Where that is the larger one by far, the "
    "structure has changed before the event, or something was wrong with its measurement; the posterior is "
    "then that of this event and those after it. A score cannot be told where hardly any draw of the "
    "events before explains the event: increase `draws` in [sampler]."
)


class EventsSection(Section):
    """Which events, and how the structure may have changed from one to the next."""

    folder: str | None = key("a folder with a file or a folder for each event, in order of their names", None)
    pattern: str | None = key('which names in `folder` are events, as "*.csv"', None)
    files: list[str] | None = key("a list of files or folders, one for each event", None, min_length=1)
    drift: dict[str, Positive] = key("a table of priors to deviations from event to event, positive", {})
    forgetting: float = key("a number above 0 and at most 1", 1.0, gt=0, le=1)
    change: float = key("a probability between 0 and 1", 0.005, gt=0, lt=1)

    @model_validator(mode="after")
    def one_source(self):
        if (self.folder is None) == (self.files is None):
            raise ValueError("must have one of the keys `folder` and `files`, got both or neither")
        if self.pattern is not None and self.folder is None:
            raise ValueError("must have `pattern` only with `folder`, got it with `files`")
        if self.files is not None and len(set(self.files)) < len(self.files):
            raise ValueError(f"must name each event once, got {shown(self.files)}")
        return self


@dataclass(frozen=True)
class Events(Responses):
    """Measured responses of several events, and besides those of the last of them."""

    events: dict[str, Responses] = field(default_factory=dict)  # by name, in their order

    key, section = "events", EventsSection
    refused = {"data.dataset": "with [events], got it. Name the files of each event."}

    @classmethod
    def is_asked(cls, config):
        return config.events is not None

    @classmethod
    def check_sections(cls, config):
        if config.data is None:
            raise ConfigError(
                "`events` must be left out without [data], got it. Events are measured responses; several "
                "tests of modes are rows of one table."
            )
        super().check_sections(config)
        if refused := [kind for kind in config.likelihood.kinds if kind not in WITH_EVIDENCE]:
            raise ConfigError(
                f"`likelihood.kinds` must not have {refused[0]} with [events], for its posterior cannot be "
                f"the prior of the next event. Take {', '.join(WITH_EVIDENCE)}."
            )
        asked = config.sampler
        if asked.method != "auto":
            raise ConfigError(f'`sampler.method` must be "auto" with [events], got {asked.method!r}.')
        if asked.draws < FEWEST_DRAWS:
            raise ConfigError(
                f"`sampler.draws` must be at least {FEWEST_DRAWS} with [events], got {asked.draws}. They are "
                "the prior of the next event."
            )
        if strangers := [name for name in config.events.drift if name not in config.priors]:
            got = f"{shown(strangers[0])}. Known here: {', '.join(config.priors)}"
            raise ConfigError(f"`events.drift` must name priors of the file, got {got}.")

    @classmethod
    def read(cls, problem):
        """Events are files with all channels, or folders in which `data.files` and `record.path` are."""
        config, events = problem.config, {}
        dofs = checked_dofs(config, problem.expected.n_dof)
        for name, path in places(config.events, problem.folder).items():
            folder = path if path.is_dir() else path.parent
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                try:
                    events[name] = cls.of_files(problem, of_event(config, path), folder, dofs)
                except ConfigError as error:
                    raise ConfigError(f"event {name}: {error}") from error
            for warning in caught:
                warnings.warn(f"{name}: {warning.message}", warning.category, stacklevel=2)
        for event in events.values():
            event.check_likelihood(problem)
        return cls(**{one.name: getattr(event, one.name) for one in fields(event)}, events=events)

    @property
    def is_checked(self):
        return any(event.is_checked for event in self.events.values())

    @property
    def used(self):
        durations = [f"{event.record.duration:.4g}" for event in self.events.values()]
        return f"{len(self.dofs)} measured {self.plural} in events of {listed(durations)} s"

    def prints(self):
        """None: events may be added."""
        return {}

    @property
    def identity(self):
        keys = "base_sha256", "base_interpolation", "channels_sha256"
        prints = [[name, *map(event.prints().get, keys)] for name, event in self.events.items()]
        return hashlib.sha256(json.dumps(prints).encode()).hexdigest()

    def at(self, problem, event: Responses):
        """The problem of one event alone; what was measured besides counts once, with the first."""
        others = problem.data[1:] if event is next(iter(self.events.values())) else ()
        return problem.with_data(event, *others)

    def told(self):
        for name, event in self.events.items():
            for one in event.told():
                yield one if isinstance(one, dict) else f"{name}: {one}"

    def check(self, problem, path):
        for number, event in enumerate(self.events.values(), 1):
            at = path.with_name(f"{path.stem}-{number}{path.suffix}")
            yield from event.check(self.at(problem, event), at)

    def sample(self, problem, likelihood, model, seed, running):
        """The posterior after the last event; that after each one is kept in a folder for each likelihood."""
        asked = self.config.events
        models = [declare(self.at(problem, event), likelihood) for event in self.events.values()]
        free = {rv.name for rv in models[0].free_RVs}
        settings = running.of_sampler(self.config.sampler)
        settings |= asked.model_dump(include={"forgetting", "change"})
        settings["drift"] = {name: value for name, value in asked.drift.items() if name in free}
        out = None if running.out is None else Path(running.out) / FOLDER / likelihood
        states = states_in_sequence(models, out=out, random_seed=seed, **settings)
        try:
            for name in self.events:
                running.progress(f"{likelihood}, {name}")
                idata = next(states)
        except StudyMismatchError:
            raise
        except ValueError as error:
            raise ConfigError(
                f"`priors` must lead to posteriors that can be sampled, after {name}: {error}"
            ) from error
        sequence = idata["sequence"].to_dataset().assign_coords(name=("event", list(self.events)))
        idata["sequence"] = xr.DataTree(sequence)
        return idata, model

    def sentences(self, problem, result, explains):
        kind = kinds_of(result)[0]
        record = result[kind]["sequence"].to_dataset()
        names, changed = record["name"].values, record["probability_changed"].values
        raised, largest = np.flatnonzero(record["alarm"].values), int(changed.argmax())
        last = f"What follows is the state after the last event, {names[-1]}."
        if raised.size:
            told = ", ".join(f"{names[k]} (probability {changed[k]:.3f})" for k in raised)
            yield (
                f"Alarm: under {kind} the structure has changed before {told}; events before the last change "
                f"count no longer. {last}",
                False,
            )
        elif names.size == 1:
            yield f"One event, {names[0]}: there is nothing yet to compare it with.", True
        else:
            yield (
                f"The {names.size} events are those of one structure under {kind}: the largest probability "
                f"of a change is {changed[largest]:.3f}, before {names[largest]}. {last}",
                True,
            )
        yield from super().sentences(problem, result, explains)

    def tables(self, problem, result):
        rows = [(kind, *row) for kind in kinds_of(result) for row in event_rows(result[kind]["sequence"])]
        own = table("events", "events", "From event to event", COLUMNS, rows, MEANING)
        return [*super().tables(problem, result), own]

    def figures_of(self, problem, part, kind):
        def draw():
            axes = plots.sequence(part)
            for ax in axes:
                ax.set_ylabel(f"{ax.get_ylabel()} [{problem.units.get(ax.get_ylabel(), '-')}]")
            return axes

        return {"events": draw} | super().figures_of(problem, part, kind)


def event_rows(record) -> list[tuple[str, ...]]:
    """Name, log scores, their error, probability of a change and alarm of each event of a sequence."""
    numbers = [record[name].values for name in ("log_score", "log_score_se", "log_score_fresh")]
    scores = np.array([[f"{value:.2f}" for value in row] for row in numbers], dtype=object)
    scores[:2, ~(numbers[1] < UNTOLD) & np.isfinite(numbers[0])] = CANNOT_BE_TOLD
    changed = [f"{value:.3f}" for value in record["probability_changed"].values]
    alarms = ["alarm" if raised else "" for raised in record["alarm"].values]
    return list(zip(record["name"].values.astype(str), *scores, changed, alarms, strict=True))


def places(section, folder: Path) -> dict[str, Path]:
    """Names of events to their files or folders, in order."""
    if section.files is not None:
        return {name: folder / name for name in section.files}
    where, pattern = folder / section.folder, section.pattern or "*"
    if not where.is_dir():
        raise ConfigError(f"`events.folder` must be an existing folder, got {shown(section.folder)}.")
    found = [path for path in where.iterdir() if path.name[0] != "." and fnmatchcase(path.name, pattern)]
    if not found:
        raise ConfigError(
            f"`events.folder` must hold an event or more, got none with a name like {shown(pattern)} in "
            f"{shown(section.folder)}."
        )
    return {path.name: path for path in sorted(found, key=lambda path: by_numbers(path.name))}


def by_numbers(name: str) -> list:
    """A key by which "event-10" comes after "event-9"."""
    parts = re.split(r"(\d+)", name)
    return [(int(part[:300]), part) if number % 2 else (0, part) for number, part in enumerate(parts)]


def of_event(config, path: Path):
    """The configuration as it is for one event alone."""
    if path.is_dir():
        if config.data.files is None:
            raise ConfigError(
                "`data.files` must be given where events are folders: the files in each of them. Or take "
                f"files for events; {path.name} is a folder. `events.pattern` may leave it out."
            )
        return config
    if config.data.files is not None or config.record is not None:
        key = "data.files" if config.data.files is not None else "record"
        raise ConfigError(
            f"`{key}` must be left out where events are files with all channels, got it and {path.name}. Or "
            "make a folder for each event."
        )
    return config.model_copy(update={"data": config.data.model_copy(update={"files": path.name})})
