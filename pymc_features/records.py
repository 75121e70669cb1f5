"""What shakes a structure: a ground-motion record, or several histories of supports or forces."""

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
        dt = _checked_step(self.dt)
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


KINDS = {"support_acceleration": "m/s^2", "force": "N"}


@dataclass(frozen=True, eq=False, repr=False)
class Loading:
    """Several evenly sampled histories that act together: support accelerations or nodal forces. Immutable.

    Between the samples they are taken as linear; the structure is at rest at the first.

    Parameters
    ----------
    values : array_like (input, time) or (time,)
        Support accelerations [m/s^2] or forces [N]; copied, float64, at least two finite samples.
    dt : float
        Sampling interval [s], positive.
    kind : str
        "support_acceleration": one input for each column of the structure's `influence`; or "force".
    matrix : array_like (n, input), optional
        Forces only: the load on degree of freedom i is sum_j matrix[i, j] values[j]. Without it, input i
        acts on degree of freedom i.
    name : str
        What messages call the loading.

    Raises
    ------
    ValueError, TypeError
        If the values are not finite numbers, `dt` is not positive, or shapes do not fit.

    Examples
    --------
    >>> loading = Loading([[0.0, 5.0, 0.0]], dt=0.02, kind="force", matrix=[[0.0], [1.0]])
    >>> loading.n_inputs, loading.n_times
    (1, 3)
    """

    values: np.ndarray = field()
    dt: float
    kind: str = "support_acceleration"
    matrix: np.ndarray | None = None
    name: str = ""

    def __post_init__(self):
        if self.kind not in KINDS:
            raise ValueError(f"`kind` must be one of {', '.join(KINDS)}, got {self.kind!r}.")
        values = np.atleast_2d(_numbers(self.values, "values"))
        if values.ndim != 2 or values.shape[1] < 2 or values.shape[0] == 0:
            raise ValueError(
                f"`values` must have shape (input, time) with at least 2 samples, got {values.shape}. "
                "Time is the last axis."
            )
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "dt", _checked_step(self.dt))
        object.__setattr__(self, "name", str(self.name))
        if self.matrix is not None:
            object.__setattr__(self, "matrix", self._checked_matrix())

    def _checked_matrix(self):
        if self.kind != "force":
            raise ValueError(
                "`matrix` must be left out with support accelerations, got one. "
                "Give the structure an `influence` matrix instead."
            )
        matrix = _numbers(self.matrix, "matrix")
        if matrix.ndim != 2 or matrix.shape[1] != self.n_inputs:
            raise ValueError(
                f"`matrix` must have shape (n, {self.n_inputs}) to match the inputs, got {matrix.shape}. "
                "Give one column for each input."
            )
        return matrix

    def __repr__(self):
        label = f"{self.name!r}, " if self.name else ""
        return f"Loading({label}{self.kind}, {self.n_inputs} x {self.n_times} samples, dt={self.dt:g} s)"

    def __reduce__(self):
        matrix = None if self.matrix is None else np.array(self.matrix)
        return type(self), (np.array(self.values), self.dt, self.kind, matrix, self.name)

    @property
    def n_inputs(self) -> int:
        """Number of histories."""
        return self.values.shape[0]

    @property
    def n_times(self) -> int:
        """Number of samples."""
        return self.values.shape[1]

    @property
    def time(self) -> np.ndarray:
        """Sampling times (time,) [s], from 0."""
        return np.arange(self.n_times) * self.dt

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return (self.n_times - 1) * self.dt


def _numbers(value, name):
    """A read-only float64 copy of finite numbers."""
    try:
        numbers = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise TypeError(f"`{name}` must be an array of numbers, got {type(value).__name__}.") from None
    if not np.isfinite(numbers).all():
        raise ValueError(f"`{name}` must be finite, got NaN or infinity. Fill or cut the gap first.")
    numbers.setflags(write=False)
    return numbers


def _checked_step(dt):
    try:
        step = float(dt)
    except (TypeError, ValueError):
        raise TypeError(
            f"`dt` must be a number, got {dt!r}. Pass the sampling interval in seconds."
        ) from None
    if not 0.0 < step < np.inf:
        raise ValueError(f"`dt` must be positive, got {step}. Pass the sampling interval in seconds.")
    return step
