"""What acts on a structure: evenly sampled histories that begin with the structure at rest."""

from dataclasses import fields
from typing import Literal

import numpy as np

Interpolation = Literal["band-limited", "linear"]
INTERPOLATIONS = "band-limited", "linear"


class DynamicLoad:
    """What acts on a structure that is at rest at the first sample.

    Structures and simulators take a `Record`, `Loading` or `CyclicTest` by these attributes alone.

    Attributes
    ----------
    inputs : array (input, time)
        Accelerations of the base or the supports [m/s^2], forces [N], or a displacement [m].
    is_force, is_displacement : bool
        Whether they are forces, or a prescribed displacement.
    dt : float
        Sampling interval [s].
    name : str
        For figures and messages.
    interpolation : str
        What it is between its samples: "linear", or "band-limited", without content above half the sampling
        rate.
    """

    inputs: np.ndarray
    is_force: bool = False
    is_displacement: bool = False
    dt: float
    name: str
    interpolation: Interpolation = "linear"

    def first(self, n_times: int) -> "DynamicLoad":
        """Cut the load to its first samples."""
        raise NotImplementedError

    def __reduce__(self):
        values = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        return _made_anew, (type(self), values)

    @property
    def n_inputs(self) -> int:
        """Number of histories."""
        return self.inputs.shape[0]

    @property
    def n_times(self) -> int:
        """Number of samples."""
        return self.inputs.shape[1]

    @property
    def time(self) -> np.ndarray:
        """Sampling times (time,) [s], from 0."""
        return np.arange(self.n_times) * self.dt

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return (self.n_times - 1) * self.dt


def _made_anew(kind, values):
    """A load of copies, so that the arrays of a deep or pickled copy are read-only as well."""
    return kind(**{name: np.array(v) if isinstance(v, np.ndarray) else v for name, v in values.items()})
