"""What a worker runs: a part of a population, by a model that it was sent once."""

import os
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pymc_features.smc.density.evaluation import PopulationLogp


class PartResult(NamedTuple):
    """What comes back of a part.

    Attributes
    ----------
    outputs : list of array (p, ...)
        As from `RowFunction`.
    last_error : str
        What the model raised last; empty if nothing did.
    warned : list of tuple (type, str)
        Warnings of this package.
    """

    outputs: list
    last_error: str
    warned: list


class ModelPart:
    """The evaluation of a model on a worker.

    Where it arrives, its functions are called once: machine code that no process of the machine has compiled
    yet is compiled by one of them, while the others wait, and found on disk by these.

    Parameters
    ----------
    logp : PopulationLogp
    """

    def __init__(self, logp: PopulationLogp):
        self.logp = logp

    def __call__(self, which: str, particles: np.ndarray | None) -> PartResult | None:
        """Raw outputs of `values` or `slopes` of particles (p, d); none only loads the model."""
        if particles is None:
            return None
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            outputs = getattr(self.logp, which)(particles)
        told = [(w.category, str(w.message)) for w in caught if is_ours(w.category)]
        return PartResult(outputs, self.logp.last_error, told)

    def __setstate__(self, state):
        self.__dict__.update(state)
        with one_process_at_a_time():
            for function in (self.logp.values, self.logp.slopes):
                if function is not None:
                    function(self.logp.start)


def is_ours(category: type) -> bool:
    """Whether a warning is one of this package."""
    return category.__module__.partition(".")[0] == "pymc_features"


@contextmanager
def one_process_at_a_time() -> Iterator[None]:
    """Wait for other processes of this user and machine, where the system can do that."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    path = Path(tempfile.gettempdir()) / f"pymc_features-{os.getuid()}.lock"
    try:
        file = open(path, "a")  # noqa: SIM115  closed below, which frees the lock
    except OSError:  # each compiles by itself
        yield
        return
    with file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
