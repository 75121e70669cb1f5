"""A ground-motion record: evenly sampled base acceleration in m/s^2."""

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, eq=False, repr=False)
class Record:
    """An evenly sampled ground acceleration, immutable.

    Between its samples the acceleration is taken as linear; the structure is at rest at the first.

    Parameters
    ----------
    acceleration : array_like (time,)
        Ground acceleration [m/s^2]; copied, float64, at least two finite samples.
    dt : float
        Sampling interval [s], positive.
    name : str
        What figures and messages call the record.

    Raises
    ------
    ValueError
        If the acceleration is not a one-dimensional series of finite numbers or `dt` is not positive.

    Examples
    --------
    >>> record = Record([0.0, 1.5, -3.0], dt=0.02, name="pulse")
    >>> record.n_times, record.pga, record.duration
    (3, 3.0, 0.04)
    """

    acceleration: np.ndarray = field()
    dt: float
    name: str = ""

    def __post_init__(self):
        try:
            acceleration = np.array(self.acceleration, dtype=np.float64)
        except (TypeError, ValueError):
            raise TypeError(
                f"`acceleration` must be an array of numbers in m/s^2, got "
                f"{type(self.acceleration).__name__}. Read files with `read_record`."
            ) from None
        if acceleration.ndim != 1 or acceleration.size < 2:
            raise ValueError(
                f"`acceleration` must be one-dimensional with at least 2 samples, got shape "
                f"{acceleration.shape}. Pass one component of the ground motion."
            )
        if not np.isfinite(acceleration).all():
            bad = int(np.flatnonzero(~np.isfinite(acceleration))[0])
            raise ValueError(
                f"`acceleration` must be finite, got {acceleration[bad]} at sample {bad}. "
                "Fill or cut the gap first."
            )
        try:
            dt = float(self.dt)
        except (TypeError, ValueError):
            raise TypeError(
                f"`dt` must be a number, got {self.dt!r}. Pass the sampling interval in seconds."
            ) from None
        if not 0.0 < dt < np.inf:
            raise ValueError(f"`dt` must be positive, got {dt}. Pass the sampling interval in seconds.")
        acceleration.setflags(write=False)
        object.__setattr__(self, "acceleration", acceleration)
        object.__setattr__(self, "dt", dt)
        object.__setattr__(self, "name", str(self.name))

    def __repr__(self):
        label = f"{self.name!r}, " if self.name else ""
        return (
            f"Record({label}{self.n_times} samples, dt={self.dt:g} s, "
            f"duration={self.duration:.4g} s, pga={self.pga:.4g} m/s^2)"
        )

    def __len__(self):
        return self.n_times

    def __reduce__(self):
        # made anew, so that the array of a deep or pickled copy is read-only as well
        return type(self), (np.array(self.acceleration), self.dt, self.name)

    @property
    def n_times(self) -> int:
        """Number of samples."""
        return self.acceleration.size

    @property
    def time(self) -> np.ndarray:
        """Sampling times (time,) [s], from 0."""
        return np.arange(self.n_times) * self.dt

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return (self.n_times - 1) * self.dt

    @property
    def pga(self) -> float:
        """Peak ground acceleration, the largest absolute value [m/s^2]."""
        return float(np.abs(self.acceleration).max())
