"""From files to measured channels, processed alike, and checked against the base and the priors."""

import contextlib
import json
import re
import warnings
from math import ceil
from pathlib import Path

import numpy as np
import xarray as xr

from pymc_features import datasets, signals
from pymc_features.exceptions import ChannelWarning, ConfigError, PriorWarning
from pymc_features.io import read_channels, read_channels_with_gaps
from pymc_features.records import EVEN
from pymc_features.signals.channels import check_window
from pymc_features.update.config.keys import named_key, shown
from pymc_features.update.config.sections import MEASURED
from pymc_features.update.kinds.base import check_dofs
from pymc_features.update.plausibility.findings import Compared, of_data
from pymc_features.update.plausibility.resonances import spectra_of
from pymc_features.update.plausibility.transfer import lags_confirmed, told_by_modes

LOWEST, HIGHEST = 1.0 / 7.0, 0.5  # of the first natural frequency: where the floors follow the base
TOP = 0.55  # the same, of a band that was asked for
NARROWEST = 1.5  # factor between the ends of a band
LAGS = "Check clocks"  # in what is said of them
EXPLAINS_ANY = 0.99  # damping ratio that explains any lag
FOLLOWS = 0.7  # coherence of one floor at least, where nobody has named the band
COHERENT = 0.5  # of a floor with the base, where the base moves
MOVING, QUIET = 0.2, 3.0  # of the rms of the whole, and of the quietest period: a sensor that is in motion
STEADY = 0.02  # of the rms
OFFSET = 1.0  # s: clocks that are not the same, and no lag
NO_CORRECTION = {"scale": 1.0, "delay": 0.0}


def read_corrected(config, folder: Path) -> tuple[xr.DataArray, str]:
    """The channels that [data] names, the base first, corrected as it says; and the names of their files."""
    data = config.data
    with named_key("data", path="files"):
        channels, source = read_all(data, folder)
    known = channels["sensor"].values.astype(str).tolist()
    wanted = [*filter(None, [data.base]), *data.sensors]
    if strangers := [name for name in wanted if name not in known]:
        key = "base" if strangers[0] == data.base else "sensors"
        raise ConfigError(
            f"`data.{key}` must be among the sensors {', '.join(known)}, got {shown(strangers[0])}."
        )
    with named_key("data"):
        channels = signals.correct(channels, scale=data.scale, delay=data.delay)
    if data.rows is not None:
        if data.rows[1] > channels.sizes["time"]:
            raise ConfigError(
                f"`data.rows` must lie within the {channels.sizes['time']} rows, got {list(data.rows)}."
            )
        first, last = (float(channels["time"][row]) for row in (data.rows[0], data.rows[1] - 1))
        channels = signals.trim(channels, first, last)
    return channels.isel(sensor=[known.index(name) for name in wanted]), source


def read_whole(config, folder: Path) -> tuple[xr.DataArray, float, str]:
    """Channels without a motion of the base, after every step of [processing]; their step [s] and files."""
    asked = config.processing
    channels, source = read_corrected(config, folder)
    channels = detrended(channels, asked)
    if asked.trim is not None:
        with named_key("processing.trim"):
            channels = signals.trim(channels, *asked.trim)
    with named_key("processing.decimate"):
        channels = signals.decimate(channels, asked.decimate)
    with named_key("data"):
        return channels, signals.sampling_step(channels), source


def read_all(data, folder) -> tuple[xr.DataArray, str]:
    """Every channel of the files of [data], and the names of the files."""
    if data.dataset is not None:
        return datasets.mini_shake_table(data.event), f"{data.dataset} ({data.event})"
    if isinstance(data.files, dict):
        paths = {}
        for name, given in data.files.items():
            own = {"file": given} if isinstance(given, str) else given.model_dump(exclude_none=True)
            quantity = "acceleration" if name == data.base else MEASURED[data.quantity]
            paths[name] = own | {"file": folder / own["file"], "quantity": quantity}
        names = [own["file"] for own in paths.values()]
    else:
        names = data.files if isinstance(data.files, list) else [data.files]
        paths = [folder / name for name in names] if isinstance(data.files, list) else folder / data.files
    keys = {"columns", "units", "dt", "clock", "clock_units", "skip", "wrapped", "resample"}
    settings = data.model_dump(include=keys, exclude_none=True)
    source = ", ".join(dict.fromkeys(Path(name).name for name in names))
    if data.gaps == "leave_out":
        return read_channels_with_gaps(paths, **settings), source
    try:
        return read_channels(paths, **settings), source
    except ValueError as error:
        advice = ""
        with contextlib.suppress(ValueError, TypeError, OSError), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if read_channels_with_gaps(paths, **settings).isnull().any():  # which are all that is wrong
                advice = ' Or leave out what is missing by gaps = "leave_out".'
        raise ValueError(f"{error}{advice}") from error


def with_motion(channels, section, folder) -> xr.DataArray:
    """Channels below the motion of the base from a file of its own, from where both are known."""
    with named_key("record"):
        step = signals.sampling_step(channels)
        record = section.read(folder)
        if section.delay or not np.isclose(record.dt, step, rtol=1e-4, atol=0.0):
            record = record.resampled(step, delay=section.delay)
    channels = channels.isel(time=slice(ceil(max(section.delay, 0.0) / step - EVEN), None))
    n = min(record.n_times, channels.sizes["time"])
    coords = {"sensor": ["ground motion"], "time": step * np.arange(n)}
    motion = xr.DataArray(record.acceleration[None, :n], coords, ("sensor", "time"), "acceleration")
    both = [motion, channels.isel(time=slice(n)).drop_attrs()]
    return xr.concat(both, dim="sensor", join="override").assign_attrs(channels.attrs)


def detrended(channels, asked) -> xr.DataArray:
    """Channels less what [processing] names as their offset or line."""
    if asked.detrend is None:
        return channels
    with named_key("processing.detrend"):
        return signals.detrend(channels, asked.detrend.kind, window=asked.detrend.window)


def part_compared(floors, asked) -> tuple[xr.DataArray, int]:
    """The part of the channels that is compared, with its times, and its first sample."""
    if asked.compare is None:
        return floors, 0
    with named_key("processing.compare"):
        low, high = check_window(floors, asked.compare, "compare")
    return floors.isel(time=slice(low, high)), low


def checked_dofs(config, size) -> list[int]:
    """A degree of freedom for each sensor."""
    sensors, dofs = config.data.sensors, config.data.dofs
    if len(sensors) != (size if dofs is None else len(dofs)):
        if dofs is None:
            raise ConfigError(
                f"`data.sensors` must be one for each of the {size} degrees of freedom of the structure, got "
                f"{len(sensors)}. Say by `data.dofs` where they are."
            )
        raise ConfigError(
            f"`data.dofs` must have one value for each of the {len(sensors)} sensors, got {len(dofs)}."
        )
    check_dofs("data.dofs", dofs or [], size)
    return list(range(size)) if dofs is None else dofs


def check(channels, config, prior) -> tuple[Compared, xr.Dataset | None, str]:
    """Compare the channels, base first, with the priors, and with each other where floors follow the base."""
    data, asked, kept = config.data, config.processing, config.processing.band_pass
    step = signals.sampling_step(channels)
    start, end = asked.compare or asked.trim or (0.0, channels.sizes["time"] * step)
    pass_band = (0.0, np.inf) if kept is None else (kept.low or 0.0, kept.high or np.inf)
    compared = of_data(channels, step, prior, duration=end - start, pass_band=pass_band)
    for sentence in compared.sentences:
        warnings.warn(sentence, PriorWarning, stacklevel=2)
    if asked.check_band is False:
        return compared, None, "not checked against each other, as the file says"
    band = band_of(asked.check_band, compared, prior)
    if data.quantity != "absolute_acceleration":
        reason = f"{data.quantity} is no motion of the base"
    else:
        reason = "" if band == asked.check_band else why_not(channels, band)
    if reason:
        none = {name: ("sensor", np.full(channels.sizes["sensor"], n)) for name, n in NO_CORRECTION.items()}
        gains = xr.Dataset(none, {"sensor": channels["sensor"].values})
    else:
        gains = gains_of(channels, band, compared)
    if of_modes := told_by_modes(gains, compared.placed):
        warnings.warn(of_modes, ChannelWarning, stacklevel=2)
    if lines := corrections(gains, data):
        warnings.warn(f"If it is so, put into [data]: {'; '.join(lines)}", ChannelWarning, stacklevel=2)
    if reason:
        return compared, None, f"not checked against each other: {reason}"
    return compared, gains, f"checked against each other between {band[0]:.3g} and {band[1]:.3g} Hz"


def band_of(asked, compared, prior) -> tuple[float, float]:
    """Choose where floors follow the base: the band of the file, below the first mode of data or priors."""
    first = prior.first
    if compared.first and (compared.is_contradicted or HIGHEST * first > TOP * compared.first):
        first = compared.first
    if asked is None:
        return LOWEST * first, HIGHEST * first
    if compared.first and asked[1] > TOP * compared.first:
        return asked[0], TOP * compared.first
    return asked


def why_not(channels, band) -> str:
    """Why a band tells nothing; empty if it does."""
    if not band[1] > NARROWEST * band[0]:
        return f"the first mode of the data leaves too little of the band from {band[0]:.3g} Hz on"
    try:
        coherence = signals.low_frequency_gains(channels, band)["coherence"].values[1:]
    except ValueError as error:
        return str(error)
    if not (coherence >= FOLLOWS).any():
        return f"no sensor follows the base between {band[0]:.3g} and {band[1]:.3g} Hz"
    return ""


def gains_of(channels, band, compared) -> xr.Dataset:
    """What `check_channels` finds, without lags that the modes contradict; another clock is refused."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        gains = signals.check_channels(channels, band=band)
        delays = gains["delay"].values[1:]
        if compared.placed is not None and delays.any() and np.abs(delays).max() < OFFSET:
            spectra, factor = spectra_of(channels, compared.step), compared.scale.factor
            if not lags_confirmed(spectra, compared.prior, factor=factor, delays=delays):
                caught.clear()
                gains = signals.check_channels(channels, band=band, damping_ratio=EXPLAINS_ANY)
    for warning in sorted(caught, key=lambda warning: LAGS in str(warning.message)):  # the least of faults
        warnings.warn(warning.message, warning.category, stacklevel=2)
    far = (gains["coherence"].values >= COHERENT) & (np.abs(gains["lag"].values) >= OFFSET)
    for name, lag in zip(gains["sensor"].values[far], gains["lag"].values[far], strict=True):
        raise ConfigError(
            f"`data.files` must have one clock, got {name} {abs(lag):.4g} s "
            f"{'after' if lag > 0 else 'before'} the base. Cut the files to the same time, or set "
            f"`data.delay = {inline({str(name): lag})}`."
        )
    return gains


def corrections(gains, data) -> list[str]:
    """Lines of [data] that put right what was found, with what is corrected already."""
    lines, names = [], gains["sensor"].values.astype(str).tolist()
    found, late = gains["scale"].values, gains["delay"].values
    if (found != 1.0).any():
        given = data.scale if isinstance(data.scale, dict) else dict.fromkeys(names, data.scale or 1.0)
        if (found[1:] == -1.0).all():
            found = np.where(np.arange(len(names)) == 0, -1.0, 1.0)
        scale = {name: given.get(name, 1.0) * float(f) for name, f in zip(names, found, strict=True)}
        lines.append(f"scale = {inline({name: f for name, f in scale.items() if f != 1.0})}")
    if late.any():
        given = data.delay or {}
        delay = given | {name: given.get(name, 0.0) + float(t) for name, t in zip(names, late, strict=True)}
        lines.append(f"delay = {inline({name: t for name, t in delay.items() if t})}")
    if order := gains.attrs.get("order"):
        lines.append(f"sensors = {json.dumps([name for name in order if name in data.sensors])}")
    return lines


def inline(values) -> str:
    """An inline table of the file, keys quoted where they must be."""
    entries = []
    for key, value in values.items():
        name = key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else json.dumps(key)
        entries.append(f"{name} = {float(f'{value:.6g}')}")
    return f"{{ {', '.join(entries)} }}" if entries else "{}"  # which cancels what is there


def warn_of_offsets(channels) -> None:
    """Warn of accelerations whose mean is alike in all quarters, and not small beside what they move."""
    means = np.array([np.nanmean(part, axis=1) for part in np.array_split(channels.values, 4, axis=1)])
    least, most = np.abs(means).min(axis=0), np.abs(means).max(axis=0)
    alike = (np.abs(np.sign(means).sum(axis=0)) == 4) & (least > 0.5 * most)
    stay = alike & (least > STEADY * np.nanstd(channels.values, axis=1))
    if stay.any():
        pairs = zip(channels["sensor"].values[stay], means.mean(axis=0)[stay], strict=True)
        told = ", ".join(f"{name} ({mean:.2g} m/s^2)" for name, mean in pairs)
        warnings.warn(
            f"The mean of {told} is an offset of the sensor: no motion goes on so, and the model has none. "
            'Take it off by `detrend = { kind = "constant" }` in [processing].',
            ChannelWarning,
            stacklevel=2,
        )


def warn_of_motion(channels, start, first_frequency) -> None:
    """Warn of a window that begins while the sensors move: models start at rest."""
    step = signals.sampling_step(channels)
    period = max(2, round(1.0 / (first_frequency * step)))
    first = round((start - float(channels["time"][0])) / step)
    if first <= 0 or channels.sizes["time"] < 4 * period:
        return
    floors = channels.values[1:] - np.nanmean(channels.values[1:], axis=1, keepdims=True)
    floors = np.nan_to_num(floors)  # in gaps nothing is seen to move
    power = np.cumsum(np.pad(floors**2, ((0, 0), (1, 0))), axis=1)
    moving = np.sqrt((power[:, period:] - power[:, :-period]).clip(min=0.0) / period)  # from each sample on
    before, everywhere = moving[:, max(0, first - period)], np.sqrt((floors**2).mean(axis=1))
    in_motion = (before > MOVING * everywhere) & (before > QUIET * moving.min(axis=1))
    if in_motion.any():
        names = ", ".join(channels["sensor"].values[1:][in_motion].astype(str))
        warnings.warn(
            f"`processing.trim` cuts into the motion of {names} at {start:g} s, but the model "
            "starts at rest there. Begin where the structure is at rest, and choose by `processing.compare` "
            "what is compared.",
            ChannelWarning,
            stacklevel=2,
        )
