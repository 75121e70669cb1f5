"""What every kind of data says of itself: its section, what was read, and what is made of it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from pymc_features.exceptions import ConfigError
from pymc_features.likelihoods import Likelihood
from pymc_features.structures import Structure
from pymc_features.update.config.entries import priors_in
from pymc_features.update.config.sections import Section
from pymc_features.update.plausibility.prior_modes import PriorModes
from pymc_features.update.presentation.shown import Figure, Verdict


class Setting(NamedTuple):
    """What a kind of data is read with.

    Attributes
    ----------
    config : Config
        The configuration file.
    folder : Path
        Files are relative to it.
    priors : dict
        Names to `Prior`.
    expected : Structure
        At the medians of the priors; of a program the values of its parameters.
    prior : PriorModes or None
        Natural modes of draws of the priors; None without modes.
    """

    config: Any
    folder: Path
    priors: dict[str, Any]
    expected: Structure
    prior: PriorModes | None


class KindOfData:
    """One kind of data of an update; a new one is a file beside this one and a line in `KINDS_OF_DATA`.

    Methods take the `Problem` that the data are part of, and the name of a likelihood.

    Attributes
    ----------
    key, section : str, type
        Name and keys of its section in the file.
    own : tuple of Likelihood
        That no other kind has.
    is_checked : bool
        Whether `read` looks for what is wrong.
    likelihoods : list of str
        That are sampled where it is the first kind of a problem; others join what is sampled.
    dofs : list of int
        Degree of freedom of each sensor.
    """

    key: str
    section: type[Section]
    own: tuple[Likelihood, ...] = ()
    is_checked: bool = True
    likelihoods: list[str]
    dofs: list[int]

    @classmethod
    def is_asked(cls, config) -> bool:
        """Whether a file has such data."""
        return getattr(config, cls.key) is not None

    @classmethod
    def check_sections(cls, config) -> None:
        """Raise ConfigError if another section says what means nothing beside it."""

    @classmethod
    def read(cls, given: Setting) -> "KindOfData":
        """Read and check what the section names; a ConfigError names the key."""
        raise NotImplementedError

    def parameters(self, likelihood: str):
        """Values of the file that are random under a likelihood, besides those of the structure."""
        return ()

    def declare(self, problem, likelihood: str, structure, values, tolerance) -> None:
        """Add what was measured to the PyMC model of the context; `values` are the variables by name."""
        raise NotImplementedError

    def sample(self, problem, likelihood: str, model, seed: int, running) -> tuple[xr.DataTree, Any] | None:
        """Posterior and its model, where it is the first of a problem; None: by the sampler of the file."""
        return None

    def predict(self, problem, likelihood: str, model, idata) -> dict[str, xr.Dataset]:
        """Groups of a result that say what a posterior makes of the data."""
        return {}

    def shared(self, problem, parts) -> dict[str, xr.Dataset]:
        """Groups of the result of all likelihoods, by path."""
        return {}

    def prints(self) -> dict[str, str]:
        """What the data are recognised by, for settings: other data are another problem."""
        return {}

    @property
    def identity(self) -> str:
        """What a finished part is recognised by besides; data that may be added are no other problem."""
        return ""

    @property
    def band(self) -> tuple[float, float]:
        """Frequencies [Hz] that the data have."""
        return 0.0, np.inf

    @property
    def used(self) -> str:
        """What they are, in words."""
        raise NotImplementedError

    def foretold(self, problem) -> list[str]:
        """What likelihoods cannot tell, before anything is sampled."""
        return []

    @property
    def measures(self) -> str:
        """Which motion the measured responses are, and in which unit; empty without responses."""
        return ""

    @property
    def left_out(self) -> str:
        """Which part of each sensor is left out as a gap; empty without gaps."""
        return ""

    @property
    def placed(self) -> dict[str, int]:
        """Names of the sensors to their degrees of freedom."""
        return {}

    def verdict(self, problem, result, kind: str) -> Verdict:
        """Judge how one likelihood of a result meets the data."""
        return Verdict([], True)

    def told(self) -> Iterator[str | dict]:
        """Sentences and tables on what was read."""
        yield from ()

    def check(self, problem, path: Path) -> Iterator[str | dict]:
        """Compare with the priors, and draw both into a file; sentences and tables on what is found."""
        yield from ()

    def tables(self, problem) -> list[dict]:
        """Tables of the report on the data, as of `table`."""
        return []

    def figures(self, problem, result) -> list[Figure]:
        """Figures that all likelihoods share."""
        return []

    def figures_of(self, problem, part, kind: str) -> list[Figure]:
        """Figures of one likelihood."""
        return []

    def drawn(self, problem) -> dict[str, xr.Dataset]:
        """Groups of a result that its page draws besides."""
        return {}

    def drawn_of(self, problem, part) -> dict[str, xr.Dataset]:
        """Groups of one likelihood that its page draws besides."""
        return {}


def check_positive_priors(section: str, asked, names, priors) -> None:
    """Scales have priors of positive numbers."""
    for name in names:
        for item in priors_in(getattr(asked, name)):
            if (middle := priors[item.prior].median) <= 0.0:
                raise ConfigError(
                    f"`{section}.{name}` must be positive, got the prior `priors.{item.prior}` with the "
                    f"median {middle:g}. Take a distribution of positive numbers."
                )
