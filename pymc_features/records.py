"""What acts on a structure: a ground-motion record, histories of supports or forces, or a displacement.

Evenly sampled histories that begin with the structure at rest.
"""

from collections.abc import Hashable
from dataclasses import dataclass, field, fields, replace
from math import ceil, floor
from typing import TYPE_CHECKING, Literal, Self

import numpy as np

from pymc_features import band_limited
from pymc_features._checks import (
    as_numbers,
    check_choice,
    check_finite,
    check_integer,
    check_number,
    check_step,
    check_title,
    is_among,
    shown,
    single,
    step_or_rate,
)

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import ArrayLike
    from pytensor.compile.sharedvalue import SharedVariable

Interpolation = Literal["band-limited", "linear"]
INTERPOLATIONS = "band-limited", "linear"
KINDS = {"support_acceleration": "m/s^2", "force": "N"}
FILL = "Fill or cut the gap first."
EVEN = 1e-6  # of a step: differences of times below this are rounding


class DynamicLoad:
    """What acts on a structure that is at rest at the first sample.

    Structures and simulators take a `Record`, `Loading` or `structures.CyclicTest` by these attributes alone.

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
    history : str
        Name of the argument with the samples (..., time).
    data : SharedVariable or None
        The `pm.Data` that the samples were passed as; they are those of its values when the load was made.
    """

    inputs: np.ndarray
    is_force: bool = False
    is_displacement: bool = False
    dt: float
    name: str
    interpolation: Interpolation = "linear"
    history: str
    data = None

    def _set(self, **values) -> None:
        """Set attributes of a frozen instance."""
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def _keep(self, **values) -> None:
        """Set these attributes, and the interval and the name, checked."""
        self._set(**values, dt=check_step(self.dt), name=check_title(self.name))

    def _series(self, advice: str, more: str) -> np.ndarray:
        """The samples (time,) as numbers, at least two and all finite."""
        samples = as_numbers(getattr(self, self.history), self.history, advice)
        if samples.ndim != 1 or samples.size < 2:
            raise ValueError(
                f"`{self.history}` must be one-dimensional with at least 2 samples, got shape "
                f"{samples.shape}. {more}"
            )
        check_finite(samples, self.history, FILL)
        return samples

    def first(self, n_times: int) -> Self:
        """Cut the load to its first samples."""
        n_times = check_integer(n_times, "n_times", least=2)
        return replace(self, **{self.history: getattr(self, self.history)[..., :n_times]})

    def __len__(self):
        return self.n_times

    @property
    def _label(self) -> str:
        return f"{self.name!r}, " if self.name else ""

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
    def fs(self) -> float:
        """Sampling rate [Hz]."""
        return 1.0 / self.dt

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


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Record(DynamicLoad):
    """An evenly sampled ground acceleration, immutable.

    The structure is at rest at the first sample.

    Parameters
    ----------
    acceleration : array_like or pm.Data (time,)
        Ground acceleration [m/s^2]; copied, float64, at least two finite samples. Of `pm.Data` a
        model takes the motion that `pm.set_data` gives it, of any length; what else is made of the record
        (`simulate`, figures, `first`, `resampled`) has the samples of when it was declared.
    dt : float
        Sampling interval [s], positive.
    name : str
        What figures and messages call the record.
    fs : float
        Sampling rate [Hz], in place of `dt`.
    interpolation : str
        What the acceleration is between its samples: "band-limited" (default), without content above half
        the sampling rate, as what an anti-aliasing filter has passed; or "linear", as records that are
        published as straight lines. A straight line lowers a component of frequency f by
        sinc(f dt)^2: 3 % at a tenth of the sampling rate.

    Raises
    ------
    ValueError
        If the acceleration is not a one-dimensional series of finite numbers, `dt` is not positive, or there
        is no such interpolation.

    Examples
    --------
    >>> record = Record([0.0, 1.5, -3.0], dt=0.02, name="pulse")
    >>> record.n_times, record.pga, record.duration
    (3, 3.0, 0.04)
    """

    acceleration: np.ndarray
    dt: float
    name: str
    interpolation: Interpolation
    history = "acceleration"

    def __init__(
        self,
        acceleration: "ArrayLike | SharedVariable",
        dt: float | None = None,
        name: str = "",
        *,
        fs: float | None = None,
        interpolation: Interpolation = "band-limited",
    ):
        dt = step_or_rate(dt, fs)
        self._set(acceleration=acceleration, dt=dt, name=name, interpolation=interpolation)
        advice = "Pass m/s^2, or read files with `read_record`."
        if hasattr(acceleration, "get_value"):  # PyTensor is not imported to read a record
            self._set(data=acceleration, acceleration=acceleration.get_value())
        samples = self._series(advice, "Pass one component of the ground motion.")
        check_choice(interpolation, "interpolation", INTERPOLATIONS)
        self._keep(acceleration=samples)

    @classmethod
    def from_channel(
        cls,
        channels: "xr.DataArray",
        sensor: Hashable | None = None,
        name: str | None = None,
        *,
        interpolation: Interpolation = "band-limited",
    ) -> "Record":
        """Make a record of a measured channel, such as the base of a shaking table.

        Parameters
        ----------
        channels : xarray.DataArray (sensor, time) or (time,)
            Accelerations in m/s^2 with an even time coordinate [s], as `read_channels` returns them.
        sensor : optional
            Label of the channel; to be left out if there is only one.
        name : str, optional
            Of the record, that of the sensor by default.
        interpolation : str
            Of the record.

        Raises
        ------
        ValueError, TypeError
            If there is no such sensor, the units are not m/s^2, or the times are not even.
        """
        import xarray as xr  # slow to import, and not needed to read a record

        from pymc_features.signals import sampling_step

        if not isinstance(channels, xr.DataArray):
            raise TypeError(
                f"`channels` must be an xarray.DataArray, got {type(channels).__name__}. "
                "Pass arrays as Record(acceleration, dt)."
            )
        channel = _picked(channels, sensor)
        units = channel.coords["units"].item() if "units" in channel.coords else channel.attrs.get("units")
        if units != "m/s^2":
            raise ValueError(
                f'`channels` must have attrs["units"] "m/s^2", got {units!r}. Convert them, and say so there.'
            )
        label = channel.coords["sensor"].item() if "sensor" in channel.coords else ""
        name = str(label) if name is None else name
        return cls(channel.values, sampling_step(channel), name, interpolation=interpolation)

    def __repr__(self):
        return (
            f"Record({self._label}{self.n_times} samples, dt={self.dt:g} s, "
            f"duration={self.duration:.4g} s, pga={self.pga:.4g} m/s^2)"
        )

    @property
    def inputs(self) -> np.ndarray:
        """The acceleration as one input (1, time)."""
        return self.acceleration[None]

    def resampled(self, dt: float, *, delay: float = 0.0) -> "Record":
        """Return the motion at another sampling interval.

        Parameters
        ----------
        dt : float
            Sampling interval [s], in any ratio to the present one.
        delay : float
            Time of the record's first sample [s], positive or negative; the result has the samples from 0 on
            at which there is a record, the first at or after `delay`.

        Returns
        -------
        Record
            Band-limited records keep their spectrum up to half of the lower sampling rate, to 1e-4 of the
            peak; linear ones are read off their straight lines.

        Raises
        ------
        ValueError
            If fewer than two samples are left.
        """
        dt, delay = check_step(dt), check_number(delay, "delay", "Pass seconds.")
        check_finite(delay, "delay", "Pass seconds.")
        first, last = ceil(max(delay, 0.0) / dt - EVEN), floor((delay + self.duration) / dt + EVEN)
        if last - first < 1:
            raise ValueError(
                f"`delay` must leave two samples of {self.duration:g} s at an interval of {dt:g} s, "
                f"got {delay:g} s. Give the time of the record's first sample."
            )
        times = np.clip(np.arange(first, last + 1) * dt - delay, 0.0, self.duration)
        if self.interpolation == "linear":
            values = np.interp(times, self.time, self.acceleration)
        else:
            values = band_limited.at_times(self.inputs, self.dt, times, dt)[0]
        return replace(self, acceleration=values, dt=dt)

    @property
    def pga(self) -> float:
        """Peak ground acceleration, the largest absolute value [m/s^2]."""
        return float(np.abs(self.acceleration).max())


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Loading(DynamicLoad):
    """Several evenly sampled histories that act together: support accelerations or nodal forces. Immutable.

    The structure is at rest at the first sample.

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
    fs : float
        Sampling rate [Hz], in place of `dt`.
    interpolation : str
        What the values are between their samples, as of `Record`: "band-limited" (default) or "linear".

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

    values: np.ndarray
    dt: float
    kind: str
    matrix: np.ndarray | None
    name: str
    interpolation: Interpolation
    history = "values"

    def __init__(
        self,
        values: "ArrayLike",
        dt: float | None = None,
        kind: str = "support_acceleration",
        matrix: "ArrayLike | None" = None,
        name: str = "",
        *,
        fs: float | None = None,
        interpolation: Interpolation = "band-limited",
    ):
        dt = step_or_rate(dt, fs)
        self._set(values=values, dt=dt, kind=kind, matrix=matrix, name=name, interpolation=interpolation)
        check_choice(self.kind, "kind", KINDS)
        check_choice(self.interpolation, "interpolation", INTERPOLATIONS)
        values = np.atleast_2d(as_numbers(self.values, "values"))
        if values.ndim != 2 or values.shape[1] < 2 or values.shape[0] == 0:
            raise ValueError(
                f"`values` must have shape (input, time) with at least 2 samples, got {values.shape}. "
                "Time is the last axis."
            )
        check_finite(values, "values", FILL)
        self._keep(values=values)
        if self.matrix is not None:
            self._keep(matrix=self._checked_matrix())

    def _checked_matrix(self):
        if self.kind != "force":
            raise ValueError(
                "`matrix` must be left out with support accelerations, got one. "
                "Give the structure an `influence` matrix instead."
            )
        matrix = as_numbers(self.matrix, "matrix")
        if matrix.ndim != 2 or matrix.shape[1] != self.n_inputs:
            raise ValueError(
                f"`matrix` must have shape (n, {self.n_inputs}) to match the inputs, got {matrix.shape}. "
                "Give one column for each input."
            )
        check_finite(matrix, "matrix", FILL)
        return matrix

    def __repr__(self):
        return (
            f"Loading({self._label}{self.kind}, {self.n_inputs} x {self.n_times} samples, dt={self.dt:g} s)"
        )

    @property
    def inputs(self) -> np.ndarray:
        """The values (input, time)."""
        return self.values

    @property
    def is_force(self) -> bool:
        """Whether they are forces."""
        return self.kind == "force"

    def applied(self, shapes: np.ndarray) -> np.ndarray:
        """Work of unit forces in shapes (m, n), shapes times `matrix`, (m, input)."""
        return shapes if self.matrix is None else shapes @ self.matrix

    def places(self, n_dof: int) -> np.ndarray:
        """Which force acts on which of n degrees of freedom (n, input)."""
        matrix = np.eye(n_dof) if self.matrix is None else self.matrix
        if matrix.shape != (n_dof, self.n_inputs):
            raise ValueError(
                f"`matrix` of the forces must have shape ({n_dof}, {self.n_inputs}), got "
                f"{'none' if self.matrix is None else self.matrix.shape}. "
                "Give one row for each degree of freedom and one column for each input."
            )
        return matrix


@dataclass(frozen=True, eq=False, repr=False)
class CyclicTest(DynamicLoad):
    """The displacement that a specimen is taken through, slowly: a quasi-static test. Immutable.

    Between its samples the displacement is taken as linear. The specimen is untouched at zero, and goes
    straight from there to the first sample.

    Parameters
    ----------
    displacement : array_like (time,)
        Prescribed displacement [m], from where the force is zero; copied, float64, at least two finite
        samples.
    dt : float
        Interval of the samples [s], positive. It labels axes and nothing else, for the force does not depend
        on the speed: by default the times are the numbers of the samples.
    name : str
        What figures and messages call the test.

    Raises
    ------
    ValueError
        If the displacement is not a one-dimensional series of finite numbers or `dt` is not positive.

    Examples
    --------
    >>> CyclicTest([0.0, 0.01, -0.01, 0.02], name="column")
    CyclicTest('column', 4 samples, from -0.01 to 0.02 m)
    """

    displacement: np.ndarray = field()
    dt: float = 1.0
    name: str = ""
    is_displacement = True
    history = "displacement"

    def __post_init__(self):
        advice = "Pass m, or read a table with `io.read_cyclic_test`."
        self._keep(displacement=self._series(advice, "Pass the history of one displacement."))

    def __repr__(self):
        low, high = self.displacement.min(), self.displacement.max()
        return f"CyclicTest({self._label}{self.n_times} samples, from {low:.4g} to {high:.4g} m)"

    @property
    def inputs(self) -> np.ndarray:
        """The displacement as one input (1, time)."""
        return self.displacement[None]


def _picked(channels, sensor):
    """One channel (time,) of an array (sensor, time) or (time,)."""
    if sensor is not None:
        labels = channels.coords["sensor"].values.tolist() if "sensor" in channels.coords else []
        if "sensor" not in channels.dims or not is_among(sensor, labels):
            raise ValueError(f"`sensor` must be one of the channels {labels}, got {shown(sensor)}.")
        channels = channels.isel(sensor=labels.index(single(sensor)))
    elif "sensor" in channels.dims and channels.sizes["sensor"] == 1:
        channels = channels.isel(sensor=0)
    if channels.dims != ("time",):
        raise ValueError(
            f"`sensor` must name one channel, got None for an array with dimensions {channels.dims}."
        )
    return channels
