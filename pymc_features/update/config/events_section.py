"""The section [events]: one structure in several events, one after another."""

from typing import Annotated

from pydantic import Field, model_validator

from pymc_features.exceptions import ConfigError
from pymc_features.likelihoods import LIKELIHOODS
from pymc_features.update.config.messages import shown
from pymc_features.update.config.sections import Section, key

FEWEST_DRAWS = 100  # to which a density is fitted


class Events(Section):
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


def check_events(config) -> None:
    """Other sections say nothing that cannot be done event by event.

    Raises
    ------
    ConfigError
        If one does; the message names the key.
    """
    if config.data is None:
        raise ConfigError(
            "`events` must be left out without [data], got it. Events are measured responses; several tests "
            "of modes are rows of one table."
        )
    if config.data.dataset is not None:
        raise ConfigError(
            "`events` must be left out with `data.dataset`, got both. Name the files of each event."
        )
    if config.likelihood is None:
        raise ConfigError("`likelihood` must be given with [events]: a table.")
    refused = [kind for kind, entry in LIKELIHOODS.items() if entry.calibrates or entry.is_likelihood_free]
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
            f"`sampler.draws` must be at least {FEWEST_DRAWS} with [events], got {asked.draws}. They are the "
            "prior of the next event."
        )
    for name in config.events.drift:
        if name not in config.priors:
            raise ConfigError(
                f"`events.drift` must name priors of the file, got {shown(name)}. Known here: "
                f"{', '.join(config.priors)}."
            )
