"""One structure in several events, one after another: [events], and what their sequence says."""

import hashlib
import json
import re
import warnings
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import xarray as xr
from pydantic import Field, model_validator

from pymc_features import plots
from pymc_features._checks import listed
from pymc_features.events.sequence import states_in_sequence
from pymc_features.exceptions import ConfigError, StudyMismatchError
from pymc_features.likelihoods import LIKELIHOODS
from pymc_features.update.config.messages import shown
from pymc_features.update.config.sections import Section, key
from pymc_features.update.kinds.base import Setting
from pymc_features.update.kinds.channels import Measured, checked_dofs, read_measured
from pymc_features.update.kinds.histories import prints_of
from pymc_features.update.kinds.model import declare
from pymc_features.update.kinds.responses import Responses, check_likelihood
from pymc_features.update.presentation.shown import Figure

FEWEST_DRAWS = 100  # to which a density is fitted
FOLDER = "sequence"  # beside the parts of an update
COLUMNS = (
    "event",
    "log score",
    "standard error",
    "of a structure unknown before",
    "probability of a change",
    "",
)
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

    folder: str | None = key(
        "a folder that holds a file or a folder for each event, in the order of their names", None
    )
    pattern: str | None = key('which names in `folder` are events, as "*.csv"', None)
    files: list[str] | None = key(
        "a list of files or folders, one for each event in their order", None, min_length=1
    )
    drift: dict[str, Annotated[float, Field(gt=0)]] = key(
        "a table of priors to positive numbers, the standard deviations by which they move between events", {}
    )
    forgetting: float = key("a number above 0 and at most 1", 1.0, gt=0, le=1)
    change: float = key("a probability between 0 and 1", 0.005, gt=0, lt=1)

    @model_validator(mode="after")
    def one_source(self):
        """A folder or a list."""
        if (self.folder is None) == (self.files is None):
            raise ValueError("must have one of the keys `folder` and `files`, got both or neither")
        if self.pattern is not None and self.folder is None:
            raise ValueError("must have `pattern` only with `folder`, got it with `files`")
        if self.files is not None and len(set(self.files)) < len(self.files):
            raise ValueError(f"must name each event once, got {shown(self.files)}")
        return self


class Event(NamedTuple):
    """One event.

    Attributes
    ----------
    name : str
        Of its file or folder.
    measured : Measured
        Motion of the base, and measured responses.
    """

    name: str
    measured: Measured


@dataclass(frozen=True)
class Events(Responses):
    """Measured responses of several events; `measured` is the last of them.

    Attributes
    ----------
    events : tuple of Event
        In their order.
    """

    events: tuple[Event, ...] = ()

    key, section = "events", EventsSection

    @classmethod
    def is_asked(cls, config):
        """Several records, each with its excitation."""
        return config.events is not None

    @classmethod
    def check_sections(cls, config):
        """Other sections say nothing that cannot be done event by event."""
        if config.data is None:
            raise ConfigError(
                "`events` must be left out without [data], got it. Events are measured responses; several "
                "tests of modes are rows of one table."
            )
        if config.data.dataset is not None:
            raise ConfigError(
                "`events` must be left out with `data.dataset`, got both. Name the files of each event."
            )
        if config.likelihood is None:
            raise ConfigError("`likelihood` must be given with [events]: a table.")
        refused = [
            kind for kind, entry in LIKELIHOODS.items() if entry.calibrates or entry.is_likelihood_free
        ]
        if found := [kind for kind in config.likelihood.kinds if kind in refused]:
            taken = ", ".join(kind for kind in LIKELIHOODS if kind not in refused)
            raise ConfigError(
                f"`likelihood.kinds` must not have {found[0]} with [events], for its posterior cannot be the "
                f"prior of the next event. Take {taken}."
            )
        asked = config.sampler
        if asked.method != "auto":
            raise ConfigError(f'`sampler.method` must be "auto" with [events], got {asked.method!r}.')
        if asked.draws < FEWEST_DRAWS:
            raise ConfigError(
                f"`sampler.draws` must be at least {FEWEST_DRAWS} with [events], got {asked.draws}. They are "
                "the prior of the next event."
            )
        for name in config.events.drift:
            if name not in config.priors:
                raise ConfigError(
                    f"`events.drift` must name priors of the file, got {shown(name)}. Known here: "
                    f"{', '.join(config.priors)}."
                )
        super().check_sections(config)

    @classmethod
    def read(cls, given: Setting):
        """Read, correct, check and process the channels of every event, all in the same way.

        An event is a file with all channels, or a folder in which `data.files` and `record.path` are.
        """
        config, folder = given.config, given.folder
        dofs = checked_dofs(config, given.expected.n_dof)
        events = []
        for name, path in places(config.events, folder).items():
            own = of_event(config, path)
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                try:
                    measured = read_measured(own, path if path.is_dir() else path.parent, given.prior)
                except ConfigError as error:
                    raise ConfigError(f"event {name}: {error}") from error
            for warning in caught:
                warnings.warn(f"{name}: {warning.message}", warning.category, stacklevel=2)
            events.append(Event(name, measured))
        check_likelihood(given, dofs, [event.measured for event in events])
        return cls(config, events[-1].measured, dofs, tuple(events))

    @property
    def is_checked(self):
        """Whether any event was."""
        return any(event.measured.checked.is_any for event in self.events)

    def alone(self, event: Event) -> Responses:
        """The responses of one event."""
        return Responses(self.config, event.measured, self.dofs)

    def told(self):
        """Say what was read of each event."""
        for event in self.events:
            for one in self.alone(event).told():
                yield one if isinstance(one, dict) else f"{event.name}: {one}"

    def check(self, problem, path):
        """Each event into a file of its own."""
        for number, event in enumerate(self.events, 1):
            at = path.with_name(f"{path.stem}-{number}{path.suffix}")
            yield from self.alone(event).check(self.at(problem, event), at)

    def figures_of(self, problem, part, kind):
        """Add the parameters from event to event to the figures of histories."""
        units = {name: problem.unit(name) for name in problem.priors}
        return [
            Figure(
                f"{kind}_events",
                f"{kind}: mean and 90 % interval of each parameter after each event, with the alarms.",
                lambda: draw_events(part, units),
            ),
            *super().figures_of(problem, part, kind),
        ]

    def prints(self):
        """None: events may be added."""
        return {}

    @property
    def identity(self):
        """What all events are recognised by."""
        prints = [[event.name, *prints_of(event.measured).values()] for event in self.events]
        return hashlib.sha256(json.dumps(prints).encode()).hexdigest()

    @property
    def used(self):
        """How many histories of what, in which events."""
        durations = [f"{event.measured.record.duration:.4g}" for event in self.events]
        return f"{len(self.dofs)} measured {self.plural} in events of {listed(durations)} s"

    def at(self, problem, event: Event):
        """The problem of one event alone; what was measured besides counts once, with the first."""
        others = problem.data[1:] if event is self.events[0] else ()
        return problem.with_data(self.alone(event), *others)

    def sample(self, problem, likelihood, model, seed, running):
        """The posterior after the last event; that after each one is kept in a folder for each likelihood."""
        asked, sampler = self.config.events, self.config.sampler
        models = [declare(self.at(problem, event), likelihood) for event in self.events]
        free = {rv.name for rv in models[0].free_RVs}
        states = states_in_sequence(
            models,
            out=None if running.out is None else Path(running.out) / FOLDER / likelihood,
            draws=sampler.draws,
            chains=sampler.chains,
            random_seed=seed,
            cores=running.cores or sampler.cores,
            executor=running.workers,
            progressbar=running.progressbar,
            drift={name: value for name, value in asked.drift.items() if name in free},
            forgetting=asked.forgetting,
            change=asked.change,
        )
        try:
            for event in self.events:
                running.tell(f"{likelihood}, {event.name}")
                idata = next(states)
        except StudyMismatchError:
            raise
        except ValueError as error:
            raise ConfigError(
                f"`priors` must lead to posteriors that can be sampled, after {event.name}: {error}"
            ) from error
        names = [event.name for event in self.events]
        idata["sequence"] = xr.DataTree(idata["sequence"].to_dataset().assign_coords(name=("event", names)))
        return idata, model

    def foretold(self, problem, measured=None):
        """Count the observations of all events together."""
        return super().foretold(problem, [event.measured for event in self.events])


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


def event_rows(part) -> list[tuple[str, ...]]:
    """Cells of each event under one likelihood, as of `COLUMNS`; none without a sequence."""
    if "sequence" not in part.children:
        return []
    record = part["sequence"].to_dataset()
    numbers = ("log_score", "log_score_se", "log_score_fresh")
    scores = np.array([[f"{value:.2f}" for value in record[name].values] for name in numbers], dtype=object)
    is_told = record["log_score_se"].values < UNTOLD
    scores[:2, ~is_told & np.isfinite(record["log_score"].values)] = CANNOT_BE_TOLD
    cells = [
        record["name"].values.astype(str),
        *scores,
        [f"{value:.3f}" for value in record["probability_changed"].values],
        ["alarm" if raised else "" for raised in record["alarm"].values],
    ]
    return list(zip(*cells, strict=True))


def events_verdict(kind, part) -> tuple[str, bool]:
    """Whether the structure has changed, in a sentence, and whether it has not; empty without a sequence."""
    if "sequence" not in part.children:
        return "", True
    record = part["sequence"].to_dataset()
    names, changed = record["name"].values, record["probability_changed"].values
    raised = np.flatnonzero(record["alarm"].values)
    last = f"What follows is the state after the last event, {names[-1]}."
    if raised.size:
        told = ", ".join(f"{names[k]} (probability {changed[k]:.3f})" for k in raised)
        return (
            f"Alarm: under {kind} the structure has changed before {told}; events before the last change "
            f"count no longer. {last}",
            False,
        )
    if names.size == 1:
        return f"One event, {names[0]}: there is nothing yet to compare it with.", True
    largest = int(changed.argmax())
    return (
        f"The {names.size} events are those of one structure under {kind}: the largest probability of a "
        f"change is {changed[largest]:.3f}, before {names[largest]}. {last}",
        True,
    )


def draw_events(part, units):
    """Parameters from event to event, with their units."""
    axes = plots.plot_sequence(part)
    for ax in axes:
        name = ax.get_ylabel()
        ax.set_ylabel(f"{name} [{units.get(name, '-')}]")
    return axes
