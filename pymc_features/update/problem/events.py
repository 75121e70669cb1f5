"""The events of a configuration, each with the channels it was measured by."""

import re
import warnings
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple

from pymc_features.exceptions import ConfigError
from pymc_features.update.config.document import Config
from pymc_features.update.config.messages import shown
from pymc_features.update.plausibility.prior_modes import PriorModes
from pymc_features.update.problem.channels import Measured, read_measured


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


def read_events(config: Config, folder: Path, prior: PriorModes) -> tuple[Event, ...]:
    """Read, correct, check and process the channels of every event, all in the same way.

    An event is a file with all channels, or a folder in which `data.files` and `record.path` are.

    Raises
    ------
    ConfigError
        If there are no events, or one cannot be read; the message names it.

    Warns
    -----
    ChannelWarning
        If a channel is suspicious; the message names the event.
    """
    events = []
    for name, path in places(config.events, folder).items():
        own = of_event(config, path)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                measured = read_measured(own, path if path.is_dir() else path.parent, prior)
            except ConfigError as error:
                raise ConfigError(f"event {name}: {error}") from error
        for warning in caught:
            warnings.warn(f"{name}: {warning.message}", warning.category, stacklevel=2)
        events.append(Event(name, measured))
    return tuple(events)


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


def of_event(config: Config, path: Path) -> Config:
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
