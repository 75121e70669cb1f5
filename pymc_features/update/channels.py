"""From files to the motion of the base and the measured responses, processed alike."""

from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr

from pymc_features import datasets, signals
from pymc_features.exceptions import ConfigError, DatasetUnavailableError
from pymc_features.io import read_channels, read_record
from pymc_features.records import Record
from pymc_features.update.config.document import Config


@dataclass(frozen=True)
class Measured:
    """What the model is updated with.

    Attributes
    ----------
    record : Record
        Motion of the base.
    channels : DataArray (sensor, time)
        Measured absolute accelerations [m/s^2], from time 0 of the record, at `step`.
    step : float
        Sampling interval of the channels [s], a multiple of the record's.
    source : str
        Where they come from.
    gains : Dataset or None
        What `check_channels` found.
    """

    record: Record
    channels: xr.DataArray
    step: float
    source: str
    gains: xr.Dataset | None

    @property
    def base(self) -> np.ndarray:
        """Motion of the base (time,) at the step of the channels [m/s^2]."""
        from scipy import signal  # a second to import

        stride = round(self.step / self.record.dt)
        return signal.resample_poly(self.record.acceleration, 1, stride)[: self.channels.sizes["time"]]


@contextmanager
def named_key(key: str, **renamed: str):
    """Errors inside get the section `key` in front, and the keys for arguments that are `renamed`."""
    try:
        yield
    except (ConfigError, DatasetUnavailableError):
        raise
    except (ValueError, TypeError, OSError) as error:
        text = str(error)
        for argument, name in renamed.items():
            text = text.replace(f"`{argument}`", f"`{name}`")
        raise ConfigError(f"[{key}]: {text}") from error


def read_measured(config: Config, folder: Path) -> Measured:
    """Read, process and check the channels of a configuration; files are relative to `folder`.

    Raises
    ------
    ConfigError
        If a file is missing or broken, a sensor is not in it, or a step of the processing fails; the message
        names the key.
    """
    with named_key("data", path="files"):
        channels, source = read_all(config, folder)
    known = [str(name) for name in channels["sensor"].values]
    wanted = ([] if config.data.base is None else [config.data.base]) + list(config.data.sensors)
    for name in wanted:
        if name not in known:
            key = "base" if name == config.data.base else "sensors"
            raise ConfigError(f"`data.{key}` must be among the sensors {', '.join(known)}, got {name!r}.")
    channels = channels.isel(sensor=[known.index(name) for name in wanted])
    if config.record is None:
        motion = None
    else:
        with named_key("record"):
            motion = read_motion(config, folder, signals.sampling_step(channels))
            common = min(motion.sizes["time"], channels.sizes["time"])
            channels = xr.concat(
                [motion.isel(time=slice(common)), channels.isel(time=slice(common)).drop_attrs()],
                dim="sensor",
                join="override",
            ).assign_attrs(channels.attrs)
    channels, gains = processed(channels, config)
    base, floors = channels.isel(sensor=0), channels.isel(sensor=slice(1, None))
    name = source if config.record is None else Path(config.record.path).name
    record = Record.from_channel(base, name=f"{config.data.base or 'ground motion'}, {name}")
    factor = config.processing.decimate
    with named_key("processing.decimate"):
        floors = signals.decimate(floors, factor)
    return Measured(record, floors, factor * record.dt, source, gains)


def read_all(config, folder) -> tuple[xr.DataArray, str]:
    """All channels of the files or the data set, and what they are called."""
    data = config.data
    if data.dataset is not None:
        return datasets.mini_shake_table(data.event), f"{data.dataset} ({data.event})"
    files = data.files
    if isinstance(files, dict):
        paths, names = {name: folder / file for name, file in files.items()}, list(files.values())
    elif isinstance(files, list):
        paths, names = [folder / file for file in files], files
    else:
        paths, names = folder / files, [files]
    keys = ("columns", "units", "dt", "clock", "clock_units", "skip", "wrapped")
    channels = read_channels(paths, **{key: getattr(data, key) for key in keys})
    return channels, ", ".join(Path(name).name for name in names)


def read_motion(config, folder, step) -> xr.DataArray:
    """The ground motion of a file as a channel beside the others."""
    section = config.record
    keys = ("units", "dt", "column", "wrapped")
    record = read_record(folder / section.path, **{key: getattr(section, key) for key in keys})
    if not np.isclose(record.dt, step, rtol=1e-4, atol=0.0):
        raise ConfigError(
            f"`record.dt` must be that of the channels, {step:g} s, got {record.dt:g} s. Resample one."
        )
    return xr.DataArray(
        record.acceleration[None],
        dims=("sensor", "time"),
        coords={"sensor": ["ground motion"], "time": ("time", step * np.arange(record.n_times))},
        name="acceleration",
    )


def processed(channels, config) -> tuple[xr.DataArray, xr.Dataset | None]:
    """Channels after every step of [processing] but the decimation, and what the check found before."""
    asked, gains = config.processing, None
    if asked.detrend is not None:
        with named_key("processing.detrend"):
            channels = signals.detrend(channels, asked.detrend.kind, window=asked.detrend.window)
    if asked.check_band is not None:
        with named_key("processing.check_band"):
            gains = signals.check_channels(channels, band=asked.check_band)
    if asked.band_pass is not None:
        filter_ = asked.band_pass
        with named_key("processing.band_pass"):
            channels = signals.band_pass(channels, filter_.low, filter_.high, order=filter_.order)
    if asked.trim is not None:
        with named_key("processing.trim"):
            channels = signals.trim(channels, *asked.trim)
    return channels, gains
