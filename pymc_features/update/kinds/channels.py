"""From files to the motion of the base and the measured responses, processed alike."""

import warnings
from dataclasses import dataclass, replace
from math import ceil
from pathlib import Path

import numpy as np
import xarray as xr

from pymc_features import datasets, signals
from pymc_features.exceptions import ConfigError
from pymc_features.io import read_channels, read_channels_with_gaps, read_record
from pymc_features.io.reading.labels import SI
from pymc_features.records import EVEN, CyclicTest, Record
from pymc_features.signals.channels import check_window
from pymc_features.update.config.messages import named_key, shown
from pymc_features.update.config.sections import MEASURED
from pymc_features.update.kinds.checks import Checked, check, warn_of_motion
from pymc_features.update.plausibility.prior_modes import PriorModes


@dataclass(frozen=True)
class Measured:
    """What the model is updated with.

    Attributes
    ----------
    record : Record or CyclicTest
        Motion of the base, or displacement of a specimen.
    channels : DataArray (sensor, time)
        Measured absolute accelerations [m/s^2], or forces [N], that are compared, at `step`, NaN in gaps;
        time 0 is that of the record.
    step : float
        Sampling interval of the channels [s], a multiple of the record's.
    source : str
        Where they come from.
    checked : Checked
        What is known of the channels against each other.
    first : int
        Sample of the response that the first of the channels is compared with.
    """

    record: Record | CyclicTest
    channels: xr.DataArray
    step: float
    source: str
    checked: Checked
    first: int = 0

    @property
    def units(self) -> str:
        """Units of the channels."""
        return self.channels.attrs.get("units", "m/s^2")

    @property
    def compared(self) -> slice:
        """Samples of the response, at `step`, that are compared."""
        return slice(self.first, self.first + self.channels.sizes["time"])

    @property
    def samples(self) -> np.ndarray:
        """Numbers (sensor,) of the samples that are compared."""
        return self.channels.notnull().sum("time").values

    @property
    def left_out(self) -> str:
        """Which part of each sensor is left out as a gap; empty without gaps."""
        shares = 100.0 * (1.0 - self.samples / self.channels.sizes["time"])
        named = zip(self.channels["sensor"].values, shares, strict=True)
        return ", ".join(f"{share:.2g} % of {name}" for name, share in named if share > 0.0)

    @property
    def base(self) -> np.ndarray:
        """Motion of the base (time,) at the times of the channels [m/s^2]."""
        from scipy import signal  # a second to import

        stride = round(self.step / self.record.dt)
        return signal.resample_poly(self.record.acceleration, 1, stride)[self.compared]


def base_and_sensors(measured: Measured) -> xr.DataArray:
    """All channels (sensor, time) [m/s^2] after processing, the base first."""
    values = np.vstack([measured.base, measured.channels.values])
    names = ["base", *(str(name) for name in measured.channels["sensor"].values)]
    coords = {"sensor": names, "time": measured.channels["time"].values}
    if measured.units != "m/s^2":
        coords["units"] = "sensor", ["m/s^2", *[measured.units] * (len(names) - 1)]
    return xr.DataArray(values, coords, ("sensor", "time"))


def read_measured(config, folder: Path, prior: PriorModes) -> Measured:
    """Read, correct, check and process the channels of a configuration; files are relative to `folder`.

    Raises
    ------
    ConfigError
        If a file is missing or broken, a sensor is not in it, or a step of the processing fails; the message
        names the key.
    """
    channels, source = read_corrected(config, folder)
    if config.record is None:
        motion = None
    else:
        with named_key("record"):
            motion, first = read_motion(config, folder, signals.sampling_step(channels))
            channels = channels.isel(time=slice(first, None))
            common = min(motion.sizes["time"], channels.sizes["time"])
            channels = xr.concat(
                [motion.isel(time=slice(common)), channels.isel(time=slice(common)).drop_attrs()],
                dim="sensor",
                join="override",
            ).assign_attrs(channels.attrs)
    refuse_gaps_of_the_base(channels.isel(sensor=0), config.data.base)
    channels, checked = processed(channels, config, prior)
    channels = channels.drop_vars("units", errors="ignore")  # of which there may be two
    base = channels.isel(sensor=0).assign_attrs(units="m/s^2")
    floors = channels.isel(sensor=slice(1, None)).assign_attrs(units=SI[MEASURED[config.data.quantity]])
    name = source if config.record is None else Path(config.record.path).name
    title = f"{config.data.base or 'ground motion'}, {name}"
    section = config.data if config.record is None else config.record
    record = Record.from_channel(base, name=title, interpolation=section.interpolation)
    factor = config.processing.decimate
    with named_key("processing.decimate"):
        floors = signals.decimate(floors, factor)
    floors, first = window_of(floors, config.processing.compare)
    silent = np.flatnonzero(floors.isnull().all("time").values)
    if silent.size:
        raise ConfigError(
            f"`data.sensors` must have samples to compare, got a gap from end to end of "
            f"{floors['sensor'].values[silent[0]]} (filters and decimation widen gaps). Leave it out."
        )
    return Measured(record, floors, factor * record.dt, source, checked, first)


def read_corrected(config, folder: Path) -> tuple[xr.DataArray, str]:
    """The channels that [data] names, the base first, corrected as it says; and the names of their files."""
    with named_key("data", path="files"):
        channels, source = read_all(config, folder)
    known = [str(name) for name in channels["sensor"].values]
    wanted = ([] if config.data.base is None else [config.data.base]) + list(config.data.sensors)
    for name in wanted:
        if name not in known:
            key = "base" if name == config.data.base else "sensors"
            raise ConfigError(
                f"`data.{key}` must be among the sensors {', '.join(known)}, got {shown(name)}."
            )
    with named_key("data"):
        channels = signals.correct(channels, scale=config.data.scale, delay=config.data.delay)
        channels = some_rows(channels, config.data.rows)
    return channels.isel(sensor=[known.index(name) for name in wanted]), source


def refuse_gaps_of_the_base(base, name) -> None:
    """The motion that shakes the model must be whole."""
    gaps = base.isnull().values
    if gaps.any():
        start = float(base["time"][int(gaps.argmax())])
        raise ConfigError(
            f"`data.base` must have no gaps, for it shakes the model, got {gaps.sum()} samples missing in "
            f"{name}, the first at {start:g} s. Cut the files to one side by `data.rows`, or give the motion "
            "in [record]."
        )


def window_of(floors, compare) -> tuple[xr.DataArray, int]:
    """The part of the channels that is compared, with its times, and its first sample."""
    if compare is None:
        return floors, 0
    with named_key("processing.compare"):
        low, high = check_window(floors, compare, "compare")
    return floors.isel(time=slice(low, high)), low


def some_rows(channels, rows) -> xr.DataArray:
    """Channels between two rows of their files, times from 0."""
    if rows is None:
        return channels
    if rows[1] > channels.sizes["time"]:
        raise ConfigError(
            f"`data.rows` must lie within the {channels.sizes['time']} rows of the files, got {list(rows)}."
        )
    step = signals.sampling_step(channels)
    return signals.trim(channels, *(float(channels["time"][0]) + step * np.array([rows[0], rows[1] - 1])))


def read_all(config, folder) -> tuple[xr.DataArray, str]:
    """All channels of the files or the data set, and what they are called."""
    data = config.data
    if data.dataset is not None:
        return datasets.mini_shake_table(data.event), f"{data.dataset} ({data.event})"
    files = data.files
    if isinstance(files, dict):
        paths = {name: of_sensor(file, folder, data, name) for name, file in files.items()}
        names = [entry["file"].name for entry in paths.values()]
    elif isinstance(files, list):
        paths, names = [folder / file for file in files], files
    else:
        paths, names = folder / files, [files]
    keys = ("columns", "units", "dt", "clock", "clock_units", "skip", "wrapped", "resample")
    settings = {key: getattr(data, key) for key in keys}
    source = ", ".join(Path(name).name for name in names)
    if data.gaps == "leave_out":
        return read_channels_with_gaps(paths, **settings), source
    try:
        return read_channels(paths, **settings), source
    except ValueError as error:
        if not has_gaps_alone(paths, settings):
            raise
        raise ValueError(f'{error} Or leave out what is missing by gaps = "leave_out".') from error


def of_sensor(given, folder, data, name) -> dict:
    """What `read_channels` is told of one sensor."""
    settings = {"file": given} if isinstance(given, str) else given.settings
    quantity = "acceleration" if name == data.base else MEASURED[data.quantity]
    return settings | {"file": folder / settings["file"], "quantity": quantity}


def has_gaps_alone(paths, settings) -> bool:
    """Whether files can be read if samples may be missing."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return bool(read_channels_with_gaps(paths, **settings).isnull().any())
    except (ValueError, TypeError, OSError):
        return False


def read_motion(config, folder, step) -> tuple[xr.DataArray, int]:
    """The ground motion of a file as a channel at the step of the others [s], and its first sample."""
    section = config.record
    keys = ("units", "dt", "column", "wrapped")
    record = read_record(folder / section.path, **{key: getattr(section, key) for key in keys})
    record = replace(record, interpolation=section.interpolation)
    if section.delay or not np.isclose(record.dt, step, rtol=1e-4, atol=0.0):
        record = record.resampled(step, delay=section.delay)
    motion = xr.DataArray(
        record.acceleration[None],
        dims=("sensor", "time"),
        coords={"sensor": ["ground motion"], "time": ("time", step * np.arange(record.n_times))},
        name="acceleration",
    )
    return motion, ceil(max(section.delay, 0.0) / step - EVEN)


def detrended(channels, asked) -> xr.DataArray:
    """Channels less what [processing] names as their offset or line."""
    if asked.detrend is None:
        return channels
    with named_key("processing.detrend"):
        return signals.detrend(channels, asked.detrend.kind, window=asked.detrend.window)


def processed(channels, config, prior) -> tuple[xr.DataArray, Checked]:
    """Channels after every step of [processing] but the decimation, and what the check found before."""
    asked = config.processing
    channels = detrended(channels, asked)
    with named_key("processing.check_band"):
        checked = check(channels, config, prior)
    if asked.band_pass is not None:
        filter_ = asked.band_pass
        with named_key("processing.band_pass"):
            channels = signals.band_pass(channels, filter_.low, filter_.high, order=filter_.order)
    if asked.trim is not None:
        with named_key("processing.trim"):
            warn_of_motion(channels, asked.trim[0], checked.compared.first or prior.first)
            channels = signals.trim(channels, *asked.trim)
    return channels, checked


def checked_dofs(config, size) -> list[int]:
    """A degree of freedom for each sensor."""
    sensors, dofs = config.data.sensors, config.data.dofs
    if dofs is None:
        if len(sensors) != size:
            raise ConfigError(
                f"`data.sensors` must be one for each of the {size} degrees of freedom of the structure, got "
                f"{len(sensors)}. Say by `data.dofs` where they are."
            )
        return list(range(size))
    if len(dofs) != len(sensors):
        raise ConfigError(
            f"`data.dofs` must have one value for each of the {len(sensors)} sensors, got {len(dofs)}."
        )
    if len(set(dofs)) < len(dofs) or not all(0 <= dof < size for dof in dofs):
        raise ConfigError(
            f"`data.dofs` must be different numbers from 0 to {size - 1}, got {shown(dofs)}. 0 is next "
            "to the base."
        )
    return dofs
